"""Convex hulls, and polyhedra of few corners or few faces that enclose them.

A plane is a row (n, d), shape (4,): its half-space holds the points x with n · x + d ≤ 0, n of length one.
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array

_MAX_EXACT = 10_000  # points, beyond which their hull may take long and have as many corners
_THICKNESS = 1e-3  # of the hull of many points, in units of their extents: what lies nearer to a face adds no corner
_OUTWARD = 1.1  # times that, by which the faces are moved out: more than Qhull's rounding
_DIGITS = 9  # to which planes, in units of the extents, are the same
_FLAT = 1e-9  # of the largest extent, below which points do not extend in a direction


def principal_axes(points: Array) -> Array:
    """Directions in which points, shape (n, 3), spread, the widest first, as the rows of a matrix, shape (3, 3)."""
    deviations = points - points.mean(axis=0)
    deviations /= max(float(np.abs(deviations).max()), np.finfo(float).tiny)
    _, eigenvectors = np.linalg.eigh(deviations.T @ deviations)  # ascending
    return np.asarray(eigenvectors.T[::-1])


def enclosing_points(points: Array) -> Array:
    """Points, shape (k, 3), whose convex hull encloses all the given points, shape (n, 3).

    The corners of the convex hull where the points are few; of many, as of a scanned ball, corners of a polyhedron that
    is about 0.3 % larger. In a plane or on a line they are the corners of the polygon or the two ends.
    """
    from scipy.spatial import ConvexHull

    if len(points) > _MAX_EXACT:
        points = _unique_points(points)
    local = (points - points.mean(axis=0)) @ principal_axes(points).T
    extent = np.ptp(local, axis=0)
    spanned = extent > _FLAT * extent.max()
    if not spanned.any():
        return points[:1]
    local = local[:, spanned] / extent[spanned]
    if local.shape[1] == 1:
        return points[[local.argmin(), local.argmax()]]
    if len(points) <= _MAX_EXACT:
        return points[ConvexHull(local).vertices]
    hull = ConvexHull(local, qhull_options=f"Qt W{_THICKNESS}")
    corners = points[hull.vertices]
    middle = local[hull.vertices].mean(axis=0)
    nearest_face = -(hull.equations[:, :-1] @ middle + hull.equations[:, -1]).max()
    center = corners.mean(axis=0)
    growth = 1 + _OUTWARD * _THICKNESS / nearest_face
    return np.asarray(center + growth * (corners - center))


def face_planes(points: Array) -> Array:
    """Planes of the faces of the points' convex hull, shape (k, 4), n pointing out; the points span a volume."""
    from scipy.spatial import ConvexHull

    planes = ConvexHull(points).equations
    # Qhull gives a plane for each triangle of a face.
    _, first = np.unique(planes.round(_DIGITS), axis=0, return_index=True)
    return np.asarray(planes[np.sort(first)])


def enclosing_planes(points: Array, max_planes: int) -> Array:
    """Planes of a polyhedron of few faces around points that span a volume.

    These are the faces of their hull if there are no more than ``max_planes``. Otherwise a box along the points'
    principal axes is cut by the hull's planes, the one that cuts off most first.

    Parameters
    ----------
    points
        Shape (n, 3).
    max_planes
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
    if len(planes) > max_planes:
        planes = _cut_box(planes, local, max_planes)
    normals = planes[:, :3] / extent @ axes
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = -(points @ normals.T).max(axis=0)
    return np.column_stack([normals, offsets])


def _cut_box(faces: Array, points: Array, max_planes: int) -> Array:
    """Planes of the box around a hull and of some of the hull's faces, the origin inside."""
    from scipy.spatial import HalfspaceIntersection

    upper = np.column_stack([np.eye(3), -points.max(axis=0)])
    lower = np.column_stack([-np.eye(3), points.min(axis=0)])
    planes = np.concatenate([upper, lower])
    while True:
        polyhedron = HalfspaceIntersection(planes, np.zeros(3))
        # Planes that touch it at an edge or less are left out.
        planes = planes[np.unique(np.concatenate(polyhedron.dual_facets))]
        beyond = np.maximum(polyhedron.intersections @ faces[:, :3].T + faces[:, 3], 0.0)
        if len(planes) == max_planes or beyond.max() < _THICKNESS:
            return np.asarray(planes)
        cuts_most = beyond.sum(axis=0).argmax()
        planes = np.concatenate([planes, faces[[cuts_most]]])


def polyhedron_corners(planes: Array, inside: Array) -> Array:
    """Corners of the polyhedron within planes, shape (k, 4), around a point strictly inside, shape (3,)."""
    from scipy.spatial import ConvexHull, HalfspaceIntersection

    corners = HalfspaceIntersection(planes, inside).intersections
    return np.asarray(corners[ConvexHull(corners).vertices])


def _unique_points(points: Array) -> Array:
    """The points without repetitions: a mesh in a file may have each of its corners six times."""
    points = points[np.lexsort(points.T)]
    is_new = np.ones(len(points), dtype=bool)
    is_new[1:] = (points[1:] != points[:-1]).any(axis=1)
    return points[is_new]
