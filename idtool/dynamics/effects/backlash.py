"""Play between a joint's motor and its link."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, replace
from weakref import WeakKeyDictionary

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Mask, dilated
from idtool.common.dataclass import dataclass
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.fixed_effect import FixedJointEffect
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.effects.probe import geometric_grid
from idtool.dynamics.mechanism import Mechanism, Transmission
from idtool.robot.model import RobotModel

_TEETH_DAMPING_RATIO = 0.5  # of motor and link against each other
_WIDTH_RANGE = (3e-4, 0.12)  # rad: from good gears to worn ones
_PRISMATIC_WIDTH_RANGE = (1e-5, 1e-2)  # m: from ball screws to racks
_WIDTH_COUNT = 6  # widths of the coarse grid; the search tries finer ones around the best
_MOTOR_FRICTION_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
_MIN_COEFFICIENT = 0.25  # of the probe, ideally 1: a smaller one means that there is no backlash
_MAX_COEFFICIENT = 3.0
_WIDTH_FACTORS = (0.85, 0.93, 1.0, 1.08, 1.17)  # of the given width, that are averaged
_TIMING_SHRINKAGE = 0.85  # least mean squared residual of a transient whose time is uncertain by milliseconds
_MIN_FAST_CROSSING = 4.0  # widths per second; slower crossings are predicted well between the contacts
_IMPACT_DECAY = 0.02  # s
_TEETH_LAG = 2e-3  # s
_MIN_INERTIA = 1e-9  # kg·m² or kg
_MIN_EXTENSION = 32  # samples
_MAX_KEPT_MOTIONS = 8  # free motions of a model
_MIN_SQUARED_VELOCITY = 1e-9  # rad²/s² or m²/s², summed over a batch: the joint rests


class Backlash(FixedJointEffect):
    """Play of a width between the motor side, which is measured and driven, and the link side.

    Without a `joint_elasticity` on the joint, the teeth of the forward model are a spring on which motor and link swing
    against each other at 200 Hz, half critically damped. It needs a rotor or a `rotor_inertia` on the joint.

    In the torque equation, the link's position is the measured one less the motor's position within the play. While the
    teeth are separated, the motor moves as measured and the link moves freely: their relative acceleration is the
    transmitted torque / the link's inertia, both from the model without the play, changed by the link's friction at its
    own velocity. Where teeth meet, they stay. ``motor_friction`` is the share of the joint's friction on the motor
    side, which is not transmitted; it may be left out, and is 0 then. The rest acts on the link: it slows the link
    down, or holds it where it is. Friction other than Coulomb and Stribeck friction counts as viscous there.
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
        self._latest: tuple[Motion, _PlayTrajectory] | None = None  # a motion, and the trajectory along it

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
        is_prismatic = summary.model.joints[joint].kind == "prismatic"
        smallest, largest = _PRISMATIC_WIDTH_RANGE if is_prismatic else _WIDTH_RANGE
        for share in _MOTOR_FRICTION_SHARES:
            for width in geometric_grid(smallest, largest, _WIDTH_COUNT):
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
        """Correction of the rigid joint's torque for the play; its fitted coefficient should be 1."""
        trajectory = _mean_trajectory(motion, joint, nonlinear_values, linearized)
        return _torque_correction(trajectory, joint, linearized)

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
        return _torque_correction(self._trajectory(motion, model), self.joint, model)

    @override
    def invalid_mask(self, motion: Motion) -> dict[int, Mask]:
        """Samples within 20 ms of a fast crossing of the play or of an uncertain contact, the same for all joints."""
        if self._rigid_joint_model is None:
            return {}
        trajectory = self._trajectory(motion, self._rigid_joint_model(motion))
        crosses_fast = np.abs(trajectory.motor_velocity) > _MIN_FAST_CROSSING * self.nonlinear_values["width"]
        contact_is_uncertain = (trajectory.separated_share > 0) & (trajectory.separated_share < 1)
        reach = max(round(_IMPACT_DECAY / motion.dt), 1)
        mask = dilated(crosses_fast | contact_is_uncertain, reach)
        return dict.fromkeys(range(len(motion.q)), mask)

    def _trajectory(self, motion: Motion, model: Linearization) -> _PlayTrajectory:
        """Trajectory within the play along a motion; the latest is kept."""
        if self._latest is None or self._latest[0] is not motion:
            self._latest = motion, _mean_trajectory(motion, self.joint, self.nonlinear_values, model)
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
class _PlayTrajectory:
    """Motion of the motor within the play.

    Attributes
    ----------
    motor_position
        Position of the motor within the play, in [−width/2, width/2], shape (N,) [rad or m].
    link_friction_correction
        Friction of the link at its own velocity less that at the motor's, shape (N,) [N·m or N].
    separated_share
        Share of the averaged widths with which the teeth are separated, shape (N,).
    dt
        Time between samples [s].
    """

    motor_position: Array
    link_friction_correction: Array
    separated_share: Array
    dt: float

    @property
    def motor_velocity(self) -> Array:
        """Velocity of the motor within the play, shape (N,) [rad/s or m/s]."""
        return np.gradient(self.motor_position, self.dt)


def _torque_correction(trajectory: _PlayTrajectory, joint: int, linearized: Linearization) -> Array:
    """Correction of the torque of a model without the play for the play, shape (nv, N) [N·m or N].

    It is less than all of it, since a mistimed transient leaves a larger residual than a smaller one.

    Parameters
    ----------
    trajectory
        The trajectory within the play along the motion.
    joint
        Index of the joint.
    linearized
        The model without the play.
    """
    velocity = trajectory.motor_velocity
    acceleration = np.gradient(velocity, trajectory.dt)
    correction = linearized.torque_change_by_motion(joint, -trajectory.motor_position, -velocity, -acceleration)
    correction[joint] += trajectory.link_friction_correction
    return _TIMING_SHRINKAGE * correction


def _mean_trajectory(
    motion: Motion, joint: int, nonlinear_values: Mapping[str, float], linearized: Linearization
) -> _PlayTrajectory:
    """Trajectory within the play along a motion, averaged over widths from 0.85 to 1.17 of the given one.

    The time of contact is uncertain by milliseconds, and a mistimed transient leaves a larger residual than none:
    averaging spreads it. Two first-order lags stand for the compliance of the teeth, as good as the spring of
    `Backlash.add_to_forward_model`.
    """
    free = _free_motion(motion, joint, nonlinear_values["motor_friction"], linearized)
    widths = [factor * nonlinear_values["width"] for factor in _WIDTH_FACTORS]
    trajectories = [_trajectory_for_width(free, width) for width in widths]
    motor_position = np.mean([one.motor_position for one in trajectories], axis=0)
    link_friction_correction = np.mean([one.link_friction_correction for one in trajectories], axis=0)
    return _PlayTrajectory(
        motor_position=_with_teeth_lag(motor_position, motion.dt),
        link_friction_correction=_with_teeth_lag(link_friction_correction, motion.dt),
        separated_share=np.mean([one.separated_share for one in trajectories], axis=0),
        dt=motion.dt,
    )


def _with_teeth_lag(x: Array, dt: float) -> Array:
    """Series after the two lags of the teeth, shape (N,)."""
    from scipy.signal import lfilter

    pole = np.exp(-dt / _TEETH_LAG)
    for _ in range(2):
        x = lfilter([1 - pole], [1, -pole], x, zi=[pole * x[0]])[0]
    return np.asarray(x)


class _FreeMotion:
    """Motion of a joint's motor relative to its link while the teeth are separated, by the model without the play.

    Attributes
    ----------
    next_driven_up, next_driven_down
        The first sample from each sample on where the transmitted torque is above, or below, 0; see `_next_true`.
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
        link_dry_friction_level = (1 - motor_friction) * dry_friction_level
        damping_divisor = 1 + link_viscosity / inertia * motion.dt  # of an implicit step, which is stable
        self.dt = motion.dt
        self.sample_count = len(velocity)
        self.next_driven_up = _next_true(transmitted > 0)
        self.next_driven_down = _next_true(transmitted < 0)
        self._transmitted = transmitted.tolist()
        self._inertia = inertia.tolist()
        self._damping_divisor = damping_divisor.tolist()
        self._velocity_increment = (without_dry_friction / inertia * motion.dt).tolist()
        self._max_dry_friction_increment = (link_dry_friction_level / inertia * motion.dt / damping_divisor).tolist()
        self._motor_velocity = velocity.tolist()
        self._paths: dict[int, _FreePath] = {}  # by the sample at which the teeth separate

    def until_contact(self, separation: int, width: float) -> tuple[list[float], list[float]]:
        """Free motion from a separation of the teeth to their contact or, without one, to the last sample.

        A width only decides where the motion ends: all widths share one simulation.

        Parameters
        ----------
        separation
            Sample at which the teeth separate.
        width
            Width of the play [rad or m].

        Returns
        -------
        At each sample from the separation on: displacement of the motor relative to the link [rad or m], and friction
        of the link at its own velocity less that at the motor's [N·m or N].
        """
        path = self._paths.get(separation)
        if path is None:
            path = self._paths[separation] = _FreePath()
            self._extend(path, separation)
        while not path.is_complete and path.farthest_travels[-1] < width:
            self._extend(path, separation)
        contact_index = bisect_left(path.farthest_travels, width)
        return path.displacements[: contact_index + 1], path.link_friction_corrections[: contact_index + 1]

    def _extend(self, path: _FreePath, separation: int) -> None:
        """Extend a path to about twice its length, at most to where the teeth meet on the side that they left."""
        # Local names are found faster than attributes: this loop takes much of the time of a search for backlash.
        inertia, transmitted, motor_velocity = self._inertia, self._transmitted, self._motor_velocity
        velocity_increment, damping_divisor = self._velocity_increment, self._damping_divisor
        max_dry_friction_increment = self._max_dry_friction_increment
        displacements, farthest_travels = path.displacements, path.farthest_travels
        corrections = path.link_friction_corrections
        dt = self.dt
        direction = 1 if transmitted[separation] > 0 else -1  # in which the motor is driven away
        displacement = displacements[-1] if displacements else 0.0
        farthest_travel = farthest_travels[-1] if farthest_travels else 0.0
        velocity = path.relative_velocity
        first = separation + len(displacements)
        end = min(first + max(len(displacements), _MIN_EXTENSION), self.sample_count)
        for k in range(first, end):
            previous_velocity = velocity
            damped_velocity = (velocity + velocity_increment[k]) / damping_divisor[k]
            # Dry friction slows the link down, at most to rest, where the relative velocity is that of the motor.
            increment = motor_velocity[k] - damped_velocity
            max_increment = max_dry_friction_increment[k]
            if increment > max_increment:
                increment = max_increment
            elif increment < -max_increment:
                increment = -max_increment
            velocity = damped_velocity + increment
            # No torque is transmitted: what does not accelerate the link is friction.
            net_torque = inertia[k] * (velocity - previous_velocity) / dt
            corrections.append(net_torque - transmitted[k])
            displacement += velocity * dt
            travel = direction * displacement
            if travel > farthest_travel:
                farthest_travel = travel
            displacements.append(displacement)
            farthest_travels.append(farthest_travel)
            if travel <= 0:
                path.is_complete = True
                return
        path.relative_velocity = velocity
        path.is_complete = end == self.sample_count


def _next_true(mask: Mask) -> list[int]:
    """The first sample from each sample on where a mask is true, N if there is none; N + 1 numbers, the last is N."""
    count = len(mask)
    true_samples = np.where(mask, np.arange(count), count)
    least_from_the_end = np.minimum.accumulate(true_samples[::-1])
    return [*least_from_the_end[::-1].tolist(), count]


@dataclass
class _FreePath:
    """Free motion of a motor relative to its link, from a separation of the teeth on.

    Attributes
    ----------
    displacements
        Displacement at each sample [rad or m].
    link_friction_corrections
        Friction of the link at its own velocity less that at the motor's, at each sample [N·m or N].
    farthest_travels
        Farthest travel into the play so far, at each sample, never decreasing [rad or m].
    relative_velocity
        Velocity of the motor relative to the link at the last sample, from which the path is extended [rad/s or m/s].
    is_complete
        True if, at the last sample, the teeth meet again on the side that they left, or the data end.
    """

    displacements: list[float] = field(default_factory=list)
    link_friction_corrections: list[float] = field(default_factory=list)
    farthest_travels: list[float] = field(default_factory=list)
    relative_velocity: float = 0.0
    is_complete: bool = False


_free_motions: WeakKeyDictionary[Linearization, dict[tuple[int, float], _FreeMotion]] = WeakKeyDictionary()


def _free_motion(motion: Motion, joint: int, motor_friction: float, linearized: Linearization) -> _FreeMotion:
    """Free motion of a joint's motor; a few are kept for each model along the motion, since all widths share them."""
    kept = _free_motions.setdefault(linearized, {})
    key = joint, motor_friction
    if key not in kept:
        kept[key] = _FreeMotion(motion, joint, motor_friction, linearized)
        if len(kept) > _MAX_KEPT_MOTIONS:
            del kept[next(iter(kept))]
    return kept[key]


def _trajectory_for_width(free: _FreeMotion, width: float) -> _PlayTrajectory:
    """Trajectory within a play of a given width [rad or m], along the motion of ``free``.

    Contacts and separations of the teeth alternate, from a contact on, which may last no sample.
    """
    phase_lengths: list[int] = []  # samples of each contact and each separation
    contact_sides: list[int] = []  # of the play, at which the motor is in each contact
    displacements: list[float] = []  # in all separations
    corrections: list[float] = []
    side = -1 if free.next_driven_down[0] == 0 else 1
    contact_start = 0
    while True:
        # The teeth stay in contact until they are driven apart.
        next_driven_apart = free.next_driven_down if side > 0 else free.next_driven_up
        separation = next_driven_apart[contact_start]
        contact_sides.append(side)
        phase_lengths.append(separation - contact_start)
        if separation == free.sample_count:
            break
        new_displacements, new_corrections = free.until_contact(separation, width)
        phase_lengths.append(len(new_displacements))
        displacements += new_displacements
        corrections += new_corrections
        contact_start = separation + len(new_displacements)
        last_position = side * width / 2 + new_displacements[-1]
        side = 1 if last_position > 0 else -1
    is_separation = np.arange(len(phase_lengths)) % 2 == 1
    phase_sides = np.repeat(contact_sides, 2)[: len(phase_lengths)]  # of a separation, that of the contact before
    is_separated = np.repeat(is_separation, phase_lengths)
    positions = np.repeat(phase_sides, phase_lengths) * width / 2
    positions[is_separated] += displacements
    link_friction_corrections = np.zeros(free.sample_count)
    link_friction_corrections[is_separated] = corrections
    return _PlayTrajectory(
        motor_position=np.clip(positions, -width / 2, width / 2),
        link_friction_correction=link_friction_corrections,
        separated_share=is_separated.astype(float),
        dt=free.dt,
    )
