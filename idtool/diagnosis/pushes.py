"""Pushes: time intervals in which a force acts on one link with any profile in time, along one direction.

In a push, the joints' residuals share one force s(t) f at one point p of a link: e = −J_p(q)ᵀ f s(t). The profile s(t)
is free, but there are several joints, whose ratio must be that of the Jacobian in every pose. Given f and p, s follows
by least squares at each sample (variable projection; Golub & Pereyra 1973). What acts on one joint only is no push.

Letters: nv joints, n samples, e residuals in units of each joint's noise, b the joint torques of the unit force.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares

from idtool.common.arrays import Array, Indices, Mask, joined_runs
from idtool.common.dataclass import dataclass
from idtool.diagnosis.robust_residual import RobustResidual
from idtool.dynamics.effects.data_summary import Burst
from idtool.robot.body import Body, Frame
from idtool.robot.kinematics import cross, frame_jacobian
from idtool.robot.model import RobotModel

_RAISED = 3.0  # times the usual level
_USUAL = 1.5  # times the usual level, at which a window ends
_MIN_PEAK = 6.0  # times the usual level
_LEVEL_SECONDS = 0.025  # in which the level is averaged
_MIN_GAP = 0.1  # s between windows
_MIN_DURATION = 0.06  # s
_MAX_WINDOWS = 20
_MAX_SHARE = 0.4  # of the log in windows
_MIN_INSIDE = 0.8  # of the log's squared residual, in windows
_BLOCK_SECONDS = 0.25  # in which the level is averaged to find the usual one
_MAX_UNEXPLAINED = 0.1  # of the squared residual above the noise, in all windows
_MAX_UNEXPLAINED_WINDOW = 0.25  # in a window, with the force and its point from the others
_MAX_DROPPED = 0.1  # of the squared residual, in windows that disagree with the rest
_MIN_SECOND_JOINT = 0.03  # of the squared residual, on the joint with the second most of it
_MAX_REVERSED = 0.05  # of a window's squared force, that has the other sign
_MAX_ROUGHNESS = 0.3  # of the force, that changes within _SMOOTH_SECONDS
_SMOOTH_SECONDS = 0.05
_REACH = 0.3  # m: typical distance of the point from the link's centre of mass
_MAX_FIT_SAMPLES = 400
_FIT_TOLERANCE = 1e-5  # relative change of the squared residual
_MAX_KNOTS = 16  # of a profile, in a window
_MIN_KNOT_SAMPLES = 3  # between two knots
_PIECES = 6  # of a straight line, in which its error is averaged
_KNOT_GAIN = 16.0  # squared residual, in units of the usual one, that one more knot explains
_NEGLIGIBLE = 0.02  # of a profile's largest value
_DIRECTIONS = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 0, -1], [1, 1, 0], [0, 1, 1]], dtype=float)
_TINY = 1e-12


def find_pushes(model: RobotModel, residual: RobustResidual) -> tuple[Burst, ...]:
    """Pushes on a link that explain all time intervals with an unusually large residual.

    Parameters
    ----------
    model
        The robot.
    residual
        Residual of a robust fit.

    Returns
    -------
    For each link on which a push may act, the same pushes as they would be on it; none if there is no such link.
    """
    usual = _usual_level(residual)
    windows = raised_windows(residual)
    if not windows:
        return ()
    bursts = []
    for i, body in enumerate(model.bodies):
        if body.kind == "link":
            burst = _push_on_link(model, i, body, residual, usual, windows)
            if burst is not None:
                bursts.append(burst)
    return tuple(bursts)


def _usual_level(residual: RobustResidual) -> float:
    """Rms level in the calmer part of the log, as long as it must be without a push; friction has peaks there too."""
    duration = float(np.median(np.diff(residual.t))) * len(residual.t)
    count = max(round(duration / _BLOCK_SECONDS), 1)
    squares = np.sort([float(np.square(block).mean()) for block in np.array_split(residual.levels, count)])
    calmer = squares[: max(round((1 - _MAX_SHARE) * count), 1)]
    return max(float(np.sqrt(calmer.mean())), _TINY)


def raised_windows(residual: RobustResidual) -> list[slice]:
    """Windows in which the level is far above the usual; none if there are too many, or little of the residual in them.

    One that fills its segment was seen neither to come nor to go.
    """
    usual = _usual_level(residual)
    windows = []
    outside = np.ones(len(residual.t), dtype=bool)
    for segment in residual.segments:
        if segment.stop - segment.start <= 2:
            continue
        dt = float(residual.t[segment.start + 1] - residual.t[segment.start])
        samples = max(round(_LEVEL_SECONDS / dt), 1)
        level = np.sqrt(uniform_filter1d(np.square(residual.levels[segment]), samples, mode="nearest"))
        for a, b in joined_runs(level > _USUAL * usual, round(_MIN_GAP / dt)):
            outer = slice(segment.start + max(a - samples, 0), min(segment.start + b + samples, segment.stop))
            high = np.count_nonzero(level[a:b] > _RAISED * usual)
            is_raised = high * dt > _MIN_DURATION and level[a:b].max() > _MIN_PEAK * usual
            if is_raised and b - a < len(level):
                windows.append(outer)
                outside[outer] = False
    if not windows or len(windows) > _MAX_WINDOWS or outside.mean() < 1 - _MAX_SHARE:
        return []
    squares = np.square(residual.levels)
    return windows if squares[~outside].sum() > _MIN_INSIDE * squares.sum() else []


@dataclass(frozen=True)
class _Windows:
    """The residual in some windows, and the Jacobian of a link there.

    Attributes
    ----------
    e
        Residual in units of the usual level, 0 where it is not known, shape (nv, n).
    linear, angular
        Jacobian of the link's frame in the same units, 0 where the residual is not known, shape (nv, 3, n).
    R
        Rotation of the link, shape (n, 3, 3).
    index
        Number of each sample's window, shape (n,).
    """

    e: Array
    linear: Array
    angular: Array
    R: Array
    index: Indices

    def part(self, keep: Mask | slice) -> _Windows:
        """Some of the samples."""
        return _Windows(
            self.e[:, keep], self.linear[:, :, keep], self.angular[:, :, keep], self.R[keep], self.index[keep]
        )

    def unit_torque(self, force: Array, point: Array) -> Array:
        """Torque b that a force along the axes of the root link at a point of the link takes, shape (nv, n)."""
        return np.asarray(np.einsum("ikn,i->kn", self.torque_by_force(point), force))

    def torque_by_force(self, point: Array) -> Array:
        """Derivative of the torque b by the force at a point, shape (3, nv, n); b is linear in the force."""
        arm = (self.R @ point).T[:, None]
        return -np.asarray(self.linear.swapaxes(0, 1) + cross(self.angular.swapaxes(0, 1), arm))

    def torque_by_point(self, force: Array) -> Array:
        """Derivative of the torque b by the point at which a force acts, shape (3, nv, n)."""
        moment = cross(force[:, None, None], self.angular.swapaxes(0, 1))
        return -np.asarray(np.einsum("nij,ikn->jkn", self.R, moment))

    def unexplained(self, b: Array) -> float:
        """Share of the squared residual above the noise that a force with a free profile does not explain."""
        known = np.square(self.linear).sum(axis=1) + np.square(self.angular).sum(axis=1) > 0
        left = self.e - b * _profile(b, self.e)
        expected_left = float(np.maximum(known.sum(axis=0) - 1, 0).sum())
        energy = float(np.square(self.e).sum()) - float(known.sum())
        return (float(np.square(left).sum()) - expected_left) / max(energy, _TINY)


def _profile(b: Array, e: Array) -> Array:
    """Best size s of the force at each sample, shape (n,)."""
    return np.asarray((b * e).sum(axis=0) / np.maximum(np.square(b).sum(axis=0), _TINY))


def _push_on_link(
    model: RobotModel, i: int, body: Body, residual: RobustResidual, usual: float, windows: Sequence[slice]
) -> Burst | None:
    """The push on the link that carries body i; None if it does not explain the windows."""
    samples = np.concatenate([np.arange(window.start, window.stop) for window in windows])
    index = np.concatenate([np.full(window.stop - window.start, k) for k, window in enumerate(windows)])
    valid = residual.valid[:, samples]
    linear, angular, R = frame_jacobian(model, Frame(i, np.eye(3), np.zeros(3)), residual.q[:, samples])
    largest = np.abs(linear).max(axis=(1, 2)) + np.abs(angular).max(axis=(1, 2))
    if np.count_nonzero(largest > _TINY) < 2:
        return None  # a free profile explains whatever is on one joint
    weight = (valid / (usual * residual.noise[:, None]))[:, None]
    data = _Windows(residual.e[:, samples] * valid / usual, linear * weight, angular * weight, R, index)
    center = body.pi[1:4] / body.pi[0] if body.pi[0] > 0 else np.zeros(3)

    force, point = _fit_force(data, center, [(direction, center) for direction in _DIRECTIONS])
    b = data.unit_torque(force, point)
    if data.unexplained(b) > _MAX_UNEXPLAINED:
        return None
    agreeing = [k for k in range(len(windows)) if _agrees(data, k, center, force, point)]
    keep = np.isin(index, agreeing)
    if np.square(data.e[:, ~keep]).sum() > _MAX_DROPPED * np.square(data.e).sum():
        return None
    data = data.part(keep)
    force, point = _fit_force(data, center, [(force, point)])
    b = data.unit_torque(force, point)
    if not _is_push(data, b, residual, samples[keep]):
        return None
    return _burst(body.name, point, _profiles(data, b, residual.t[samples[keep]]))


def _agrees(data: _Windows, k: int, center: Array, force: Array, point: Array) -> bool:
    """True if window k is explained by the force and its point in the others; given those in all windows."""
    is_own = data.index == k
    own, others = data.part(is_own), data.part(~is_own)
    if not is_own.all():
        force, point = _fit_force(others, center, [(force, point)])
    return own.unexplained(own.unit_torque(force, point)) < _MAX_UNEXPLAINED_WINDOW


def _profiles(data: _Windows, b: Array, t: Array) -> list[list[tuple[float, float]]]:
    """Times and sizes of the force in each window."""
    s = _profile(b, data.e)
    left = np.square(data.e - b * s).sum(axis=0)
    weight = np.square(b).sum(axis=0) / (1 + left)  # friction at a reversal is not along the force
    smallest = _NEGLIGIBLE * float(np.quantile(np.abs(s), 0.99))
    profiles = []
    for k in np.unique(data.index):
        own = data.index == k
        profiles.append(_knots(t[own], s[own], weight[own], smallest))
    return profiles


def _burst(link: str, point: Array, profiles: Sequence[Sequence[tuple[float, float]]]) -> Burst | None:
    """Burst of pushes on a link with these profiles; None if all are too short to have a size."""
    rows = [row for profile in profiles for row in profile]
    largest = max((size for _, size in rows), key=abs)
    if not largest:
        return None
    x, y, z = (round(float(value), 4) for value in point)
    return Burst(
        windows=tuple((round(profile[0][0], 4), round(profile[-1][0], 4)) for profile in profiles),
        link=link,
        point=(x, y, z),
        profile=tuple((round(t, 4), round(size / largest, 4)) for t, size in rows),
    )


def _fit_force(data: _Windows, center: Array, starts: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Direction of the force, a unit vector, and its point in the link's frame [m], that explain most."""
    every = -(-data.e.shape[1] // _MAX_FIT_SAMPLES)
    few = data.part(slice(None, None, every))

    def remaining(x: Array) -> Array:
        force, point = x[:3], x[3:]
        b = few.unit_torque(force, point)
        left = few.e - b * _profile(b, few.e)
        return np.concatenate([left.ravel(), (point - center) / _REACH, [np.linalg.norm(force) - 1]])

    def derivative(x: Array) -> Array:
        force, point = x[:3], x[3:]
        b = few.unit_torque(force, point)
        s = _profile(b, few.e)
        db = np.concatenate([few.torque_by_force(point), few.torque_by_point(force)])
        ds = (db * (few.e - 2 * b * s)).sum(axis=1) / np.maximum(np.square(b).sum(axis=0), _TINY)
        d_left = -(db * s + b * ds[:, None])
        of_point = np.vstack([np.zeros((3, 3)), np.eye(3) / _REACH])
        of_size = np.concatenate([force / np.linalg.norm(force), np.zeros(3)])
        return np.column_stack([d_left.reshape(6, -1), of_point, of_size]).T

    solutions = []
    for force, point in starts:
        start = np.concatenate([force / np.linalg.norm(force), point])
        solutions.append(least_squares(remaining, start, jac=derivative, ftol=_FIT_TOLERANCE))
    best = min(solutions, key=lambda solution: float(solution.cost)).x
    return best[:3] / np.linalg.norm(best[:3]), best[3:]


def _is_push(data: _Windows, b: Array, residual: RobustResidual, samples: Indices) -> bool:
    """True if the force acts on two joints, in one direction in each window, and smoothly."""
    s = _profile(b, data.e)
    by_joint = np.sort(np.square(b * s).sum(axis=1))
    if by_joint[-2] < _MIN_SECOND_JOINT * by_joint.sum():
        return False
    weight = np.square(b).sum(axis=0)
    dt = float(np.median(np.diff(residual.t[samples])))
    smooth_samples = max(round(_SMOOTH_SECONDS / dt), 1)
    rough = 0.0
    for k in np.unique(data.index):
        own = data.index == k
        positive = float((weight[own] * np.square(np.maximum(s[own], 0))).sum())
        total = float((weight[own] * np.square(s[own])).sum())
        if min(positive, total - positive) > _MAX_REVERSED * total:
            return False
        mean_weight = np.maximum(uniform_filter1d(weight[own], smooth_samples), _TINY)  # 0 where no joint is known
        smooth = uniform_filter1d(s[own] * weight[own], smooth_samples) / mean_weight
        rough += float((weight[own] * np.square(s[own] - smooth)).sum())
    return rough < _MAX_ROUGHNESS**2 * float((weight * np.square(s)).sum())


def _knots(t: Array, s: Array, weight: Array, smallest: float) -> list[tuple[float, float]]:
    """Times and sizes of a profile with straight lines that begins and ends at 0, in few pieces.

    Parameters
    ----------
    t
        Times [s], shape (n,).
    s, weight
        Sizes and their weights, shape (n,).
    smallest
        Size that counts.
    """
    large = np.flatnonzero(uniform_filter1d(np.abs(s), _MIN_KNOT_SAMPLES) > smallest)
    first = max(int(large[0]) - 1, 0) if len(large) else 0
    last = min(int(large[-1]) + 1, len(t) - 1) if len(large) else len(t) - 1
    knots = [first, last]
    values = np.zeros(2)
    while len(knots) < _MAX_KNOTS:
        split = _split(s - np.interp(t, t[knots], values), weight, knots, smallest)
        if split is None:
            break
        knots = sorted([*knots, split])
        hats = np.stack([np.interp(t, t[knots], unit) for unit in np.eye(len(knots))[1:-1]])
        inner = np.linalg.lstsq((hats * weight) @ hats.T, (hats * weight) @ s, rcond=None)[0]
        values = np.concatenate([[0.0], inner, [0.0]])
    return [(float(t[k]), float(value)) for k, value in zip(knots, values, strict=True)]


def _split(error: Array, weight: Array, knots: Sequence[int], smallest: float) -> int | None:
    """Sample amid the errors on the piece with most of them, for another knot; None if they are small.

    Parameters
    ----------
    error, weight
        Errors of the profile with these knots and their weights, shape (n,).
    knots
        Samples, ascending.
    smallest
        Size that counts.
    """
    best = None
    largest_gain = 0.0
    for a, b in pairwise(knots):
        if b - a <= 2 * _MIN_KNOT_SAMPLES:
            continue
        smoothing = max((b - a) // _PIECES, _MIN_KNOT_SAMPLES)  # what is rough on a piece is no bend of it
        own_weight = uniform_filter1d(weight[a:b], smoothing, mode="nearest")
        own_error = uniform_filter1d((weight * error)[a:b], smoothing, mode="nearest") / np.maximum(own_weight, _TINY)
        squares = own_weight * np.square(own_error)
        gain = float(squares.sum())
        if gain > max(largest_gain, _KNOT_GAIN, float(own_weight.sum()) * (smallest / 2) ** 2):
            middle = a + int(np.searchsorted(np.cumsum(squares), gain / 2))
            best = min(max(middle, a + _MIN_KNOT_SAMPLES), b - _MIN_KNOT_SAMPLES)
            largest_gain = gain
    return best
