"""The robots of this simulator by name, and their motions."""

from __future__ import annotations

from collections.abc import Callable

from ground.humanoid import true_humanoid
from ground.humanoid_motions import humanoid_motion
from ground.motions import Motion
from ground.quadruped import true_quadruped
from ground.quadruped_motions import quadruped_motion
from ground.robot import Robot

KINDS = ("stand", "walk", "hang")

TRUE_ROBOTS: dict[str, Callable[[int], Robot]] = {"quadruped": true_quadruped, "humanoid": true_humanoid}


def motion(robot: Robot, kind: str, seconds: float, seed: int) -> Motion:
    """A motion of a kind, one of `KINDS`, with a chance of its own."""
    if robot.name == "quadruped":
        return quadruped_motion(kind, seed)
    return humanoid_motion(robot, kind, seconds, seed)
