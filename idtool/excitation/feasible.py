"""Motions scaled until they are within all limits, looked at more closely than the log is sampled.

Shapes: nv joints, N samples. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.names import nearest, some
from idtool.excitation.limits import QUANTITIES
from idtool.excitation.patterns import Part, Samples, Trajectory
from idtool.excitation.task import Task

_BETWEEN = 2  # instants looked at for each sample
_RATE = 500.0  # Hz: no fewer
_SPARSE = 200.0  # Hz at which the clearance is looked at
_SURE = 1 - 1e-6  # of a limit
_SURE_TORQUE = 0.999  # of its limit: where friction changes its sign, curvature says nothing
_TRIES = 30  # of scaling, where the way does not go by the scale
_FIRST, _SHARES = 0.005, 30  # step by which the scale goes down at first, ever faster, and how many: to 0.1
_POSES = 2000  # tried for a home
_STATIC = 0.8  # of the effort limits that a home may take to hold
_AMPLE = 2.0  # times the clearance wanted, that a home has where it can


def home_of(task: Task, start: Mapping[str, float], rng: np.random.Generator) -> Array:
    """The pose that all begins and ends at, shape (nv,): the middle of the ranges or a pose near it.

    Parameters
    ----------
    task
        Robot and limits.
    start
        Positions of joints, by name, that are to be kept [rad or m].
    rng
        For the poses tried.

    Raises
    ------
    ConfigError
        If ``start`` names a strange joint, lies outside the limits, or there are links too near to each other.
    ModelError
        If no pose was found.
    """
    limits, given = task.limits, np.full(len(task.limits.joints), np.nan)
    for name, value in start.items():
        if name not in limits.joints:
            raise ConfigError("--start", f"{name} is no moving joint; {nearest(name, limits.joints)}")
        given[limits.joints.index(name)] = value
    room = (limits.lower[:, None], limits.upper[:, None])
    fixed = np.isfinite(given)
    home = np.where(fixed, given, limits.middle)
    for name, x, lower, upper in zip(limits.joints, home, limits.lower, limits.upper, strict=True):
        if not lower < x < upper:
            raise ConfigError("--start", f"{name} = {x:g} is not within {lower:.4g} to {upper:.4g}, margin included")
    spread = np.linspace(0, 1, _POSES) * limits.half[:, None] * rng.normal(size=(len(home), _POSES)) / 2
    poses = np.clip(home[:, None] + np.where(fixed[:, None], 0, spread), *room)
    poses = poses[:, :1] if fixed.all() else poses
    held = _held(task, poses)
    clearance = task.collision.clearance(poses) if task.collision is not None else np.full(poses.shape[1], np.inf)
    for enough in (_AMPLE * task.clearance, task.clearance):
        good = held & (clearance >= enough)
        if good.any():
            return np.asarray(poses[:, int(np.argmax(good))])
    where = "--start" if fixed.all() else task.model.robot.path
    if not held.any():
        raise ModelError(
            where, "gravity alone takes too much torque at the start; give another --start, or effort limits"
        )
    (one, other), distance, _ = _nearest(task, poses[:, [int(np.argmax(np.where(held, clearance, -np.inf)))]])
    what = (
        f"links {one} and {other} are {1000 * distance:.3g} mm apart at the start, {1000 * task.clearance:g} are wanted"
    )
    raise ModelError(where, f"{what}; give another --start, or a smaller --clearance")


def _nearest(task: Task, q: Array) -> tuple[tuple[str, str], float, int]:
    if task.collision is None:
        raise AssertionError  # without geometry, no pose is too near
    return task.collision.nearest(q)


def _held(task: Task, poses: Array) -> Mask:
    """Which poses (nv, N) can be held against gravity."""
    still = np.zeros_like(poses)
    tau = task.torque(Samples(poses, still, still), np.arange(poses.shape[1], dtype=float))
    return np.asarray((np.abs(tau) <= _STATIC * task.limits.effort[:, None]).all(axis=0))


def feasible(task: Task, part: Part) -> Part:
    """The part, scaled about its home by no more than it takes to be within all limits.

    Raises
    ------
    ModelError
        If that leaves nothing of it.
    """
    part, share = _within_motion_limits(task, part), 1.0
    for k in range(_SHARES):  # from the top: less way is not always less torque
        scaled = _scaled(task, part, share)
        if _possible(task, scaled):
            return scaled
        share *= 1 - _FIRST * (k + 1)
    what = f"no {part.pattern.name} motion from the start pose keeps torque limits and clearance"
    raise ModelError(task.model.robot.path, f"{what}; give another --start, or a smaller --clearance or --margin")


def _scaled(task: Task, part: Part, share: float | Array) -> Part:
    shares = np.broadcast_to(np.asarray(share, dtype=float), len(task.limits.joints))
    return Part(part.pattern, part.pattern.scaled(part.x, shares))


def _interval(task: Task) -> float:
    return 1 / max(_BETWEEN * task.rate, _RATE)


def _within_motion_limits(task: Task, part: Part) -> Part:
    """Scaled joint by joint to within the limits of position, velocity and acceleration."""
    limits, home = task.limits, part.pattern.home
    room = np.stack([limits.upper - home, home - limits.lower, limits.velocity, limits.acceleration])
    for _ in range(_TRIES):
        way = np.zeros_like(room)
        for _, (q, v, a) in part.blocks(_interval(task)):
            away = q - home[:, None]
            way = np.maximum(way, [_highest(away, 1.0), _highest(away, -1.0), _highest(v), _highest(a)])
        share = np.min(np.divide(_SURE * room, way, out=np.ones_like(way), where=way > room), axis=0)
        if (share == 1).all():
            return part
        part = _scaled(task, part, share)
    raise ModelError(task.model.robot.path, f"no {part.pattern.name} motion was found within the limits; give others")


def _highest(x: Array, sign: float = 0.0) -> Array:
    """The largest values of curves (nv, N) times the sign, or without one of their sizes, between samples too; (nv,).

    Between samples a curve may be higher than at the nearest by an eighth of the second difference there.
    """
    bend = np.abs(np.diff(x, 2, axis=1)) / 8 if x.shape[1] > 2 else np.zeros((len(x), 0))
    high = np.abs(x) if sign == 0 else sign * x
    high[:, 1 : 1 + bend.shape[1]] += bend
    return np.asarray(high.max(axis=1))


def _possible(task: Task, part: Part) -> bool:
    """Whether torque and clearance are within their limits."""
    for t, samples in part.blocks(_interval(task)):
        if (np.abs(task.torque(samples, t)) > _SURE_TORQUE * task.limits.effort[:, None]).any():
            return False
    if task.collision is None:
        return True
    return all((task.collision.clearance(s.q) >= task.clearance).all() for _, s in part.blocks(1 / _SPARSE))


def collisions(task: Task, part: Part) -> Array:
    """When links come too near to each other, the part being within the limits of motion, shape (M,) [s]."""
    if task.collision is None or not task.collision.pairs:
        return np.zeros(0)
    part = _within_motion_limits(task, part)
    found = [t[task.collision.clearance(s.q) < task.clearance] for t, s in part.blocks(1 / _SPARSE)]
    return np.concatenate(found)


def largest_use(task: Task, trajectory: Trajectory) -> Array:
    """The largest share of the robot's own limits, without margin, that a trajectory takes, shape (4, nv).

    Raises
    ------
    ModelError
        If it leaves them.
    """
    use = np.zeros((len(QUANTITIES), len(task.full.joints)))
    for part in {id(part): part for part in trajectory.parts}.values():
        for t, samples in part.blocks(_interval(task)):
            use = np.maximum(use, task.full.use(*samples, task.torque(samples, t)))
    if (use > 1).any():
        over = [f"{QUANTITIES[k]} of {task.full.joints[j]}" for k, j in np.argwhere(use > 1)]
        raise ModelError(task.model.robot.path, f"the design leaves the limits: {some(over)}; give a larger --margin")
    return use


def nearest_links(task: Task, trajectory: Trajectory) -> tuple[tuple[str, str], float, float] | None:
    """The two links that come nearest to each other, how near [m], and when [s]; None without any."""
    if task.collision is None or not task.collision.pairs:
        return None
    t, samples = trajectory.sampled(_SPARSE)
    pair, distance, at = task.collision.nearest(samples.q)
    return pair, distance, float(t[at])
