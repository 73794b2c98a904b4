"""Solid ellipsoids that bound a body's mass.

S = {x : (x − x_s)ᵀ Q_s⁻¹ (x − x_s) ≤ 1} (23), or homogeneously {x : [x; 1]ᵀ Q [x; 1] ≥ 0} (25); lengths in m.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.robot.convex import principal_axes
from idtool.robot.rotation import rotation_from_rpy, rotation_of_axes, rpy_from_rotation

_ADDED_POINTS = 32  # farthest points beyond the ellipsoid that each iteration adds


@dataclass(frozen=True)
class Ellipsoid:
    """A solid ellipsoid.

    Attributes
    ----------
    center
        x_s [m].
    semi_axes
        Half lengths along the ellipsoid's own axes [m], positive.
    rpy
        Roll, pitch and yaw of those axes, as in URDF [rad].
    """

    center: tuple[float, float, float]
    semi_axes: tuple[float, float, float]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def from_axes(cls, center: ArrayLike, semi_axes: ArrayLike, R: Array) -> Ellipsoid:
        """The ellipsoid whose axes are the columns of the rotation matrix R, shape (3, 3)."""
        x, y, z = np.array([center, semi_axes, rpy_from_rotation(R)], dtype=float).tolist()
        return cls(tuple(x), tuple(y), tuple(z))

    def mirrored(self, signs: Array) -> Ellipsoid:
        """The mirror image, with x, y and z multiplied by signs, shape (3,)."""
        return Ellipsoid.from_axes(signs * self.center, self.semi_axes, signs[:, None] * self.rotation * signs)

    def to_dict(self) -> dict[str, list[float]]:
        """Plain data as in JSON and YAML."""
        return {"center": list(self.center), "semi_axes": list(self.semi_axes), "rpy": list(self.rpy)}

    @property
    def rotation(self) -> Array:
        """Axes as columns, shape (3, 3)."""
        return rotation_from_rpy(self.rpy)

    @property
    def Q_s(self) -> Array:  # noqa: N802
        """The shape matrix [m²], shape (3, 3)."""
        R = self.rotation
        return np.asarray(R @ np.diag(np.square(self.semi_axes)) @ R.T)

    @property
    def Q(self) -> Array:  # noqa: N802
        """The homogeneous matrix, shape (4, 4): [x; 1]ᵀ Q [x; 1] ≥ 0 inside, 1 at the centre (25)."""
        x = np.asarray(self.center)
        A = np.linalg.inv(self.Q_s)
        return np.block([[-A, (A @ x)[:, None]], [(x @ A)[None, :], np.array([[1 - x @ A @ x]])]])

    @property
    def size(self) -> float:
        """A length for scaling: the geometric mean of the semi-axes [m]."""
        return float(np.prod(self.semi_axes) ** (1 / 3))

    def contains(self, points: ArrayLike, tolerance: float = 1e-9) -> Mask:
        """Mask of the points, shape (..., 3), that lie inside, within a relative tolerance."""
        local = (np.asarray(points, dtype=float) - self.center) @ self.rotation / self.semi_axes
        return np.asarray(np.square(local).sum(axis=-1) <= 1 + tolerance)

    def grid(self, count: int) -> Array:
        """About ``count`` points spread evenly over the solid, shape (K, 3) [m]: its centre and shells to the surface.

        Evenly in units of the semi-axes; on each shell along a spiral that turns by the golden angle.
        """
        shells = max(1, round((3 * count / (4 * np.pi)) ** (1 / 3)))
        area = np.square(np.arange(1, shells + 1))
        counts = np.maximum(6, np.round((count - 1) * area / area.sum()))
        points = [np.zeros((1, 3))]
        for shell, points_on_shell in enumerate(counts, start=1):
            k = np.arange(points_on_shell) + 0.5
            angle = np.pi * (1 + np.sqrt(5)) * k
            z = 1 - 2 * k / points_on_shell
            width = np.sqrt(1 - z**2)
            unit = np.column_stack([width * np.cos(angle), width * np.sin(angle), z])
            points.append(shell / shells * unit)
        return np.asarray(np.concatenate(points) * self.semi_axes @ self.rotation.T + self.center)


def minimum_volume_ellipsoid(points: ArrayLike, tolerance: float = 1e-4, min_thickness: float = 0.05) -> Ellipsoid:
    """The ellipsoid of minimum volume around points, shape (n, 3), within a relative tolerance of its volume.

    Khachiyan's algorithm with the step of Todd & Yildirim (2007), on some of the points to which those farthest beyond
    the ellipsoid are added until there are none. Points in a plane or on a line get a semi-axis of about
    ``min_thickness`` times the largest distance from their mean.

    Raises
    ------
    ValueError
        If there are no points or one is not finite.
    """
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    if not len(points) or not np.isfinite(points).all():
        raise ValueError("an ellipsoid needs at least one point, all of them finite")
    cloud = _thicken(points, min_thickness)
    mean = cloud.mean(axis=0)
    scale = float(np.abs(cloud - mean).max())  # far away, squares would lose digits
    cloud = (cloud - mean) / scale
    core = _spanning_points(cloud)
    while True:
        center, shape = _khachiyan(cloud[core], tolerance)
        squares, axes = np.linalg.eigh(shape)
        distance = np.square((cloud - center) @ axes / np.sqrt(squares)).sum(axis=1)
        beyond = np.setdiff1d(np.flatnonzero(distance > 1 + 2 * tolerance), core)
        if not len(beyond):
            break
        farthest = beyond[np.argsort(distance[beyond])[-_ADDED_POINTS:]]
        core = np.concatenate([core, farthest])
    # Khachiyan's algorithm stops with points just outside: grow until all are inside.
    semi_axes = np.sqrt(squares * max(distance.max(), 1.0))
    return Ellipsoid.from_axes(mean + scale * center, scale * semi_axes, rotation_of_axes(axes))


def _thicken(points: Array, min_thickness: float) -> Array:
    """The points and, where they don't span three dimensions, some to either side."""
    center = points.mean(axis=0)
    axes = principal_axes(points)
    extent = np.ptp((points - center) @ axes.T, axis=0)
    # Not the largest extent: the axes of a square's points may be its sides or its diagonals.
    thickness = min_thickness * max(2 * np.linalg.norm(points - center, axis=1).max(), 1e-3)
    offsets = 0.5 * thickness * axes[extent < thickness]
    return np.concatenate([points, center - offsets, center + offsets])


def _spanning_points(points: Array) -> Indices:
    """Indices of some extreme points that span three dimensions, as all of them do."""
    axes = principal_axes(points)
    core = np.zeros(0, dtype=np.intp)
    for _ in range(4):  # of a point, a line and a plane the last axis leads out
        local = points @ axes.T
        core = np.union1d(core, [*local.argmin(axis=0), *local.argmax(axis=0)])
        axes = principal_axes(points[core])
    return core


def _khachiyan(points: Array, tolerance: float) -> tuple[Array, Array]:
    """Centre and shape matrix of the minimum-volume ellipsoid, from the dual weights u on the points."""
    n, d = points.shape
    lifted = np.column_stack([points, np.ones(n)])
    u = np.full(n, 1 / n)
    for _ in range(100_000):
        moment = lifted.T @ (lifted * u[:, None])
        distance = np.einsum("ni,ni->n", lifted, np.linalg.solve(moment, lifted.T).T)
        farthest = int(np.argmax(distance))
        nearest = int(np.argmin(np.where(u > 0, distance, np.inf)))
        rise = distance[farthest] / (d + 1) - 1
        fall = 1 - distance[nearest] / (d + 1)
        if max(rise, fall) <= tolerance:
            break
        j = farthest if rise >= fall else nearest
        beyond = distance[j] - 1  # 0 for a point at the very centre, which is dropped
        step = (beyond - d) / ((d + 1) * beyond) if beyond > 0 else -np.inf
        if step < 0:
            step = max(step, -u[j] / (1 - u[j]))
        u = (1 - step) * u
        u[j] = max(u[j] + step, 0.0)
    center = u @ points
    deviations = points - center
    return center, d * (deviations.T @ (deviations * u[:, None]))
