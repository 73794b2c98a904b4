"""Realizability check of a URDF's links, and the nearest URDF whose links are all realizable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.common.names import suggestion
from idtool.estimation.problem.projection import project
from idtool.estimation.problem.realizability import check_realizability
from idtool.robot.body import Body, Frame
from idtool.robot.bounding import bounding_shape
from idtool.robot.config import Config
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import Robot
from idtool.robot.urdf.writing import replace_parameters


@dataclass(frozen=True)
class LinkCheck:
    """Result of one link's check.

    Attributes
    ----------
    body
        The link by itself, with the bounds that the configuration gives it.
    violations
        Reasons why its inertial is not realizable, one sentence each; none if it is.
    """

    body: Body
    violations: tuple[str, ...]


def check_links(robot: Robot, config: Config) -> list[LinkCheck]:
    """Check every link that has an inertial with mass or inertia, within the bounds that the configuration gives it.

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
                raise ConfigError(f"{key}: {name}", f"is not a link of the URDF; {suggestion(name, robot.links)}")
    checks = []
    for link, pi in robot.links.items():
        if pi is None or not pi.any():
            continue
        ellipsoids = tuple(bounding.to_ellipsoid() for bounding in config.bounding_ellipsoids.get(link, ()))
        shapes = tuple(bounding_shape(bound, robot, link) for bound in config.bounding_shapes.get(link, ()))
        mount = Frame(-1, np.eye(3), np.zeros(3))
        body = Body(link, "link", pi, ellipsoids, mount, np.zeros(3), False, np.zeros(0), shapes=shapes)
        checks.append(LinkCheck(body, check_realizability(body, pi).violations))
    return checks


def nearest_bodies(checks: Sequence[LinkCheck]) -> dict[str, Array]:
    """Nearest realizable inertials, in the pull-back metric, of links that are not realizable; by link, shape (10,)."""
    unrealizable = [check.body for check in checks if check.violations]
    return {body.name: project(body.pi, choose_set(body), body, "pullback").pi for body in unrealizable}


def repaired(robot: Robot, inertials: dict[str, Array]) -> bytes:
    """The URDF's text with new inertials, every other byte kept."""
    return replace_parameters(robot.text, inertials, {})
