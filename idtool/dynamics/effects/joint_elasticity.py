"""Joints whose motor and link sides are joined by a spring."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.signal import welch

from idtool.common.arrays import Array, Mask
from idtool.data.filters import DIFFERENCE_REACH, LowPass, differentiate
from idtool.data.signals import Motion
from idtool.dynamics.effects.held_effect import HeldJointEffect
from idtool.dynamics.effects.joint_effect import Held
from idtool.dynamics.effects.survey import Present, Survey
from idtool.dynamics.mechanism import Gear, Mechanism
from idtool.robot.inertia import symmetric
from idtool.robot.model import Model

_DAMPING = 0.05  # of what is critical: harmonic drives and belts have a few per cent
_BANDS = (14.0, 20.0, 28.0, 40.0, 56.0)  # Hz, below one of which torque tells the deflection
_OF_RATE = 0.2  # of the sampling rate, that it is at the most
_CLEAR = 4.0  # of the noise's power density, above which torque tells more than noise
_SPECTRUM = 1024  # samples
_ORDER = 4
MOTOR_FRICTION = (0.0, 0.5, 1.0)  # shares of friction on the motor's side that are tried


class JointElasticity(HeldJointEffect):
    """Motor side less link side = carried torque / stiffness.

    The joint is measured and driven at the motor's side, where its rotors turn; all other effects act at the link's,
    and of friction what ``motor_friction``, a share that may be left out, does not put on the motor's. Forwards it is a
    spring with a damper of 5 % of what is critical for the motor, which needs a rotor or `rotor_inertia` on the joint.

    In the torque equation the link's motion is the measured one less the deflection, which is taken from the measured
    torque, less what the rotors take of it by their prior, up to where that sinks into its noise, 14 to 56 Hz. What
    the rotors take more than they would if they turned with the link is known then too. That of a `rotor_inertia` is
    not: give a heavy rotor under `rotors`.
    """

    id = "joint_elasticity"
    means = "the joint gives under load"
    shows = "quick reversals at high and at low load"
    rank = 1
    by_torque = True
    turning = True
    held = (Held("stiffness", positive=True), Held("motor_friction", most=1.0))

    def __init__(self, model: Model, joint: int, shape: Mapping[str, float] | None = None) -> None:
        super().__init__(model, joint, shape)
        self._rotors = np.zeros((len(model.joints), len(model.joints)))  # torque on each joint per acceleration of each
        for body in model.bodies:
            if body.kind == "rotor":
                axial = float(body.axis @ symmetric(body.pi[4:]) @ body.axis)
                self._rotors += axial * np.outer(body.ratios, body.ratios)
        self._along: Callable[[Motion], Present] | None = None

    @classmethod
    def tried(cls, survey: Survey, joint: int) -> Iterator[Mapping[str, float]]:
        """See `JointEffect.tried`: where teeth have play, what gives is the teeth."""
        if not survey.has("backlash", survey.model.names[joint]):
            for share in MOTOR_FRICTION:
                yield {"motor_friction": share}

    @classmethod
    def slopes(cls, survey: Survey, joint: int, shape: Mapping[str, float], motion: Motion, present: Present) -> Array:
        """See `HeldJointEffect.slopes`: by the compliance, 1 / stiffness."""
        one = cls(survey.model, joint, {"stiffness": 1.0})
        q, v, a = one._deflection(motion, shape["motor_friction"] * present.rubbed(joint))
        return present.moved(motion, joint, -q, -v, -a)

    @classmethod
    def solved(cls, c: float, shape: Mapping[str, float]) -> Mapping[str, float] | None:
        """See `HeldJointEffect.solved`."""
        return {**shape, "stiffness": 1 / c} if c > 0 else None

    def refer(self, model: Callable[[Motion], Present], theta: Array) -> None:
        """See `Effect.refer`."""
        self._along = model

    def true(self, motion: Motion) -> Motion:
        """See `Effect.true`: the link's motion."""
        ahead = np.stack(self._deflection(motion, self._rubbed(motion)))
        return replace(self._moved(motion, -ahead), ahead={**motion.ahead, self.joint: ahead})

    def known(self, motion: Motion) -> Array:
        """See `Effect.known`: what the motor's side takes more than it would if it moved as the link, as given."""
        ahead = motion.ahead[self.joint]
        torque = np.outer(self._rotors[:, self.joint], ahead[2])
        if self.shape["motor_friction"]:
            torque[self.joint] += self._rubbed(self._moved(motion, ahead)) - self._rubbed(motion)
        return torque

    def _rubbed(self, motion: Motion) -> Array | float:
        """Friction on the motor's side that moves so, shape (N,)."""
        share = self.shape["motor_friction"]
        return share * self._along(motion).rubbed(self.joint) if share and self._along is not None else 0.0

    def _moved(self, motion: Motion, by: Array) -> Motion:
        """The motion with the joint's other by q, v and a, shape (3, N)."""
        q, v, a = motion.q.copy(), motion.v.copy(), motion.a.copy()
        for x, change in zip((q, v, a), by, strict=True):
            x[self.joint] += change
        return replace(motion, q=q, v=v, a=a)

    def undefined(self, motion: Motion) -> dict[int, Mask]:
        """Where the deflection is not known, since its filter reaches beyond the samples."""
        edge = min(_low_pass(_BANDS[0], motion.dt).edge, len(motion.t))
        mask = np.zeros(len(motion.t), dtype=bool)
        mask[:edge] = mask[len(mask) - edge :] = True
        return dict.fromkeys(range(len(motion.q)), mask)

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        play = mechanism.gears[self.joint].play if self.joint in mechanism.gears else 0.0
        mechanism.gears[self.joint] = Gear(self.shape["stiffness"], _DAMPING, play, self.shape["motor_friction"])

    def _deflection(self, motion: Motion, rubbed: Array | float) -> tuple[Array, Array, Array]:
        """The deflection and its first two derivatives, shape (N,); ``rubbed`` is friction on the motor's side."""
        dt = motion.dt
        carried = motion.tau[self.joint] - self._rotors[self.joint] @ motion.a - rubbed
        low_pass, r = _low_pass(_band(motion.logged[self.joint], dt), dt), 2 * DIFFERENCE_REACH
        around = np.pad(carried, low_pass.reach + r, mode="reflect", reflect_type="odd")
        x = low_pass(around[None], low_pass.reach, low_pass.reach) / self.shape["stiffness"]
        v = differentiate(x, dt)
        return x[0, r:-r], v[0, r // 2 : -(r // 2)], differentiate(v, dt)[0]


def _band(tau: Array, dt: float) -> float:
    """Up to which frequency a torque stands above its noise [Hz]: beyond, its second derivative is mostly noise."""
    # Not all above the motion is noise: what an encoder's steps make a drive do is torque.
    f, power = welch(tau, 1 / dt, nperseg=min(_SPECTRUM, len(tau)))
    tops = [*_BANDS, *(_BANDS[-1] * 2**k for k in range(1, 5))]
    octaves = [power[(f > top / 2) & (f <= top)] for top in tops if top < 0.5 / dt]
    noise = min((np.median(octave) for octave in octaves if octave.size), default=0.0)
    clear = [np.mean(octave) > _CLEAR * noise if octave.size else False for octave in octaves]
    for band, above in reversed(list(zip(_BANDS, clear, strict=False))[1:]):
        if above and band < _OF_RATE / dt:
            return float(band)
    return _BANDS[0]


@cache
def _low_pass(band: float, dt: float) -> LowPass:
    return LowPass(min(band, _OF_RATE / dt), _ORDER, dt)
