"""Summary of the logs: identifiable and locked joints, band of the motion, and source of the torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.common.names import join_names, printable
from idtool.common.notice import Notice
from idtool.data.inspection.channel_findings import BAND_FACTOR
from idtool.data.logs import JointLog
from idtool.data.signals import default_cutoff
from idtool.estimation.dataset.experiment import Progress
from idtool.robot.config import Config
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import Robot, UrdfJoint
from idtool.setup.loaded_logs import LoadedLog, find_sensors, find_topic, load_logs
from idtool.setup.log_notices import log_notices
from idtool.setup.logged_sensors import LoggedSensors
from idtool.setup.wrench_sensors import wrench_sensor_joints

_MIN_CUTOFF = 5.0  # Hz; below it, friction at reversals cannot be told from other effects
# Torque computed from a command has kp times the noise of q, which at ω looks like an inertia of kp / ω².
_BAND_OF_COMMANDED = 2.0


@dataclass(frozen=True)
class LockedJoint:
    """A locked joint: its position [rad or m], and the reason."""

    position: float
    reason: str


@dataclass(frozen=True)
class LogSummary:
    """Summary of the logs.

    Attributes
    ----------
    logs
        The samples for trials.
    identifiable
        Joints that can be identified, in the URDF's order.
    joints
        Joints that are identified: as given, or all identifiable ones.
    moving
        Joints of ``joints`` that move.
    locked
        The other actuated joints of the URDF.
    without_torque
        Joints that move and have neither torque nor position command, each with the first log that lacks both.
    with_torque
        Joints of ``joints`` with a torque or a command in some log.
    commanded
        Joints of ``joints`` with a position command but no torque in some log.
    velocity_commanded
        Those of them with a velocity command in every log.
    topic, topics
        The topic that is read, if there are several, and all topics.
    imu_topics, pose_topics
        The topics to choose the IMU and the pose from, the one that is read first; empty if there is one at most.
    are_sensors_read
        False if there are several IMUs, none of them in all logs.
    rates_hz
        Sampling rate of each log.
    motion_hz
        Band of the motion: the widest band of a joint's velocity, median over the logs.
    bands
        Ratio of the filter's cut-off to that band.
    cutoff_hz
        Cut-off of the filter.
    notices
        Notices for the user.
    """

    logs: tuple[JointLog, ...]
    identifiable: tuple[str, ...]
    joints: tuple[str, ...]
    moving: tuple[str, ...]
    locked: dict[str, LockedJoint]
    without_torque: dict[str, str]
    with_torque: tuple[str, ...]
    commanded: tuple[str, ...]
    velocity_commanded: tuple[str, ...]
    topic: str | None
    topics: tuple[str, ...]
    imu_topics: tuple[str, ...]
    pose_topics: tuple[str, ...]
    are_sensors_read: bool
    rates_hz: tuple[float, ...]
    motion_hz: float
    bands: float
    cutoff_hz: float
    notices: tuple[Notice, ...]


def summarize_logs(robot: Robot, paths: Sequence[Path], given: Config, progress: Progress) -> LogSummary:
    """Read and inspect the logs.

    Parameters
    ----------
    robot, paths
        The robot and its logs.
    given
        How to read the logs, and which joints to identify and to lock.
    progress
        Callback for the stage and its share that is done.

    Raises
    ------
    IdtoolError
        If a log cannot be read, or no joint of the robot moves and has a torque or a command.
    """
    topic, topics = find_topic(robot, paths, given)
    sensors = find_sensors(robot, paths, given, topic)
    logs = load_logs(robot, paths, given, topic, sensors.options, progress)
    needs_torque = not _has_wrench_sensors(robot, given, logs)
    reasons = _unidentifiable_reasons(robot, given, logs, needs_torque)
    identifiable = tuple(name for name, reason in reasons.items() if reason is None)
    joints = identifiable if given.joints is None else given.joints
    without_torque: dict[str, str] = {}
    if needs_torque:
        without_torque = {name: lacking[0] for name in reasons if (lacking := _logs_without_torque(name, logs))}
    if not set(identifiable) & set(joints):
        raise LogError(paths[0], _no_joint_message(reasons, without_torque, logs))
    locked = {
        name: LockedJoint(_rest_position(robot.joints[name], logs), reason or "left out of joints")
        for name, reason in reasons.items()
        if name not in joints
    }
    moving = tuple(name for name in joints if _moves(name, logs))
    motion = float(np.median([_motion_band(log, moving) for log in logs]))
    commanded = tuple(name for name in joints if any(_is_commanded(name, log) for log in logs))
    if given.controller is None and not needs_torque:
        commanded = ()  # whose torque is not needed
    bands = _BAND_OF_COMMANDED if commanded else BAND_FACTOR
    return LogSummary(
        logs=tuple(log.log for log in logs),
        identifiable=identifiable,
        joints=joints,
        moving=moving,
        locked=locked,
        without_torque=without_torque,
        with_torque=tuple(name for name in joints if any({"tau", "qcmd"} & _signals(name, log) for log in logs)),
        commanded=commanded,
        velocity_commanded=tuple(name for name in commanded if all("vcmd" in log.signals(name) for log in logs)),
        topic=topic if topics else None,
        topics=topics,
        imu_topics=sensors.imu_topics,
        pose_topics=sensors.pose_topics,
        are_sensors_read=sensors.options is not None,
        rates_hz=tuple(log.inspection.rate_hz for log in logs),
        motion_hz=motion,
        bands=bands,
        cutoff_hz=_cutoff(bands * motion, min(default_cutoff(log.inspection.dt) for log in logs)),
        notices=log_notices(robot, logs, joints, tuple(locked), needs_torque),
    )


def _unidentifiable_reasons(
    robot: Robot, given: Config, logs: Sequence[LoadedLog], needs_torque: bool
) -> dict[str, str | None]:
    """Reason why an actuated joint cannot be identified, by joint; None if it can."""
    logged = [name for name in logs[0].inspection.joints if all(name in log.inspection.joints for log in logs)]
    # raises for logs of another robot, or a missing joint
    build_model(robot, given.model_copy(update={"locked_joints": {}}), logged)
    given_locked = given.locked_joints if given.joints is None else ()
    reasons: dict[str, str | None] = {}
    for joint in robot.joints.values():
        if joint.kind == "fixed" or joint.mimic is not None:
            continue
        if joint.name not in logged:
            reasons[joint.name] = "not in every log"
        elif joint.name in given_locked:
            reasons[joint.name] = "locked in the configuration"
        else:
            reasons[joint.name] = _log_reason(joint.name, logs, needs_torque)
    return reasons


def _has_wrench_sensors(robot: Robot, given: Config, logs: Sequence[LoadedLog]) -> bool:
    """True if sensors of force and moment, given or logged, tell what the joints carry, so that none needs a torque."""
    if given.wrench_sensors:
        return True
    return bool(wrench_sensor_joints(robot, LoggedSensors.of_logs([log.log for log in logs]).wrenches))


def _log_reason(joint: str, logs: Sequence[LoadedLog], needs_torque: bool) -> str | None:
    """Reason why a joint that is in every log cannot be identified; None if it can."""
    if not all("q" in log.signals(joint) for log in logs):
        return "has no position in some log"
    if not _moves(joint, logs):
        return "does not move"
    lacking = _logs_without_torque(joint, logs) if needs_torque else []
    return f"has neither torque nor position command in {join_names(lacking)}" if lacking else None


def _moves(joint: str, logs: Sequence[LoadedLog]) -> bool:
    return any(log.moves(joint) for log in logs)


def _logs_without_torque(joint: str, logs: Sequence[LoadedLog]) -> list[str]:
    """The logs in which a joint that moves has neither torque nor position command."""
    if not _moves(joint, logs):
        return []
    names = []
    for log in logs:
        if joint in log.inspection.joints and not {"tau", "qcmd"} & log.signals(joint):
            names.append(log.log.path.name)
    return names


def _signals(joint: str, log: LoadedLog) -> set[str]:
    return log.signals(joint) if joint in log.inspection.joints else set()


def _is_commanded(joint: str, log: LoadedLog) -> bool:
    return "qcmd" in log.signals(joint) and "tau" not in log.signals(joint)


def _no_joint_message(
    reasons: Mapping[str, str | None], without_torque: Mapping[str, str], logs: Sequence[LoadedLog]
) -> str:
    """Error message if no joint can be identified, with advice."""
    joints_by_reason: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        joints_by_reason.setdefault(reason or "left out of joints", []).append(name)
    parts = [f"{reason}: {join_names(names)}" for reason, names in joints_by_reason.items()]
    if without_torque:
        first = printable(next(iter(without_torque)))
        parts.append(
            f"map the column of the torque to tau_{first} in log.columns, and set its N·m per unit in log.scale"
        )
        parts += [notice.text for log in logs for notice in log.inspection.reading]
    return f"no joint of the robot can be identified: {'; '.join(parts)}"


def _rest_position(joint: UrdfJoint, logs: Sequence[LoadedLog]) -> float:
    """Position of a locked joint: the logged log, or zero or the limit nearest to it [rad or m]."""
    logged = [log.median_positions[joint.name] for log in logs if joint.name in log.median_positions]
    if logged:
        return round(float(np.median(logged)), 4)
    return float(min(max(0.0, joint.lower), max(joint.upper, joint.lower)))


def _motion_band(log: LoadedLog, joints: Sequence[str]) -> float:
    """Widest band of a joint's velocity [Hz]."""
    bands = (log.inspection.joints[name].band_hz for name in joints)
    return max((band for band in bands if band is not None), default=0.0)


def _cutoff(wanted: float, highest: float) -> float:
    """The permitted cut-off nearest to ``wanted``, to two digits [Hz]."""
    return float(f"{min(max(wanted, _MIN_CUTOFF), highest):.2g}")
