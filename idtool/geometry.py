"""The geometry that a URDF gives its links: primitives and meshes, as points whose convex hull encloses it.

Meshes are a stranger's files: read from the disk alone, never from the network, in formats that hold nothing but
geometry, and bounded in size. What cannot be read is said.
"""

from __future__ import annotations

import io
import logging
import math
import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import trimesh
from lxml import etree
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from idtool.exceptions import ModelError
from idtool.robot import Robot, parse_xml

Array = NDArray[np.float64]

_MOST_BYTES = 100 << 20
_MOST_NODES = 10_000  # of a scene, repetitions written out, so that nested ones cannot blow up
_MOST = 1e6  # m; what is larger is no robot
_FORMATS = ("stl", "obj", "ply", "off", "dae")
_SIDES = 32  # of the polygon around a circle, 0.5 % larger
_DIRECTIONS = 400  # of the points around a ball, less than 1 % larger

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # its remarks on materials are not for the user


class _UnreadableError(Exception):
    """Why one piece of geometry cannot be used, in words."""


@dataclass(frozen=True)
class Geometry:
    """What a URDF says of a link's extent.

    Attributes
    ----------
    points
        Points in the link's frame whose convex hull encloses all that was read, shape (n, 3) [m]; around a curved
        primitive up to 1 % larger than it.
    read
        What was read, in words.
    missing
        What was not, and why, in words: where there is any, the points do not enclose the link.
    """

    points: Array
    read: tuple[str, ...]
    missing: tuple[str, ...]


def link_geometry(robot: Robot, link: str) -> Geometry:
    """The collision geometry of a link or, where that is absent or not all of it can be read, the visual one.

    Where not all of the visual can be read either, what there is of the collision geometry, if anything.
    """
    element = next(e for e in parse_xml(robot.path, robot.text).iterfind("link") if e.get("name") == link)
    found = [_read_all(robot.path, element.findall(tag)) for tag in ("collision", "visual")]
    whole = [geometry for geometry in found if geometry.read and not geometry.missing]
    some = [geometry for geometry in found if geometry.read]
    notes = tuple(dict.fromkeys(note for geometry in found for note in geometry.missing))
    return (*whole, *some, Geometry(np.empty((0, 3)), (), notes))[0]


def link_vertices(robot: Robot, link: str, file: str | None = None) -> Array:
    """Points whose convex hull is a link's geometry, in its frame; shape (n, 3) [m].

    Parameters
    ----------
    robot, link
        The link of a robot.
    file
        A mesh in the link's frame, from the URDF's folder, in metres; else what the URDF gives the link.

    Raises
    ------
    ModelError
        If there is no geometry, or not all of it can be read.
    """
    if file is not None:
        try:
            return _mesh(robot.path, file)
        except _UnreadableError as error:
            raise ModelError(f"{robot.path}: link {link}", f"{error}; give another file") from None
    geometry = link_geometry(robot, link)
    if geometry.missing or not geometry.read:
        why = geometry.missing[0] if geometry.missing else "the URDF gives it no collision or visual"
        raise ModelError(f"{robot.path}: link {link}", f"its geometry cannot be read: {why}; give a file or dimensions")
    return geometry.points


def _read_all(urdf: Path, elements: list[etree._Element]) -> Geometry:
    """The geometry of all of a link's <collision> or <visual>."""
    points, read, missing = [np.empty((0, 3))], [], []
    for element in elements:
        part = next((e for e in element.iterfind("geometry/*") if isinstance(e.tag, str)), None)
        if part is None:
            missing.append(f"line {element.sourceline}: {element.tag} has no geometry")
            continue
        try:
            R, p = _origin(element)
            points.append(_solid(urdf, part) @ R.T + p)
            read.append(" ".join(filter(None, (str(part.tag), part.get("filename")))))
        except _UnreadableError as error:
            missing.append(f"line {part.sourceline}: {error}")
    return Geometry(np.concatenate(points), tuple(read), tuple(missing))


def _origin(element: etree._Element) -> tuple[Array, Array]:
    """Rotation (3, 3) and position (3,) of a <collision> or <visual> in its link."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(3), np.zeros(3)
    xyz, rpy = (_numbers(origin, name, 3, default="0 0 0") for name in ("xyz", "rpy"))
    return Rotation.from_euler("xyz", rpy).as_matrix(), xyz


def _numbers(element: etree._Element, name: str, count: int, default: str = "") -> Array:
    text = element.get(name, default)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.array([])
    if len(values) != count or not (np.abs(values) < _MOST).all():
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        raise _UnreadableError(f"{element.tag} {name} '{text[:40]}' should be {expected}")
    return values


def _solid(urdf: Path, part: etree._Element) -> Array:
    """Points around a primitive or of a mesh, in its own frame, shape (n, 3)."""
    if part.tag == "mesh":
        return _mesh(urdf, part.get("filename", "")) * _numbers(part, "scale", 3, default="1 1 1")
    if part.tag == "box":
        return 0.5 * _corners() * _numbers(part, "size", 3)
    if part.tag not in ("sphere", "cylinder", "capsule"):
        raise _UnreadableError(f"{part.tag} is not a geometry that is read here")
    radius = abs(_numbers(part, "radius", 1))
    if part.tag == "sphere":
        return radius * _around_ball()
    ends = 0.5 * _numbers(part, "length", 1) * np.array([[0, 0, 1.0], [0, 0, -1.0]])
    return np.concatenate(
        [end + radius * (_around_disc() if part.tag == "cylinder" else _around_ball()) for end in ends]
    )


@cache
def _corners() -> Array:
    return np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)


@cache
def _around_disc() -> Array:
    """Corners of a polygon around the unit circle."""
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_SIDES)]) / math.cos(math.pi / _SIDES)


@cache
def _around_ball() -> Array:
    """Corners of a polyhedron around the unit ball."""
    k = np.arange(_DIRECTIONS) + 0.5
    turn, z = np.pi * (1 + math.sqrt(5)) * k, 1 - 2 * k / _DIRECTIONS
    points = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    return np.asarray(points / -ConvexHull(points).equations[:, 3].max())


def _mesh(urdf: Path, name: str) -> Array:
    """Corners of a mesh's convex hull, or all its vertices where they span no volume, as in the file; shape (n, 3)."""
    if name.partition("://")[0] in ("http", "https", "ftp"):
        raise _UnreadableError(f"mesh {name} is not on this machine, and nothing is fetched")
    path = next((path for path in _places(urdf, name) if _is_file(path)), None)
    if path is None:
        raise _UnreadableError(f"mesh {name} is not found")
    kind = path.suffix.lower().removeprefix(".")
    if kind not in _FORMATS:
        raise _UnreadableError(f"mesh {path} is of a format that is not read here; save it as {' or '.join(_FORMATS)}")
    try:
        with path.open("rb") as file:
            data = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise _UnreadableError(f"mesh {path} cannot be read ({error.strerror})") from None
    if len(data) > _MOST_BYTES:
        raise _UnreadableError(f"mesh {path} is larger than {_MOST_BYTES >> 20} MiB")
    points = _vertices(path, data, kind)
    if not len(points) or not (np.abs(points) < _MOST).all():
        what = f"a vertex that is not within {_MOST:g} m" if len(points) else "no faces"
        raise _UnreadableError(f"mesh {path} holds {what}")
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points


def _vertices(path: Path, data: bytes, kind: str) -> Array:
    """Vertices of all faces in a mesh file's contents, shape (n, 3)."""
    options: dict[str, Any] = {"skip_materials": True} if kind in ("obj", "ply") else {}
    try:
        unit = _collada_unit(parse_xml(path, data)) if kind == "dae" else 1.0
        with warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, allow_remote=False, process=False, **options)
            points = [np.empty((0, 3))]
            for node in scene.graph.nodes_geometry:
                T, name = scene.graph[node]
                mesh = scene.geometry[name]
                if isinstance(mesh, trimesh.Trimesh):
                    points.append(mesh.vertices[np.unique(mesh.faces)] @ T[:3, :3].T + T[:3, 3])
            return unit * np.concatenate(points)
    except (_UnreadableError, ModelError) as error:
        raise _UnreadableError(f"mesh {path} {getattr(error, 'what', error)}") from None
    except Exception as error:  # the parsers have no error of their own for contents that are not the format's
        raise _UnreadableError(f"mesh {path} is not well-formed {kind} ({type(error).__name__})") from None


def _collada_unit(root: etree._Element) -> float:
    """The unit of a COLLADA file's lengths [m]; its up axis is not heeded, as is the rule for URDFs.

    Raises
    ------
    _UnreadableError
        If its scene repeats itself without end, or the unit is no number.
    """
    nodes = {f"#{node.get('id')}": node for node in root.iterfind(".//{*}node")}
    sizes: dict[str, int] = {}

    def size(node: etree._Element) -> int:
        total = 1 + sum(size(child) for child in node.iterfind("{*}node"))
        for instance in node.iterfind("{*}instance_node"):
            url = instance.get("url", "")
            if url in nodes and url not in sizes:
                sizes[url] = _MOST_NODES  # a node that holds itself
                sizes[url] = size(nodes[url])
            total += sizes.get(url, 1)
        return total

    if sum(size(node) for node in root.iterfind(".//{*}visual_scene/{*}node")) >= _MOST_NODES:
        raise _UnreadableError("has a scene that repeats itself without end")
    unit = root.find("{*}asset/{*}unit")
    return 1.0 if unit is None else float(_numbers(unit, "meter", 1, default="1")[0])


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        return False


def _places(urdf: Path, name: str) -> Iterator[Path]:
    """Where a mesh of a URDF may be, the likeliest first.

    A package is looked for in ROS's search paths and in the folders above the URDF; then any end of the mesh's path
    in those folders.
    """
    scheme, found, path = name.partition("://")
    path = unquote(path) if found else name
    folders = urdf.absolute().parents
    parts = [part for part in Path(path).parts if part not in ("/", "..")]
    if scheme in ("package", "model") and found:
        package, within = parts[:1], Path(*parts[1:])
        for entry in filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)):
            yield Path(entry, *package, within)
            if [Path(entry).name] == package:
                yield Path(entry, within)
        for entry in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
            yield Path(entry, "share", *package, within)
        for folder in folders:
            yield Path(folder, *package, within)
            if [folder.name] == package:
                yield folder / within
    else:
        yield Path(folders[0], path)
    for first in range(len(parts) - 1):
        for folder in folders:
            yield Path(folder, *parts[first:])
    if parts:
        yield folders[0] / parts[-1]
