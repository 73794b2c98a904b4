"""Convex hulls of points, few points around many, and few planes.

A plane is a row (n, d), shape (4,): its half-space holds the points x with n · x + d ≤ 0, n of length one.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection

from idtool.common.arrays import Array

_MANY = 10_000  # points, beyond which their hull may take long and have as many corners
_THICKNESS = 1e-3  # of the hull of many points, in units of their extents: what lies nearer to a face adds no corner
_SLACK = 1.1  # times that, by which the faces are moved out: more than Qhull's rounding
_DIGITS = 9  # to which planes, in units of the extents, are the same
_FLAT = 1e-9  # of the largest extent, below which points do not extend in a direction


def principal_axes(points: Array) -> Array:
    """Directions in which points, shape (n, 3), spread, the widest first, as the rows of a matrix, shape (3, 3)."""
    spread = points - points.mean(axis=0)
    spread /= max(float(np.abs(spread).max()), np.finfo(float).tiny)
    return np.asarray(np.linalg.eigh(spread.T @ spread)[1].T[::-1])


def enclosing_points(points: Array) -> Array:
    """Points, shape (k, 3), whose convex hull encloses all of the given, shape (n, 3).

    The corners of the convex hull where the points are few; of many, as of a scanned ball, corners of a polyhedron that
    is about 0.3 % larger. In a plane or on a line they are the corners of the polygon or the two ends.
    """
    if len(points) > _MANY:
        points = _distinct(points)
    local = (points - points.mean(axis=0)) @ principal_axes(points).T
    extent = np.ptp(local, axis=0)
    spanned = extent > _FLAT * extent.max()
    if not spanned.any():
        return points[:1]
    local = local[:, spanned] / extent[spanned]
    if local.shape[1] == 1:
        return points[[local.argmin(), local.argmax()]]
    if len(points) <= _MANY:
        return points[ConvexHull(local).vertices]
    hull = ConvexHull(local, qhull_options=f"Qt W{_THICKNESS}")
    corners = points[hull.vertices]
    middle = local[hull.vertices].mean(axis=0)
    nearest_face = -(hull.equations[:, :-1] @ middle + hull.equations[:, -1]).max()
    center = corners.mean(axis=0)
    return np.asarray(center + (1 + _SLACK * _THICKNESS / nearest_face) * (corners - center))


def face_planes(points: Array) -> Array:
    """Planes of the faces of the points' convex hull, shape (k, 4), n pointing out; the points span a volume."""
    planes = ConvexHull(points).equations
    _, first = np.unique(planes.round(_DIGITS), axis=0, return_index=True)  # one for each triangle of a face
    return np.asarray(planes[np.sort(first)])


def enclosing_planes(points: Array, most: int) -> Array:
    """Planes of a polyhedron around points that span a volume: of their hull's faces, if these are at most so many.

    Of more, those that cut off most, one by one, from a box along the points' axes.

    Parameters
    ----------
    points
        Shape (n, 3).
    most
        Number of planes, at least 6.

    Returns
    -------
    Shape (k, 4), n pointing out.
    """
    axes = principal_axes(points)
    center = points.mean(axis=0)
    extent = np.ptp(points @ axes.T, axis=0)
    local = (points - center) @ axes.T / extent
    planes = face_planes(local)
    if len(planes) > most:
        planes = _most_cutting(planes, local, most)
    normals = planes[:, :3] / extent @ axes
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.column_stack([normals, -(points @ normals.T).max(axis=0)])


def _most_cutting(faces: Array, points: Array, most: int) -> Array:
    """At most so many of a hull's planes and of those of the box around it, the origin inside."""
    box = np.column_stack([np.eye(3), -points.max(axis=0)]), np.column_stack([-np.eye(3), points.min(axis=0)])
    chosen = np.concatenate(box)
    while True:
        outer = HalfspaceIntersection(chosen, np.zeros(3))
        chosen = chosen[np.unique(np.concatenate(outer.dual_facets))]  # without those that touch it at an edge or less
        beyond = np.maximum(outer.intersections @ faces[:, :3].T + faces[:, 3], 0.0)
        if len(chosen) == most or beyond.max() < _THICKNESS:
            return np.asarray(chosen)
        chosen = np.concatenate([chosen, faces[[beyond.sum(axis=0).argmax()]]])


def polyhedron_corners(planes: Array, inside: Array) -> Array:
    """Corners of the polyhedron within planes, shape (k, 4), around a point strictly inside, shape (3,)."""
    found = HalfspaceIntersection(planes, inside).intersections
    return np.asarray(found[ConvexHull(found).vertices])


def _distinct(points: Array) -> Array:
    """The points without repetitions: a mesh in a file may have each of its corners six times."""
    points = points[np.lexsort(points.T)]
    new = np.ones(len(points), dtype=bool)
    new[1:] = (points[1:] != points[:-1]).any(axis=1)
    return points[new]
