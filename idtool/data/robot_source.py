"""A robot from its URDF or, if none is given, from the robot description in a ROS bag."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from idtool.data.logs import is_bag
from idtool.robot.urdf.reading import Robot, parse_robot, read_robot


def read_robot_and_logs(urdf: Path, logs: Sequence[Path]) -> tuple[Robot, list[Path]]:
    """The robot and its logs.

    If ``urdf`` is a bag (an MCAP file or a rosbag2 folder), it is the first of the logs, and the robot is the one on
    topic ``/robot_description`` of any of the logs. The robot's `path` is then that of the bag and the topic: there is
    no such file, so its meshes are found by ROS's search paths, not beside it.

    Parameters
    ----------
    urdf
        The URDF, or a bag.
    logs
        The logs, or the other logs.

    Raises
    ------
    IdtoolError
        If the URDF or a bag cannot be read, no bag describes a robot, or two describe different ones.
    """
    if not is_bag(urdf):
        return read_robot(urdf), list(logs)
    from idtool.data.logs.description import find_robot_description

    all_logs = [urdf, *logs]
    description = find_robot_description(all_logs)
    parts = [part for part in description.topic.split("/") if part.strip(".")]  # no "..": stay within the bag
    return parse_robot(description.path.joinpath(*parts), description.text), all_logs
