"""Channels of sensors that are of no joint: IMU, contact flags, forces, pose of the base.

Each has stamps of its own, in the clock of the joints' samples. Units: rad/s, m/s², N, N·m, m.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from idtool.common.arrays import Mask
from idtool.common.exceptions import LogError
from idtool.common.names import count_text, join_names, printable, suggestion
from idtool.common.notice import Notice
from idtool.data.logs.log import Channel, JointLog

SENSOR_CHANNEL = re.compile(r"imu_(q[wxyz]|[wa][xyz])|contact_.+|force_.+_m?[xyz]|base_(q[wxyz]|[xyz])")

_QUATERNIONS = (("imu_qw", "imu_qx", "imu_qy", "imu_qz"), ("base_qw", "base_qx", "base_qy", "base_qz"))
_MAX_STEPS = 10.0  # between samples of a channel, in its own median steps and in the joints', beyond which it has a gap


@dataclass(frozen=True)
class SensorOptions:
    """How to read the topics of sensors: that of the IMU, or None for the only one."""

    imu_topic: str | None = None


def with_sensors(log: JointLog, names: Iterable[str]) -> JointLog:
    """The log with only some of its channels; samples at which one of them is missing are in no segment.

    Parameters
    ----------
    log
        The log.
    names
        The channels that are needed.

    Raises
    ------
    LogError
        If the log lacks one of them, or no two samples in a row have all.
    """
    channels = {}
    for name in dict.fromkeys(names):
        if name not in log.channels:
            raise LogError(log.path, f"has no channel {printable(name)}; {suggestion(name, list(log.channels))}")
        channels[name] = finite_samples(log.channels[name])
        if len(channels[name].t) < (1 if _is_flag(name) else 2):
            raise LogError(log.path, f"channel {printable(name)} has no values")
    for quaternion in _QUATERNIONS:
        channels |= _without_sign_changes({name: channels[name] for name in quaternion if name in channels})
    is_missing = np.zeros(len(log), dtype=bool)
    for name, channel in channels.items():
        if not _is_flag(name):
            is_missing |= _is_in_gap(channel, log)
    segments = tuple(_complete_segments(log.segments, is_missing))
    if not segments:
        what = f"no two samples in a row have joints and sensors; compare the times of {join_names(list(channels))}"
        raise LogError(log.path, what)
    notices = log.notices
    lost = sum(s.stop - s.start for s in log.segments) - sum(s.stop - s.start for s in segments)
    if lost:
        message = f"{count_text(lost, 'sample')} without a value of every sensor; left out"
        notices += (Notice("sensors_missing", "note", None, message),)
    return replace(log, channels=channels, segments=segments, notices=notices)


def _is_flag(name: str) -> bool:
    """True for a contact flag, which may be logged only when it changes."""
    return name.startswith("contact_")


def finite_samples(channel: Channel) -> Channel:
    """The channel's finite samples in the order of time."""
    is_finite = np.isfinite(channel.t) & np.isfinite(channel.x)
    t = channel.t[is_finite]
    order = np.argsort(t, kind="stable")
    return Channel(t[order], channel.x[is_finite][order])


def _without_sign_changes(parts: Mapping[str, Channel]) -> dict[str, Channel]:
    """The four parts of a quaternion, whose sign means nothing, without jumps of the sign."""
    if len(parts) < len(_QUATERNIONS[0]) or len({len(part.t) for part in parts.values()}) > 1:
        return dict(parts)
    quaternions = np.stack([part.x for part in parts.values()])
    is_reversed = (quaternions[:, 1:] * quaternions[:, :-1]).sum(axis=0) < 0
    sign = np.where(np.cumsum(np.concatenate([[False], is_reversed])) % 2, -1.0, 1.0)
    return {name: Channel(part.t, part.x * sign) for name, part in parts.items()}


def _is_in_gap(channel: Channel, log: JointLog) -> Mask:
    """True for samples of the log before a channel's first value, after its last, or in a gap of it."""
    longest = _MAX_STEPS * max(float(np.median(np.diff(channel.t))), log.dt)
    next_sample = np.searchsorted(channel.t, log.t, side="left")
    after = channel.t[np.minimum(next_sample, len(channel.t) - 1)]
    before = channel.t[np.maximum(next_sample - 1, 0)]
    with np.errstate(invalid="ignore"):
        is_outside = (log.t < channel.t[0] - log.dt) | (log.t > channel.t[-1] + log.dt)
        return np.asarray(is_outside | (after - before > longest))


def _complete_segments(segments: tuple[slice, ...], is_missing: Mask) -> Iterator[slice]:
    """Parts of segments in which nothing is missing, of at least two samples."""
    for segment in segments:
        edges = np.flatnonzero(np.diff(is_missing[segment], prepend=True, append=True))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if stop - start > 1:
                yield slice(segment.start + int(start), segment.start + int(stop))
