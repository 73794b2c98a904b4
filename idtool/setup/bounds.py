"""Bounding ellipsoids for a first configuration, and the reasons why some links have none."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import Any

from idtool.common.dataclass import dataclass
from idtool.robot.body import Body
from idtool.robot.bounding import bounding_ellipsoids, ellipsoids_config
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import mass_com_inertia
from idtool.robot.model import RobotModel
from idtool.robot.urdf.reading import Robot

_DIGITS = 4  # of a length in m


@dataclass(frozen=True)
class Bounds:
    """Ellipsoids by link, as under ``bounding_ellipsoids``.

    Attributes
    ----------
    ellipsoids
        Ellipsoids of links whose whole body is bounded.
    unused
        Ellipsoids of links whose body has another, unbounded part.
    missing
        Reason why a link with mass has none, by link.
    """

    ellipsoids: Mapping[str, Any]
    unused: Mapping[str, Any]
    missing: Mapping[str, str]

    @property
    def unread(self) -> tuple[str, ...]:
        """Links with a mesh that was not found or could not be read."""
        return tuple(link for link, why in self.missing.items() if "mesh" in why)


def find_bounds(robot: Robot, model: RobotModel) -> Bounds:
    """The bounding ellipsoids of the links that move."""
    ellipsoids, reasons = bounding_ellipsoids(robot)
    rounded = {link: _rounded(entries) for link, entries in ellipsoids_config(ellipsoids).items()}
    used: dict[str, Any] = {}
    unused: dict[str, Any] = {}
    missing = {}
    for body in model.bodies:
        links = [member.link for member in body.members if member.link in robot.links and body.kind == "link"]
        own = {link: rounded[link] for link in links if link in rounded}
        lacking = _unbounded(body, ellipsoids)
        (unused if lacking else used).update(own)
        missing.update({link: reasons[link] for link in lacking})
    return Bounds(used, unused, missing)


def _unbounded(body: Body, ellipsoids: Mapping[str, Ellipsoid]) -> list[str]:
    """A body's links with mass that have no ellipsoid and whose centre of mass lies in no other's."""
    if body.kind != "link":
        return []
    bounded = [member.frame.transform(ellipsoids[member.link]) for member in body.members if member.link in ellipsoids]
    lacking = []
    for member in body.members:
        if member.link in ellipsoids or not member.pi[0] > 0:
            continue
        centre = mass_com_inertia(member.pi_in_body)[1]
        if not any(ellipsoid.contains(centre) for ellipsoid in bounded):
            lacking.append(member.link)
    return lacking


def _rounded(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Ellipsoids rounded to a tenth of a millimetre, semi-axes rounded up."""
    scale = 10**_DIGITS
    return [
        {
            "center": [round(x, _DIGITS) for x in entry["center"]],
            "semi_axes": [math.ceil(scale * x) / scale for x in entry["semi_axes"]],
            "rpy": [round(x, _DIGITS) for x in entry["rpy"]],
        }
        for entry in entries
    ]


def search_paths(robot: Robot) -> str:
    """Description of the folders in which meshes are searched."""
    variables = (f"{name}{_value(name)}" for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"))
    return f"searched in {robot.path.absolute().parent} and the folders above, {', '.join(variables)}"


def _value(name: str) -> str:
    value = os.environ.get(name, "")
    return f" ({value})" if value else " (not set)"
