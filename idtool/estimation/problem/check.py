"""Which of a URDF's bodies can exist, and the nearest URDF all of whose bodies can."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.common.names import nearest
from idtool.estimation.problem.projection import project
from idtool.estimation.problem.verdict import judge
from idtool.robot.body import Body, Frame
from idtool.robot.bounding import bounding_shape
from idtool.robot.config import Config
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import Robot
from idtool.robot.urdf.writing import rewrite


@dataclass(frozen=True)
class LinkCheck:
    """What is to be said of one link's inertial.

    Attributes
    ----------
    body
        The link by itself, with the bounds that the configuration gives it.
    violations
        Why no body can have it, a plain sentence each; none where one can.
    """

    body: Body
    violations: tuple[str, ...]


def check(robot: Robot, config: Config) -> list[LinkCheck]:
    """Every link that has an inertial with mass or inertia, against the bounds that the configuration gives it.

    Parameters
    ----------
    robot
        From the URDF.
    config
        Its bounding ellipsoids and shapes, if any.

    Raises
    ------
    ConfigError
        If it bounds a link that is not there.
    """
    for key in ("bounding_ellipsoids", "bounding_shapes"):
        for name in getattr(config, key):
            if name not in robot.links:
                raise ConfigError(f"{key}: {name}", f"is no link of the URDF; {nearest(name, robot.links)}")
    checks = []
    for link, pi in robot.links.items():
        if pi is None or not pi.any():
            continue
        ellipsoids = tuple(bounding.ellipsoid() for bounding in config.bounding_ellipsoids.get(link, ()))
        shapes = tuple(bounding_shape(bound, robot, link) for bound in config.bounding_shapes.get(link, ()))
        place = Frame(-1, np.eye(3), np.zeros(3))
        body = Body(link, "link", pi, ellipsoids, place, np.zeros(3), False, np.zeros(0), shapes=shapes)
        checks.append(LinkCheck(body, judge(body, pi).violations))
    return checks


def nearest_bodies(checks: Sequence[LinkCheck]) -> dict[str, Array]:
    """The nearest inertials, in the pull-back metric, of the links that no body can have; by link, shape (10,)."""
    wrong = [c.body for c in checks if c.violations]
    return {body.name: project(body.pi, choose_set(body), body, "pullback").pi for body in wrong}


def repaired(robot: Robot, inertials: dict[str, Array]) -> bytes:
    """The URDF's text with these inertials, every other byte kept."""
    return rewrite(robot.text, inertials, {})
