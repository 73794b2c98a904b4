"""The robot in three dimensions, as it stood along a log: what `templates/robot.js` draws."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array
from idtool.estimation.evaluation.envelope import Trace
from idtool.reporting.pages.base import Sections
from idtool.robot.body import Body, Frame
from idtool.robot.geometry import link_surface
from idtool.robot.kinematics import body_placements
from idtool.robot.meshes import Mesh, merge_meshes, simplify_mesh
from idtool.robot.model import Model
from idtool.robot.urdf.reading import Robot

ROBOT = ("The robot in 3D", "robot_3d.html")
_POSTURES = 60  # at the most
_MOST_PLACES = 1000  # of bodies in postures
_DECIMALS = 4
_FINE = 3  # of its surface [m]
_MOST_FACES = 10_000  # of all bodies
_FEWEST_FACES = 60  # of a body


def robot_view(
    model: Model, bodies: Sequence[Mapping[str, Any]], traces: Sequence[Trace], shown: str = "identified"
) -> dict[str, Any]:
    """What is drawn of the robot, of bounded size.

    Parameters
    ----------
    model
        The tree of bodies.
    bodies
        As `body_views` returns them.
    traces
        The first with the joints' positions, ``q``, shape (nv, 2 stretches), gives the postures.
    shown
        What the bodies are, beside the prior's.

    Returns
    -------
    ``robot``: None where there is no such trace, else the base and the ``bodies``, each with the ``surface`` of its
    geometry, or None; what is ``shown``; the name of the ``log``, the times ``t`` [s] of the postures and the bodies'
    ``frames`` in each, a quaternion x, y, z, w and a position [m] in the root link; ``hidden``, how many are not drawn.
    """
    trace = next((trace for trace in traces if "q" in trace.curves), None)
    if trace is None:
        return {"robot": None}
    t, q = _postures(trace, min(_POSTURES, max(_MOST_PLACES // max(len(bodies), 1), 1)))
    places, known = body_placements(model, q), {view["name"]: view for view in bodies}
    drawn = [(i, body) for i, body in enumerate(model.bodies) if body.name in known][:_MOST_PLACES]
    most = max(_MOST_FACES // (len(drawn) + 1), _FEWEST_FACES)
    views = [_base(model.robot, most)]
    views += [{**known[body.name], "masses": None, "surface": _surface(model.robot, body, most)} for _, body in drawn]
    frames = [[_frame(places[i], n) for i in (-1, *(i for i, _ in drawn))] for n in range(len(t))]
    view = {
        "bodies": views,
        "shown": shown,
        "log": trace.name,
        "t": t.round(2).tolist(),
        "frames": frames,
        "hidden": len(model.bodies) - len(drawn),
    }
    return {"robot": view}


def with_robot(sections: Sections, view: Mapping[str, Any]) -> Sections:
    """The sections, without the robot where it is not drawn."""
    return [section for section in sections if section != ROBOT or view["robot"]]


def _postures(trace: Trace, most: int) -> tuple[Array, Array]:
    """Times, shape (n,), and positions then, (nv, n): the middles of stretches in which something was measured."""
    t, q = trace.t.reshape(-1, 2).mean(axis=1), trace.curves["q"].reshape(len(trace.curves["q"]), -1, 2).mean(axis=2)
    known = np.flatnonzero(np.isfinite(q).all(axis=0))
    chosen = known[np.unique(np.linspace(0, len(known) - 1, most).round().astype(int))]
    return t[chosen], q[:, chosen]


def _frame(place: tuple[Array, Array], n: int) -> list[float]:
    R, p = (x[min(n, len(x) - 1)] for x in place)
    return [round(float(x), _DECIMALS) for x in (*Rotation.from_matrix(R).as_quat(), *p)]


def _base(robot: Robot, most: int) -> dict[str, Any]:
    """The root link and those fixed to it."""
    frames = {robot.root: Frame(-1, np.eye(3), np.zeros(3))}
    for joint in robot.joints.values():
        if joint.kind == "fixed" and joint.parent in frames:
            frames[joint.child] = frames[joint.parent].compose(joint.R, joint.p)
    seen: dict[str, Any] = {"bounds": [], "found": None, "prior": None, "masses": None}
    return {"name": robot.root, **seen, "surface": _drawn(robot, frames.items(), most)}


def _surface(robot: Robot, body: Body, most: int) -> dict[str, Any] | None:
    """The geometry of a body's links in its frame."""
    return _drawn(robot, [(member.link, member.frame) for member in body.members if member.link in robot.links], most)


def _drawn(robot: Robot, places: Iterable[tuple[str, Frame]], most: int) -> dict[str, Any] | None:
    """How links at some places look, of so many faces at the most; None without any."""
    found = []
    for link, frame in places:
        mesh = link_surface(robot, link)
        found.append(Mesh(mesh.points @ frame.R.T + frame.p, mesh.faces))
    whole = simplify_mesh(merge_meshes(found), most)
    return {"points": whole.points.round(_FINE).tolist(), "faces": whole.faces.tolist()} if len(whole.faces) else None
