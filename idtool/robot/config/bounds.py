"""Bounding ellipsoids and shapes, in the link's frame."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator

from idtool.robot.config.base import ConfigRecord, Length, Vector
from idtool.robot.ellipsoid import Ellipsoid


class BoundingEllipsoid(ConfigRecord):
    """A bounding ellipsoid: centre [m], semi-axes [m], roll–pitch–yaw [rad]."""

    center: Vector = (0.0, 0.0, 0.0)
    semi_axes: tuple[Length, Length, Length]
    rpy: Vector = (0.0, 0.0, 0.0)

    def to_ellipsoid(self) -> Ellipsoid:
        """The ellipsoid as geometry."""
        return Ellipsoid(self.center, self.semi_axes, self.rpy)


class PosedBound(ConfigRecord):
    """Pose of a bounding shape: centre [m], roll–pitch–yaw [rad]."""

    center: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)


class BoxBound(PosedBound):
    """A box with sides of lengths ``size`` [m]."""

    kind: Literal["box"]
    size: tuple[Length, Length, Length]


class CylinderBound(PosedBound):
    """A cylinder about its z axis: radius [m], length [m]."""

    kind: Literal["cylinder"]
    radius: Length
    length: Length


class CapsuleBound(PosedBound):
    """A capsule about its z axis: a cylinder of ``length`` [m] with a hemisphere at each end."""

    kind: Literal["capsule"]
    radius: Length
    length: Length


class HullBound(ConfigRecord):
    """The convex hull of a mesh: ``file``, relative to the URDF's folder, or the link's geometry in the URDF."""

    kind: Literal["hull"]
    file: str | None = None


_KINDS: dict[Any, type[ConfigRecord]] = {
    "box": BoxBound,
    "cylinder": CylinderBound,
    "capsule": CapsuleBound,
    "hull": HullBound,
}


def _by_kind(data: Any) -> Any:
    """The record of the named kind, so that errors are about that one only."""
    if isinstance(data, ConfigRecord):
        return data
    if not isinstance(data, Mapping):
        raise ValueError("input should be a mapping of keys to values")
    if "kind" not in data:
        for key in data:
            if difflib.get_close_matches(str(key), ["kind"]):
                raise ValueError(f"unknown key '{key}'; did you mean 'kind'?")
        raise ValueError(f"needs a kind that is one of {', '.join(_KINDS)}")
    kind = str(data["kind"])
    if kind not in _KINDS:
        raise ValueError(f"needs a kind that is one of {', '.join(_KINDS)}, not {kind}")
    return _KINDS[kind].model_validate(data)


BoundingShape = Annotated[BoxBound | CylinderBound | CapsuleBound | HullBound, BeforeValidator(_by_kind)]
