"""`Shape`: a solid that bounds a body's mass. A new shape is one new file in this folder.

Each shape has side by side its numeric check, a test of points, and its realizability constraints: linear inequalities
on the moments of a density that is zero outside of it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from typing_extensions import override

from idtool.common.arrays import Array, Mask
from idtool.robot.inequality import Piece
from idtool.robot.rotation import rotation_from_rpy, rpy_from_rotation

Vector = tuple[float, float, float]


class Shape(ABC):
    """A solid.

    Attributes
    ----------
    kind
        As in the configuration and the report.
    exact
        True if `pieces` admits exactly the parameters of the densities on the solid, False if also others.
    """

    kind: ClassVar[str]
    exact: ClassVar[bool]

    @property
    @abstractmethod
    def volume(self) -> float:
        """Volume [m³]."""

    @property
    def size(self) -> float:
        """A length for scaling: the radius of a ball of the same volume [m]."""
        return math.cbrt(0.75 * self.volume / math.pi)

    @abstractmethod
    def transformed(self, R: Array, p: Array) -> Self:
        """The solid in another frame, in which its present frame has the pose R (3, 3), p (3,) [m].

        R is a rotation or, for the solid's mirror image, a reflection.
        """

    @abstractmethod
    def contains(self, points: ArrayLike, tolerance: float = 1e-9) -> Mask:
        """Mask of the points, shape (..., 3), that lie inside, within a tolerance relative to its size; shape (...)."""

    @abstractmethod
    def grid(self, count: int) -> Array:
        """About ``count`` points spread evenly over the solid, its boundary included; shape (K, 3) [m]."""

    @abstractmethod
    def pieces(self) -> tuple[Piece, ...]:
        """The pieces whose sum the parameters of a body within the solid are."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Kind, pose and dimensions as plain data, as in the configuration."""

    @classmethod
    @abstractmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """The shape of plain data such as `to_dict` gives, its kind aside: checked by the configuration, not here."""


class PosedShape(Shape):
    """A solid described in a frame at its own centre: a frozen dataclass with these two fields.

    It is symmetric to the planes of that frame.

    Attributes
    ----------
    center
        Position of the frame [m].
    rpy
        The frame's roll, pitch and yaw, as in URDF [rad].
    """

    center: Vector
    rpy: Vector
    #: The configuration's name for a field that has another.
    config_names: ClassVar[dict[str, str]] = {}
    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def rotation(self) -> Array:
        """The shape's axes as columns, shape (3, 3)."""
        return rotation_from_rpy(self.rpy)

    @override
    def transformed(self, R: Array, p: Array) -> Self:
        axes = R @ self.rotation
        axes[:, 0] *= np.sign(np.linalg.det(axes))  # after a reflection; the solid is symmetric in x
        rpy = rpy_from_rotation(axes)
        center = R @ self.center + p
        return replace(self, center=tuple(center.tolist()), rpy=tuple(rpy.tolist()))

    @override
    def to_dict(self) -> dict[str, Any]:
        data: dict[str, Any] = {"kind": self.kind}
        for field in fields(self):
            value = getattr(self, field.name)
            key = self.config_names.get(field.name, field.name)
            data[key] = list(value) if isinstance(value, tuple) else value
        return data

    @classmethod
    @override
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        values: dict[str, Any] = {}
        for field in fields(cls):
            value = data.get(cls.config_names.get(field.name, field.name))
            if value is not None:
                values[field.name] = tuple(value) if isinstance(value, Sequence) else value
        return cls(**values)

    def to_local(self, points: ArrayLike) -> Array:
        """Points, shape (..., 3), in its own frame [m]."""
        return np.asarray((np.asarray(points, dtype=float) - self.center) @ self.rotation)

    def to_body(self, points: Array) -> Array:
        """Points of its own frame, shape (n, 3), in the body's frame [m]."""
        return np.asarray(points @ self.rotation.T + self.center)

    def affine_coordinates(self, units: ArrayLike) -> Array:
        """Rows f, shape (4, 4), of f · [x; 1]: x in its own frame, in ``units`` (3,) [m], and last the constant 1."""
        rows = np.eye(4)
        rows[:3, :3] = self.rotation.T / np.asarray(units, dtype=float)[:, None]
        rows[:3, 3] = -rows[:3, :3] @ self.center
        return rows


def product_form(f: Array, g: Array) -> Array:
    """The symmetric Q, shape (..., 4, 4), with [x; 1]ᵀ Q [x; 1] = (f · [x; 1]) (g · [x; 1])."""
    Q = f[..., :, None] * g[..., None, :]
    return np.asarray(0.5 * (Q + np.swapaxes(Q, -1, -2)))


def disc_points(levels: Array, radii: Array, spacing: float) -> Array:
    """Points of discs around the z axis at heights ``levels``, in rings about ``spacing`` apart; shape (n, 3) [m]."""
    points: list[Array] = []
    for z, radius in zip(levels, radii, strict=True):
        points.append(np.array([[0.0, 0.0, z]]))
        rings = max(1, round(radius / spacing)) if radius > 0 else 0
        for ring_radius in radius * np.arange(1, rings + 1) / max(rings, 1):
            count = max(4, round(2 * np.pi * ring_radius / spacing))
            angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
            x = ring_radius * np.cos(angle)
            y = ring_radius * np.sin(angle)
            points.append(np.column_stack([x, y, np.full(count, z)]))
    return np.concatenate(points)


def finest_grid(points: Callable[[float], Array], coarsest: float, count: int) -> Array:
    """The grid of the smallest spacing, up to ``coarsest`` [m], that has no more than ``count`` points."""
    best = points(coarsest)
    spacing = 0.97 * coarsest
    while len(finer := points(spacing)) <= count:
        best = finer
        spacing *= 0.97
    return best
