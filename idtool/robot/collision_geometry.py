"""The convex pieces that the links of a robot are made of, and how far they are from each other.

Boxes, cylinders, spheres, capsules and the convex hulls of meshes. Distances are Coal's: GJK (Gilbert, Johnson &
Keerthi 1988) and, where pieces penetrate, EPA (van den Bergen 2001).

Letters: R (3, 3) and p (3,) [m] a frame's place in another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import coal
import numpy as np
from lxml import etree
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.exceptions import ModelError
from idtool.common.names import some
from idtool.robot.body import Frame
from idtool.robot.geometry import link_geometry, link_vertices
from idtool.robot.meshes import UnreadableGeometryError, numeric_attribute
from idtool.robot.urdf.reading import Robot, parse_xml

_MOST_PIECES = 16  # of a link; more are taken as their common hull
_MOST_VERTICES = 400  # of a hull
_THICKNESS = 1e-3  # m, of a mesh that spans no volume


@dataclass(frozen=True)
class ConvexPart:
    """A convex part of a link.

    Its shape, where that sits in a body, the radius of a sphere around the shape's origin that holds it, and how far
    the part reaches beyond the shape [m].
    """

    link: str
    shape: coal.ShapeBase
    frame: Frame
    radius: float
    swept_sphere_radius: float = 0.0


class DistanceQueries:
    """Distances of pairs of pieces.

    Parameters
    ----------
    pieces
        The pieces.
    ends
        Which of them are paired, shape (2, pairs).
    """

    def __init__(self, pieces: Sequence[ConvexPart], ends: Indices) -> None:
        self._ends = ends.T.tolist()
        self._pieces = tuple(pieces)  # Coal keeps pointers to their shapes
        self._solvers = [coal.ComputeDistance(pieces[i].shape, pieces[j].shape) for i, j in self._ends]
        self._beyond: list[float] = [pieces[i].beyond + pieces[j].beyond for i, j in self._ends]
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()

    def __call__(self, pair: int, R: Array, p: Array) -> float:
        """The distance of a pair, negative by the depth of a penetration [m].

        Parameters
        ----------
        pair
            Its index.
        R, p
            Where all pieces are, shapes (pieces, 3, 3) and (pieces, 3).
        """
        i, j = self._ends[pair]
        self._result.clear()
        one, other = coal.Transform3s(R[i], p[i]), coal.Transform3s(R[j], p[j])
        distance = float(self._solvers[pair](one, other, self._request, self._result))
        return distance - self._beyond[pair]


def read_convex_parts(robot: Robot, frames: Mapping[str, Frame]) -> tuple[tuple[ConvexPart, ...], tuple[str, ...]]:
    """The pieces of links, and a line on what could not be read, if anything.

    Parameters
    ----------
    robot
        The URDF.
    frames
        The links, and where they are.
    """
    pieces: list[ConvexPart] = []
    missing: dict[str, str] = {}
    for element in parse_xml(robot.path, robot.text).iterfind("link"):
        link = str(element.get("name"))
        if link in frames:
            found, unread = _of_link(robot, element, link, frames[link])
            pieces += found
            missing |= {link: unread[0]} if unread else {}
    if not missing:
        return tuple(pieces), ()
    why = next(iter(missing.values()))
    return tuple(pieces), (f"geometry is left out of the check for self-collision, of {some(missing)}: {why}",)


def _of_link(robot: Robot, element: etree._Element, link: str, frame: Frame) -> tuple[list[ConvexPart], list[str]]:
    """A link's pieces and what of it is missing: the visual ones where not all of the collision can be read."""
    found = []
    for tag in ("collision", "visual"):
        pieces, missing = _of_parts(robot, element.findall(tag), link, frame)
        if pieces and not missing:
            return pieces, []
        found.append((pieces, missing))
    return next((pieces for pieces, _ in found if pieces), []), [note for _, missing in found for note in missing]


def _of_parts(
    robot: Robot, parts: Sequence[etree._Element], link: str, frame: Frame
) -> tuple[list[ConvexPart], list[str]]:
    """The pieces of all of a link's <collision> or <visual>, and what of it is missing."""
    if len(parts) > _MOST_PIECES:
        whole = link_geometry(robot, link)
        return [_hull(link, whole.points, frame)] if whole.parts_read else [], list(whole.unreadable)
    pieces, missing = [], []
    for part in parts:
        try:
            pieces.append(_piece(robot, part, link, frame))
        except UnreadableGeometryError as error:
            missing.append(f"line {part.sourceline}: {error}")
    return pieces, missing


def _piece(robot: Robot, element: etree._Element, link: str, frame: Frame) -> ConvexPart:
    """A <collision> or <visual>."""
    origin = element.find("origin")
    part = next((e for e in element.iterfind("geometry/*") if isinstance(e.tag, str)), None)
    if part is None:
        raise UnreadableGeometryError(f"{element.tag} has no geometry")
    if origin is not None:
        xyz, rpy = (numeric_attribute(origin, name, 3, "0 0 0") for name in ("xyz", "rpy"))
        frame = frame.compose(Rotation.from_euler("xyz", rpy).as_matrix(), xyz)
    if part.tag == "mesh":
        try:
            points = link_vertices(robot, link, part.get("filename", ""))
        except ModelError as error:
            raise UnreadableGeometryError(error.what.removesuffix("; give another file")) from None
        return _hull(link, points * numeric_attribute(part, "scale", 3, "1 1 1"), frame)
    if part.tag == "box":
        size = np.abs(numeric_attribute(part, "size", 3))
        return ConvexPart(link, coal.Box(*size), frame, float(np.linalg.norm(size)) / 2)
    if part.tag not in ("sphere", "cylinder", "capsule"):
        raise UnreadableGeometryError(f"{part.tag} is not a geometry that is read here")
    radius = abs(float(numeric_attribute(part, "radius", 1)[0]))
    if part.tag == "sphere":
        return ConvexPart(link, coal.Sphere(radius), frame, radius)
    length = abs(float(numeric_attribute(part, "length", 1)[0]))
    if part.tag == "cylinder":
        return ConvexPart(link, coal.Cylinder(radius, length), frame, math.hypot(radius, length / 2))
    return ConvexPart(link, coal.Capsule(radius, length), frame, radius + length / 2)


def _hull(link: str, points: Array, frame: Frame) -> ConvexPart:
    """The convex hull of points, shape (n, 3); of many, that of the outermost, and how far the others lie beyond it."""
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    points = points - center
    kept = points if len(points) <= _MOST_VERTICES else points[outermost(points)]
    try:
        hull = ConvexHull(kept)
    except QhullError:  # they span no volume
        corners = _THICKNESS / 2 * np.array(list(product((-1, 1), repeat=3)))
        hull = ConvexHull((kept[:, None] + corners).reshape(-1, 3))
    corners, index = hull.points[hull.vertices], np.zeros(len(hull.points), dtype=int)
    index[hull.vertices] = np.arange(len(hull.vertices))
    shape = _convex(corners, index[hull.simplices])
    beyond = 0.0 if kept is points else _farthest(shape, points[~_inside(hull, points)])
    radius = float(np.linalg.norm(corners, axis=1).max())
    return ConvexPart(link, shape, frame.compose(np.eye(3), center), radius, beyond)


def outermost(points: Array) -> Indices:
    """Indices of the points that lie farthest in directions spread over all sides."""
    k = np.arange(_MOST_VERTICES) + 0.5
    turn, z = math.pi * (1 + math.sqrt(5)) * k, 1 - 2 * k / _MOST_VERTICES
    directions = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    return np.unique([np.argmax(points @ direction) for direction in directions])


def _inside(hull: ConvexHull, points: Array) -> Mask:
    """Which points a hull holds, shape (n,)."""
    inside = np.ones(len(points), dtype=bool)
    for equation in hull.equations:
        inside &= points @ equation[:3] + equation[3] <= 0
    return inside


def _farthest(shape: coal.Convex, points: Array) -> float:
    """The greatest distance of points, shape (n, 3), from a hull [m]."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    still, dot, farthest = coal.Transform3s(), coal.Sphere(0.0), 0.0
    for point in points:
        result.clear()
        place = coal.Transform3s(np.eye(3), point)
        farthest = max(farthest, float(coal.distance(shape, still, dot, place, request, result)))
    return farthest


def _convex(corners: Array, faces: Indices) -> coal.Convex:
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for corner in corners:
        points.append(corner)
    for face in faces.tolist():
        triangles.append(coal.Triangle(*face))
    return coal.Convex(points, triangles)
