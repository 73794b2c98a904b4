"""`Log`: a log as a library user sees it.

N samples, nj joints. Units: s, rad or m, rad/s or m/s, N·m or N.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from idtool.common.arrays import Array
from idtool.common.exceptions import LogError
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.data.base_sensors import POSE
from idtool.data.logs import SIGNALS, JointLog, make_log, write_log
from idtool.data.logs import read_log as read_record
from idtool.data.logs.message_options import MessageOptions, message_options
from idtool.data.logs.sensor_channels import SensorOptions
from idtool.data.logs.state_topics import sensor_topics
from idtool.robot.config.base import validate_record
from idtool.robot.config.signals import LogOptions


class Log:
    """Joint signals over time, read from a file. The arrays are read-only.

    When you pass the path of a log to a function such as `idtool.fit`, the log is read with the settings of the
    model's configuration (``log.topic``, ``log.columns``, ``log.scale``). A `Log` object is used as it is.
    `Model.read_log` reads a log with the settings of the configuration.

    Parameters
    ----------
    path
        The log file, or a rosbag2 folder.
    topic
        The topic with the joint states, if the file has several topics.
    columns
        For CSV: name of the column in the file for each canonical name (``t``, ``q_hip``, …).
    scale
        SI units per logged unit, by signal and joint, e.g. ``{"tau": {"hip": 0.118}}`` for a logged current; or by
        signal, for all joints.
    sensors
        True to read the topics of an MCAP file with IMU, contact flags and wrenches too, for a robot with a floating
        base. A CSV file has them as columns, which are always read.
    imu_topic
        The topic with the IMU, if the file has several.
    pose_topic
        The topic with the pose of the base, if the file has several; without it, none of them is read.
    preset, fields, field_joints
        For messages that are not joint states, as in the configuration's section ``log``: a preset such as
        ``unitree_go``, the path of each field, and the joints in the order of the index ``{i}``.

    Raises
    ------
    ConfigError
        If a field or the preset cannot be used.
    LogError
        If the file cannot be read, or does not contain the topic, columns, fields or joints in the options.

    Examples
    --------
    >>> log = idtool.Log("sample_logs/leg_train.mcap")
    >>> log
    Log leg_train.mcap: 3 joints (abad, hip, knee), 10 s at 1000 Hz: q, v, tau
    >>> log.tau.shape
    (10000, 3)
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        topic: str | None = None,
        columns: Mapping[str, str] | None = None,
        scale: Mapping[str, Mapping[str, float] | float] | None = None,
        sensors: bool = False,
        imu_topic: str | None = None,
        pose_topic: str | None = None,
        preset: str | None = None,
        fields: Mapping[str, str] | None = None,
        field_joints: Sequence[str | None] = (),
    ) -> None:
        options = validate_record(
            LogOptions, {"preset": preset, "fields": fields or {}, "field_joints": tuple(field_joints)}, "Log"
        )
        record = read_record(
            path,
            topic=topic,
            columns=columns or {},
            scale=scale or {},
            sensors=SensorOptions(imu_topic, pose_topic) if sensors else None,
            messages=message_options(options),
        )
        if sensors and pose_topic is None:
            notices = _unread_poses(record, message_options(options))
            record = replace(record, notices=(*record.notices, *notices))
        self._set_record(record, as_logged=not (columns or scale))

    @classmethod
    def from_arrays(
        cls,
        name: str,
        t: ArrayLike,
        joints: Sequence[str],
        *,
        q: ArrayLike,
        v: ArrayLike | None = None,
        tau: ArrayLike | None = None,
        qcmd: ArrayLike | None = None,
        vcmd: ArrayLike | None = None,
    ) -> Log:
        """A log from arrays, which are copied.

        Parameters
        ----------
        name
            Name of the log in messages and reports.
        t
            Sample times [s], shape (N,).
        joints
            Joint names, nj of them.
        q, v, tau, qcmd, vcmd
            Position, velocity, torque at the joint output, commanded position and velocity, shape (N, nj) each. A
            joint that lacks a signal has NaN.

        Raises
        ------
        LogError
            If the shapes do not match, or the log has no usable segment.
        """
        names = tuple(joints)
        times = np.array(t, dtype=float)
        signals = {}
        for signal, values in zip(SIGNALS, (q, v, tau, qcmd, vcmd), strict=True):
            if values is not None:
                signals[signal] = np.array(values, dtype=float)
        if times.ndim != 1 or not names or len(set(names)) != len(names):
            raise LogError(name, "needs times of shape (N,) and a unique name for each joint")
        shape = (len(times), len(names))
        for signal, array in signals.items():
            if array.shape != shape:
                raise LogError(name, f"{signal} has the shape {array.shape}; give {shape}")
        return cls.from_record(make_log(Path(name), times, names, signals))

    @classmethod
    def from_record(cls, record: JointLog, as_logged: bool = False) -> Log:
        """A log from its internal record.

        Parameters
        ----------
        record
            The record.
        as_logged
            True for the record of a file, read without columns or scale.
        """
        log = cls.__new__(cls)
        log._set_record(record, as_logged)
        return log

    def _set_record(self, record: JointLog, as_logged: bool) -> None:
        signals = {name: _read_only(values) for name, values in record.signals.items()}
        self._record = replace(record, t=_read_only(record.t), signals=signals)
        self._as_logged = as_logged

    @property
    def record(self) -> JointLog:
        """The internal record."""
        return self._record

    @property
    def as_logged(self) -> bool:
        """True for the record of a file, read without columns or scale."""
        return self._as_logged

    @property
    def path(self) -> Path:
        """Path of the file, or the name of a log that was created from arrays."""
        return self._record.path

    @property
    def joints(self) -> tuple[str, ...]:
        """Joint names, in the order of the columns."""
        return self._record.joints

    @property
    def signals(self) -> tuple[str, ...]:
        """Signals in the log: q, v, tau, qcmd, vcmd or some of them."""
        return tuple(name for name in SIGNALS if name in self._record.signals)

    @property
    def t(self) -> Array:
        """Sample times as logged [s], shape (N,)."""
        return self._record.t

    @property
    def q(self) -> Array:
        """Positions [rad or m], shape (N, nj); NaN for a joint that has none."""
        return self._record.signals["q"]

    @property
    def v(self) -> Array | None:
        """Velocities [rad/s or m/s], shape (N, nj); None if they were not logged."""
        return self._record.signals.get("v")

    @property
    def tau(self) -> Array | None:
        """Torques at the joint output [N·m or N], shape (N, nj); None if they were not logged."""
        return self._record.signals.get("tau")

    @property
    def qcmd(self) -> Array | None:
        """Commanded positions [rad or m], shape (N, nj); None if they were not logged."""
        return self._record.signals.get("qcmd")

    @property
    def vcmd(self) -> Array | None:
        """Commanded velocities [rad/s or m/s], shape (N, nj); None if they were not logged."""
        return self._record.signals.get("vcmd")

    @property
    def segments(self) -> tuple[slice, ...]:
        """Segments of samples without a gap, as slices of the first axis."""
        return self._record.segments

    @property
    def rate(self) -> float:
        """Nominal sample rate [Hz]."""
        return float(1 / self._record.dt)

    @property
    def seconds(self) -> float:
        """Duration from the first to the last sample, without gaps [s]."""
        return float(self._record.dt * sum(part.stop - part.start - 1 for part in self.segments))

    @property
    def warnings(self) -> tuple[str, ...]:
        """The notices as plain text."""
        return tuple(notice.text for notice in self.notices)

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Notices of the reader."""
        return self._record.notices

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the log, with the channels of its sensors, in the format of the file extension; returns the path.

        Raises
        ------
        LogError
            If the file extension is unknown, or the log cannot be written.
        """
        write_log(path, self._record)
        return Path(path)

    def __len__(self) -> int:
        return len(self._record)

    def __repr__(self) -> str:
        count = len(self.joints)
        noun = "joint" if count == 1 else "joints"
        joints = f"{count} {noun} ({join_names(self.joints)})"
        time = f"{short_number(self.seconds)} s at {short_number(self.rate, 4)} Hz"
        if len(self.segments) > 1:
            time += f", {len(self.segments)} segments"
        return f"Log {self.path.name}: {joints}, {time}: {', '.join(self.signals)}"


def read_log(path: str | os.PathLike[str], **options: Any) -> Log:
    """The log in a file; see `Log` for the options and errors."""
    return Log(path, **options)


def _unread_poses(log: JointLog, messages: MessageOptions) -> Iterator[Notice]:
    """Notice about several topics with a pose of which none was read."""
    if POSE[0] in log.channels:
        return
    topics = sensor_topics(log.path, messages).poses
    if len(topics) > 1:
        message = f"{len(topics)} topics carry a pose, and none of them was read: {join_names(topics)}"
        yield Notice("pose_not_chosen", "note", None, message, "name one as pose_topic")


def _read_only(array: Array) -> Array:
    """A view that cannot be written to."""
    view = array.view()
    view.flags.writeable = False
    return view
