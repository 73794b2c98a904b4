"""Notices about the logs of a first configuration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.estimation.dataset.joint_limits import beyond_limits_notice
from idtool.robot.urdf.reading import Robot
from idtool.setup.loaded_logs import LoadedLog


def log_notices(
    robot: Robot, logs: Sequence[LoadedLog], joints: Sequence[str], locked: Sequence[str], needs_torque: bool
) -> tuple[Notice, ...]:
    """Notices about the logs.

    Parameters
    ----------
    robot, logs
        The robot and its logs.
    joints, locked
        Joints that are identified, and joints that are locked.
    needs_torque
        False if wrench sensors tell what the joints carry.
    """
    reading = [notice for log in logs for notice in log.inspection.reading]
    return (
        *reading,
        *_problems(logs, joints, needs_torque),
        *_wrongly_locked(logs, joints, locked),
        *_constant_torque(logs, (*joints, *locked)),
        *_beyond_limits(robot, logs),
    )


def _problems(logs: Sequence[LoadedLog], joints: Sequence[str], needs_torque: bool) -> Iterator[Notice]:
    """Problems with the used joints that the inspections found, those of one kind together."""
    alike: dict[tuple[str, str, str], list[str]] = {}
    for log in logs:
        name = Path(log.inspection.path).name
        for finding in log.inspection.findings:
            if finding.code == "missing_torque" and not needs_torque:
                continue
            if finding.severity == "problem" and finding.subject in (None, *joints):
                message = f"{finding.subject}: {finding.message}" if finding.subject else finding.message
                alike.setdefault((name, finding.code, finding.advice), []).append(message)
    for (name, code, advice), messages in alike.items():
        yield Notice(code, "problem", name, join_names(messages), advice)


def _wrongly_locked(logs: Sequence[LoadedLog], joints: Sequence[str], locked: Sequence[str]) -> Iterator[Notice]:
    """Locked joints that move, and identified joints that do not."""
    moving = [name for name in locked if any(log.moves(name) for log in logs)]
    if moving:
        message = (
            f"these locked joints move in the logs, which affects the torque of the other joints: {join_names(moving)}"
        )
        yield Notice("moving_joints_held_still", "warning", None, message)
    still = [name for name in joints if not any(log.moves(name) for log in logs)]
    if still:
        message = f"these joints do not move in the logs, so they cannot be identified: {join_names(still)}"
        yield Notice("joint_at_rest", "warning", None, message)


def _constant_torque(logs: Sequence[LoadedLog], joints: Sequence[str]) -> Iterator[Notice]:
    for log in logs:
        if names := [name for name in log.constant_torque if name in joints]:
            what = "the torque never changes while the joint moves, so it is treated as if it were not logged"
            name = log.log.path.name
            yield Notice("torque_from_command", "note", name, f"{what}: {join_names(names)}")


def _beyond_limits(robot: Robot, logs: Sequence[LoadedLog]) -> Iterator[Notice]:
    """Positions far beyond the URDF's limits."""
    for log in logs:
        ranges = {}
        for name, joint in log.inspection.joints.items():
            if q := joint.signals.get("q"):
                ranges[name] = (q.minimum, q.maximum)
        notice = beyond_limits_notice(robot, ranges)
        if notice is not None:
            yield notice.about(log.log.path.name)
