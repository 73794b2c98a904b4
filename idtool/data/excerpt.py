"""Excerpts: short windows of samples, spread evenly over a log, for what a part of it tells as well as all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from idtool.data.logs import JointLog
from idtool.data.logs.log import Channel


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
    samples = sum(segment.stop - segment.start for segment in log.segments)
    length = max(round(window / log.dt), 2)
    wanted = max(round(duration / log.dt), length)
    if wanted >= samples:
        return log
    windows = evenly_chosen(list(spread_windows(log.segments, wanted / samples, length)), wanted)
    kept = np.concatenate([np.arange(part.start, part.stop) for part in windows])
    stops = np.cumsum([part.stop - part.start for part in windows]).tolist()
    return replace(
        log,
        t=log.t[kept],
        signals={name: np.asarray(values[kept]) for name, values in log.signals.items()},
        segments=tuple(map(slice, [0, *stops[:-1]], stops)),
        is_excerpt=True,
        channels=_channels_within(log.channels, [(log.t[part.start], log.t[part.stop - 1]) for part in windows]),
    )


def spread_windows(ranges: Sequence[slice], share: float, length: int) -> Iterator[slice]:
    """Windows with about a share of some ranges of samples, spread evenly over each.

    There is at least one of each range, which is all of it if it is as short.

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
        count = min(max(round(share * samples / length), 1), samples // length)
        spacing = samples / count
        for i in range(count):
            start = part.start + int((i + 0.5) * spacing - length / 2)
            yield slice(start, start + length)


def evenly_chosen(windows: Sequence[slice], wanted: int) -> list[slice]:
    """Some of many windows, evenly chosen, that together have about as many samples as wanted; all of few."""
    samples = sum(window.stop - window.start for window in windows)
    return list(windows[:: max(round(samples / wanted), 1)])


def _channels_within(channels: Mapping[str, Channel], intervals: Sequence[tuple[float, float]]) -> dict[str, Channel]:
    """Channels with their values in some intervals of time [s], and the last before and the first after each.

    A flag keeps a value until the next, however late that is.
    """
    kept = {}
    for name, channel in channels.items():
        is_within = np.zeros(len(channel.t), dtype=bool)
        for first, last in intervals:
            start = int(np.searchsorted(channel.t, first, side="right")) - 1
            stop = int(np.searchsorted(channel.t, last)) + 1
            is_within[max(start, 0) : stop] = True
        kept[name] = Channel(channel.t[is_within], channel.x[is_within])
    return kept


def duration_of(log: JointLog) -> float:
    """Time that a log's samples cover, gaps left out [s]."""
    return float(sum(segment.stop - segment.start for segment in log.segments) * log.dt)


def seconds_within(log: JointLog, size: int) -> float:
    """Time for which a log's samples, without its channels, take as many bytes [s]."""
    numbers = 1 + sum(values.shape[1] for values in log.signals.values())
    return float(size / (8 * numbers) * log.dt)
