"""`LoadedLog`: a log that is read only once, with its inspection and the samples for trials.

If a file has several topics, the one of the robot is found.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.data.base_sensors import sensor_options
from idtool.data.inspection import Inspection, inspect_log
from idtool.data.inspection.records import InspectedJoint
from idtool.data.logs import JointLog, read_log
from idtool.data.logs.message_options import message_options
from idtool.data.logs.sensor_channels import SensorOptions
from idtool.data.logs.state_topics import sensor_topics, state_topics
from idtool.estimation.dataset.experiment import Progress
from idtool.robot.config import Config
from idtool.robot.urdf.reading import Robot

MAX_SAMPLES = 200_000  # samples of a log that trials use


@dataclass(frozen=True)
class LoadedLog:
    """A log and its inspection.

    Attributes
    ----------
    log
        The log, or the first samples of a long one, without constant torque.
    inspection
        Inspection of the whole log.
    median_positions
        Median position by joint [rad or m].
    constant_torque
        Joints whose torque never changes while they move: drivers without a sensor publish zeros.
    """

    log: JointLog
    inspection: Inspection
    median_positions: dict[str, float]
    constant_torque: tuple[str, ...]

    def signals(self, joint: str) -> set[str]:
        """The signals that a joint has."""
        return set(self.inspection.joints[joint].signals) - ({"tau"} if joint in self.constant_torque else set())

    def moves(self, joint: str) -> bool:
        """True if the log has the joint and it moves."""
        return joint in self.inspection.joints and self.inspection.joints[joint].moves


def load_logs(
    robot: Robot,
    paths: Sequence[Path],
    given: Config,
    topic: str | None,
    sensors: SensorOptions | None,
    progress: Progress,
) -> list[LoadedLog]:
    """Read and inspect the logs.

    Parameters
    ----------
    robot, paths
        The robot and its logs.
    given
        How to read the logs. A joint in its ``joints`` without command is passive and may have zero torque.
    topic
        The topic to read.
    sensors
        How to read the topics of sensors; None: they are not read.
    progress
        Callback for the stage and its share that is done.

    Raises
    ------
    LogError
        If a log cannot be read.
    """
    logs: list[LoadedLog] = []
    for path in paths:
        progress(f"inspecting {path.name}", len(logs) / len(paths))
        log = _read_with_sensors(path, robot, given, topic, sensors)
        logs.append(_inspect(log, robot, given.joints or ()))
    return logs


def _read_with_sensors(
    path: Path, robot: Robot, given: Config, topic: str | None, sensors: SensorOptions | None
) -> JointLog:
    """A log with its sensors; without them, and with a notice, if they cannot be read and are not asked for."""
    try:
        return _read(path, robot, given, topic, sensors)
    except LogError as error:
        if sensors is None or sensor_options(given) is not None:
            raise
        log = _read(path, robot, given, topic)
        message = f"the sensors beside the joints cannot be read: {error.what}"
        notice = Notice("sensors_not_read", "warning", None, message, "repair or remove their topic if they matter")
        return replace(log, notices=(*log.notices, notice))


def _read(path: Path, robot: Robot, given: Config, topic: str | None, sensors: SensorOptions | None = None) -> JointLog:
    options = given.log
    return read_log(
        path,
        topic=topic,
        columns=options.columns,
        scale=dict(options.scale),
        sensors=sensors,
        messages=message_options(options, robot.joints),
    )


def _inspect(log: JointLog, robot: Robot, passive: Collection[str]) -> LoadedLog:
    q = log.signals["q"]
    median_positions = {}
    for i, name in enumerate(log.joints):
        if name in robot.joints and log.has("q", name):
            median_positions[name] = float(np.nanmedian(q[:, i]))
            log.release_memory()
    inspection = inspect_log(log)
    constant_torque = tuple(
        name
        for name, joint in inspection.joints.items()
        if _has_constant_torque(joint) and ("qcmd" in joint.signals or name not in passive)
    )
    trial_log = _without_torque(first_samples(log), constant_torque)
    return LoadedLog(trial_log, inspection, median_positions, constant_torque)


def _has_constant_torque(joint: InspectedJoint) -> bool:
    return joint.moves and "tau" in joint.signals and joint.signals["tau"].constant


def first_samples(log: JointLog) -> JointLog:
    """The log, or a copy of the first samples of a long one."""
    kept: list[slice] = []
    remaining = MAX_SAMPLES
    for segment in log.segments:
        if remaining > 1:
            kept.append(slice(segment.start, min(segment.stop, segment.start + remaining)))
            remaining -= segment.stop - segment.start
    last = kept[-1].stop
    if last == log.segments[-1].stop:
        return log
    signals = {name: x[:last].copy() for name, x in log.signals.items()}
    return replace(log, t=log.t[:last].copy(), signals=signals, segments=tuple(kept))


def _without_torque(log: JointLog, joints: Sequence[str]) -> JointLog:
    """The log without the torque of some joints."""
    if not joints:
        return log
    tau = log.signals["tau"].copy()
    tau[:, [log.joints.index(name) for name in joints]] = np.nan
    return replace(log, signals={**log.signals, "tau": tau})


def find_topic(robot: Robot, paths: Sequence[Path], given: Config) -> tuple[str | None, tuple[str, ...]]:
    """The topic with most of the robot's joints, then most signals, then most samples; and the topics to choose from.

    It is in all logs.

    Raises
    ------
    LogError
        If the logs have no topic in common.
    """
    if given.log.topic is not None:
        return given.log.topic, ()
    messages = message_options(given.log, robot.joints)
    topics = {path: state_topics(path, messages) for path in paths if path.exists()}
    several = next((path for path, names in topics.items() if len(names) > 1), None)
    if several is None:
        return None, ()
    shared = [name for name in topics[several] if all(name in names for names in topics.values() if names)]
    if not shared:
        raise LogError(several, f"has no topic in common with the other logs: {join_names(topics[several])}")

    def score(name: str) -> tuple[int, int, int]:
        try:
            log = _read(several, robot, given, name)
        except LogError:  # joint commands have the message type of states, but no position
            return -1, 0, 0
        known = [joint for joint in log.joints if joint in robot.joints]
        values = sum(log.has(signal, joint) for joint in known for signal in log.signals)
        return len(known), values, len(log)

    return max(shared, key=score), tuple(shared)


@dataclass(frozen=True)
class SensorChoice:
    """The topics of sensors to read.

    Attributes
    ----------
    options
        How to read them; None: they are not read.
    imu_topics, pose_topics
        The topics to choose the IMU and the pose from, the chosen one first; empty if there is one at most.
    """

    options: SensorOptions | None
    imu_topics: tuple[str, ...] = ()
    pose_topics: tuple[str, ...] = ()


def find_sensors(robot: Robot, paths: Sequence[Path], given: Config, topic: str | None) -> SensorChoice:
    """The topics of IMU and pose to read.

    Nothing has to be chosen if no log has several, or if the messages of the joints contain an IMU. An IMU must be in
    all logs. If there are several and none is, a pose in all logs takes their place; without one, no sensors are read.

    Parameters
    ----------
    robot, paths
        The robot and its logs.
    given
        How to read the logs; a topic that it gives is not chosen again.
    topic
        The topic of the joints; None: the only one.
    """
    given_pose = None if given.base.pose is None else given.base.pose.topic
    if given.base.imu.topic is not None:
        return SensorChoice(SensorOptions(given.base.imu.topic, given_pose))
    messages = message_options(given.log, robot.joints)
    existing = [path for path in paths if path.exists()]
    try:
        by_log = [sensor_topics(path, messages) for path in existing]
    except LogError:
        return SensorChoice(SensorOptions())  # `load_logs` says why they cannot be read
    poses = () if given_pose is not None else _shared_topics([topics.poses for topics in by_log])
    pose = given_pose or (poses[0] if poses else None)
    imus = [topics.imus for topics in by_log]
    options = SensorOptions(pose_topic=pose)
    if all(len(names) < 2 for names in imus):
        return SensorChoice(options, pose_topics=poses)
    of_joints = {topic} if topic is not None else {name for path in existing for name in state_topics(path, messages)}
    if all(of_joints & set(names) for names in imus):
        return SensorChoice(options, pose_topics=poses)
    shared = _shared_topics(imus)
    if not shared:
        has_pose = pose is not None or all(len(topics.poses) == 1 for topics in by_log)
        if not has_pose:
            return SensorChoice(None)
        return SensorChoice(replace(options, needs_imu=False), pose_topics=poses)
    return SensorChoice(SensorOptions(shared[0], pose), shared, poses)


def _shared_topics(by_log: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """The topics that are in all logs, the shortest name first, if some log has several."""
    if all(len(names) < 2 for names in by_log):
        return ()
    shared = [name for name in by_log[0] if all(name in names for names in by_log)]
    return tuple(sorted(shared, key=len))
