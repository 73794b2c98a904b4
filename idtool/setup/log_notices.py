"""Notices about the logs that a first configuration is made from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.robot.urdf.reading import Joint, Robot
from idtool.setup.loaded_log import LoadedLog

_FAR = 0.5  # of a joint's range: further beyond its limits than a zero that is off takes it


def log_notices(
    robot: Robot, seen: Sequence[LoadedLog], joints: Sequence[str], locked: Sequence[str]
) -> tuple[Notice, ...]:
    """Notices about the logs.

    Parameters
    ----------
    robot, seen
        From the URDF; the logs.
    joints, locked
        Joints that are identified, and those that are held still.
    """
    reading = [notice for one in seen for notice in one.inspection.reading]
    return (
        *reading,
        *_problems(seen, joints),
        *_wrongly_held(seen, joints, locked),
        *_unfilled(seen, (*joints, *locked)),
        *_beyond_limits(robot, seen),
    )


def _problems(seen: Sequence[LoadedLog], joints: Sequence[str]) -> Iterator[Notice]:
    """Problems that an inspection finds in what is used, those of one kind together."""
    alike: dict[tuple[str, str, str], list[str]] = {}
    for one in seen:
        name = Path(one.inspection.path).name
        for finding in one.inspection.findings:
            if finding.severity == "problem" and finding.subject in (None, *joints):
                message = f"{finding.subject}: {finding.message}" if finding.subject else finding.message
                alike.setdefault((name, finding.code, finding.advice), []).append(message)
    for (name, code, advice), messages in alike.items():
        yield Notice(code, "problem", name, join_names(messages), advice)


def _wrongly_held(seen: Sequence[LoadedLog], joints: Sequence[str], locked: Sequence[str]) -> Iterator[Notice]:
    """Joints that are held still though they move, and the other way round."""
    moving = [name for name in locked if any(one.moves(name) for one in seen)]
    if moving:
        message = f"held still though they move, which the other joints' torque does not fit: {join_names(moving)}"
        yield Notice("moving_joints_held_still", "warning", None, message)
    still = [name for name in joints if not any(one.moves(name) for one in seen)]
    if still:
        message = f"wanted under joints though they do not move, so that nothing is learnt of them: {join_names(still)}"
        yield Notice("joint_at_rest", "warning", None, message)


def _unfilled(seen: Sequence[LoadedLog], joints: Sequence[str]) -> Iterator[Notice]:
    for one in seen:
        if names := [name for name in one.unfilled if name in joints]:
            what = "torque that never changes while the joint moves is none, and is taken as not logged"
            name = one.log.path.name
            yield Notice("torque_from_command", "note", name, f"{what}: {join_names(names)}")


def _beyond_limits(robot: Robot, seen: Sequence[LoadedLog]) -> Iterator[Notice]:
    """Positions far beyond the URDF's limits."""
    for one in seen:
        far = [name for name in one.inspection.joints if name in robot.joints and _is_far(robot.joints[name], one)]
        if far:
            joint, q = robot.joints[far[0]], one.inspection.joints[far[0]].signals["q"]
            name = one.log.path.name
            limits = f"the first one's being {joint.lower:.4g} to {joint.upper:.4g}"
            where = f"{join_names(far)} ({q.minimum:.4g} to {q.maximum:.4g}, {limits})"
            message = f"q is far beyond the URDF's limits: {where}"
            advice = "degrees (then set log.scale of q and v to 0.0174533), another unit, or another joint's position"
            yield Notice("beyond_limits", "warning", name, message, advice)


def _is_far(joint: Joint, seen: LoadedLog) -> bool:
    q = seen.inspection.joints[joint.name].signals.get("q")
    room = _FAR * (joint.upper - joint.lower)
    if q is None or not 0 < room < math.inf:
        return False
    return q.maximum > joint.upper + room or q.minimum < joint.lower - room
