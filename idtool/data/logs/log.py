"""`Log`: joint signals over time, the one record that every reader returns.

Letters: t time [s], q position [rad or m], v velocity [rad/s or m/s], tau torque or force at the joint output
[N·m or N], qcmd and vcmd the commanded position and velocity. N samples, nj joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.exceptions import LogError
from idtool.common.notice import Notice
from idtool.common.provenance import InputFile
from idtool.data.logs.times import doubtful_unit, wrong_time_unit

SIGNALS = ("q", "v", "tau", "qcmd", "vcmd")

_RECOVERY = 20  # samples before and after a long step that tell whether it is a gap
_BLOCK = 1 << 15  # samples looked at together


@dataclass(frozen=True)
class Log:
    """Joint signals over time.

    Attributes
    ----------
    path
        The file or folder they came from.
    joints
        Joint names, in the order of the columns.
    t
        Sample times as logged [s], shape (N,).
    signals
        Any of `SIGNALS` to an array of shape (N, nj). A joint that lacks the signal has a column of NaN; a signal
        that no joint has is absent.
    segments
        Runs of samples without a gap, as slices into the first axis.
    dt
        Nominal sample time [s].
    notices
        What the reader had to say.
    sources
        The files that it was read from.
    """

    path: Path
    joints: tuple[str, ...]
    t: Array
    signals: Mapping[str, Array]
    segments: tuple[slice, ...]
    dt: float
    notices: tuple[Notice, ...] = ()
    sources: tuple[InputFile, ...] = ()

    def __len__(self) -> int:
        return len(self.t)

    def has(self, signal: str, joint: str) -> bool:
        """Whether ``joint`` carries ``signal``."""
        if joint not in self.joints or signal not in self.signals:
            return False
        column = self.signals[signal][:, self.joints.index(joint)]
        return bool(np.isfinite(column[:1]).any() or np.isfinite(column).any())


def truncation(what: str, kept: str) -> Notice:
    """Notice that a file was cut off while it was written, and what of it was kept."""
    advice = "record again if what was kept is too short"
    return Notice("log_truncated", "warning", None, f"{what} was cut off in mid-write; kept: {kept}", advice)


def make_log(
    path: Path,
    t: Array,
    joints: tuple[str, ...],
    signals: Mapping[str, Array],
    notices: tuple[Notice, ...] = (),
) -> Log:
    """Check what a reader has read and split it into segments.

    Rows in which a present signal or the time is not finite end a segment, as gaps and backward steps in time do.
    Samples that repeat the stamp before them count as jitter when the stamps catch up again.

    Parameters
    ----------
    path
        The file the data came from; errors name it.
    t
        Sample times [s], shape (N,).
    joints
        Joint names.
    signals
        Any of `SIGNALS`, each of shape (N, nj).
    notices
        What the reader had to say.

    Raises
    ------
    LogError
        If there is no position, fewer than two samples, or no usable run of samples.
    """
    bad, held = _incomplete(t, signals)
    if "q" not in held:
        raise LogError(path, "no joint positions found; name them q_<joint> or <joint>/position")
    if len(t) < 2:
        raise LogError(path, f"holds {len(t)} samples; at least two are needed")
    with np.errstate(invalid="ignore", over="ignore"):
        step = _steps(t)
        forward = step[(step > 0) & np.isfinite(step)]
        if not len(forward):
            raise LogError(path, "time does not advance; check the time column")
        dt, longest = _clock(forward)
        segments = _segments(t, dt, longest, bad)
    if not segments:
        raise LogError(path, "no two consecutive samples are complete; check for missing values")
    if bad.any():
        message = f"{int(bad.sum())} samples hold values that are not finite and were left out"
        advice = "nothing to do if they are few; else see what idtool inspect says"
        notices += (Notice("not_finite", "note", None, message, advice),)
    if unit := doubtful_unit(dt, segments, held):
        notices += (wrong_time_unit(dt, unit, held),)
    return Log(path, joints, t, held, segments, dt, notices)


def _incomplete(t: Array, signals: Mapping[str, Array]) -> tuple[Mask, dict[str, Array]]:
    """Samples that lack a value, shape (N,), and the signals that some joint has."""
    bad = ~np.isfinite(t)
    held = {}
    for name, array in signals.items():
        # a column at a time: a mask of the whole array would add an eighth to the memory
        for column in array.T:
            missing = ~np.isfinite(column)
            if not missing.all():
                held[name] = array
                bad |= missing
    return bad, held


def _clock(step: Array) -> tuple[float, float]:
    """Nominal sample time, and the longest step that is no gap [s].

    Where samples are lost, a step is a multiple of the sample time. Stamps that jitter fill the room in between too:
    then a step is only a gap where it is longer than jitter makes it.
    """
    middle = float(np.median(step))
    between = np.count_nonzero((step > 1.2 * middle) & (step < 1.8 * middle))
    longest = (2.5 if between > np.count_nonzero(step >= 1.8 * middle) else 1.5) * middle
    return float(step[step <= longest].mean()), longest


def _steps(t: Array) -> Array:
    """Time from sample to sample, of a long log those of a part of the samples spread over it."""
    i = np.unique(np.linspace(0, len(t) - 2, _BLOCK).astype(int))
    return np.asarray(t[i + 1] - t[i])


def _segments(t: Array, dt: float, longest: float, bad: Mask) -> tuple[slice, ...]:
    """Runs without a gap: a break is time that was lost for good, not a stamp that came late."""
    edges = [np.array([0])]
    for start in range(0, len(t) - 1, _BLOCK):  # of bounded size: no array beside the log's own is as long as it
        rows = slice(start, start + _BLOCK + 1)
        step = np.diff(t[rows])
        suspect = start + np.flatnonzero((step > longest) | (step < -0.5 * dt))
        edges.append(suspect[~_late(t, dt, suspect)] + 1)
        edges.append(start + np.flatnonzero(np.diff(bad[rows])) + 1)
    breaks = np.unique(np.concatenate([*edges, [len(t)]]))
    whole = (np.diff(breaks) >= 2) & ~bad[breaks[:-1]]
    return tuple(map(slice, breaks[:-1][whole].tolist(), breaks[1:][whole].tolist()))


def _late(t: Array, dt: float, suspect: Indices) -> Mask:
    """Whether the stamps after a long step are in time with those before it, so that it lost no time."""
    count = np.arange(_RECOVERY + 1)
    before = suspect[:, None] - count
    expected = np.where(before >= 0, t[np.maximum(before, 0)] + dt * count, np.nan)  # of the sample before the step
    following = suspect[:, None] + count[1:]
    lateness = t[np.minimum(following, len(t) - 1)] - np.nanmedian(expected, axis=1)[:, None] - dt * count[1:]
    caught_up = (lateness < 0.5 * dt) & (following < len(t))
    return np.asarray(caught_up.any(axis=1) & (t[suspect + 1] > t[suspect]))
