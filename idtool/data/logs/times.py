"""The unit of a log's times. They are seconds; times that can't be are converted, doubtful ones are named.

Letters: t time [s], q position [rad or m], v velocity [rad/s or m/s], N samples, nj joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.notice import Notice

_UNITS = {"ns": 1e9, "us": 1e6, "ms": 1e3}  # to the second
_LOOKED_AT, _FEW = 1 << 14, 16  # samples
_SLOWEST = 0.2  # s from sample to sample, with which no log of a motion is made
_AGREES = 1.25  # ratio of v to dq/dt, or of dq/dt to v, that is no other unit


def in_seconds(t: Array) -> list[Notice]:
    """Convert times that can't be seconds, in place: their epoch or their step would be far off.

    Parameters
    ----------
    t
        Times, shape (N,).

    Returns
    -------
    A notice of what was done, if anything was.
    """
    unit = _unit(t[:_LOOKED_AT])
    if unit is None:
        return []
    t /= _UNITS[unit]
    message = f"its times are in {unit}; they were converted to seconds"
    return [Notice("times_converted", "note", None, message, "nothing to do if that is right")]


def _unit(t: Array) -> str | None:
    """The unit of times that can't be seconds; None for seconds."""
    if (t[:_FEW] % 1 > 0).any():  # of nearly all logs
        return None
    t = t[np.isfinite(t)]
    if len(t) < 2 or not (t == np.rint(t)).all():
        return None
    for unit, per_second in _UNITS.items():
        if 5e8 < t[0] / per_second < 5e9:  # 1985 to 2128
            return unit
    forward = np.diff(t)[np.diff(t) > 0]
    step = np.median(forward) if len(forward) else 0
    return "ns" if step >= 1e5 else "us" if step >= 100 else None


def doubtful_unit(dt: float, segments: Sequence[slice], signals: Mapping[str, Array]) -> str | None:
    """The unit that times seem to be in, where they are too far apart for seconds; None where there is no doubt.

    Where a velocity was logged it must be dq/dt in that unit: a motion that is slow enough to be sampled so seldom is
    left in peace.

    Parameters
    ----------
    dt
        Nominal sample time [s].
    segments
        Runs of samples without a gap.
    signals
        Among them q and, where it was logged, v, each of shape (N, nj).
    """
    unit = next((unit for unit, per in reversed(_UNITS.items()) if dt / per < _SLOWEST), None)
    if dt < _SLOWEST or unit is None or "v" not in signals:
        return unit if dt >= _SLOWEST else None
    longest = max(segments, key=lambda s: s.stop - s.start)
    q, v = (signals[name][longest][:_LOOKED_AT] for name in ("q", "v"))
    way, expected = np.diff(q, axis=0), 0.5 * dt * (v[1:] + v[:-1])
    scale = np.nansum(way * expected) / max(float(np.nansum(expected**2)), np.finfo(float).tiny)  # least squares
    return unit if 1 / _AGREES < scale * _UNITS[unit] < _AGREES else None


def wrong_time_unit(dt: float, unit: str, signals: Mapping[str, Array]) -> Notice:
    """Notice that the times seem to be in another unit than seconds.

    Parameters
    ----------
    dt
        Nominal sample time [s].
    unit
        The unit that they seem to be in, from `doubtful_unit`.
    signals
        Those of the log, by name.
    """
    evidence = f"which are in {unit}, as v tells" if "v" in signals else f"which look like {unit}"
    message = f"samples are {dt:.3g} s apart by their times, {evidence}"
    return Notice("wrong_unit", "problem", None, message, "write them in seconds")
