"""The same robot written in other units, or with its link frames elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idtool.robot.ellipsoid import Ellipsoid

Array = NDArray[np.float64]
Frame = tuple[Array, Array]  # rotation (3, 3) and place (3,): where it sits in another


def in_units(text: str, length: float, mass: float) -> str:
    """A URDF's numbers in other units; ``length`` of them in a metre, ``mass`` in a kilogram."""
    root = etree.fromstring(text.encode())
    for element in root.iter("origin"):
        element.set("xyz", " ".join(repr(length * float(x)) for x in str(element.get("xyz")).split()))
    for element in root.iter("mass"):
        element.set("value", repr(mass * float(str(element.get("value")))))
    for element in root.iter("inertia"):
        for name, value in element.attrib.items():
            element.set(name, repr(mass * length**2 * float(value)))
    return etree.tostring(root).decode()


def bounds_in_units(config: Mapping[str, Any], length: float) -> dict[str, Any]:
    """A configuration's bounding ellipsoids and gravity in other units."""
    limits = {
        link: [
            {**bound, **{key: (length * np.array(bound[key])).tolist() for key in ("center", "semi_axes")}}
            for bound in bounds
        ]
        for link, bounds in config["bounding_ellipsoids"].items()
    }
    gravity = config.get("gravity", [0.0, 0.0, -9.81])
    return {**config, "bounding_ellipsoids": limits, "gravity": (length * np.array(gravity)).tolist()}


def in_frames(text: str, frames: Mapping[str, Frame]) -> str:
    """The same robot with other link frames.

    Parameters
    ----------
    text
        A URDF in which every link but the root has a joint with origin and axis, and an inertial with origin.
    frames
        Where each link's new frame sits in its old one. Its origin is on the joint's axis.
    """
    root = etree.fromstring(text.encode())
    stay = (np.eye(3), np.zeros(3))
    for link in root.iterfind("link"):
        for place in link.iterfind("inertial/origin"):
            _place(place, _then(_inverse(frames.get(str(link.get("name")), stay)), _frame(place)))
    for joint in root.iterfind("joint"):
        parent, child = (frames.get(str(joint.find(end).get("link")), stay) for end in ("parent", "child"))
        place, axis = joint.find("origin"), joint.find("axis")
        _place(place, _then(_then(_inverse(parent), _frame(place)), child))
        axis.set("xyz", _text(child[0].T @ np.array(str(axis.get("xyz")).split(), dtype=float)))
    return etree.tostring(root).decode()


def bounds_in_frames(config: Mapping[str, Any], frames: Mapping[str, Frame]) -> dict[str, Any]:
    """A configuration's bounding ellipsoids in other link frames."""
    limits: dict[str, Any] = {}
    for link, bounds in config["bounding_ellipsoids"].items():
        R, p = _inverse(frames[link]) if link in frames else (np.eye(3), np.zeros(3))
        olds = [Ellipsoid(*(tuple(bound[key]) for key in ("center", "semi_axes", "rpy"))) for bound in bounds]
        news = [Ellipsoid.from_axes(R @ old.center + p, old.semi_axes, R @ old.rotation) for old in olds]
        limits[link] = [{key: list(getattr(e, key)) for key in ("center", "semi_axes", "rpy")} for e in news]
    return {**config, "bounding_ellipsoids": limits}


def _then(a: Frame, b: Frame) -> Frame:
    return a[0] @ b[0], a[0] @ b[1] + a[1]


def _inverse(a: Frame) -> Frame:
    return a[0].T, -a[0].T @ a[1]


def _frame(place: Any) -> Frame:
    xyz, rpy = (np.array(str(place.get(key)).split(), dtype=float) for key in ("xyz", "rpy"))
    return Rotation.from_euler("xyz", rpy).as_matrix(), xyz


def _place(place: Any, frame: Frame) -> None:
    place.set("xyz", _text(frame[1]))
    place.set("rpy", _text(Rotation.from_matrix(frame[0]).as_euler("xyz")))


def _text(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)
