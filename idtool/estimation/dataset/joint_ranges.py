"""Positions of a log compared with the limits of the URDF: far beyond them, the unit is another one or the column."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.data.logs import JointLog
from idtool.robot.urdf.reading import Robot, UrdfJoint

_FAR = 0.5  # of a joint's range: too far beyond its limits for a zero offset
_ADVICE = "for degrees, set log.scale of q and v to 0.0174533; otherwise check the unit and the column of q"

Ranges = Mapping[str, tuple[float, float]]


def position_ranges(log: JointLog, joints: Sequence[str]) -> Ranges:
    """Least and greatest position of some joints in a log that has their positions [rad or m]."""
    ranges = {}
    for name in joints:
        q = log.signals["q"][:, log.joints.index(name)]
        ranges[name] = (float(np.nanmin(q)), float(np.nanmax(q)))
    return ranges


def limits_notice(robot: Robot, ranges: Ranges) -> Notice | None:
    """Notice about joints whose positions are far outside the URDF's limits; None if there are none.

    Parameters
    ----------
    robot
        From the URDF.
    ranges
        Least and greatest position by joint [rad or m].
    """
    far = [name for name, range_ in ranges.items() if name in robot.joints and _is_far(robot.joints[name], *range_)]
    if not far:
        return None
    joint, (low, high) = robot.joints[far[0]], ranges[far[0]]
    example = f"{low:.4g} to {high:.4g}, limits {joint.lower:.4g} to {joint.upper:.4g}"
    message = f"q is far outside the URDF's limits: {join_names(far)} ({example})"
    return Notice("beyond_limits", "warning", None, message, _ADVICE)


def _is_far(joint: UrdfJoint, low: float, high: float) -> bool:
    room = _FAR * (joint.upper - joint.lower)
    if not 0 < room < math.inf:
        return False
    return high > joint.upper + room or low < joint.lower - room
