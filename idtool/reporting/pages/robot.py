"""The robot in three dimensions along a log, as data for `templates/robot.js`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.estimation.dataset.envelope import Trace
from idtool.reporting.pages.base import Sections
from idtool.robot.body import Body, Frame
from idtool.robot.geometry import link_surface
from idtool.robot.kinematics import body_placements
from idtool.robot.meshes import Mesh, merge_meshes, simplify_mesh
from idtool.robot.model import RobotModel
from idtool.robot.rotation import quaternions
from idtool.robot.urdf.reading import Robot

ROBOT = ("The robot in 3D", "robot_3d.html")
_MAX_POSTURES = 60  # at the most
_MAX_FRAMES = 1000  # of bodies in postures
_DECIMALS = 4
_SURFACE_DECIMALS = 3  # of its surface [m]
_MAX_FACES = 10_000  # of all bodies
_MIN_FACES = 60  # of a body


def robot_view(
    model: RobotModel, bodies: Sequence[Mapping[str, Any]], traces: Sequence[Trace], shown: str = "identified"
) -> dict[str, Any]:
    """The view of the robot for `robot.js`, of bounded size.

    Parameters
    ----------
    model
        The tree of bodies.
    bodies
        As `body_views` returns them.
    traces
        The first with the joints' positions, ``q``, shape (nv, 2 stretches), gives the postures, with the rotation of a
        floating base to the world, ``base``, shape (9, 2 stretches).
    shown
        Name of the bodies' parameters, beside the prior's.

    Returns
    -------
    ``robot``: None where there is no such trace, else the base and the ``bodies``, each with the ``surface`` of its
    geometry, or None; what is ``shown``; the name of the ``log``, the times ``t`` [s] of the postures and the bodies'
    ``frames`` in each, a quaternion x, y, z, w and a position [m] in the root link; ``hidden``, how many are not drawn.
    """
    trace = next((trace for trace in traces if "q" in trace.curves), None)
    if trace is None:
        return {"robot": None}
    max_postures = max(_MAX_FRAMES // max(len(bodies), 1), 1)
    t, q, turns = _postures(trace, min(_MAX_POSTURES, max_postures))
    placements = body_placements(model, q)
    views_by_name = {view["name"]: view for view in bodies}
    indices = [i for i, body in enumerate(model.bodies) if body.name in views_by_name][:_MAX_FRAMES]
    max_faces = max(_MAX_FACES // (len(indices) + 1), _MIN_FACES)
    views = [_base_view(model.robot, max_faces)]
    for i in indices:
        body = model.bodies[i]
        surface = _body_surface(model.robot, body, max_faces)
        views.append({**views_by_name[body.name], "masses": None, "surface": surface})
    frames = np.stack([_frames(*placements[i], turns) for i in (-1, *indices)], axis=1)
    view = {
        "bodies": views,
        "shown": shown,
        "log": trace.name,
        "t": t.round(2).tolist(),
        "frames": frames.round(_DECIMALS).tolist(),
        "hidden": len(model.bodies) - len(indices),
    }
    return {"robot": view}


def with_robot(sections: Sections, view: Mapping[str, Any]) -> Sections:
    """The sections, without the robot where it is not drawn."""
    return [section for section in sections if section != ROBOT or view["robot"]]


def _postures(trace: Trace, max_postures: int) -> tuple[Array, Array, Array]:
    """Times, positions and turns of the base: the middles of stretches in which something was measured.

    Shape (n,), (nv, n), and rotations to the world (n, 3, 3); unit matrices with a fixed base.
    """
    t = trace.t.reshape(-1, 2).mean(axis=1)
    q = _middles(trace.curves["q"])
    known = np.flatnonzero(np.isfinite(q).all(axis=0))
    spread = np.unique(np.linspace(0, len(known) - 1, max_postures).round().astype(int))
    chosen = known[spread]
    turns = np.tile(np.eye(3), (len(chosen), 1, 1))
    if "base" in trace.curves:
        rows = _middles(trace.curves["base"])[:, chosen]
        left, _, right = np.linalg.svd(rows.T.reshape(-1, 3, 3))  # middles are rotations only approximately
        turns = left @ right
    return t[chosen], q[:, chosen], turns


def _middles(pairs: Array) -> Array:
    """Middles of the least and the greatest values in stretches, shape (k, 2 stretches) to (k, stretches)."""
    return np.asarray(pairs.reshape(len(pairs), -1, 2).mean(axis=2))


def _frames(R: Array, p: Array, turns: Array) -> Array:
    """Quaternion x, y, z, w and position [m] of a body in every posture, turned with the base; shape (n, 7)."""
    return np.concatenate([quaternions(turns @ R), (turns @ p[:, :, None])[:, :, 0]], axis=1)


def _base_view(robot: Robot, max_faces: int) -> dict[str, Any]:
    """The root link and those fixed to it."""
    frames = {robot.root: Frame(-1, np.eye(3), np.zeros(3))}
    for joint in robot.joints.values():
        if joint.kind == "fixed" and joint.parent in frames:
            frames[joint.child] = frames[joint.parent].compose(joint.R, joint.p)
    empty: dict[str, Any] = {"bounds": [], "found": None, "prior": None, "masses": None}
    return {"name": robot.root, **empty, "surface": _surface_of_links(robot, frames.items(), max_faces)}


def _body_surface(robot: Robot, body: Body, max_faces: int) -> dict[str, Any] | None:
    """The geometry of a body's links in its frame."""
    return _surface_of_links(
        robot, [(member.link, member.frame) for member in body.members if member.link in robot.links], max_faces
    )


def _surface_of_links(robot: Robot, links: Iterable[tuple[str, Frame]], max_faces: int) -> dict[str, Any] | None:
    """Surface of links in their frames, simplified to a number of faces; None without geometry."""
    meshes = []
    for link, frame in links:
        mesh = link_surface(robot, link)
        meshes.append(Mesh(mesh.points @ frame.R.T + frame.p, mesh.faces))
    surface = simplify_mesh(merge_meshes(meshes), max_faces)
    if not len(surface.faces):
        return None
    return {"points": surface.points.round(_SURFACE_DECIMALS).tolist(), "faces": surface.faces.tolist()}
