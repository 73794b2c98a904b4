"""Excerpts: short windows of samples, spread evenly over a log, for what a part of it tells as well as all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from idtool.data.logs import JointLog
from idtool.data.logs.log import Channel

_MIN_WINDOW_SAMPLES = 2  # of which a segment consists
_NUMBER_BYTES = 8


def excerpt_of(log: JointLog, duration: float, window: float) -> JointLog:
    """Windows of a log, spread evenly over it, as a log with a segment for each.

    Parameters
    ----------
    log
        The log.
    duration
        About how long the windows are together [s], but at least one window; a log that is as short is kept whole.
    window
        Length of a window [s].
    """
    total_samples = _sample_count(log.segments)
    window_samples = max(round(window / log.dt), _MIN_WINDOW_SAMPLES)
    wanted_samples = max(round(duration / log.dt), window_samples)
    if wanted_samples >= total_samples:
        return log
    candidates = list(spread_windows(log.segments, wanted_samples / total_samples, window_samples))
    windows = _thinned(candidates, wanted_samples)
    kept = np.concatenate([np.arange(part.start, part.stop) for part in windows])
    lengths = [part.stop - part.start for part in windows]
    new_stops = np.cumsum(lengths).tolist()
    new_starts = [0, *new_stops[:-1]]
    intervals = [(float(log.t[part.start]), float(log.t[part.stop - 1])) for part in windows]
    return replace(
        log,
        t=log.t[kept],
        signals={name: np.asarray(values[kept]) for name, values in log.signals.items()},
        segments=tuple(map(slice, new_starts, new_stops)),
        is_excerpt=True,
        channels=_channels_around(log.channels, intervals),
    )


def spread_windows(ranges: Sequence[slice], share: float, length: int) -> Iterator[slice]:
    """Windows with about a share of the samples of some ranges, spread evenly over each range.

    Each range has at least one window; a range that is no longer than a window is one.

    Parameters
    ----------
    ranges
        The ranges.
    share
        Share of their samples.
    length
        Number of samples in a window.
    """
    for part in ranges:
        samples = part.stop - part.start
        if samples <= length:
            yield part
            continue
        wanted_count = max(round(share * samples / length), 1)
        count = min(wanted_count, samples // length)
        spacing = samples / count
        for i in range(count):
            middle = part.start + (i + 0.5) * spacing
            start = int(middle - length / 2)
            yield slice(start, start + length)


def _thinned(windows: Sequence[slice], wanted_samples: int) -> list[slice]:
    """Every n-th window, so that they have about the wanted number of samples together; all windows if they are few."""
    step = max(round(_sample_count(windows) / wanted_samples), 1)
    return list(windows[::step])


def _sample_count(ranges: Sequence[slice]) -> int:
    """Number of samples in ranges."""
    return sum(part.stop - part.start for part in ranges)


def _channels_around(channels: Mapping[str, Channel], intervals: Sequence[tuple[float, float]]) -> dict[str, Channel]:
    """Channels with their values in some intervals of time [s], and the nearest before and after each.

    A flag keeps a value until the next, however late that is; other channels are interpolated.
    """
    kept = {}
    for name, channel in channels.items():
        is_kept = np.zeros(len(channel.t), dtype=bool)
        for first, last in intervals:
            latest_before = int(np.searchsorted(channel.t, first, side="right")) - 1
            next_after = int(np.searchsorted(channel.t, last))
            is_kept[max(latest_before, 0) : next_after + 1] = True
        kept[name] = Channel(channel.t[is_kept], channel.x[is_kept])
    return kept


def duration_of(log: JointLog) -> float:
    """Time that a log's samples cover, gaps left out [s]."""
    return float(_sample_count(log.segments) * log.dt)


def seconds_that_fit(log: JointLog, size: int) -> float:
    """Time [s] of a log's samples, its channels left out, that fit into a memory of a size [bytes]."""
    numbers_per_sample = 1 + sum(values.shape[1] for values in log.signals.values())
    bytes_per_sample = _NUMBER_BYTES * numbers_per_sample
    return float(size / bytes_per_sample * log.dt)
