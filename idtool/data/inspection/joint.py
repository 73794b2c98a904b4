"""One joint of a log, put together from the measures.

Letters: q position [rad or m], v velocity [rad/s or m/s], tau torque or force [N·m or N], N samples of a stretch,
M samples of all stretches.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.data.inspection.jumps import Jumps
from idtool.data.inspection.records import InspectedJoint, Signal, Velocity
from idtool.data.inspection.signal_statistics import (
    ColumnStatistics,
    noise_level,
    power_band,
    quantisation,
    stale_share,
    stuck_share,
)
from idtool.data.inspection.torque import torque_source
from idtool.data.logs.log import SIGNALS, JointLog
from idtool.data.smoothing import gaussian_mean, moving_mean
from idtool.data.velocity_agreement import Agreement, velocity_agreement

_MAX_QUANTISATION_SAMPLES = 1 << 15  # samples that quantisation is read from
_MIN_RELATIVE_TRAVEL = 10.0  # range of q over its noise or resolution
_STANDSTILL_SPEED = 0.02  # of the fastest motion
_SPEED_WINDOW = 0.05  # s over which the speed is averaged to tell standstill
_CLOCK_WIDTH = 50  # samples over which the stamps are smoothed into a rate
_MIN_CLIPPED_SPEED = 1.02  # speed over the v that is stuck
_MIN_SPEED_AT_EXTREMES = 0.1  # speed at the extremes of q, over the rms speed: a joint that rests there is slower


def inspect_joint(
    log: JointLog,
    i: int,
    statistics: Mapping[str, ColumnStatistics],
    jumps: Jumps,
    stretches: Sequence[slice],
    fresh: Mask,
) -> tuple[InspectedJoint, Mask]:
    """Inspect joint ``i``.

    Parameters
    ----------
    log
        The log.
    i
        Index of the joint.
    statistics
        Statistics of every signal, over the whole log.
    jumps
        Jumps of its position.
    stretches
        Stretches without a gap that statistics are taken from.
    fresh
        Rows of the stretches that do not repeat the one before in every joint, shape (M,).

    Returns
    -------
    tuple
        The joint, and the rows of the stretches in which it moves, shape (M,).
    """
    names = [name for name in SIGNALS if log.has(name, log.joints[i])]
    runs = {name: [np.ascontiguousarray(log.signals[name][s, i]) for s in stretches] for name in names}
    changing = {name for name in names if statistics[name].low[i] < statistics[name].high[i]}
    steps = {name: quantisation(_subsampled(runs[name])) for name in names}
    noise = {}
    for name in names:
        noise[name] = float(np.median([noise_level(x) for x in _long_runs(runs[name])]))
    moves = False
    if "q" in changing:
        travel = statistics["q"].high[i] - statistics["q"].low[i]
        finest = max(steps["q"] or 0.0, noise["q"])
        moves = bool(travel > _MIN_RELATIVE_TRAVEL * finest)
    source, derivatives = ("v", 0) if "v" in changing else ("q", 1)
    speed = np.zeros(len(fresh))
    if source in runs:
        speed = _speed(runs[source], derivatives, log.dt)
    speed_rms = float(np.sqrt(np.mean(speed**2)))
    moving = moves & (speed > _STANDSTILL_SPEED * np.percentile(speed, 99.5))
    signals = {}
    for name in names:
        low, high, rms, not_finite = (float(column[i]) for column in statistics[name])
        x = np.concatenate(runs[name])[fresh]
        is_moving = moving[fresh]
        stale = stale_share(x, is_moving, steps[name], noise[name])
        stuck = stuck_share(x[is_moving], low, high, steps[name])
        if name == "v" and stuck and not _moves_faster_than_extremes_of_v(runs, low, high, log.dt):
            stuck = 0.0
        if name == "q" and stuck and "v" in changing and not _moves_at_extremes_of_q(runs, low, high, speed_rms):
            stuck = 0.0
        signals[name] = Signal(low, high, rms, int(not_finite), steps[name], noise[name], stale, stuck)
    joint = InspectedJoint(
        signals=signals,
        moves=moves,
        standstill=1 - float(moving.mean()),
        speed_rms=speed_rms,
        band_hz=power_band(runs[source], log.dt, derivatives) if moves else None,
        jumps=jumps.number if moves else 0,
        wraps=jumps.wraps and moves,
        velocity=_velocity(log, runs, stretches) if moves and "v" in changing and not jumps.number else None,
        torque=torque_source(runs, signals["tau"]) if moves and "tau" in changing else None,
    )
    return joint, moving


def _subsampled(runs: Sequence[Array]) -> Array:
    stride = -(-sum(len(x) for x in runs) // _MAX_QUANTISATION_SAMPLES)
    return np.concatenate([x[::stride] for x in runs])


def _long_runs(runs: Sequence[Array]) -> list[Array]:
    """Runs not much shorter than the longest: short ones tell little of a spectrum."""
    longest = max(len(x) for x in runs)
    return [x for x in runs if len(x) > longest // 8]


def _speed(runs: Sequence[Array], derivatives: int, dt: float) -> Array:
    """Smoothed speed, from the velocity, or from the position and one derivative, shape (M,)."""
    width = max(int(_SPEED_WINDOW / dt), 1)
    speeds = []
    for x in runs:
        v = np.gradient(x) / dt if derivatives else x
        speeds.append(np.abs(moving_mean(v, width)))
    return np.concatenate(speeds)


def _moves_faster_than_extremes_of_v(runs: Mapping[str, Sequence[Array]], low: float, high: float, dt: float) -> bool:
    """True if the derivative of q exceeds the extremes of v where v is at one; otherwise v is just constant there."""
    v = np.concatenate(runs["v"])
    is_extreme = (v <= low) | (v >= high)
    speed = _speed(runs["q"], 1, dt)[is_extreme]
    return bool(np.median(speed) > _MIN_CLIPPED_SPEED * np.median(np.abs(v[is_extreme])))


def _moves_at_extremes_of_q(runs: Mapping[str, Sequence[Array]], low: float, high: float, speed_rms: float) -> bool:
    """True if v goes on where q is at an extreme; otherwise the joint rests there, as at an end stop."""
    q = np.concatenate(runs["q"])
    v = np.concatenate(runs["v"])
    is_extreme = (q <= low) | (q >= high)
    if not is_extreme.any():
        return False
    return bool(np.median(np.abs(v[is_extreme])) > _MIN_SPEED_AT_EXTREMES * speed_rms)


def _velocity(log: JointLog, runs: Mapping[str, Sequence[Array]], stretches: Sequence[slice]) -> Velocity | None:
    """Agreement of v with q, the stretches weighted by their information."""
    agreements: list[Agreement] = []
    power = []
    for q, v, stretch in zip(runs["q"], runs["v"], stretches, strict=True):
        # where samples were lost without a gap the stamps show it; smoothed, they give the rate
        rate = gaussian_mean(np.gradient(log.t[stretch]) / log.dt, _CLOCK_WIDTH)
        agreement = velocity_agreement(q, v * rate, log.dt)
        if not np.isnan(agreement.agreement):
            agreements.append(agreement)
            power.append(float(v @ v) + np.finfo(float).tiny)
    if not agreements:
        return None
    lag, gain, explained, error = np.array(agreements).T
    share = float(np.average(explained, weights=power))
    samples = sum(len(v) for v in runs["v"])
    residual = float(np.sqrt((1 - share) * sum(power) / samples))
    is_related = np.isfinite(lag)
    if not is_related.any():
        return Velocity(None, None, None, share, residual)
    lag = lag[is_related]
    weight = 1 / np.maximum(error[is_related], 1e-9) ** 2
    mean_lag = float(np.average(lag, weights=weight))
    mean_gain = float(np.average(gain[is_related], weights=weight))
    scatter = float(np.average((lag - mean_lag) ** 2, weights=weight)) / max(len(lag) - 1, 1)
    lag_error = float(np.sqrt(max(1 / weight.sum(), scatter)))
    return Velocity(1e3 * mean_lag, 1e3 * lag_error, mean_gain, share, residual)
