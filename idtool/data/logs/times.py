"""The unit of a log's times: seconds. Times that cannot be seconds are converted; doubtful ones are reported.

Letters: t time [s], q position [rad or m], v velocity [rad/s or m/s], N samples, nj joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.notice import Notice
from idtool.common.number_text import short_number

_UNITS = {"ns": 1e9, "us": 1e6, "ms": 1e3}  # units per second
_MAX_SAMPLES = 1 << 14  # samples that the unit is judged by
_FIRST_SAMPLES = 16
_MAX_STEP = 0.2  # s between samples; no log of a motion is sampled more slowly
_MAX_RATIO = 1.25  # of v to dq/dt or the reverse, if both have the same unit of time


def convert_to_seconds(t: Array) -> list[Notice]:
    """Convert times that cannot be seconds, by their epoch or their step, in place.

    Parameters
    ----------
    t
        Times, shape (N,).

    Returns
    -------
    A notice if the times were converted.
    """
    unit = _certain_unit(t[:_MAX_SAMPLES])
    if unit is None:
        return []
    t /= _UNITS[unit]
    message = f"its times are in {unit}; they were converted to seconds"
    return [Notice("times_converted", "note", None, message)]


def _certain_unit(t: Array) -> str | None:
    """The unit of times that cannot be seconds; None for seconds."""
    first = t[:_FIRST_SAMPLES]
    if (first[np.isfinite(first)] % 1 > 0).any():  # true of nearly all logs
        return None
    t = t[np.isfinite(t)]
    if len(t) < 2 or not (t == np.rint(t)).all():
        return None
    for unit, per_second in _UNITS.items():
        if 5e8 < t[0] / per_second < 5e9:  # 1985 to 2128
            return unit
    forward = np.diff(t)[np.diff(t) > 0]
    step = np.median(forward) if len(forward) else 0
    if step >= 1e5:
        return "ns"
    return "us" if step >= 100 else None


def suspected_unit(dt: float, segments: Sequence[slice], signals: Mapping[str, Array]) -> str | None:
    """The likely unit of times that are too far apart for seconds; None if there is no doubt.

    If a velocity was logged, it must be dq/dt in that unit, so that slow motions with a low sampling rate pass.

    Parameters
    ----------
    dt
        Nominal sample time [s].
    segments
        Runs of samples without a gap.
    signals
        At least q, and v if it was logged, each of shape (N, nj).
    """
    if dt < _MAX_STEP:
        return None
    unit = next((unit for unit, per_second in reversed(_UNITS.items()) if dt / per_second < _MAX_STEP), None)
    if unit is None or "v" not in signals:
        return unit
    longest = max(segments, key=lambda s: s.stop - s.start)
    q, v = (signals[name][longest][:_MAX_SAMPLES] for name in ("q", "v"))
    dq = np.diff(q, axis=0)
    expected = 0.5 * dt * (v[1:] + v[:-1])
    scale = np.nansum(dq * expected) / max(float(np.nansum(expected**2)), np.finfo(float).tiny)  # least squares
    return unit if 1 / _MAX_RATIO < scale * _UNITS[unit] < _MAX_RATIO else None


def time_unit_notice(dt: float, unit: str, signals: Mapping[str, Array]) -> Notice:
    """Notice that the times do not seem to be in seconds.

    Parameters
    ----------
    dt
        Nominal sample time [s].
    unit
        Their likely unit, from `suspected_unit`.
    signals
        The log's signals by name.
    """
    evidence = f"are in {unit}, according to v" if "v" in signals else f"seem to be in {unit}"
    message = f"samples are {short_number(dt)} s apart; the times {evidence}"
    return Notice("wrong_unit", "problem", None, message, "write them in seconds")
