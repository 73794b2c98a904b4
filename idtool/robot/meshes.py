"""Meshes that a URDF names: found, read, and simplified.

They are untrusted files: read from the disk alone, never from the network, in formats that hold nothing but geometry,
and bounded in size.
"""

from __future__ import annotations

import gc
import io
import logging
import os
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from lxml import etree

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ModelError
from idtool.robot.urdf.reading import parse_xml

_MAX_LENGTH = 1e6  # m; what is larger is no robot
_MAX_BYTES = 100 << 20
_LARGE_FILE = 1 << 20  # bytes
_MAX_NODES = 10_000  # of a scene, repetitions written out, so that nested ones cannot blow up
_FORMATS = ("stl", "obj", "ply", "off", "dae")
_MAX_CELLS = 128  # along the longest side, in the finest grid by which a mesh is simplified


class UnreadableGeometryError(Exception):
    """Geometry that cannot be used; the message says why."""


@dataclass(frozen=True)
class Mesh:
    """Triangles.

    Attributes
    ----------
    points
        Their corners, shape (n, 3) [m].
    faces
        The corners of each, shape (m, 3).
    """

    points: Array
    faces: Indices

    @property
    def corners(self) -> Array:
        """The points that are the corner of a face, shape (k, 3) [m]."""
        used = np.zeros(len(self.points), dtype=bool)
        used[self.faces] = True
        return self.points if used.all() else self.points[used]


def read_mesh(urdf: Path, name: str) -> Mesh:
    """The mesh that a URDF names, as in the file.

    Raises
    ------
    UnreadableError
        If it is not found or cannot be read.
    """
    if name.partition("://")[0] in ("http", "https", "ftp"):
        raise UnreadableGeometryError(f"mesh {name} is a web address and is not downloaded")
    path = mesh_file(urdf, name)
    if path is None:
        raise UnreadableGeometryError(f"mesh {name} is not found")
    kind = path.suffix.lower().removeprefix(".")
    if kind not in _FORMATS:
        raise UnreadableGeometryError(f"mesh {path} has an unsupported format; save it as {' or '.join(_FORMATS)}")
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise UnreadableGeometryError(f"mesh {path} cannot be read ({error.strerror})") from None
    if len(data) > _MAX_BYTES:
        raise UnreadableGeometryError(f"mesh {path} is larger than {_MAX_BYTES >> 20} MiB")
    mesh = _parse_mesh(path, data, kind)
    if len(data) > _LARGE_FILE:
        gc.collect()  # trimesh's objects refer to each other and take several times the memory of the mesh
    corners = mesh.corners
    if not len(corners) or not (corners.min() > -_MAX_LENGTH and corners.max() < _MAX_LENGTH):
        what = f"a vertex that is not within {_MAX_LENGTH:g} m" if len(corners) else "no faces"
        raise UnreadableGeometryError(f"mesh {path} contains {what}")
    return mesh


def mesh_file(urdf: Path, name: str) -> Path | None:
    """The file of a mesh that a URDF, or the configuration beside it, names; None if it is not found."""
    return next((path for path in _candidate_paths(urdf, name) if _is_file(path)), None)


def relocated_mesh(urdf: Path, name: str, folder: Path) -> str:
    """The name of a mesh for a URDF in another folder: a relative path.

    A name that is not relative, such as that of a package, stays if it is found from the other folder too.

    Parameters
    ----------
    urdf
        The URDF.
    name
        The mesh as it or the configuration beside it names it.
    folder
        The other folder.
    """
    file = mesh_file(urdf, name)
    if file is None:
        return name
    is_relative = "://" not in name and not os.path.isabs(name)
    found_from_there = mesh_file(folder / urdf.name, name)
    if not is_relative and found_from_there is not None and found_from_there.samefile(file):
        return name
    real_file = os.path.join(os.path.realpath(file.parent), file.name)
    return Path(os.path.relpath(real_file, os.path.realpath(folder))).as_posix()


def numeric_attribute(element: etree._Element, name: str, count: int, default: str = "") -> Array:
    """The numbers in an attribute, shape (count,).

    Raises
    ------
    UnreadableGeometryError
        If they are not so many finite numbers.
    """
    text = element.get(name, default)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.array([])
    if len(values) != count or not (np.abs(values) < _MAX_LENGTH).all():
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        raise UnreadableGeometryError(f"{element.tag} {name} '{text[:40]}' should be {expected}")
    return values


def size_attribute(element: etree._Element, name: str, count: int) -> Array:
    """The lengths in an attribute, shape (count,) [m].

    Raises
    ------
    UnreadableGeometryError
        If they are not so many finite numbers of 0 or more.
    """
    values = numeric_attribute(element, name, count)
    if (values < 0).any():
        raise UnreadableGeometryError(f"{element.tag} {name} '{element.get(name, '')[:40]}' is negative")
    return values


def merge_meshes(meshes: Iterable[Mesh]) -> Mesh:
    """Several meshes as one."""
    points = [np.empty((0, 3))]
    faces = [np.empty((0, 3), dtype=np.intp)]
    count = 0
    for mesh in meshes:
        points.append(mesh.points)
        faces.append(mesh.faces + count)
        count += len(mesh.points)
    return Mesh(np.concatenate(points), np.concatenate(faces))


def simplify_mesh(mesh: Mesh, max_faces: int) -> Mesh:
    """A similar mesh of no more than so many faces.

    The corners in each cell of a grid are merged at their mean, in the finest grid that leaves few enough faces.
    Source: Rossignac & Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993
    """
    if len(mesh.faces) <= max_faces:
        return mesh
    mesh = _cluster_vertices(mesh, _MAX_CELLS)
    if len(mesh.faces) <= max_faces:
        return mesh
    few_enough = 0
    too_many = _MAX_CELLS + 1
    while too_many - few_enough > 1:
        cells = (few_enough + too_many) // 2
        if len(_cluster_vertices(mesh, cells).faces) <= max_faces:
            few_enough = cells
        else:
            too_many = cells
    return _cluster_vertices(mesh, few_enough)


def _cluster_vertices(mesh: Mesh, cells: int) -> Mesh:
    """The mesh with the vertices in each cell of a grid merged, so many cells along its longest side."""
    if not cells or not len(mesh.faces):
        return Mesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.intp))
    used, faces = np.unique(mesh.faces, return_inverse=True)
    points = mesh.points[used]
    cell_size = np.ptp(points, axis=0).max() / cells or 1.0
    cell = np.floor((points - points.min(axis=0)) / cell_size).astype(np.int64)
    cell_number = cell @ (cells + 1) ** np.arange(3)
    _, cluster, counts = np.unique(cell_number, return_inverse=True, return_counts=True)
    sums = np.stack([np.bincount(cluster, weights=x) for x in points.T], axis=1)
    means = sums / counts[:, None]

    new_faces = cluster[faces.reshape(-1, 3)]
    corners = np.sort(new_faces, axis=1)
    has_area = (corners[:, 0] < corners[:, 1]) & (corners[:, 1] < corners[:, 2])
    _, first = np.unique(corners[has_area], axis=0, return_index=True)
    return Mesh(means, new_faces[has_area][np.sort(first)])


def _parse_mesh(path: Path, data: bytes, kind: str) -> Mesh:
    """All triangles in a mesh file's contents [m]."""
    import trimesh

    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # its remarks on materials are not for the user
    options: dict[str, Any] = {"skip_materials": True} if kind in ("obj", "ply") else {}
    try:
        unit = _collada_unit(parse_xml(path, data)) if kind == "dae" else 1.0
        with warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, allow_remote=False, process=False, **options)
            parts = []
            for node in scene.graph.nodes_geometry:
                T, name = scene.graph[node]
                part = scene.geometry[name]
                if isinstance(part, trimesh.Trimesh):
                    points = part.vertices @ (unit * T[:3, :3].T)
                    points += unit * T[:3, 3]
                    parts.append(Mesh(points, np.asarray(part.faces)))
            return parts[0] if len(parts) == 1 else merge_meshes(parts)
    except (UnreadableGeometryError, ModelError) as error:
        raise UnreadableGeometryError(f"mesh {path} {getattr(error, 'what', error)}") from None
    except Exception as error:  # the parsers have no error of their own for contents that are not the format's
        raise UnreadableGeometryError(f"mesh {path} is not well-formed {kind} ({type(error).__name__})") from None


def _collada_unit(root: etree._Element) -> float:
    """The unit of a COLLADA file's lengths [m]; its up axis is not heeded, as is the rule for URDFs.

    Raises
    ------
    UnreadableError
        If its scene repeats itself without end, or the unit is no number.
    """
    nodes = {f"#{node.get('id')}": node for node in root.iterfind(".//{*}node")}
    sizes: dict[str, int] = {}

    def size(node: etree._Element) -> int:
        total = 1 + sum(size(child) for child in node.iterfind("{*}node"))
        for instance in node.iterfind("{*}instance_node"):
            url = instance.get("url", "")
            if url in nodes and url not in sizes:
                sizes[url] = _MAX_NODES  # a node that holds itself
                sizes[url] = size(nodes[url])
            total += sizes.get(url, 1)
        return total

    if sum(size(node) for node in root.iterfind(".//{*}visual_scene/{*}node")) >= _MAX_NODES:
        raise UnreadableGeometryError("has a scene that contains itself")
    unit = root.find("{*}asset/{*}unit")
    return 1.0 if unit is None else float(numeric_attribute(unit, "meter", 1, default="1")[0])


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        return False


def _candidate_paths(urdf: Path, name: str) -> Iterator[Path]:
    """Paths at which a mesh of a URDF may be, the likeliest first.

    A package is looked for in ROS's search paths and in the folders above the URDF; then any end of the mesh's path
    in those folders.
    """
    scheme, separator, path = name.partition("://")
    path = unquote(path) if separator else name
    folders = urdf.absolute().parents
    parts = [part for part in Path(path).parts if part not in ("/", "..")]
    if scheme in ("package", "model") and separator:
        package = parts[:1]
        within = Path(*parts[1:])
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
        yield urdf.parent / path
    for first in range(len(parts) - 1):
        for folder in folders:
            yield Path(folder, *parts[first:])
    if parts:
        yield folders[0] / parts[-1]
