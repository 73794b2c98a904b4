"""A planar arm with the torque of Pinocchio and additional torques in some states, or at some times."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
from numpy.typing import NDArray
from reference import Reference

from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]
Hidden = Callable[[Array, Array, Array, Array], Array]  # t, q, v, tau to torque; (2, N) but for t

RATE, SECONDS, NOISE = 1000.0, 16.0, 0.01
LINK = """<link name="{0}"><inertial><origin xyz="0.02 0.01 -0.2"/><mass value="2"/>
<inertia ixx="0.04" iyy="0.04" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="0 0 {3}"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="99" velocity="20"/></joint>"""
URDF = "".join(
    [
        '<robot name="arm"><link name="base"/>',
        *(LINK.format(name) for name in ("upper", "lower")),
        JOINT.format("j1", "base", "upper", 0),
        JOINT.format("j2", "upper", "lower", -0.4),
        "</robot>",
    ]
)


def silent(stage: str, share: float) -> None:
    """Ignore the progress."""


@cache
def motion() -> tuple[Array, Array, Array, Array]:
    """t (N,), q and v (2, N) of two joints of which the second now and then stands still, and Pinocchio's torque."""
    t = np.arange(round(SECONDS * RATE)) / RATE
    now_and_then = np.clip(0.5 + 1.2 * np.sin(2 * np.pi * t / 5.3), 0, 1)
    moving = now_and_then**3 * (10 - 15 * now_and_then + 6 * now_and_then**2)
    q = np.stack(
        [
            0.8 * np.sin(2.1 * t) + 0.3 * np.sin(4.7 * t + 1) + 0.2 * np.sin(0.37 * t),
            moving * (0.5 * np.sin(7.3 * t) + 0.3 * np.sin(3.1 * t + 2)),
        ]
    )
    v = np.gradient(q, 1 / RATE, axis=1, edge_order=2)
    a = np.gradient(v, 1 / RATE, axis=1, edge_order=2)
    reference = Reference(URDF, ["j1", "j2"], {"gravity": [0, 0, -9.81]})
    tau = np.stack([reference.torque(*state) for state in zip(q.T, v.T, a.T, strict=True)], axis=1)
    return t, q, v, tau


def experiment_of(folder: Path, *hidden: Hidden, rows: Any = slice(None), **config: Any) -> Experiment:
    """A log for each hidden torque, whose model is the arm without it; the last third is held out."""
    t, q, v, tau = motion()
    rng = np.random.default_rng(7)
    (folder / "arm.urdf").write_text(URDF)
    logs = []
    for i, extra in enumerate(hidden):
        total = tau + extra(t, q, v, tau) + NOISE * rng.normal(size=tau.shape)
        columns = np.vstack([t, q, v, total]).T[rows]
        logs.append(folder / f"log{i}.csv")
        head = "t,q_j1,q_j2,v_j1,v_j2,tau_j1,tau_j2"
        np.savetxt(logs[-1], columns, fmt="%.10g", delimiter=",", header=head, comments="")
    told = {"friction": {"viscous": False, "coulomb": False}, **config}
    return prepare(read_robot(folder / "arm.urdf"), parse_config(told, ""), logs, holdout=0.3)


def torque_on_joint(joint: int, torque: Callable[..., Array]) -> Hidden:
    """A torque on one joint, as a function of its t, q, v and tau."""

    def hidden(t: Array, q: Array, v: Array, tau: Array) -> Array:
        found = np.zeros_like(q)
        found[joint] = torque(t, q[joint], v[joint], tau[joint])
        return found

    return hidden


nothing = torque_on_joint(0, lambda t, q, v, tau: 0 * t)


def after_reversals(t: Array, q: Array, v: Array, tau: Array) -> Array:
    """A torque in the first 0.05 rad after each reversal."""
    turns = np.flatnonzero(np.diff(np.sign(v)))
    last = np.searchsorted(turns, np.arange(len(q)), side="right") - 1
    return np.where((last >= 0) & (np.abs(q - q[turns[last]]) < 0.05), np.sign(v), 0.0)


def noisy(bound: Callable[..., NDArray[np.bool_]]) -> Hidden:
    """Disturbances on the first joint, within the band, where the state is in a region."""
    t = motion()[0]
    rough = np.interp(t, t[::20], np.random.default_rng(3).normal(size=len(t[::20])))
    return torque_on_joint(0, lambda t, q, v, tau: rough * bound(t, q, v, tau))


WRENCH = [6.0, 0.0, 4.0, 0.0, 1.5, 0.0]


def contact(*windows: tuple[float, float]) -> Hidden:
    """Torque of a wrench on the second link, by Pinocchio's Jacobian."""
    model = pin.buildModelFromXML(URDF)
    data, frame = model.createData(), model.getFrameId("lower")

    def hidden(t: Array, q: Array, v: Array, tau: Array) -> Array:
        needed = np.zeros_like(q)
        now = np.logical_or.reduce([(t >= first) & (t < last) for first, last in windows])
        for i in np.flatnonzero(now):
            J = pin.computeFrameJacobian(model, data, q[:, i], frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            needed[:, i] = -J.T @ WRENCH
        return needed

    return hidden
