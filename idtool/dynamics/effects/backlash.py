"""Play between a joint's motor and its link."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

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

_TEETH_DAMPING_RATIO = 0.5  # of motor and link against each other
_MIN_WIDTH = 3e-4  # rad or m: what gears have
_MAX_WIDTH = 0.12  # rad or m: what would be felt by hand
_WIDTH_COUNT = 6  # widths of the coarse grid; the search tries finer ones around the best
_MOTOR_FRICTION_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
_MIN_COEFFICIENT = 0.25  # of the probe, ideally 1: a smaller one means that there is no backlash
_MAX_COEFFICIENT = 3.0
_WIDTH_BLUR = (0.85, 0.93, 1.0, 1.08, 1.17)  # factors of the width that are averaged
_BLIP_SHARE = 0.85  # of a blip whose time is known to milliseconds: leaves the least residual on average
_MIN_SPEED_APART = 4.0  # widths per second: slower, and the teeth have met
_IMPACT_DECAY = 0.02  # s
_TEETH_LAG = 2e-3  # s: time constant of each of two low-passes, for the compliance of the teeth
_MIN_INERTIA = 1e-9  # kg·m² or kg
_MIN_STEPS = 32  # by which a path is continued
_MAX_KEPT_MOTIONS = 8  # relative motions of a model
_MIN_SQUARED_VELOCITY = 1e-9  # rad²/s² or m²/s², summed over a log: the joint rests


class Backlash(FixedJointEffect):
    """Play of a width between the motor side, which is measured and driven, and the link side.

    Where the joint has no `joint_elasticity`, the teeth are a spring on which motor and link would swing against each
    other at 200 Hz, half critically damped: needs a rotor or `rotor_inertia` on the joint.

    In the torque equation the link's motion is the measured one less the position of the motor within the play. While
    the teeth are apart, the motor moves as measured and the link falls freely, so that the play closes with transmitted
    torque / the link's inertia, both as the model without the play has them; where teeth meet they stay. Of friction,
    ``motor_friction``, a share that may be left out, acts on the motor side, and is not transmitted; the rest acts on
    the link at the link's own velocity. It slows the falling link down, or holds it where it is.
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
        self._latest: tuple[Motion, _Play] | None = None  # a motion, and the play along it

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
        for share in _MOTOR_FRICTION_SHARES:
            for width in geometric_grid(_MIN_WIDTH, _MAX_WIDTH, _WIDTH_COUNT):
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
        play = _play_along(motion, joint, nonlinear_values, linearized)
        return _torque_change(play, motion.dt, joint, linearized)

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
        return _torque_change(self._play(motion, model), motion.dt, self.joint, model)

    @override
    def invalid_mask(self, motion: Motion) -> dict[int, Mask]:
        """Samples while the teeth fly apart, may have met, or have just met, on all joints that this shakes."""
        if self._rigid_joint_model is None:
            return {}
        play = self._play(motion, self._rigid_joint_model(motion))
        speed = np.abs(np.gradient(play.motor_position, motion.dt))
        fly_apart = speed > _MIN_SPEED_APART * self.nonlinear_values["width"]
        may_touch = (play.apart_share > 0) & (play.apart_share < 1)
        reach = max(round(_IMPACT_DECAY / motion.dt), 1)
        mask = ndimage.binary_dilation(fly_apart | may_touch, iterations=reach)
        return dict.fromkeys(range(len(motion.q)), mask)

    def _play(self, motion: Motion, model: Linearization) -> _Play:
        """Play along a motion; the latest is kept."""
        if self._latest is None or self._latest[0] is not motion:
            self._latest = motion, _play_along(motion, self.joint, self.nonlinear_values, model)
        return self._latest[1]

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        transmission = mechanism.transmissions.get(self.joint, Transmission(np.inf, _TEETH_DAMPING_RATIO))
        mechanism.transmissions[self.joint] = replace(
            transmission,
            backlash=self.nonlinear_values["width"],
            motor_friction=max(transmission.motor_friction, self.nonlinear_values["motor_friction"]),
        )


@dataclass(frozen=True)
class _Play:
    """Play along a motion.

    Attributes
    ----------
    motor_position
        Position of the motor within the play, in [−width/2, width/2], shape (N,) [rad or m].
    friction_change
        Friction of the link at its own velocity less that at the motor's, shape (N,) [N·m or N].
    apart_share
        Share of the widths with which the teeth are apart, shape (N,).
    """

    motor_position: Array
    friction_change: Array
    apart_share: Array


def _torque_change(play: _Play, dt: float, joint: int, linearized: Linearization) -> Array:
    """Change of the predicted torque by the play, shape (nv, N); less than all, as a mistimed blip is worse.

    Parameters
    ----------
    play
        The play along the motion.
    dt
        Time between samples [s].
    joint
        Index of the joint.
    linearized
        The model without the play.
    """
    position = play.motor_position
    velocity = np.gradient(position, dt)
    acceleration = np.gradient(velocity, dt)
    change = linearized.torque_change_by_motion(joint, -position, -velocity, -acceleration)
    change[joint] += play.friction_change
    return _BLIP_SHARE * change


def _play_along(motion: Motion, joint: int, nonlinear_values: Mapping[str, float], linearized: Linearization) -> _Play:
    """Play along a motion: the mean over widths about the one given.

    Teeth give when they meet: two lags of 2 ms, as good as the spring of `add_to_forward_model`. When they meet is
    known no better than to some milliseconds, and a blip that comes too early or too late explains less than none.
    """
    relative = _relative_motion(motion, joint, nonlinear_values["motor_friction"], linearized)
    width = nonlinear_values["width"]
    plays = [_simulate_play(relative, factor * width) for factor in _WIDTH_BLUR]
    motor_position = np.mean([play.motor_position for play in plays], axis=0)
    friction_change = np.mean([play.friction_change for play in plays], axis=0)
    return _Play(
        motor_position=_with_teeth_lag(motor_position, motion.dt),
        friction_change=_with_teeth_lag(friction_change, motion.dt),
        apart_share=np.mean([play.apart_share for play in plays], axis=0),
    )


def _with_teeth_lag(x: Array, dt: float) -> Array:
    """Series after two low-passes, shape (N,)."""
    pole = np.exp(-dt / _TEETH_LAG)
    for _ in range(2):
        x = lfilter([1 - pole], [1, -pole], x, zi=[pole * x[0]])[0]
    return np.asarray(x)


class _RelativeMotion:
    """Motion of a joint's motor relative to its link while the teeth are apart, by the model without the play.

    Attributes
    ----------
    driven_up, driven_down
        Samples where the transmitted torque is above and below 0, ascending.
    dt
        Time between samples [s].
    sample_count
        Number of samples, N.

    Parameters
    ----------
    motion
        The measured motion.
    joint
        Index of the joint.
    motor_friction
        Share of the friction that acts on the motor side.
    linearized
        The model without the play.
    """

    def __init__(self, motion: Motion, joint: int, motor_friction: float, linearized: Linearization) -> None:
        velocity = motion.v[joint]
        friction = linearized.friction_torque(joint)
        dry_friction, dry_friction_level = linearized.dry_friction(joint)
        viscosity = (friction - dry_friction) @ velocity / max(velocity @ velocity, _MIN_SQUARED_VELOCITY)
        link_viscosity = (1 - motor_friction) * max(float(viscosity), 0.0)

        load, inertia = linearized.link_load(motion, joint)
        inertia = np.maximum(inertia, _MIN_INERTIA)
        transmitted = load - motor_friction * friction
        without_dry_friction = transmitted - (1 - motor_friction) * dry_friction
        self.dt = motion.dt
        self.sample_count = len(velocity)
        self.driven_up: list[int] = np.flatnonzero(transmitted > 0).tolist()
        self.driven_down: list[int] = np.flatnonzero(transmitted < 0).tolist()
        self._transmitted = transmitted.tolist()
        self._inertia_per_time_step = (inertia / self.dt).tolist()
        # changes of the relative velocity from sample to sample
        self._velocity_change = (without_dry_friction / inertia * self.dt).tolist()
        self._damping_divisor = (1 + link_viscosity / inertia * self.dt).tolist()
        self._max_friction_velocity_change = ((1 - motor_friction) * dry_friction_level / inertia * self.dt).tolist()
        self._motor_velocity = velocity.tolist()
        self._paths: dict[int, _Path] = {}  # by the sample at which the teeth part

    def path_until_contact(self, separation: int, side: int, width: float) -> tuple[list[float], list[float]]:
        """Displacement of the motor relative to the link from separation to contact, and change of the link's friction.

        Without contact, to the last sample. The width only says where a path ends: plays of all widths share it.

        Parameters
        ----------
        separation
            Sample at which the teeth part.
        side
            1 or −1: the end of the play at which they part.
        width
            Width of the play [rad or m].
        """
        path = self._paths.get(separation)
        if path is None:
            path = self._paths[separation] = _Path([], [], [], 0.0, is_complete=False)
        while True:
            contact = bisect_left(path.largest_depths, width)
            if contact < len(path.largest_depths) or path.is_complete:
                return path.displacements[: contact + 1], path.friction_changes[: contact + 1]
            self._continue(path, separation, side)

    def _continue(self, path: _Path, separation: int, side: int) -> None:
        """Continue a path to about twice its length, at most to where the teeth meet where they parted."""
        displacement = path.displacements[-1] if path.displacements else 0.0
        depth = path.largest_depths[-1] if path.largest_depths else 0.0
        velocity = path.velocity
        first = separation + len(path.displacements)
        last = min(first + max(len(path.displacements), _MIN_STEPS), self.sample_count)
        for k in range(first, last):
            previous_velocity = velocity
            damped_velocity = (velocity + self._velocity_change[k]) / self._damping_divisor[k]
            # Dry friction slows the link down, at most to rest.
            link_velocity = self._motor_velocity[k] - damped_velocity
            max_change = self._max_friction_velocity_change[k]
            velocity = damped_velocity + min(max(link_velocity, -max_change), max_change)
            # No torque is transmitted, so what does not accelerate the link is friction.
            accelerating_torque = self._inertia_per_time_step[k] * (velocity - previous_velocity)
            path.friction_changes.append(accelerating_torque - self._transmitted[k])
            displacement += velocity * self.dt
            depth = max(depth, -side * displacement)
            path.displacements.append(displacement)
            path.largest_depths.append(depth)
            if -side * displacement <= 0:
                path.is_complete = True
                return
        path.velocity = velocity
        path.is_complete = last == self.sample_count


@dataclass
class _Path:
    """Motion of a motor relative to its link from where the teeth part.

    Attributes
    ----------
    displacements
        Displacement at each sample [rad or m].
    friction_changes
        Friction of the link at its own velocity less that at the motor's, at each sample [N·m or N].
    largest_depths
        Largest displacement into the play so far, ascending [rad or m].
    velocity
        Relative velocity at the last sample [rad/s or m/s].
    is_complete
        True if the teeth meet again on the same side at the last sample, or the data end there.
    """

    displacements: list[float]
    friction_changes: list[float]
    largest_depths: list[float]
    velocity: float
    is_complete: bool


_relative_motions: WeakKeyDictionary[Linearization, dict[tuple[int, float], _RelativeMotion]] = WeakKeyDictionary()


def _relative_motion(motion: Motion, joint: int, motor_friction: float, linearized: Linearization) -> _RelativeMotion:
    """Relative motion of a joint's motor and link; the latest are kept for each model, since all widths share them."""
    kept = _relative_motions.setdefault(linearized, {})
    key = joint, motor_friction
    if key not in kept:
        kept[key] = _RelativeMotion(motion, joint, motor_friction, linearized)
        if len(kept) > _MAX_KEPT_MOTIONS:
            del kept[next(iter(kept))]
    return kept[key]


def _simulate_play(relative: _RelativeMotion, width: float) -> _Play:
    """Play of a width along a motion.

    Parameters
    ----------
    relative
        Motion of motor and link while the teeth are apart.
    width
        Width of the play [rad or m].
    """
    positions = np.empty(relative.sample_count)
    friction_changes = np.zeros(relative.sample_count)
    is_apart = np.zeros(relative.sample_count)
    begins_driven_down = relative.driven_down[:1] == [0]
    side = -1 if begins_driven_down else 1  # of the play, at which the teeth are in contact
    k = 0
    while k < relative.sample_count:
        # The teeth stay in contact until they are driven apart.
        driven_apart = relative.driven_down if side > 0 else relative.driven_up
        next_drive = bisect_left(driven_apart, k)
        separation = driven_apart[next_drive] if next_drive < len(driven_apart) else relative.sample_count
        contact = side * width / 2
        positions[k:separation] = contact
        if separation == relative.sample_count:
            break
        displacements, changes = relative.path_until_contact(separation, side, width)
        k = separation + len(displacements)
        positions[separation:k] = displacements
        positions[separation:k] += contact
        friction_changes[separation:k] = changes
        is_apart[separation:k] = 1.0
        side = 1 if contact + displacements[-1] > 0 else -1
    return _Play(np.clip(positions, -width / 2, width / 2), friction_changes, is_apart)
