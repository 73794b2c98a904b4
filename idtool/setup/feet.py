"""Feet in a URDF: links at the ends of legs, and where they touch the ground."""

from __future__ import annotations

import numpy as np

from idtool.common.dataclass import dataclass
from idtool.robot.geometry import link_geometry, link_sphere
from idtool.robot.model import RobotModel
from idtool.robot.urdf.reading import Robot
from idtool.setup.name_matching import FOOT_WORDS, words

_LEG_JOINTS = 3  # that a leg has at least
_ANKLE_JOINTS = 5  # of a leg whose foot lies flat on the ground: four suffice to place a point
_FLAT = 0.6  # ratio of the shortest extent to the middle one, below which a link is flat
_ROUND = 0.75  # ratio of the shortest extent to the longest one, above which a foot may be a ball
_SLENDER = 0.3  # ratio of the middle extent to the longest one, below which it is a shank rather than a sole
_DIGITS = 5  # of a length in m


@dataclass(frozen=True)
class Touch:
    """Contact of a link with the ground: a surface, a ball or a point.

    Attributes
    ----------
    is_surface
        True if it takes a moment, as a flat sole does.
    centre, radius
        Of a ball, in the link's frame [m]; None without one.
    is_bound
        True if the ball is that about a mesh, and the foot may be smaller.
    """

    is_surface: bool
    centre: tuple[float, ...] | None = None
    radius: float | None = None
    is_bound: bool = False


def find_feet(robot: Robot, model: RobotModel) -> list[str]:
    """The feet by their names: of each body at the end of at least three joints, the link that is most likely one.

    Parameters
    ----------
    robot
        The robot.
    model
        The same, with a floating base.
    """
    candidates: dict[int, list[str]] = {}
    for link in leg_ends(robot, model):
        if words(link) & set(FOOT_WORDS):
            candidates.setdefault(model.frames[link].body, []).append(link)
    return [min(links, key=lambda link: _rank(robot, link)) for links in candidates.values()]


def leg_ends(robot: Robot, model: RobotModel) -> list[str]:
    """The links that are moved by at least three joints, and that carry no further joint."""
    carrying = {body.mount.body for body in model.bodies if body.kind == "link"}
    ends = []
    for link in robot.links:
        if model.frames[link].body not in carrying and count_joints(model, link) >= _LEG_JOINTS:
            ends.append(link)
    return ends


def count_joints(model: RobotModel, link: str) -> int:
    """Number of joints that move a link against the base."""
    return int(model.support()[model.frames[link].body, : model.joint_count].sum())


def _rank(robot: Robot, link: str) -> tuple[bool, int, int]:
    """Order of the links of one body: balls first, then by the word."""
    word = min(FOOT_WORDS.index(word) for word in words(link) & set(FOOT_WORDS))
    return link_sphere(robot, link) is None, word, len(link)


def touch_of(robot: Robot, model: RobotModel, link: str) -> Touch:
    """Contact of a link with the ground, by its geometry, or by the number of joints of the leg."""
    if model.bodies[model.frames[link].body].is_base:
        return Touch(is_surface=True)  # whatever holds the base exerts any force and moment
    sphere = link_sphere(robot, link)
    if sphere is not None:
        centre, radius = sphere
        return Touch(False, tuple(round(float(x), _DIGITS) + 0.0 for x in centre), round(radius, _DIGITS))
    points = link_geometry(robot, link).points
    if len(points):
        shortest, middle, longest = np.sort(np.ptp(points, axis=0))
        if shortest > _ROUND * longest:
            centre = (points.min(axis=0) + points.max(axis=0)) / 2
            radius = round(float(middle) / 2, _DIGITS)
            return Touch(False, tuple(round(float(x), _DIGITS) + 0.0 for x in centre), radius, is_bound=True)
        return Touch(is_surface=bool(shortest < _FLAT * middle and middle > _SLENDER * longest))
    return Touch(is_surface=count_joints(model, link) >= _ANKLE_JOINTS)
