"""A robot from its URDF or, where none is given, from the description that a bag of ROS holds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from idtool.data.logs import is_bag
from idtool.robot.urdf.reading import Robot, parse_robot, read_robot


def robot_and_logs(urdf: Path, logs: Sequence[Path]) -> tuple[Robot, list[Path]]:
    """The robot and its logs.

    Where ``urdf`` is a bag, an MCAP file or a rosbag2 folder, it is the first of the logs, and the robot is that on its
    topic ``/robot_description``, or on that of another log. The robot's `path` is then the bag's and the topic's: there
    is no such file, so its meshes are found by ROS's search paths, not beside it.

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
    from idtool.data.logs.description import robot_description

    every = [urdf, *logs]
    found = robot_description(every)
    parts = [part for part in found.topic.split("/") if part.strip(".")]  # not up and out of the bag
    return parse_robot(found.path.joinpath(*parts), found.text), every
