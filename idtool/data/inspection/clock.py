"""The clock of a log: its stamps, and the real instants by position and velocity.

Letters: t stamps [s], q position [rad or m], v velocity [rad/s or m/s], dt nominal sample time [s], N samples,
nj joints.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.data.inspection.records import Gap, Sampling
from idtool.data.logs.log import JointLog
from idtool.data.logs.stored_arrays import blocks

_GAP_STAMPS = 9  # stamps to either side of a gap
_MIN_STEPS = 200  # steps that tell the time, for a statement
_MAX_STEP_ERROR = 0.1  # standard error of a step, in samples, above which it does not tell the time
_SKIPPING_STEP = 1.6  # steps longer than this skip a sample


def jitter(t: Array, dt: float, segments: Iterable[slice]) -> float:
    """Root-mean-square deviation of the stamps from a uniform clock, fitted per segment, in units of ``dt``.

    Parameters
    ----------
    t
        Stamps [s], shape (N,).
    dt
        Nominal sample time [s].
    segments
        Runs without a gap.
    """
    squares = 0.0
    count = 0
    for segment in segments:
        for deviation in clock_deviations(t[segment]):
            squares += float(deviation @ deviation)
            count += len(deviation)
    return float(np.sqrt(squares / count)) / dt if count else 0.0


def step_jitter(t: Array, dt: float, segments: Iterable[slice]) -> float:
    """Standard deviation of the steps from stamp to stamp, those between segments left out, in units of ``dt``.

    It is what differentiating from sample to sample suffers from, while a clock that drifts does it no harm; a fit
    states the same. Parameters are those of `jitter`.
    """
    parts = list(segments)
    count = sum(s.stop - s.start - 1 for s in parts)
    mean = sum(float(t[s.stop - 1] - t[s.start]) for s in parts) / count
    squares = 0.0
    for segment in parts:
        for rows in blocks(segment.stop - segment.start - 1):
            step = np.diff(t[segment][rows.start : rows.stop + 1])
            squares += float(np.square(step - mean).sum())
    return float(np.sqrt(squares / count)) / dt


def clock_deviations(t: Array) -> Iterator[Array]:
    """Deviation of the stamps of one segment, shape (N,), from a uniform clock, its rate fitted [s]; in blocks."""
    mean_time = t.mean()
    mean_count = 0.5 * (len(t) - 1)
    product = 0.0
    square = 0.0
    for rows in blocks(len(t)):
        count = np.arange(rows.start, rows.stop) - mean_count
        product += float(count @ (t[rows] - mean_time))
        square += float(count @ count)
    period = product / max(square, 1.0)
    for rows in blocks(len(t)):
        count = np.arange(rows.start, rows.stop) - mean_count
        yield t[rows] - mean_time - count * period


def disordered_stamps(t: Array) -> tuple[int, int]:
    """Numbers of stamps, shape (N,), that are equal to, and earlier than, the one before."""
    duplicates = 0
    backward = 0
    previous = np.nan
    for rows in blocks(len(t)):
        known = t[rows][np.isfinite(t[rows])]
        step = np.diff(known, prepend=previous)
        duplicates += int(np.count_nonzero(step == 0))
        backward += int(np.count_nonzero(step < 0))
        previous = known[-1] if len(known) else previous
    return duplicates, backward


def first_and_last(t: Array) -> tuple[float, float]:
    """First and last finite stamp of those, shape (N,), of a log."""
    is_known = np.isfinite(t)
    last = len(t) - 1 - np.argmax(is_known[::-1])
    return float(t[np.argmax(is_known)]), float(t[last])


def gaps(log: JointLog) -> tuple[Gap, ...]:
    """Time that was lost between segments, the longest first; rows left out for their values are not lost time."""
    first, _ = first_and_last(log.t)
    if log.is_excerpt:  # what is between the windows was left out on purpose
        return ()
    time_gaps = []
    for before, after in zip(log.segments[:-1], log.segments[1:], strict=True):
        # several stamps to either side, extrapolated to the gap: a single one may be off
        k = np.arange(_GAP_STAMPS)
        last = log.t[before][: -_GAP_STAMPS - 1 : -1]
        following = log.t[after][:_GAP_STAMPS]
        end = float(np.median(last + log.dt * k[: len(last)]))
        start = float(np.median(following - log.dt * k[: len(following)]))
        lost = start - end - log.dt * (after.start - before.stop + 1)
        if lost > 0.5 * log.dt:
            time_gaps.append(Gap(end - first, lost))
    return tuple(sorted(time_gaps, key=lambda gap: -gap.lost))


def fresh_rows(log: JointLog, stretch: slice) -> Mask:
    """True for rows of a stretch that differ from the one before in the q or v of any joint, shape (N,)."""
    fresh = np.zeros(stretch.stop - stretch.start, dtype=bool)
    fresh[0] = True
    for name in {"q", "v"} & log.signals.keys():
        x = log.signals[name][stretch]
        changed = x[1:] != x[:-1]
        fresh[1:] |= (changed & ~np.isnan(x[1:])).any(axis=1)
    return fresh


def sample_steps(q: Array, v: Array, dt: float) -> tuple[Array, Array]:
    """Real time between neighbouring samples, as the joints' motion tells it, and its standard error.

    While a joint moves, its step in position over its velocity is the time that passed. All joints share one clock, so
    their least-squares mean is that time and their disagreement is its error. A step of 0 is a sample that was logged
    twice; a step of 2 skips one.

    Parameters
    ----------
    q, v
        Positions [rad or m] and velocities [rad/s or m/s] of one segment, shape (N, nj), nj ≥ 2.
    dt
        Nominal sample time [s].

    Returns
    -------
    tuple of Array
        Steps and their standard errors in units of ``dt``, each of shape (N − 1,); NaN where too little moves.
    """
    step = np.diff(q, axis=0)
    expected = 0.5 * (v[1:] + v[:-1]) * dt
    power = np.sum(expected**2, axis=0) + np.finfo(float).tiny
    expected = expected * (np.sum(step * expected, axis=0) / power)  # wrong units and a turned sign put right
    weight = 1 / (np.mean((step - expected) ** 2, axis=0) + 1e-12 * power / len(step))
    information = np.sum(expected**2 * weight, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = np.sum(step * expected * weight, axis=1) / information
        residual = (step - steps[:, None] * expected) ** 2 * weight
        mean_residual = np.nansum(residual) / max(np.isfinite(residual).sum(), 1)
        variance = mean_residual * q.shape[1] / (q.shape[1] - 1)
        error = np.sqrt(variance / information)
    return steps, error


def sampling(stretches: Sequence[tuple[Array, Array, Array]], dt: float) -> Sampling | None:
    """The real instants of the samples by the joints' motion; None where it does not tell them.

    Parameters
    ----------
    stretches
        t, shape (N,), and q and v of the joints that move, shape (N, nj), of stretches without a gap.
    dt
        Nominal sample time [s].
    """
    parts = []
    for t, q, v in stretches:
        if q.shape[1] > 1 and len(t) > 2:
            parts.append(np.stack([*sample_steps(q, v, dt), np.diff(t) / dt]))
    if not parts:
        return None
    steps, error, stamps = np.concatenate(parts, axis=1)
    certain = error < _MAX_STEP_ERROR
    if certain.sum() < _MIN_STEPS:
        return None
    noise = 2 * float(np.mean(error[certain] ** 2))
    steps[~certain] = np.nan
    return Sampling(
        skipped=float(np.mean(steps[certain] > _SKIPPING_STEP)),
        jitter_ms=1e3 * dt * _instant_jitter(steps, noise),
        stamp_error_ms=1e3 * dt * _instant_jitter(steps - stamps, noise),
    )


def _instant_jitter(steps: Array, noise: float) -> float:
    """Standard deviation of independent instants, from second differences: steps differ by sqrt(6) times that.

    Differences leave out what changes slowly, such as a velocity that lags; medians, what is skipped or repeated.
    """
    change = np.diff(steps)
    if not np.isfinite(change).any():
        return 0.0
    spread = 1.4826 * float(np.nanmedian(np.abs(change)))
    return float(np.sqrt(max(spread**2 - noise, 0.0) / 6))
