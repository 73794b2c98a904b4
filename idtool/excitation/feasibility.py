"""Scaling of motions to all limits, evaluated on a finer grid than the log's samples.

Shapes: nv joints, N samples. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.names import join_names, suggestion
from idtool.common.number_text import short_number
from idtool.excitation.limits import QUANTITIES
from idtool.excitation.patterns import MotionSamples, Trajectory, TrajectorySegment
from idtool.excitation.task import DesignTask

_TIMES_PER_SAMPLE = 2  # at which the limits are checked
_MIN_RATE = 500.0  # Hz, of these
_CLEARANCE_RATE = 200.0  # Hz, at which the clearance is checked
_LIMIT_SHARE = 1 - 1e-6  # of a limit that may be used
_TORQUE_SHARE = 0.999  # of its limit: where friction changes its sign, curvature tells nothing
_MAX_SCALINGS = 30  # of a motion whose excursion is not proportional to its scale
_FIRST_STEP = 0.005  # by which the scale is reduced at first; each step is larger than the one before
_STEPS = 30  # down to a scale of 0.1
_POSES = 2000  # random candidates for the home pose
_STATIC_SHARE = 0.8  # of the effort limits that gravity may take at the home pose
_AMPLE_CLEARANCE = 2.0  # times the wanted clearance, preferred for the home pose


def home_pose(task: DesignTask, start: Mapping[str, float], rng: np.random.Generator) -> Array:
    """The pose at which all segments begin and end, shape (nv,): the middle of the ranges or a pose near it.

    Parameters
    ----------
    task
        Robot and limits.
    start
        Given positions of joints, by name [rad or m].
    rng
        For the candidates.

    Raises
    ------
    ConfigError
        If ``start`` names an unknown joint, lies outside the limits, or has links too near to each other.
    ModelError
        If no pose was found.
    """
    limits = task.limits
    given = np.full(len(limits.joints), np.nan)
    for name, value in start.items():
        if name not in limits.joints:
            raise ConfigError("--start", f"{name} is not a moving joint; {suggestion(name, limits.joints)}")
        given[limits.joints.index(name)] = value
    is_given = np.isfinite(given)
    home = np.where(is_given, given, limits.middle)
    for name, x, lower, upper in zip(limits.joints, home, limits.lower, limits.upper, strict=True):
        if not lower < x < upper:
            raise ConfigError(
                "--start",
                f"{name} = {x:g} is not between {short_number(lower, 4)} and {short_number(upper, 4)}, the "
                "limits with the margin",
            )

    # Candidates spread more and more around the middle.
    radius = np.linspace(0, 1, _POSES)
    offsets = radius * limits.half_range[:, None] * rng.normal(size=(len(home), _POSES)) / 2
    offsets[is_given] = 0.0
    poses = np.clip(home[:, None] + offsets, limits.lower[:, None], limits.upper[:, None])
    if is_given.all():
        poses = poses[:, :1]
    is_static = _statically_feasible(task, poses)
    clearance = np.full(poses.shape[1], np.inf)
    if task.collision is not None:
        clearance = task.collision.clearance(poses)
    for wanted in (_AMPLE_CLEARANCE * task.clearance, task.clearance):
        is_feasible = is_static & (clearance >= wanted)
        if is_feasible.any():
            return np.asarray(poses[:, int(np.argmax(is_feasible))])

    where = "--start" if is_given.all() else task.model.robot.path
    if not is_static.any():
        what = "at the start, gravity alone requires more torque than the limits allow"
        raise ModelError(where, f"{what}; give another --start, or larger effort limits")
    if task.collision is None:
        raise AssertionError  # without geometry, no pose is too near
    best = int(np.argmax(np.where(is_static, clearance, -np.inf)))
    (one, other), distance, _ = task.collision.nearest(poses[:, [best]])
    what = (
        f"links {one} and {other} are {short_number(1000 * distance)} mm apart at the start, but "
        f"{1000 * task.clearance:g} mm are required"
    )
    raise ModelError(where, f"{what}; give another --start, or a smaller --clearance")


def _statically_feasible(task: DesignTask, poses: Array) -> Mask:
    """Mask of the poses (nv, N) that can be held against gravity."""
    zero = np.zeros_like(poses)
    tau = task.torque(MotionSamples(poses, zero, zero), np.arange(poses.shape[1], dtype=float))
    return np.asarray((np.abs(tau) <= _STATIC_SHARE * task.limits.effort[:, None]).all(axis=0))


def scale_to_limits(task: DesignTask, segment: TrajectorySegment) -> TrajectorySegment:
    """The segment, scaled about its home by no more than it takes to be within all limits.

    Raises
    ------
    ModelError
        If no scale is found.
    """
    segment = _within_motion_limits(task, segment)
    share = 1.0
    for k in range(_STEPS):  # from the top: a smaller motion does not always take less torque
        scaled = _scaled(task, segment, share)
        if _within_torque_and_clearance(task, scaled):
            return scaled
        share *= 1 - _FIRST_STEP * (k + 1)
    what = f"no {segment.pattern.name} motion from the start pose respects the torque limits and the clearance"
    raise ModelError(task.model.robot.path, f"{what}; give another --start, or a smaller --clearance or --margin")


def _scaled(task: DesignTask, segment: TrajectorySegment, share: float | Array) -> TrajectorySegment:
    shares = np.broadcast_to(np.asarray(share, dtype=float), len(task.limits.joints))
    return TrajectorySegment(segment.pattern, segment.pattern.scaled(segment.x, shares))


def _interval(task: DesignTask) -> float:
    """Time between the samples at which the limits are checked [s]."""
    return 1 / max(_TIMES_PER_SAMPLE * task.rate, _MIN_RATE)


def _within_motion_limits(task: DesignTask, segment: TrajectorySegment) -> TrajectorySegment:
    """The segment, scaled joint by joint to the limits of position, velocity and acceleration."""
    limits = task.limits
    home = segment.pattern.home
    available = np.stack([limits.upper - home, home - limits.lower, limits.velocity, limits.acceleration])
    for _ in range(_MAX_SCALINGS):
        used = np.zeros_like(available)
        for _, (q, v, a) in segment.blocks(_interval(task)):
            excursion = q - home[:, None]
            peaks = [_peak(excursion), _peak(-excursion), _peak_magnitude(v), _peak_magnitude(a)]
            used = np.maximum(used, peaks)
        ratio = np.divide(_LIMIT_SHARE * available, used, out=np.ones_like(used), where=used > available)
        share = np.min(ratio, axis=0)
        if (share == 1).all():
            return segment
        segment = _scaled(task, segment, share)
    what = f"no {segment.pattern.name} motion was found within the limits; widen the limits"
    raise ModelError(task.model.robot.path, what)


def _peak_magnitude(x: Array) -> Array:
    """Largest magnitudes of curves (nv, N), between samples too, shape (nv,)."""
    return _with_curvature(np.abs(x), x)


def _peak(x: Array) -> Array:
    """Largest values of curves (nv, N), between samples too, shape (nv,)."""
    return _with_curvature(x.copy(), x)


def _with_curvature(values: Array, x: Array) -> Array:
    """Largest values, shape (nv,), each increased by what the curve x may rise above it between samples.

    That is at most an eighth of the second difference.
    """
    if x.shape[1] > 2:
        values[:, 1:-1] += np.abs(np.diff(x, 2, axis=1)) / 8
    return np.asarray(values.max(axis=1))


def _within_torque_and_clearance(task: DesignTask, segment: TrajectorySegment) -> bool:
    for t, samples in segment.blocks(_interval(task)):
        if (np.abs(task.torque(samples, t)) > _TORQUE_SHARE * task.limits.effort[:, None]).any():
            return False
    if task.collision is None:
        return True
    for _, samples in segment.blocks(1 / _CLEARANCE_RATE):
        if not (task.collision.clearance(samples.q) >= task.clearance).all():
            return False
    return True


def collision_times(task: DesignTask, segment: TrajectorySegment) -> Array:
    """Times at which links are too near to each other, shape (M,) [s], in the segment scaled to the motion limits."""
    if task.collision is None or not task.collision.pairs:
        return np.zeros(0)
    segment = _within_motion_limits(task, segment)
    times = []
    for t, samples in segment.blocks(1 / _CLEARANCE_RATE):
        times.append(t[task.collision.clearance(samples.q) < task.clearance])
    return np.concatenate(times)


def limit_utilization(task: DesignTask, trajectory: Trajectory) -> Array:
    """The largest share of the robot's own limits, without margin, that a trajectory uses, shape (4, nv).

    Raises
    ------
    ModelError
        If it exceeds them.
    """
    utilization = np.zeros((len(QUANTITIES), len(task.robot_limits.joints)))
    distinct = {id(segment): segment for segment in trajectory.segments}
    for segment in distinct.values():
        for t, samples in segment.blocks(_interval(task)):
            utilization = np.maximum(utilization, task.robot_limits.utilization(*samples, task.torque(samples, t)))
    if (utilization > 1).any():
        exceeded = [f"{QUANTITIES[k]} of {task.robot_limits.joints[j]}" for k, j in np.argwhere(utilization > 1)]
        what = f"the trajectory exceeds limits: {join_names(exceeded)}; give a larger --margin"
        raise ModelError(task.model.robot.path, what)
    return utilization


def nearest_links(task: DesignTask, trajectory: Trajectory) -> tuple[tuple[str, str], float, float] | None:
    """The two links that come nearest to each other, their distance [m], and the time [s]; None without any."""
    if task.collision is None or not task.collision.pairs:
        return None
    t, samples = trajectory.sampled(_CLEARANCE_RATE)
    pair, distance, index = task.collision.nearest(samples.q)
    return pair, distance, float(t[index])
