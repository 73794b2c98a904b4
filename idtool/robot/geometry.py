"""The geometry that a URDF gives its links: primitives and meshes, as points whose convex hull encloses it.

What cannot be read is listed with the reason.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
from lxml import etree

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ModelError
from idtool.robot.convex import enclosing_points
from idtool.robot.meshes import (
    Mesh,
    UnreadableGeometryError,
    merge_meshes,
    numeric_attribute,
    read_mesh,
    size_attribute,
)
from idtool.robot.rotation import rotation_from_rpy
from idtool.robot.urdf.reading import Robot, parse_xml

_SIDES = 32  # of the polygon around a circle, 0.5 % larger
_DIRECTIONS = 400  # of the points around a ball, less than 1 % larger


@dataclass(frozen=True)
class LinkGeometry:
    """A link's extent according to the URDF.

    Attributes
    ----------
    points
        Points in the link's frame whose convex hull encloses all that was read, shape (n, 3) [m]; around a curved
        primitive or a mesh of many vertices up to 1 % larger than it.
    parts_read
        The parts that were read, in words.
    unreadable
        The parts that were not, and why: where there are any, the points do not enclose the link.
    meshes
        Names of the meshes that were read, as in the URDF.
    """

    points: Array
    parts_read: tuple[str, ...]
    unreadable: tuple[str, ...]
    meshes: tuple[str, ...] = ()


def links_with_geometry(robot: Robot) -> set[str]:
    """Names of the links that have collision or visual geometry in the URDF, whether or not it can be read."""
    names = set()
    for link in parse_xml(robot.path, robot.text).iterfind("link"):
        parts = [*link.iterfind("collision"), *link.iterfind("visual")]
        if any(_geometry_element(part) is not None for part in parts):
            names.add(str(link.get("name")))
    return names


def link_geometry(robot: Robot, link: str) -> LinkGeometry:
    """The collision geometry of a link or, where that is absent or not all of it can be read, the visual one.

    Where not all of the visual can be read either, what there is of the collision geometry, if anything.
    """
    element = _link_element(robot, link)
    collision = _read_elements(robot.path, element.findall("collision"))
    visual = _read_elements(robot.path, element.findall("visual"))
    for geometry in (collision, visual):
        if geometry.parts_read and not geometry.unreadable:
            return geometry
    for geometry in (collision, visual):
        if geometry.parts_read:
            return geometry
    notes = tuple(dict.fromkeys(collision.unreadable + visual.unreadable))
    return LinkGeometry(np.empty((0, 3)), (), notes)


def link_sphere(robot: Robot, link: str) -> tuple[Array, float] | None:
    """Centre, shape (3,), in the link's frame and radius [m] of the only sphere in a link's geometry.

    Collision geometry comes first; None if neither that nor the visual one has a single sphere.
    """
    element = _link_element(robot, link)
    for tag in ("collision", "visual"):
        parts = [(own, _geometry_element(own)) for own in element.findall(tag)]
        spheres = [(own, part) for own, part in parts if part is not None and part.tag == "sphere"]
        if len(spheres) == 1:
            own, part = spheres[0]
            with suppress(UnreadableGeometryError):
                return _origin(own)[1], float(size_attribute(part, "radius", 1)[0])
    return None


def link_surface(robot: Robot, link: str) -> Mesh:
    """Triangles of a link's visual geometry or, where none of that can be read, of its collision geometry.

    In the link's frame; what cannot be read is left out.
    """
    element = _link_element(robot, link)
    for tag in ("visual", "collision"):
        mesh = merge_meshes(_element_meshes(robot.path, element.findall(tag)))
        if len(mesh.faces):
            return mesh
    return merge_meshes([])


def _link_element(robot: Robot, link: str) -> etree._Element:
    elements = parse_xml(robot.path, robot.text).iterfind("link")
    return next(element for element in elements if element.get("name") == link)


def _geometry_element(element: etree._Element) -> etree._Element | None:
    """The primitive or mesh of a <collision> or <visual>, if it has one."""
    return next((child for child in element.iterfind("geometry/*") if isinstance(child.tag, str)), None)


def _element_meshes(urdf: Path, elements: list[etree._Element]) -> Iterator[Mesh]:
    """Triangles of each of a link's <visual> or <collision> that can be read, in the link's frame."""
    for element in elements:
        part = _geometry_element(element)
        if part is not None:
            with suppress(UnreadableGeometryError):
                R, p = _origin(element)
                mesh = _part_mesh(urdf, part)
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
            return _mesh_points(robot.path, file)
        except UnreadableGeometryError as error:
            raise ModelError(f"{robot.path}: link {link}", f"{error}; give another file") from None
    geometry = link_geometry(robot, link)
    if geometry.unreadable or not geometry.parts_read:
        why = (
            geometry.unreadable[0]
            if geometry.unreadable
            else "the URDF has no collision or visual geometry for the link"
        )
        raise ModelError(f"{robot.path}: link {link}", f"its geometry cannot be read: {why}; give a file or dimensions")
    return geometry.points


def _read_elements(urdf: Path, elements: list[etree._Element]) -> LinkGeometry:
    """The geometry of all of a link's <collision> or <visual>."""
    points = [np.empty((0, 3))]
    parts_read: list[str] = []
    unreadable: list[str] = []
    meshes: list[str] = []
    for element in elements:
        part = _geometry_element(element)
        if part is None:
            unreadable.append(f"line {element.sourceline}: {element.tag} has no geometry")
            continue
        try:
            R, p = _origin(element)
            points.append(_part_points(urdf, part) @ R.T + p)
        except UnreadableGeometryError as error:
            unreadable.append(f"line {part.sourceline}: {error}")
            continue
        filename = part.get("filename")
        parts_read.append(f"{part.tag} {filename}" if filename else str(part.tag))
        if part.tag == "mesh" and filename:
            meshes.append(filename)
    return LinkGeometry(np.concatenate(points), tuple(parts_read), tuple(unreadable), tuple(meshes))


def _origin(element: etree._Element) -> tuple[Array, Array]:
    """Rotation (3, 3) and position (3,) of a <collision> or <visual> in its link."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(3), np.zeros(3)
    xyz = numeric_attribute(origin, "xyz", 3, default="0 0 0")
    rpy = numeric_attribute(origin, "rpy", 3, default="0 0 0")
    return rotation_from_rpy(rpy), xyz


def _part_points(urdf: Path, part: etree._Element) -> Array:
    """Points around a primitive or of a mesh, in its own frame, shape (n, 3)."""
    if part.tag == "mesh":
        return _mesh_points(urdf, part.get("filename", "")) * numeric_attribute(part, "scale", 3, default="1 1 1")
    if part.tag == "box":
        return 0.5 * _cube_corners() * size_attribute(part, "size", 3)
    if part.tag not in ("sphere", "cylinder", "capsule"):
        raise UnreadableGeometryError(f"{part.tag} is not a supported geometry")
    radius = size_attribute(part, "radius", 1)
    if part.tag == "sphere":
        return radius * _ball_points()
    end = radius * (_disc_points() if part.tag == "cylinder" else _ball_points())
    offset = 0.5 * size_attribute(part, "length", 1) * np.array([0, 0, 1.0])
    return np.concatenate([end + offset, end - offset])


def _part_mesh(urdf: Path, part: etree._Element) -> Mesh:
    """Triangles of a primitive or a mesh, in its own frame."""
    if part.tag == "mesh":
        mesh = read_mesh(urdf, part.get("filename", ""))
        return Mesh(mesh.points * numeric_attribute(part, "scale", 3, default="1 1 1"), mesh.faces)
    points = _part_points(urdf, part)
    if part.tag == "box":
        return Mesh(points, _cube_faces())
    from scipy.spatial import ConvexHull, QhullError

    try:
        return Mesh(points, ConvexHull(points).simplices.astype(np.intp))
    except QhullError:
        raise UnreadableGeometryError(f"{part.tag} has no volume") from None


@cache
def _cube_corners() -> Array:
    return np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)


@cache
def _cube_faces() -> Indices:
    """Two triangles for each side of a cube, of the corners as in `_cube_corners`."""
    corners = _cube_corners()
    triangles = []
    for axis, side in itertools.product(range(3), (-1, 1)):
        a, b, c, d = np.flatnonzero(corners[:, axis] == side)  # a and d are opposite corners
        triangles += [(a, b, d), (a, d, c)]
    return np.array(triangles)


@cache
def _disc_points() -> Array:
    """Corners of a polygon around the unit circle."""
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_SIDES)]) / math.cos(math.pi / _SIDES)


@cache
def _ball_points() -> Array:
    """Corners of a polyhedron around the unit ball."""
    from scipy.spatial import ConvexHull

    k = np.arange(_DIRECTIONS) + 0.5
    angle = np.pi * (1 + math.sqrt(5)) * k
    z = 1 - 2 * k / _DIRECTIONS
    width = np.sqrt(1 - z**2)
    points = np.column_stack([width * np.cos(angle), width * np.sin(angle), z])
    inscribed_radius = -ConvexHull(points).equations[:, 3].max()
    return np.asarray(points / inscribed_radius)


def _mesh_points(urdf: Path, name: str) -> Array:
    """Points around a mesh, as in the file, shape (n, 3)."""
    return enclosing_points(read_mesh(urdf, name).corners)
