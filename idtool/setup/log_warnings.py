"""What in the logs a user should know of before believing what is found in them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from idtool.common.names import some
from idtool.robot.urdf.reading import Joint, Robot
from idtool.setup.loaded_log import LoadedLog

_FAR = 0.5  # of a joint's range: further beyond its limits than a zero that is off takes it


def doubts(robot: Robot, seen: Sequence[LoadedLog], joints: Sequence[str], locked: Sequence[str]) -> tuple[str, ...]:
    """Plain sentences, a sentence each.

    Parameters
    ----------
    robot, seen
        From the URDF; the logs.
    joints, locked
        Joints that are identified, and those that are held still.
    """
    said = [warning for one in seen for warning in one.inspection.warnings]
    return (
        *said,
        *_problems(seen, joints),
        *_held(seen, joints, locked),
        *_unfilled(seen, (*joints, *locked)),
        *_beyond(robot, seen),
    )


def _problems(seen: Sequence[LoadedLog], joints: Sequence[str]) -> Iterator[str]:
    """Problems that an inspection finds in what is used, those of one kind together."""
    found: dict[tuple[str, str], list[str]] = {}
    for one in seen:
        for finding in one.inspection.findings:
            if finding.severity == "problem" and finding.joint in (None, *joints):
                what = f"{finding.joint}: {finding.what}" if finding.joint else finding.what
                found.setdefault((Path(one.inspection.path).name, finding.meaning), []).append(what)
    for (name, meaning), which in found.items():
        yield f"{name}: {some(which)}: {meaning}"


def _held(seen: Sequence[LoadedLog], joints: Sequence[str], locked: Sequence[str]) -> Iterator[str]:
    """Joints that are held still though they move, and the other way round."""
    moving = [name for name in locked if any(one.moves(name) for one in seen)]
    if moving:
        yield f"held still though they move, which the other joints' torque does not fit: {some(moving)}"
    still = [name for name in joints if not any(one.moves(name) for one in seen)]
    if still:
        yield f"wanted under joints though they do not move, so that nothing is learnt of them: {some(still)}"


def _unfilled(seen: Sequence[LoadedLog], joints: Sequence[str]) -> Iterator[str]:
    for one in seen:
        if names := [name for name in one.unfilled if name in joints]:
            what = "torque that never changes while the joint moves is none, and is taken as not logged"
            yield f"{one.log.path.name}: {what}: {some(names)}"


def _beyond(robot: Robot, seen: Sequence[LoadedLog]) -> Iterator[str]:
    """Positions far beyond the URDF's limits."""
    for one in seen:
        far = [name for name in one.inspection.joints if name in robot.joints and _is_far(robot.joints[name], one)]
        if far:
            joint, q = robot.joints[far[0]], one.inspection.joints[far[0]].signals["q"]
            where = f"{some(far)} ({q.minimum:.4g} to {q.maximum:.4g}, the first one's being {joint.lower:.4g} to "
            meaning = "degrees (then set log.scale of q and v to 0.0174533), another unit, or another joint's position"
            yield f"{one.log.path.name}: q is far beyond the URDF's limits: {where}{joint.upper:.4g}): {meaning}"


def _is_far(joint: Joint, seen: LoadedLog) -> bool:
    q = seen.inspection.joints[joint.name].signals.get("q")
    room = _FAR * (joint.upper - joint.lower)
    if q is None or not 0 < room < math.inf:
        return False
    return q.maximum > joint.upper + room or q.minimum < joint.lower - room
