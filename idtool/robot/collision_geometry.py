"""The convex parts that the links of a robot are made of, and the distances between them.

Boxes, cylinders, spheres, capsules and the convex hulls of meshes. Distances are Coal's: GJK (Gilbert, Johnson &
Keerthi 1988) and, where parts penetrate, EPA (van den Bergen 2001).

Letters: R (3, 3) and p (3,) [m] a frame's pose in another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product

import coal
import numpy as np
from lxml import etree
from scipy.spatial import ConvexHull, QhullError

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ModelError
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.robot.body import Frame
from idtool.robot.geometry import link_geometry, link_vertices
from idtool.robot.meshes import UnreadableGeometryError, numeric_attribute, size_attribute
from idtool.robot.rotation import rotation_from_rpy
from idtool.robot.urdf.reading import Robot, parse_xml

_MAX_PARTS = 16  # of a link; more are taken as their common hull
_MAX_VERTICES = 400  # of a hull
_THICKNESS = 1e-3  # m, of a mesh that spans no volume


@dataclass(frozen=True)
class ConvexPart:
    """A convex part of a link.

    Attributes
    ----------
    link
        The link's name.
    shape
        Coal's shape.
    frame
        Pose of the shape in a body.
    radius
        Radius of a sphere around the shape's origin that encloses it [m].
    swept_sphere_radius
        How far the part reaches beyond the shape [m].
    """

    link: str
    shape: coal.ShapeBase
    frame: Frame
    radius: float
    swept_sphere_radius: float = 0.0


class DistanceQueries:
    """Distances of pairs of convex parts.

    Parameters
    ----------
    parts
        The parts.
    pairs
        Indices of the parts of each pair, shape (2, pairs).
    """

    def __init__(self, parts: Sequence[ConvexPart], pairs: Indices) -> None:
        self._parts = tuple(parts)  # Coal keeps pointers to their shapes
        self._pairs = pairs.T.tolist()
        self._solvers: list[coal.ComputeDistance] = []
        self._swept_radii: list[float] = []
        for i, j in self._pairs:
            first, second = parts[i], parts[j]
            self._solvers.append(coal.ComputeDistance(first.shape, second.shape))
            self._swept_radii.append(first.swept_sphere_radius + second.swept_sphere_radius)
        self._request = coal.DistanceRequest()
        self._result = coal.DistanceResult()

    def __call__(self, pair: int, R: Array, p: Array) -> float:
        """The distance of a pair, negative by the depth of a penetration [m].

        Parameters
        ----------
        pair
            Its index.
        R, p
            Poses of all parts, shapes (parts, 3, 3) and (parts, 3).
        """
        i, j = self._pairs[pair]
        first_pose = coal.Transform3s(R[i], p[i])
        second_pose = coal.Transform3s(R[j], p[j])
        self._result.clear()
        distance = float(self._solvers[pair](first_pose, second_pose, self._request, self._result))
        return distance - self._swept_radii[pair]


def read_convex_parts(robot: Robot, frames: Mapping[str, Frame]) -> tuple[tuple[ConvexPart, ...], tuple[Notice, ...]]:
    """The convex parts of links, and a notice on what could not be read, if anything.

    Parameters
    ----------
    robot
        The URDF.
    frames
        The links' frames, by name.
    """
    parts: list[ConvexPart] = []
    missing: dict[str, str] = {}
    for element in parse_xml(robot.path, robot.text).iterfind("link"):
        link = str(element.get("name"))
        if link not in frames:
            continue
        link_parts, unreadable = _parts_of_link(robot, element, link, frames[link])
        parts += link_parts
        if unreadable:
            missing[link] = unreadable[0]
    if not missing:
        return tuple(parts), ()
    why = next(iter(missing.values()))
    message = f"the self-collision check ignores geometry of {join_names(missing)}: {why}"
    return tuple(parts), (Notice("geometry_not_read", "warning", None, message),)


def _parts_of_link(
    robot: Robot, element: etree._Element, link: str, frame: Frame
) -> tuple[list[ConvexPart], list[str]]:
    """A link's convex parts and what of it is missing: the visual ones where not all of the collision can be read."""
    readable: list[ConvexPart] = []
    unreadable: list[str] = []
    for tag in ("collision", "visual"):
        parts, notes = _parts_of_elements(robot, element.findall(tag), link, frame)
        if parts and not notes:
            return parts, []
        readable = readable or parts
        unreadable += notes
    return readable, unreadable


def _parts_of_elements(
    robot: Robot, elements: Sequence[etree._Element], link: str, frame: Frame
) -> tuple[list[ConvexPart], list[str]]:
    """The convex parts of all of a link's <collision> or <visual>, and what of it is missing."""
    if len(elements) > _MAX_PARTS:
        geometry = link_geometry(robot, link)
        hull = [_hull(link, geometry.points, frame)] if geometry.parts_read else []
        return hull, list(geometry.unreadable)
    parts: list[ConvexPart] = []
    unreadable: list[str] = []
    for element in elements:
        try:
            parts.append(_convex_part(robot, element, link, frame))
        except UnreadableGeometryError as error:
            unreadable.append(f"line {element.sourceline}: {error}")
    return parts, unreadable


def _convex_part(robot: Robot, element: etree._Element, link: str, frame: Frame) -> ConvexPart:
    """The convex part of a <collision> or <visual>."""
    geometry = next((child for child in element.iterfind("geometry/*") if isinstance(child.tag, str)), None)
    if geometry is None:
        raise UnreadableGeometryError(f"{element.tag} has no geometry")
    origin = element.find("origin")
    if origin is not None:
        xyz = numeric_attribute(origin, "xyz", 3, "0 0 0")
        rpy = numeric_attribute(origin, "rpy", 3, "0 0 0")
        frame = frame.compose(rotation_from_rpy(rpy), xyz)
    if geometry.tag == "mesh":
        try:
            points = link_vertices(robot, link, geometry.get("filename", ""))
        except ModelError as error:
            raise UnreadableGeometryError(error.what.removesuffix("; give another file")) from None
        return _hull(link, points * numeric_attribute(geometry, "scale", 3, "1 1 1"), frame)
    if geometry.tag == "box":
        size = size_attribute(geometry, "size", 3)
        return ConvexPart(link, coal.Box(*size), frame, float(np.linalg.norm(size)) / 2)
    if geometry.tag not in ("sphere", "cylinder", "capsule"):
        raise UnreadableGeometryError(f"{geometry.tag} is not a supported geometry")
    radius = float(size_attribute(geometry, "radius", 1)[0])
    if geometry.tag == "sphere":
        return ConvexPart(link, coal.Sphere(radius), frame, radius)
    length = float(size_attribute(geometry, "length", 1)[0])
    if geometry.tag == "cylinder":
        return ConvexPart(link, coal.Cylinder(radius, length), frame, math.hypot(radius, length / 2))
    return ConvexPart(link, coal.Capsule(radius, length), frame, radius + length / 2)


def _hull(link: str, points: Array, frame: Frame) -> ConvexPart:
    """The convex hull of points, shape (n, 3); of many, that of the outermost, and how far the others lie beyond it."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    points = points - center
    is_simplified = len(points) > _MAX_VERTICES
    vertices = points[outermost(points)] if is_simplified else points
    try:
        hull = ConvexHull(vertices)
    except QhullError:  # they span no volume
        cube = _THICKNESS / 2 * np.array(list(product((-1, 1), repeat=3)))
        hull = ConvexHull((vertices[:, None] + cube).reshape(-1, 3))
    corners = hull.points[hull.vertices]
    corner_index = np.zeros(len(hull.points), dtype=int)
    corner_index[hull.vertices] = np.arange(len(hull.vertices))
    shape = _coal_convex(corners, corner_index[hull.simplices])
    beyond = _largest_distance(shape, points[~_inside(hull, points)]) if is_simplified else 0.0
    radius = float(np.linalg.norm(corners, axis=1).max())
    return ConvexPart(link, shape, frame.compose(np.eye(3), center), radius, beyond)


def outermost(points: Array) -> Indices:
    """Indices of the points that lie farthest in directions spread over the sphere along a golden spiral."""
    k = np.arange(_MAX_VERTICES) + 0.5
    angle = math.pi * (1 + math.sqrt(5)) * k
    z = 1 - 2 * k / _MAX_VERTICES
    width = np.sqrt(1 - z**2)
    directions = np.column_stack([width * np.cos(angle), width * np.sin(angle), z])
    return np.unique([np.argmax(points @ direction) for direction in directions])


def _inside(hull: ConvexHull, points: Array) -> Mask:
    """Mask of the points inside a hull, shape (n,)."""
    inside = np.ones(len(points), dtype=bool)
    for equation in hull.equations:
        inside &= points @ equation[:3] + equation[3] <= 0
    return inside


def _largest_distance(shape: coal.Convex, points: Array) -> float:
    """The largest distance of points, shape (n, 3), from a hull [m]."""
    request = coal.DistanceRequest()
    result = coal.DistanceResult()
    identity = coal.Transform3s()
    point_shape = coal.Sphere(0.0)
    largest = 0.0
    for point in points:
        result.clear()
        pose = coal.Transform3s(np.eye(3), point)
        distance = float(coal.distance(shape, identity, point_shape, pose, request, result))
        largest = max(largest, distance)
    return largest


def _coal_convex(corners: Array, faces: Indices) -> coal.Convex:
    points = coal.StdVec_Vec3s()
    for corner in corners:
        points.append(corner)
    triangles = coal.StdVec_Triangle()
    for face in faces.tolist():
        triangles.append(coal.Triangle(*face))
    return coal.Convex(points, triangles)
