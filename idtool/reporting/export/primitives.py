"""The primitives that a URDF gives its links, as MuJoCo's geoms; meshes stay behind."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array
from idtool.robot.urdf.reading import Robot, parse_xml

GROUPS = {"visual": "1", "collision": "3"}  # MuJoCo's viewer shows the first and hides the second

_MOST = 1e6  # m
_RADIUS, _LENGTH = ("radius", 1.0, 1), ("length", 0.5, 1)  # attribute, factor, how many numbers
_SIZES = {"box": [("size", 0.5, 3)], "cylinder": [_RADIUS, _LENGTH], "capsule": [_RADIUS, _LENGTH], "sphere": [_RADIUS]}


def primitives(robot: Robot) -> Iterator[tuple[str, dict[str, str] | None]]:
    """Link and geom of every <visual> and <collision>; None for what is no box, cylinder, capsule or sphere."""
    for link in parse_xml(robot.path, robot.text).iterfind("link"):
        for element in link:
            part = next(element.iterfind("geometry/*"), None) if element.tag in GROUPS else None
            if part is not None:
                yield link.get("name", ""), _geom(element, part)


def _geom(element: etree._Element, part: etree._Element) -> dict[str, str] | None:
    """The geom of a <visual> or <collision>."""
    size = _size(part)
    origin = element.find("origin")
    xyz, rpy = (_numbers("0 0 0" if origin is None else origin.get(key, "0 0 0")) for key in ("xyz", "rpy"))
    if size is None or len(xyz) != 3 or len(rpy) != 3:
        return None
    quat = Rotation.from_euler("xyz", rpy).as_quat(canonical=True, scalar_first=True)
    place = {"size": _text(size), "pos": _text(xyz), "quat": _text(quat)}
    return {"class": str(element.tag), "type": str(part.tag), **place}


def _size(part: etree._Element) -> Array | None:
    """MuJoCo's sizes of a primitive: the radius first, half the lengths."""
    attributes = _SIZES.get(str(part.tag))
    if attributes is None:
        return None
    given = [factor * _numbers(part.get(name, "")) for name, factor, _ in attributes]
    if [len(values) for values in given] != [count for _, _, count in attributes]:
        return None
    size = np.concatenate(given)
    return size if (size > 0).all() else None


def _numbers(words: str) -> Array:
    """The numbers in an attribute; none where one of them is not finite."""
    try:
        values = [float(word) for word in words.split()]
    except ValueError:
        return np.array([])
    return np.array(values if all(math.isfinite(x) and abs(x) < _MOST for x in values) else [])


def _text(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)
