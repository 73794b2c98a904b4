"""Bounds of a link's mass: ellipsoids around the geometry that the URDF gives it, and the configuration's shapes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from idtool.common.provenance import InputFile, source_from_file
from idtool.robot.config import BoundingShape, Config, HullBound
from idtool.robot.ellipsoid import Ellipsoid, minimum_volume_ellipsoid
from idtool.robot.geometry import link_geometry, link_vertices
from idtool.robot.meshes import mesh_file
from idtool.robot.shapes import Hull, Shape, known_shapes
from idtool.robot.urdf.reading import Robot


def bounding_ellipsoids(robot: Robot, margin: float = 0.05) -> tuple[dict[str, Ellipsoid], dict[str, str]]:
    """The smallest ellipsoid around each link's geometry, its semi-axes longer by a margin.

    Parameters
    ----------
    robot
        The robot.
    margin
        Share by which the semi-axes grow.

    Returns
    -------
    Ellipsoids of the links that have mass and whose geometry was read in full, and the reason why each other link with
    mass has none; by link.
    """
    ellipsoids: dict[str, Ellipsoid] = {}
    reasons: dict[str, str] = {}
    for link, pi in robot.links.items():
        if pi is None or not pi[0] > 0:
            continue
        geometry = link_geometry(robot, link)
        if geometry.parts_read and not geometry.unreadable:
            tight = minimum_volume_ellipsoid(geometry.points)
            x, y, z = tight.semi_axes
            growth = 1 + margin
            ellipsoids[link] = replace(tight, semi_axes=(growth * x, growth * y, growth * z))
        elif not geometry.unreadable:
            reasons[link] = "the link has no collision or visual geometry in the URDF"
        else:
            more = f" (and {len(geometry.unreadable) - 1} more)" if len(geometry.unreadable) > 1 else ""
            reasons[link] = f"{geometry.unreadable[0]}{more}"
    return ellipsoids, reasons


def ellipsoids_config(ellipsoids: Mapping[str, Ellipsoid]) -> dict[str, Any]:
    """Ellipsoids by link as the value of the configuration's ``bounding_ellipsoids``: plain data, lengths in m."""
    return {link: [ellipsoid.to_dict()] for link, ellipsoid in ellipsoids.items()}


def bounding_shape(bound: BoundingShape, robot: Robot, link: str) -> Shape:
    """A shape of the configuration as geometry, in the link's frame.

    Raises
    ------
    ModelError
        If it is the hull of a mesh that cannot be read.
    """
    if isinstance(bound, HullBound):
        return Hull.around(link_vertices(robot, link, bound.file))
    return known_shapes()[bound.kind].from_dict(bound.model_dump())


def hull_sources(robot: Robot, config: Config) -> list[InputFile]:
    """Mesh files of the hulls among a configuration's bounding shapes."""
    sources = []
    for link, bounds in config.bounding_shapes.items():
        for bound in bounds:
            if isinstance(bound, HullBound):
                names = link_geometry(robot, link).meshes if bound.file is None else (bound.file,)
                files = [mesh_file(robot.path, name) for name in names]
                sources += [source_from_file("mesh", file) for file in files if file is not None]
    return sources
