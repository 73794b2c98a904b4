"""Play between a joint's motor and its link."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage
from scipy.signal import lfilter
from typing_extensions import override

from idtool.common.arrays import Array, Mask
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.fixed_effect import FixedJointEffect
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.effects.probe import geometric_grid
from idtool.dynamics.mechanism import Mechanism, Transmission
from idtool.robot.model import RobotModel

_DAMPING_RATIO = 0.5
_MIN_WIDTH = 3e-4  # rad or m: what gears have
_MAX_WIDTH = 0.12  # rad or m: what would be felt by hand
_TRIALS = 6  # the search tries finer ones around the best
_TRIAL_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
_MIN_COEFFICIENT = 0.25  # share of the change that the width makes
_MAX_COEFFICIENT = 3.0
_WIDTH_BLUR = (0.85, 0.93, 1.0, 1.08, 1.17)  # factors of the width that are averaged
_BLIP_SHARE = 0.6  # of a blip whose time is known to milliseconds: leaves the least residual on average
_APART_SPEED = 4e-3  # of the width per sample: slower, and the teeth have met
_IMPACT_DECAY = 0.02  # s
_TEETH_LAG = 2e-3  # s
_MIN_INERTIA = 1e-9  # kg·m² or kg


class Backlash(FixedJointEffect):
    """Play of a width between the motor side, which is measured and driven, and the link side.

    Where the joint has no `joint_elasticity`, the teeth are a spring on which motor and link would swing against each
    other at 200 Hz, half critically damped: needs a rotor or `rotor_inertia` on the joint.

    In the torque equation the link's motion is the measured one less the position of the motor within the play. While
    the teeth are apart, the motor moves as measured and the link falls freely, so that the play closes with transmitted
    torque / the link's inertia, both as the model without the play has them; where teeth meet they stay. Of friction,
    ``motor_friction``, a share that may be left out, acts on the motor side, and is not transmitted.
    """

    id = "backlash"
    description = "play decouples the load after each reversal of the torque"
    excitation_hint = "fast and slow reversals of the transmitted torque"
    cause = "distance_since_reversal"
    follows_direction = True
    is_undefined_where_it_acts = True
    nonlinear_parameters = (
        NonlinearParameter("width", ("rad", "m"), positive=True),
        NonlinearParameter("motor_friction", optional_maximum=1.0),
    )

    def __init__(self, model: RobotModel, joint: int, nonlinear_values: Mapping[str, float] | None = None) -> None:
        super().__init__(model, joint, nonlinear_values)
        self._rigid_joint_model: Callable[[Motion], Linearization] | None = None
        self._latest: tuple[Motion, Array] | None = None  # a motion, and the motor's position in the play along it

    @classmethod
    @override
    def gradient_parameters(cls) -> tuple[str, ...]:
        """No parameters, since the times at which teeth part and meet jump from sample to sample."""
        return ()

    @classmethod
    @override
    def grid_parameters(cls) -> tuple[str, ...]:
        return ("width", "motor_friction")

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        for share in _TRIAL_SHARES:
            for width in geometric_grid(_MIN_WIDTH, _MAX_WIDTH, _TRIALS):
                yield {"width": width, "motor_friction": share}

    @classmethod
    @override
    def torque_derivative(
        cls,
        summary: DataSummary,
        joint: int,
        nonlinear_values: Mapping[str, float],
        motion: Motion,
        linearized: Linearization,
    ) -> Array:
        """Total change of the torque by the play; its fitted coefficient should be 1."""
        position = _motor_in_play(motion, joint, nonlinear_values, linearized)
        return _torque_change(position, motion.dt, joint, linearized)

    @classmethod
    @override
    def values_from_coefficient(cls, c: float, nonlinear_values: Mapping[str, float]) -> Mapping[str, float] | None:
        return dict(nonlinear_values) if _MIN_COEFFICIENT < c < _MAX_COEFFICIENT else None

    @override
    def set_operating_point(self, model: Callable[[Motion], Linearization], theta: Array) -> None:
        self._rigid_joint_model = model
        self._latest = None

    @override
    def fixed_torque(self, motion: Motion) -> Array | None:
        if self._rigid_joint_model is None:
            return None
        model = self._rigid_joint_model(motion)
        return _torque_change(self._motor_position(motion, model), motion.dt, self.joint, model)

    @override
    def invalid_mask(self, motion: Motion) -> dict[int, Mask]:
        """Samples while the teeth are apart and until their impact has decayed, on all joints that it shakes."""
        if self._rigid_joint_model is None:
            return {}
        position = self._motor_position(motion, self._rigid_joint_model(motion))
        apart = np.abs(np.gradient(position)) > _APART_SPEED * self.nonlinear_values["width"]
        reach = max(round(_IMPACT_DECAY / motion.dt), 1)
        mask = ndimage.binary_dilation(apart, iterations=reach)
        return dict.fromkeys(range(len(motion.q)), mask)

    def _motor_position(self, motion: Motion, model: Linearization) -> Array:
        """Position of the motor within the play, shape (N,)."""
        if self._latest is None or self._latest[0] is not motion:
            self._latest = motion, _motor_in_play(motion, self.joint, self.nonlinear_values, model)
        return self._latest[1]

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        transmission = mechanism.transmissions.get(self.joint, Transmission(np.inf, _DAMPING_RATIO))
        mechanism.transmissions[self.joint] = replace(
            transmission,
            backlash=self.nonlinear_values["width"],
            motor_friction=max(transmission.motor_friction, self.nonlinear_values["motor_friction"]),
        )


def _torque_change(position: Array, dt: float, joint: int, linearized: Linearization) -> Array:
    """Change of the predicted torque by the play, shape (nv, N); less than all, as a mistimed blip is worse.

    Parameters
    ----------
    position
        Position of the motor within the play, shape (N,).
    dt
        Time between samples [s].
    joint
        Index of the joint.
    linearized
        The model without the play.
    """
    velocity = np.gradient(position, dt)
    acceleration = np.gradient(velocity, dt)
    return _BLIP_SHARE * linearized.torque_change_by_motion(joint, -position, -velocity, -acceleration)


def _motor_in_play(
    motion: Motion, joint: int, nonlinear_values: Mapping[str, float], linearized: Linearization
) -> Array:
    """Position of the motor within the play, shape (N,): the mean over widths about the one given.

    Teeth give when they meet: two lags of 2 ms, as good as the spring of `add_to_forward_model`. When they meet is
    known no better than to some milliseconds, and a blip that comes too early or too late explains less than none.
    """
    transmitted, inertia = linearized.link_load(motion, joint)
    if nonlinear_values["motor_friction"]:
        transmitted = transmitted - nonlinear_values["motor_friction"] * linearized.friction_torque(joint)
    acceleration = transmitted / np.maximum(inertia, _MIN_INERTIA)

    width = nonlinear_values["width"]
    widths = [factor * width for factor in _WIDTH_BLUR]
    positions = _simulate_play(acceleration, widths, motion.dt)
    position = np.mean(positions, axis=0)
    pole = np.exp(-motion.dt / _TEETH_LAG)
    for _ in range(2):
        position = lfilter([1 - pole], [1, -pole], position, zi=[pole * position[0]])[0]
    return np.asarray(position)


def _simulate_play(acceleration: Array, widths: Sequence[float], dt: float) -> list[Array]:
    """Position of the motor within plays, each in [−width/2, width/2], under an acceleration; shape (N,) each."""
    driven_up = np.flatnonzero(acceleration[:-1] > 0).tolist()
    driven_down = np.flatnonzero(acceleration[:-1] < 0).tolist()
    accelerations = acceleration.tolist()
    return [_simulate_one_play(accelerations, driven_up, driven_down, width / 2, dt) for width in widths]


def _simulate_one_play(
    accelerations: Sequence[float], driven_up: Sequence[int], driven_down: Sequence[int], half: float, dt: float
) -> Array:
    """`_simulate_play` of one play.

    Parameters
    ----------
    accelerations
        Acceleration of the motor relative to the link.
    driven_up, driven_down
        Samples where it is above and below 0, ascending.
    half
        Half the width.
    dt
        Time between samples [s].
    """
    count = len(accelerations)
    out = np.empty(count)
    side = 1 if accelerations[0] > 0 else -1
    k = 0
    while k < count:
        # The teeth stay in contact until they are driven apart.
        leaving = driven_down if side > 0 else driven_up
        following = bisect_left(leaving, k)
        parting = leaving[following] if following < len(leaving) else count
        out[k:parting] = side * half

        x = side * half
        v = 0.0
        apart = []
        for k in range(parting, count):
            v += accelerations[k] * dt
            x += v * dt
            if not -half < x < half:
                side = 1 if x > 0 else -1
                break
            apart.append(x)
        k = parting + len(apart)
        out[parting:k] = apart
    return out
