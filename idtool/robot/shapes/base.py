"""`Shape`: a solid that bounds a body's mass. A new shape is one new file in this folder.

Each shape says side by side what it is, as a test of points, and what it demands of a body's parameters, as linear
inequalities on the moments of a density that is zero outside of it.
"""

from __future__ import annotations

import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from typing_extensions import override

from idtool.common.arrays import Array, Mask
from idtool.robot.inequality import Piece

Vector = tuple[float, float, float]


class Shape(ABC):
    """A solid.

    Attributes
    ----------
    kind
        As in the configuration and the report.
    exact
        Whether `pieces` admits exactly what a density on the solid can have.
    """

    kind: ClassVar[str]
    exact: ClassVar[bool]

    @property
    @abstractmethod
    def volume(self) -> float:
        """Its volume [m³]."""

    @property
    def size(self) -> float:
        """A length for scaling: the radius of a ball of the same volume [m]."""
        return math.cbrt(0.75 * self.volume / math.pi)

    @abstractmethod
    def transformed(self, R: Array, p: Array) -> Self:
        """The same solid in the frame in which its present frame sits at R (3, 3), p (3,) [m].

        R is a rotation or, for the solid's mirror image, a reflection.
        """

    @abstractmethod
    def contains(self, points: ArrayLike, tolerance: float = 1e-9) -> Mask:
        """Whether points, shape (..., 3), lie inside, within a tolerance relative to its size; shape (...)."""

    @abstractmethod
    def grid(self, count: int) -> Array:
        """About ``count`` places spread evenly over the solid, its boundary included; shape (K, 3) [m]."""

    @abstractmethod
    def pieces(self) -> tuple[Piece, ...]:
        """What parameters of a body within the solid fulfil: pi is the sum of parameters of these pieces."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Kind, place and dimensions as plain data, as in the configuration."""

    @classmethod
    @abstractmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """The shape of plain data such as `to_dict` gives, its kind aside: checked by the configuration, not here."""


class PosedShape(Shape):
    """A solid described in a frame of its own, at its middle: a frozen dataclass with these two fields.

    It is symmetric to the planes of that frame.

    Attributes
    ----------
    center
        The frame's place [m].
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
        """Its own axes as columns, shape (3, 3)."""
        matrix: Array = Rotation.from_euler("xyz", self.rpy).as_matrix()
        return matrix

    @override
    def transformed(self, R: Array, p: Array) -> Self:
        with warnings.catch_warnings(action="ignore"):  # of gimbal lock: any of the angles that make R will do
            own = R @ self.rotation
            own[:, 0] *= np.sign(np.linalg.det(own))  # a mirror image: the solid is its own, x turned round
            rpy = Rotation.from_matrix(own).as_euler("xyz")
        return replace(self, center=tuple((R @ self.center + p).tolist()), rpy=tuple(rpy.tolist()))

    @override
    def to_dict(self) -> dict[str, Any]:
        values = {self.config_names.get(field.name, field.name): getattr(self, field.name) for field in fields(self)}
        return {"kind": self.kind} | {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}

    @classmethod
    @override
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        values = {field.name: data.get(cls.config_names.get(field.name, field.name)) for field in fields(cls)}
        given = {k: v for k, v in values.items() if v is not None}
        return cls(**{k: tuple(v) if isinstance(v, Sequence) else v for k, v in given.items()})

    def to_local(self, points: ArrayLike) -> Array:
        """Points, shape (..., 3), in its own frame [m]."""
        return np.asarray((np.asarray(points, dtype=float) - self.center) @ self.rotation)

    def to_body(self, points: Array) -> Array:
        """Points of its own frame, shape (n, 3), in the body's frame [m]."""
        return np.asarray(points @ self.rotation.T + self.center)

    def affine_coordinates(self, units: ArrayLike) -> Array:
        """Rows f, shape (4, 4), with f · [x; 1] the place in its own frame in ``units``, shape (3,) [m], and last 1."""
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
        rings = max(1, round(radius / spacing)) if radius > 0 else 0
        points.append(np.array([[0.0, 0.0, z]]))
        for ring in radius * np.arange(1, rings + 1) / max(rings, 1):
            angle = np.linspace(0, 2 * np.pi, max(4, round(2 * np.pi * ring / spacing)), endpoint=False)
            points.append(np.column_stack([ring * np.cos(angle), ring * np.sin(angle), np.full(len(angle), z)]))
    return np.concatenate(points)


def finest_grid(points: Callable[[float], Array], coarsest: float, count: int) -> Array:
    """The points of a spacing below ``coarsest`` [m], as fine as gives no more than ``count``; else the coarsest."""
    best = points(coarsest)
    spacing = coarsest
    while len(finer := points(spacing := 0.97 * spacing)) <= count:
        best = finer
    return best
