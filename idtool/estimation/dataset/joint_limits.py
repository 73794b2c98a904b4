"""Check of the joint positions in a log against the limits of the URDF, which shows a wrong unit or column."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.data.logs import JointLog
from idtool.data.logs.stored_arrays import column_ranges
from idtool.robot.urdf.reading import Robot, UrdfJoint

_MARGIN = 0.5  # of the range in the URDF: the zero of an encoder alone is not that far off
_ADVICE = "for degrees, set log.scale of q and v to 0.0174533; otherwise check the unit and the column of q"

PositionRanges = Mapping[str, tuple[float, float]]


def position_ranges(log: JointLog, joints: Sequence[str]) -> PositionRanges:
    """Least and greatest position of each of the joints, which the log must have [rad or m]."""
    least, greatest = column_ranges(log.signals["q"])
    columns = [log.joints.index(name) for name in joints]
    return {name: (float(least[i]), float(greatest[i])) for name, i in zip(joints, columns, strict=True)}


def beyond_limits_notice(robot: Robot, ranges: PositionRanges) -> Notice | None:
    """Notice about joints whose positions are far outside the URDF's limits; None if there are none.

    Parameters
    ----------
    robot
        The robot, with the limits of its joints.
    ranges
        Least and greatest position by joint [rad or m]; joints that the robot lacks do not count.
    """
    far_joints = []
    for name, (least, greatest) in ranges.items():
        if name in robot.joints and _is_far_outside(robot.joints[name], least, greatest):
            far_joints.append(name)
    if not far_joints:
        return None
    first = far_joints[0]
    limits = robot.joints[first]
    least, greatest = ranges[first]
    example = (
        f"{first} {short_number(least)} to {short_number(greatest)}, limits {short_number(limits.lower)} to "
        f"{short_number(limits.upper)}"
    )
    message = f"q is far outside the URDF's limits: {join_names(far_joints)} ({example})"
    return Notice("beyond_limits", severity="warning", subject=None, message=message, advice=_ADVICE)


def _is_far_outside(joint: UrdfJoint, least: float, greatest: float) -> bool:
    """True if positions are outside the limits by much of the range; False for a joint without two limits."""
    margin = _MARGIN * (joint.upper - joint.lower)
    has_limits = 0 < margin < math.inf
    return has_limits and (greatest > joint.upper + margin or least < joint.lower - margin)
