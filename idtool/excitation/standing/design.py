"""`design_standing`: an exciting trajectory of a robot whose feet stay on the ground.

It differs from `design` in what moves freely: the independent coordinates, which are those of the base and the joints
of no leg.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.names import suggestion
from idtool.estimation.dataset.experiment import Progress, signals_of
from idtool.estimation.dataset.reduction import Factor, Reduction, empty, merge
from idtool.excitation.criteria import expected_standard_errors
from idtool.excitation.design import (
    MAX_DURATION,
    Design,
    DesignOptions,
    criteria_of,
    friction_segments,
    logged_rows_of,
    max_frequency,
    scaled_segments,
    search,
)
from idtool.excitation.limits import QUANTITIES
from idtool.excitation.logged_data import LoggedData
from idtool.excitation.patterns import (
    PATTERNS,
    MotionSamples,
    PatternSpec,
    Trajectory,
    TrajectorySegment,
)
from idtool.excitation.standing.feet import Foot
from idtool.excitation.standing.kinematics import StandingKinematics, StandingSamples
from idtool.excitation.standing.objective import StandingObjective
from idtool.excitation.standing.predicted_log import predicted_log
from idtool.excitation.standing.robot import Loads
from idtool.excitation.standing.task import StandingTask, joint_samples
from idtool.robot.config import Config

STANDING_PATTERNS = ("fourier", "bspline")
_MAX_FREQUENCY = 1.0  # Hz: on joint controllers, a standing robot sways by itself at some hertz
_SAMPLES_PER_PERIOD = 12.0  # of the highest frequency, on the grid of the search
_MIN_COARSE_RATE = 8.0  # Hz
_SCALING_RATE = 50.0  # Hz, at which the scale of a segment is found
_CHECK_RATE = 250.0  # Hz, at which the limits are checked
_BLOCK = 2048  # samples
_FIRST_REDUCTION = 0.005  # of the scale, by the first step; that of each step is larger than that of the one before
_STEPS = 30  # down to a scale of 0.1


@dataclass(frozen=True)
class StandingTrajectory(Trajectory):
    """Segments of the independent coordinates, and the motion of the robot that follows from them.

    Attributes
    ----------
    kinematics
        Motion of the robot with its feet on the ground.
    """

    kinematics: StandingKinematics

    @property
    @override
    def home(self) -> Array:
        return self.kinematics.stance.q

    @override
    def motion(self, t: Array) -> MotionSamples:
        n = self.kinematics.model.joint_count
        return MotionSamples(*(signal[:n] for signal in self.standing_samples(t).motion))

    def standing_samples(self, t: Array) -> StandingSamples:
        """Motion of the whole robot at ascending times, shape (N,) [s]."""
        return self.kinematics.samples(*super().motion(t))


@dataclass(frozen=True)
class GroundUse:
    """Loads of the feet at their worst.

    Attributes
    ----------
    feet
        The feet.
    friction_coefficient
        That of the ground, without margin.
    friction
        Friction coefficient that each foot needs, shape (feet,).
    lowest_load
        Least force across the ground on each foot, shape (feet,) [N].
    pressure
        Largest distance of the centre of pressure from the middle of each sole, as a share of half its size; 0 for
        points; shape (feet,).
    base
        Lowest and highest position [m] and rotation [rad] of the base from the stance, shape (2, 6).
    limit_shares
        Largest share of each limit of the design, by its name; 1 at the limit.
    """

    feet: tuple[Foot, ...]
    friction_coefficient: float
    friction: Array
    lowest_load: Array
    pressure: Array
    base: Array
    limit_shares: Mapping[str, float]


@dataclass(frozen=True)
class StandingDesign(Design):
    """A trajectory of a robot that stands.

    Attributes
    ----------
    ground
        Loads of the feet at their worst.
    """

    ground: GroundUse

    @override
    def curves(self, t: Array) -> tuple[MotionSamples, Array]:
        task, trajectory = _standing(self)
        samples = trajectory.standing_samples(t)
        return joint_samples(task, samples), task.loads(samples, t).torque


def _standing(design: StandingDesign) -> tuple[StandingTask, StandingTrajectory]:
    """Task and trajectory of a design by their own types."""
    task, trajectory = design.task, design.trajectory
    if not isinstance(task, StandingTask) or not isinstance(trajectory, StandingTrajectory):
        raise TypeError("a standing design has a standing task and trajectory")
    return task, trajectory


def design_standing(
    task: StandingTask, config: Config, options: DesignOptions, logged: LoggedData | None, progress: Progress
) -> StandingDesign:
    """Find a trajectory of a robot that stands.

    Parameters
    ----------
    task
        Robot, feet, limits and criterion.
    config, options, logged, progress
        As for `design`.

    Raises
    ------
    IdtoolError
        If there is no such motion.
    """
    if options.pattern not in STANDING_PATTERNS:
        what = f"{options.pattern} is not a pattern for a standing robot"
        raise ConfigError("--pattern", f"{what}; {suggestion(options.pattern, STANDING_PATTERNS)}")
    rng = np.random.default_rng(options.seed)
    limits = task.coordinate_limits
    frequency = options.max_frequency or min(max_frequency(limits, task.rate, config), _MAX_FREQUENCY)

    def spec_of(duration: float) -> PatternSpec:
        return PatternSpec(task.model, limits, task.kinematics.home, duration)

    def scale(segment: TrajectorySegment) -> TrajectorySegment:
        return _scale_to_limits(task, segment)

    progress("designing", 0.0)
    segments, remaining = friction_segments(options, spec_of, scale, rng)
    logged_rows = logged_rows_of(task, logged)
    repeats = int(np.ceil(remaining / MAX_DURATION))
    spec = replace(spec_of(remaining / repeats), max_frequency=max(frequency, 2 * repeats / remaining))
    pattern = PATTERNS[options.pattern](spec)
    information = logged_rows.T @ logged_rows
    rate = max(_SAMPLES_PER_PERIOD * spec.max_frequency, _MIN_COARSE_RATE)
    for segment in segments:
        fixed = StandingObjective(task, segment.pattern, 0 * information, 1, rate)
        information = information + fixed.information(segment.x)
    objective = StandingObjective(task, pattern, information, repeats, rate)
    first, interrupted = search(objective, options.iterations, rng, progress)

    progress("checking the limits", 0.0)
    random_segment, segment = scaled_segments(task, objective, first, scale)
    trajectory = StandingTrajectory((segment,) * repeats + segments, task.kinematics)
    utilization, ground = _check(task, trajectory)

    progress("predicting the standard errors", 0.0)
    logged_errors = None
    if logged is not None:
        logged_errors = expected_standard_errors(logged_rows / task.scales, task.base)
    reduction = _predicted_reduction(task, config, trajectory)
    rows = np.concatenate([logged_rows, task.columns.rows(reduction, task.noise) * task.scales])
    information_of = {"random": objective.information(random_segment.x), "design": rows.T @ rows}
    if logged is not None:
        information_of["logged"] = logged_rows.T @ logged_rows
    return StandingDesign(
        task=task,
        trajectory=trajectory,
        errors=expected_standard_errors(rows / task.scales, task.base),
        logged_errors=logged_errors,
        criteria={name: criteria_of(task, M) for name, M in information_of.items()},
        utilization=utilization,
        nearest=_nearest_links(task, trajectory),
        max_frequency=spec.max_frequency,
        evaluations=objective.evaluations,
        interrupted=interrupted,
        ground=ground,
    )


def _blocks(
    task: StandingTask, segment: TrajectorySegment, rate: float
) -> Iterator[tuple[Array, StandingSamples, Loads]]:
    """Times of a segment at a rate [Hz], the motion, and the loads, block by block."""
    count = max(int(np.ceil(segment.pattern.duration * rate)) + 1, 2)
    times = np.linspace(0, segment.pattern.duration, count)
    for start in range(0, count, _BLOCK):
        t = times[start : start + _BLOCK]
        samples = task.kinematics.samples(*segment.motion(t))
        yield t, samples, task.loads(samples, t)


def _scale_to_limits(task: StandingTask, segment: TrajectorySegment) -> TrajectorySegment:
    """The segment, scaled about the stance until it is within all limits; ModelError if it never is."""
    share = 1.0
    rates = [_SCALING_RATE, _CHECK_RATE]  # the slow check is for what passes the fast one
    for k in range(_STEPS):
        shares = np.full(len(task.kinematics.independent), share)
        scaled = TrajectorySegment(segment.pattern, segment.pattern.scaled(segment.x, shares))
        if all(_is_within(task, scaled, rate) for rate in rates):
            return scaled
        share *= 1 - _FIRST_REDUCTION * (k + 1)
    what = f"no {segment.pattern.name} motion from this stance keeps the feet on the ground within all limits"
    advice = "give another --start, a larger --ground-friction, or a smaller --clearance or --margin"
    raise ModelError(task.model.robot.path, f"{what}; {advice}")


def _is_within(task: StandingTask, segment: TrajectorySegment, rate: float) -> bool:
    """True if a segment is within all limits at samples of a rate [Hz]."""
    for _, samples, loads in _blocks(task, segment, rate):
        if not samples.is_reached.all() or (loads.violation > 0).any() or (task.excess(samples) > 0).any():
            return False
        if (task.limits.utilization(*joint_samples(task, samples), loads.torque) > 1).any():
            return False
        if task.collision is not None and not (task.collision.clearance(samples.motion.q) >= task.clearance).all():
            return False
    return True


def _check(task: StandingTask, trajectory: StandingTrajectory) -> tuple[Array, GroundUse]:
    """The largest shares of the robot's own limits, shape (4, n), and the loads of the feet at their worst.

    Raises
    ------
    ModelError
        If a limit is exceeded.
    """
    utilization = np.zeros((len(QUANTITIES), task.model.joint_count))
    friction, lowest_load, pressure, base = [], [], [], []
    shares: dict[str, float] = {}
    distinct = {id(segment): segment for segment in trajectory.segments}
    for segment in distinct.values():
        for _, samples, loads in _blocks(task, segment, _CHECK_RATE):
            used = task.robot_limits.utilization(*joint_samples(task, samples), loads.torque)
            utilization = np.maximum(utilization, used)
            friction.append(loads.ground.friction.max(axis=1))
            lowest_load.append(loads.ground.normal.min(axis=1))
            pressure.append(loads.ground.pressure.max(axis=1))
            for name, share in _limit_shares(task, samples, loads).items():
                shares[name] = max(share, shares.get(name, 0.0))
            excursion = samples.w[task.model.joint_count :]
            base += [excursion.min(axis=1), excursion.max(axis=1)]
    if (utilization > 1).any():
        raise ModelError(task.model.robot.path, "the trajectory exceeds limits; give a larger --margin")
    ground = GroundUse(
        feet=task.kinematics.feet.feet,
        friction_coefficient=task.friction_coefficient,
        friction=np.max(friction, axis=0),
        lowest_load=np.min(lowest_load, axis=0),
        pressure=np.max(pressure, axis=0),
        base=np.stack([np.min(base, axis=0), np.max(base, axis=0)]),
        limit_shares=shares,
    )
    return utilization, ground


def _limit_shares(task: StandingTask, samples: StandingSamples, loads: Loads) -> dict[str, float]:
    """Largest share of each limit of the design, by its name."""
    shares: dict[str, float] = {}
    used = task.limits.utilization(*joint_samples(task, samples), loads.torque)
    for quantity, row in zip(QUANTITIES, used, strict=True):
        for joint, share in zip(task.limits.joints, row, strict=True):
            shares[f"{quantity} of {joint}"] = float(share)
    ground = task.robot.forces.limit_shares(loads.ground)
    for foot, load, friction, pressure in zip(
        task.kinematics.feet.feet, ground.normal, ground.friction, ground.pressure, strict=True
    ):
        shares[f"load of {foot.name}"] = float(load.max())
        shares[f"friction of {foot.name}"] = float(friction.max())
        if foot.sole is not None:
            shares[f"centre of pressure of {foot.name}"] = float(pressure.max())
    for name, share in zip(task.kinematics.coordinates, task.coordinate_use(samples), strict=True):
        shares[f"motion of {name}"] = float(share.max())
    return shares


def _nearest_links(task: StandingTask, trajectory: StandingTrajectory) -> tuple[tuple[str, str], float, float] | None:
    """The two links that come nearest to each other, their distance [m], and the time [s]; None without any."""
    if task.collision is None or not task.collision.pairs:
        return None
    t = np.arange(0, trajectory.duration, 1 / _CHECK_RATE)
    pair, distance, index = task.collision.nearest(trajectory.standing_samples(t).motion.q)
    return pair, distance, float(t[index])


def _predicted_reduction(task: StandingTask, config: Config, trajectory: StandingTrajectory) -> Reduction:
    """The trajectory's log as `fit` would reduce it."""
    count = int(np.floor(trajectory.duration * task.rate + 1e-9)) + 1
    t = np.arange(count) / task.rate
    samples = trajectory.standing_samples(t)
    torque = task.loads(samples, t).torque
    feet = tuple(foot.name for foot in task.kinematics.feet.feet)
    # without noise, an IMU tells of the base what a pose does
    base_with_imu = config.base.model_copy(update={"pose": None})
    settings = config.model_copy(update={"base": base_with_imu})
    log = predicted_log(task.model, settings, feet, t, samples, torque)
    signals = signals_of(log, task.model, settings)
    reduction = empty(task.equation.active())
    for batch in signals.batches():
        rows, shares = task.equation.counted_rows(batch)
        factors = []
        for block, share in zip(rows, shares, strict=True):
            factors.append(Factor.from_shares(block, np.asarray(share, dtype=float), signals.low_pass.redundancy))
        reduction = merge(reduction, tuple(factors))
    return reduction
