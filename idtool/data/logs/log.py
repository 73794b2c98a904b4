"""`JointLog`: joint signals over time, the one record that every reader returns.

Letters: t time [s], q position [rad or m], v velocity [rad/s or m/s], tau torque or force at the joint output
[N·m or N], qcmd and vcmd the commanded position and velocity. N samples, nj joints.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.common.names import count_text
from idtool.common.notice import Notice
from idtool.common.provenance import InputFile
from idtool.data.logs.stored_arrays import blocks_of, evaluate_blocks, release_pages
from idtool.data.logs.times import suspected_unit, time_unit_notice

SIGNALS = ("q", "v", "tau", "qcmd", "vcmd")

SET = 0.5  # value of a flag, above which it is set
_RECOVERY = 20  # samples before and after a long step that decide whether it is a gap
_BLOCK = 1 << 15  # samples checked together


@dataclass(frozen=True)
class Channel:
    """A channel of a sensor with stamps of its own.

    Attributes
    ----------
    t
        Times [s], shape (k,).
    x
        Values, shape (k,); one that is not finite is none.
    """

    t: Array
    x: Array

    @property
    def step(self) -> float:
        """Usual time from a value to the next [s]; 0 for less than two values."""
        return float(np.median(np.diff(self.t))) if len(self.t) > 1 else 0.0

    def at(self, t: Array) -> Array:
        """Interpolated values at times [s], shape (N,)."""
        return np.interp(t, self.t, self.x)

    def is_set(self, t: Array, widen: float = 0.0) -> Mask:
        """True at times [s], shape (N,), at which a flag is set; it keeps a value until the next.

        Parameters
        ----------
        t
            The times.
        widen
            Time [s] by which it counts as set before it is, and after it was.
        """
        if not len(t):
            return np.zeros(0, dtype=bool)
        latest_before_all = int(np.searchsorted(self.t, t.min() - widen)) - 1
        next_after_all = int(np.searchsorted(self.t, t.max() + widen, side="right"))
        window = slice(max(latest_before_all, 0), max(next_after_all, 1))
        times, x = self.t[window], self.x[window]
        set_times = times[x > SET]
        first = np.searchsorted(set_times, t - widen)
        stop = np.searchsorted(set_times, t + widen, side="right")
        is_set_within = stop > first
        latest_before = np.searchsorted(times, t - widen, side="right") - 1
        was_set_before = x[np.maximum(latest_before, 0)] > SET
        return np.asarray(is_set_within | was_set_before)


@dataclass(frozen=True)
class JointLog:
    """Joint signals over time.

    Attributes
    ----------
    path
        The file or folder that was read.
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
        Notices of the reader.
    sources
        The files that were read.
    channels
        Channels of sensors that are of no joint, by name; see `sensor_channels`.
    unknown_torque
        Joints whose torque was not logged, and is 0 in ``signals``.
    preset
        Preset that names the joints, which the messages do not; None: they are named in the file or by the options.
    is_excerpt
        True if samples between the segments were left out on purpose.
    """

    path: Path
    joints: tuple[str, ...]
    t: Array
    signals: Mapping[str, Array]
    segments: tuple[slice, ...]
    dt: float
    notices: tuple[Notice, ...] = ()
    sources: tuple[InputFile, ...] = ()
    channels: Mapping[str, Channel] = field(default_factory=dict)
    unknown_torque: tuple[str, ...] = ()
    preset: str | None = None
    is_excerpt: bool = False

    def __len__(self) -> int:
        return len(self.t)

    @property
    def start(self) -> float:
        """Time of the first complete sample [s]."""
        return float(self.t[self.segments[0].start])

    @property
    def duration(self) -> float:
        """Time from the first complete sample to the last [s]."""
        return float(self.t[self.segments[-1].stop - 1]) - self.start

    def has(self, signal: str, joint: str) -> bool:
        """True if ``joint`` has ``signal``."""
        if joint not in self.joints or signal not in self.signals:
            return False
        column = self.signals[signal][:, self.joints.index(joint)]
        if np.isfinite(column[:1]).any():
            return True
        return any(np.isfinite(column[rows]).any() for rows in self.blocks())

    def blocks(self) -> Iterator[slice]:
        """Slices of samples that are looked at together; after each, the memory for them is given back."""
        return blocks_of(self.signals.values(), len(self))

    def release_memory(self) -> None:
        """Give back the memory that was taken by reading or changing what is in a file; see `stored_arrays`."""
        release_pages(self.signals.values())
        release_pages(channel.x for channel in self.channels.values())
        release_pages(channel.t for channel in self.channels.values())


def truncation_notice(file: str, kept: str) -> Notice:
    """Notice that a file was cut off while it was written, and how much of it was kept."""
    advice = "record again if this is too short"
    return Notice("log_truncated", "warning", None, f"{file} was cut off while it was written; kept: {kept}", advice)


def make_log(
    path: Path,
    t: Array,
    joints: tuple[str, ...],
    signals: Mapping[str, Array],
    notices: tuple[Notice, ...] = (),
) -> JointLog:
    """Check the data of a reader and split them into segments.

    Rows in which the time or a signal is not finite end a segment, as do gaps and backward steps in time. Samples that
    repeat the previous stamp count as jitter if later stamps catch up.

    Parameters
    ----------
    path
        The file that was read; errors name it.
    t
        Sample times [s], shape (N,).
    joints
        Joint names.
    signals
        Any of `SIGNALS`, each of shape (N, nj).
    notices
        Notices of the reader.

    Raises
    ------
    LogError
        If there is no position, fewer than two samples, or no two consecutive complete samples.
    """
    invalid, present = _check_values(t, signals)
    if "q" not in present:
        raise LogError(path, "no joint positions found; name them q_<joint> or <joint>/position")
    if len(t) < 2:
        raise LogError(path, f"has {count_text(len(t), 'sample')}; at least two are needed")
    with np.errstate(invalid="ignore", over="ignore"):
        steps = _sampled_steps(t)
        forward = steps[(steps > 0) & np.isfinite(steps)]
        if not len(forward):
            raise LogError(path, "time does not advance; check the time column")
        dt, longest_step = _nominal_step(forward)
        segments = _split(t, dt, longest_step, invalid)
    if not segments:
        raise LogError(path, "no two consecutive samples are complete; check for missing values")
    if invalid.any():
        count = int(invalid.sum())
        message = f"{count} samples have values that are not finite; they were left out"
        if count == 1:
            message = "1 sample has a value that is not finite; it was left out"
        advice = "if there are many of them, run idtool inspect"
        notices += (Notice("not_finite", "note", None, message, advice),)
    if unit := suspected_unit(dt, segments, present):
        notices += (time_unit_notice(dt, unit, present),)
    return JointLog(path, joints, t, present, segments, dt, notices)


def _check_values(t: Array, signals: Mapping[str, Array]) -> tuple[Mask, dict[str, Array]]:
    """True for samples that lack a value, shape (N,); and the signals that at least one joint has."""
    known_columns = {name: finite_columns(array) for name, array in signals.items()}
    present = {name: array for name, array in signals.items() if known_columns[name].any()}

    def is_invalid(rows: slice) -> Mask:
        invalid = ~np.isfinite(t[rows])
        for name, array in present.items():
            columns = np.ascontiguousarray(array[rows].T)
            invalid |= ~np.isfinite(columns[known_columns[name]]).all(axis=0)
        return invalid

    in_blocks = evaluate_blocks(is_invalid, present.values(), len(t))
    return np.concatenate([np.zeros(0, dtype=bool), *in_blocks]), present


def finite_columns(array: Array) -> Mask:
    """True for columns of an array, shape (N, nj), that have a finite value."""
    has_value = np.zeros(array.shape[1], dtype=bool)
    for rows in blocks_of([array], len(array)):
        has_value |= np.isfinite(array[rows]).any(axis=0)
        if has_value.all():
            break
    return has_value


def _nominal_step(steps: Array) -> tuple[float, float]:
    """Nominal sample time, and the longest step that is not a gap [s].

    Lost samples make steps that are multiples of the sample time. Jitter makes steps of any length in between: then
    only a longer step counts as a gap.
    """
    median = float(np.median(steps))
    between = np.count_nonzero((steps > 1.2 * median) & (steps < 1.8 * median))
    multiples = np.count_nonzero(steps >= 1.8 * median)
    longest_step = (2.5 if between > multiples else 1.5) * median
    return float(steps[steps <= longest_step].mean()), longest_step


def _sampled_steps(t: Array) -> Array:
    """Steps between consecutive times; of a long log only some, spread evenly over it."""
    i = np.unique(np.linspace(0, len(t) - 2, _BLOCK).astype(int))
    return np.asarray(t[i + 1] - t[i])


def _split(t: Array, dt: float, longest_step: float, invalid: Mask) -> tuple[slice, ...]:
    """Runs without a gap. A late stamp is no gap if later stamps catch up."""
    edges = [np.array([0])]
    for start in range(0, len(t) - 1, _BLOCK):  # in blocks, so that no temporary array is as long as the log
        rows = slice(start, start + _BLOCK + 1)
        step = np.diff(t[rows])
        candidates = start + np.flatnonzero((step > longest_step) | (step < -0.5 * dt))
        edges.append(candidates[~_catches_up(t, dt, candidates)] + 1)
        edges.append(start + np.flatnonzero(np.diff(invalid[rows])) + 1)
    edges.append(np.array([len(t)]))
    breaks = np.unique(np.concatenate(edges))
    starts, stops = breaks[:-1], breaks[1:]
    usable = (stops - starts >= 2) & ~invalid[starts]
    return tuple(map(slice, starts[usable].tolist(), stops[usable].tolist()))


def _catches_up(t: Array, dt: float, candidates: Indices) -> Mask:
    """True if the stamps after a long step return to the clock of those before it, so that no time was lost."""
    count = np.arange(_RECOVERY + 1)
    before = candidates[:, None] - count
    after = candidates[:, None] + count[1:]
    # time of the sample before the step, extrapolated from several samples before it
    extrapolated = np.where(before >= 0, t[np.maximum(before, 0)] + dt * count, np.nan)
    start = np.nanmedian(extrapolated, axis=1)[:, None]
    lateness = t[np.minimum(after, len(t) - 1)] - start - dt * count[1:]
    caught_up = (lateness < 0.5 * dt) & (after < len(t))
    return np.asarray(caught_up.any(axis=1) & (t[candidates + 1] > t[candidates]))
