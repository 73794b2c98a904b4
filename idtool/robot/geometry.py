"""The geometry that a URDF gives its links: primitives and meshes, as points whose convex hull encloses it.

What cannot be read is said.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from lxml import etree
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array
from idtool.common.exceptions import ModelError
from idtool.robot.convex import enclosing_points
from idtool.robot.meshes import Mesh, UnreadableGeometryError, merge_meshes, numeric_attribute, read_mesh
from idtool.robot.urdf.reading import Robot, parse_xml

_SIDES = 32  # of the polygon around a circle, 0.5 % larger
_DIRECTIONS = 400  # of the points around a ball, less than 1 % larger


@dataclass(frozen=True)
class LinkGeometry:
    """What a URDF says of a link's extent.

    Attributes
    ----------
    points
        Points in the link's frame whose convex hull encloses all that was read, shape (n, 3) [m]; around a curved
        primitive or a mesh of many vertices up to 1 % larger than it.
    parts_read
        What was read, in words.
    unreadable
        What was not, and why, in words: where there is any, the points do not enclose the link.
    """

    points: Array
    parts_read: tuple[str, ...]
    unreadable: tuple[str, ...]


def link_geometry(robot: Robot, link: str) -> LinkGeometry:
    """The collision geometry of a link or, where that is absent or not all of it can be read, the visual one.

    Where not all of the visual can be read either, what there is of the collision geometry, if anything.
    """
    element = next(e for e in parse_xml(robot.path, robot.text).iterfind("link") if e.get("name") == link)
    found = [_read_all(robot.path, element.findall(tag)) for tag in ("collision", "visual")]
    whole = [geometry for geometry in found if geometry.parts_read and not geometry.unreadable]
    some = [geometry for geometry in found if geometry.parts_read]
    notes = tuple(dict.fromkeys(note for geometry in found for note in geometry.unreadable))
    return (*whole, *some, LinkGeometry(np.empty((0, 3)), (), notes))[0]


def link_surface(robot: Robot, link: str) -> Mesh:
    """How a link looks: its visual geometry or, where none of that can be read, the collision geometry, as triangles.

    In the link's frame; what cannot be read is left out.
    """
    element = next(e for e in parse_xml(robot.path, robot.text).iterfind("link") if e.get("name") == link)
    looks = (merge_meshes(_surfaces(robot.path, element.findall(tag))) for tag in ("visual", "collision"))
    return next((mesh for mesh in looks if len(mesh.faces)), merge_meshes([]))


def _surfaces(urdf: Path, elements: list[etree._Element]) -> Iterator[Mesh]:
    """The geometry of a link's <visual> or <collision>, of each that can be read."""
    for element in elements:
        part = next((e for e in element.iterfind("geometry/*") if isinstance(e.tag, str)), None)
        if part is not None:
            with suppress(UnreadableGeometryError, QhullError):
                R, p = _origin(element)
                mesh = _surface(urdf, part)
                yield Mesh(mesh.points @ R.T + p, mesh.faces)


def link_vertices(robot: Robot, link: str, file: str | None = None) -> Array:
    """Points whose convex hull is a link's geometry, in its frame; shape (n, 3) [m].

    Parameters
    ----------
    robot, link
        The link of a robot.
    file
        A mesh in the link's frame, from the URDF's folder, in metres; else what the URDF gives the link.

    Raises
    ------
    ModelError
        If there is no geometry, or not all of it can be read.
    """
    if file is not None:
        try:
            return _mesh(robot.path, file)
        except UnreadableGeometryError as error:
            raise ModelError(f"{robot.path}: link {link}", f"{error}; give another file") from None
    geometry = link_geometry(robot, link)
    if geometry.unreadable or not geometry.parts_read:
        why = geometry.unreadable[0] if geometry.unreadable else "the URDF gives it no collision or visual"
        raise ModelError(f"{robot.path}: link {link}", f"its geometry cannot be read: {why}; give a file or dimensions")
    return geometry.points


def _read_all(urdf: Path, elements: list[etree._Element]) -> LinkGeometry:
    """The geometry of all of a link's <collision> or <visual>."""
    points, read, missing = [np.empty((0, 3))], [], []
    for element in elements:
        part = next((e for e in element.iterfind("geometry/*") if isinstance(e.tag, str)), None)
        if part is None:
            missing.append(f"line {element.sourceline}: {element.tag} has no geometry")
            continue
        try:
            R, p = _origin(element)
            points.append(_solid(urdf, part) @ R.T + p)
            read.append(" ".join(filter(None, (str(part.tag), part.get("filename")))))
        except UnreadableGeometryError as error:
            missing.append(f"line {part.sourceline}: {error}")
    return LinkGeometry(np.concatenate(points), tuple(read), tuple(missing))


def _origin(element: etree._Element) -> tuple[Array, Array]:
    """Rotation (3, 3) and position (3,) of a <collision> or <visual> in its link."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(3), np.zeros(3)
    xyz, rpy = (numeric_attribute(origin, name, 3, default="0 0 0") for name in ("xyz", "rpy"))
    return Rotation.from_euler("xyz", rpy).as_matrix(), xyz


def _solid(urdf: Path, part: etree._Element) -> Array:
    """Points around a primitive or of a mesh, in its own frame, shape (n, 3)."""
    if part.tag == "mesh":
        return _mesh(urdf, part.get("filename", "")) * numeric_attribute(part, "scale", 3, default="1 1 1")
    if part.tag == "box":
        return 0.5 * _corners() * numeric_attribute(part, "size", 3)
    if part.tag not in ("sphere", "cylinder", "capsule"):
        raise UnreadableGeometryError(f"{part.tag} is not a geometry that is read here")
    radius = abs(numeric_attribute(part, "radius", 1))
    if part.tag == "sphere":
        return radius * _around_ball()
    ends = 0.5 * numeric_attribute(part, "length", 1) * np.array([[0, 0, 1.0], [0, 0, -1.0]])
    return np.concatenate(
        [end + radius * (_around_disc() if part.tag == "cylinder" else _around_ball()) for end in ends]
    )


def _surface(urdf: Path, part: etree._Element) -> Mesh:
    """A primitive's or a mesh's triangles, in its own frame; QhullError for what has no volume."""
    if part.tag == "mesh":
        mesh = read_mesh(urdf, part.get("filename", ""))
        return Mesh(mesh.points * numeric_attribute(part, "scale", 3, default="1 1 1"), mesh.faces)
    points = _solid(urdf, part)
    return Mesh(points, ConvexHull(points).simplices.astype(np.intp))


@cache
def _corners() -> Array:
    return np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)


@cache
def _around_disc() -> Array:
    """Corners of a polygon around the unit circle."""
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_SIDES)]) / math.cos(math.pi / _SIDES)


@cache
def _around_ball() -> Array:
    """Corners of a polyhedron around the unit ball."""
    k = np.arange(_DIRECTIONS) + 0.5
    turn, z = np.pi * (1 + math.sqrt(5)) * k, 1 - 2 * k / _DIRECTIONS
    points = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    return np.asarray(points / -ConvexHull(points).equations[:, 3].max())


def _mesh(urdf: Path, name: str) -> Array:
    """Points around a mesh, as in the file, shape (n, 3)."""
    return enclosing_points(read_mesh(urdf, name).corners)
