"""Play between a joint's motor and its link."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy import ndimage
from scipy.signal import lfilter

from idtool.common.arrays import Array, Indices, Mask
from idtool.data.signals import Motion
from idtool.dynamics.effects.held_effect import HeldJointEffect
from idtool.dynamics.effects.joint_effect import Held
from idtool.dynamics.effects.joint_elasticity import MOTOR_FRICTION
from idtool.dynamics.effects.probe import spread
from idtool.dynamics.effects.survey import Present, Survey
from idtool.dynamics.mechanism import Gear, Mechanism
from idtool.robot.model import Model

_DAMPING = 0.5  # of what is critical
_NARROW, _WIDE, _TRIED = 3e-4, 0.12, 12  # rad or m
_LEAST, _MOST = 0.25, 3.0  # of the change that the width makes
_BLUR = (0.85, 0.93, 1.0, 1.08, 1.17)  # of the width
_COUNTS = 0.6  # of a blip, where its time is known to milliseconds: leaves least of it on average
_STAYS = 4e-3  # of the width a sample: slower, and the teeth have met
_DIES = 0.02  # s
_GIVES = 2e-3  # s
_LIGHT = 1e-9  # kg·m² or kg


class Backlash(HeldJointEffect):
    """Play of a width between the motor's side, which is measured and driven, and the link's.

    Where the joint has no `joint_elasticity`, the teeth are a spring on which motor and link would swing against each
    other at 200 Hz, half critically damped: needs a rotor or `rotor_inertia` on the joint.

    In the torque equation the link's motion is the measured one less the place of the motor within the play. While the
    teeth are apart, the motor moves as measured and the link falls freely, so that the play closes with carried torque
    / the link's inertia, both as the model without the play has them; where teeth meet they stay. Of friction,
    ``motor_friction``, a share that may be left out, acts on the motor's side, and is not carried.
    """

    id = "backlash"
    means = "play lets the load go after each reversal of the torque"
    shows = "quick reversals of the carried torque, and slow ones"
    held = (Held("width", positive=True), Held("motor_friction", most=1.0))

    def __init__(self, model: Model, joint: int, shape: Mapping[str, float] | None = None) -> None:
        super().__init__(model, joint, shape)
        self._along: Callable[[Motion], Present] | None = None

    @classmethod
    def shapes(cls) -> tuple[str, ...]:
        """See `NamedEffect.shapes`: none, since the moments at which teeth part and meet jump from sample to sample."""
        return ()

    @classmethod
    def scanned(cls) -> tuple[str, ...]:
        """See `NamedEffect.scanned`."""
        return ("width",)

    @classmethod
    def tried(cls, survey: Survey, joint: int) -> Iterator[Mapping[str, float]]:
        """See `JointEffect.tried`: from what gears have to what would be felt by hand."""
        for share in MOTOR_FRICTION:
            for width in spread(_NARROW, _WIDE, _TRIED):
                yield {"width": width, "motor_friction": share}

    @classmethod
    def slopes(cls, survey: Survey, joint: int, shape: Mapping[str, float], motion: Motion, present: Present) -> Array:
        """See `HeldJointEffect.slopes`: all of the change, of which the coefficient should be 1."""
        return _change(motion, joint, shape, present)

    @classmethod
    def solved(cls, c: float, shape: Mapping[str, float]) -> Mapping[str, float] | None:
        """See `HeldJointEffect.solved`."""
        return dict(shape) if _LEAST < c < _MOST else None

    def refer(self, model: Callable[[Motion], Present], theta: Array) -> None:
        """See `Effect.refer`."""
        self._along = model

    def known(self, motion: Motion) -> Array | None:
        """See `Effect.known`."""
        return None if self._along is None else _change(motion, self.joint, self.shape, self._along(motion))

    def undefined(self, motion: Motion) -> dict[int, Mask]:
        """While teeth are apart and until the blow of their meeting has died away, for all that the joint shakes."""
        if self._along is None:
            return {}
        place = _travel(motion, self.joint, self.shape, self._along(motion))
        apart = np.abs(np.gradient(place)) > _STAYS * self.shape["width"]
        reach = max(round(_DIES / motion.dt), 1)
        return dict.fromkeys(range(len(motion.q)), ndimage.binary_dilation(apart, iterations=reach))

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        teeth = mechanism.gears.get(self.joint, Gear(np.inf, _DAMPING))
        rubbing = max(teeth.rubbing, self.shape["motor_friction"])
        mechanism.gears[self.joint] = replace(teeth, play=self.shape["width"], rubbing=rubbing)


def _change(motion: Motion, joint: int, shape: Mapping[str, float], present: Present) -> Array:
    """What play adds to the predicted torque, shape (nv, N); less than all, as a blip at the wrong time is worse."""
    place = _travel(motion, joint, shape, present)
    v = np.gradient(place, motion.dt)
    return _COUNTS * present.moved(motion, joint, -place, -v, -np.gradient(v, motion.dt))


def _travel(motion: Motion, joint: int, shape: Mapping[str, float], present: Present) -> Array:
    """Where the motor is within the play, shape (N,)."""
    carried, inertia = present.carried(motion, joint)
    if shape["motor_friction"]:
        carried = carried - shape["motor_friction"] * present.rubbed(joint)
    return _places(carried / np.maximum(inertia, _LIGHT), shape["width"], motion.dt)


def _places(closing: Array, width: float, dt: float) -> Array:
    """Where the motor is within the play, shape (N,): the mean over widths about the one given.

    Teeth give when they meet: two lags of 2 ms, as good as the spring of `join`. When they meet is known no better
    than to some milliseconds, and a blip that comes too early or too late explains less than none.
    """
    outwards = np.flatnonzero(closing[:-1] > 0), np.flatnonzero(closing[:-1] < 0)
    place = np.mean([_place(closing, outwards, share * width, dt) for share in _BLUR], axis=0)
    pole = np.exp(-dt / _GIVES)
    for _ in range(2):
        place = lfilter([1 - pole], [1, -pole], place, zi=[pole * place[0]])[0]
    return np.asarray(place)


def _place(closing: Array, outwards: tuple[Indices, Indices], width: float, dt: float) -> Array:
    """Where the motor is within a play, in [−width/2, width/2], driven by an acceleration, shape (N,).

    ``outwards`` are the samples at which it is driven up, and down.
    """
    half, count, driven = width / 2, len(closing), closing.tolist()
    out = np.empty(count)
    side, k = 1 if driven[0] > 0 else -1, 0
    while k < count:
        leaves = outwards[1 if side > 0 else 0]  # teeth stay until they are driven apart
        at = int(np.searchsorted(leaves, k))
        leave = int(leaves[at]) if at < len(leaves) else count
        out[k:leave] = side * half
        x, v, k = side * half, 0.0, leave
        while k < count:
            v += driven[k] * dt
            x += v * dt
            if not -half < x < half:
                side = 1 if x > 0 else -1
                break
            out[k] = x
            k += 1
    return out
