"""An arm of three joints in MuJoCo with a sensor of force and moment between two halves of its second link."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

JOINTS = ("turn", "lift", "bend")
SENSOR = "upper_ft"
CHANNELS = tuple(f"force_{SENSOR}_{part}" for part in ("x", "y", "z", "mx", "my", "mz"))
COULOMB = 0.1  # N m


@dataclass(frozen=True)
class Link:
    """A link: its parent, where it is attached [m], its joint or None, and its mass [kg], com [m] and inertia."""

    name: str
    parent: str
    position: tuple[float, float, float]
    joint: str | None
    axis: tuple[float, float, float]
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float]


LINKS = (
    Link("shoulder", "base", (0, 0, 0.1), "turn", (0, 0, 1), 1.5, (0.01, 0.0, 0.1), (0.006, 0.007, 0.004)),
    Link("lower", "shoulder", (0, 0, 0.2), "lift", (0, 1, 0), 0.6, (0.08, 0.01, 0.0), (0.004, 0.006, 0.007)),
    Link("upper", "lower", (0.15, 0, 0.01), None, (0, 0, 0), 0.5, (0.07, 0.0, 0.01), (0.004, 0.005, 0.006)),
    Link("hand", "upper", (0.15, 0, 0), "bend", (0, 1, 0), 0.8, (0.12, 0.02, 0.0), (0.004, 0.008, 0.007)),
)


def urdf_text() -> str:
    """URDF of the arm."""
    parts = ['<robot name="arm"><link name="base"/>']
    for link in LINKS:
        ixx, iyy, izz = link.inertia
        parts.append(
            f'<link name="{link.name}"><inertial><origin xyz="{_text(link.com)}"/><mass value="{link.mass}"/>'
            f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        name, kind = (link.joint, "revolute") if link.joint else (f"{link.name}_ft", "fixed")
        parts.append(
            f'<joint name="{name}" type="{kind}"><origin xyz="{_text(link.position)}"/><parent link="{link.parent}"/>'
            f'<child link="{link.name}"/><axis xyz="{_text(link.axis) if link.joint else "1 0 0"}"/>'
            '<limit lower="-3" upper="3" effort="50" velocity="20"/></joint>'
        )
    return "\n".join([*parts, "</robot>"])


def write_log(path: Path, seconds: float, offset: Array, with_torque: bool = True, seed: int = 3) -> None:
    """Write a log of the arm in motion, its sensor read with an offset, shape (6,) [N, N m]."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * 1000)) / 1000
    q, v, a = np.zeros((3, len(t), 3))
    for j in range(3):
        for _ in range(5):
            w = 2 * np.pi * rng.uniform(0.1, 1.2)
            amplitude, phase = rng.uniform(0.1, 0.5) / (1 + w / 4), rng.uniform(0, 2 * np.pi)
            q[:, j] += amplitude * np.sin(w * t + phase)
            v[:, j] += amplitude * w * np.cos(w * t + phase)
            a[:, j] -= amplitude * w * w * np.sin(w * t + phase)
    tau, wrench = _torque_and_wrench(q, v, a)
    columns: dict[str, Any] = {"t": t}
    for j, name in enumerate(JOINTS):
        columns[f"q_{name}"] = q[:, j] + 1e-5 * rng.normal(size=len(t))
        if with_torque:
            columns[f"tau_{name}"] = tau[:, j] + COULOMB * np.sign(v[:, j]) + 0.02 * rng.normal(size=len(t))
    noise = np.array([0.2, 0.2, 0.2, 0.01, 0.01, 0.01]) * rng.normal(size=wrench.shape)
    for name, own in zip(CHANNELS, (wrench + offset + noise).T, strict=True):
        columns[name] = own
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(columns), comments="")


def _torque_and_wrench(q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Torque of the joints, shape (N, 3), and the wrench on the upper half, as MuJoCo's sensors read it, (N, 6)."""
    spec = mujoco.MjSpec()
    spec.option.gravity = (0, 0, -9.81)
    bodies = {"base": spec.worldbody}
    for link in LINKS:
        body = bodies[link.parent].add_body(name=link.name, pos=link.position)
        bodies[link.name] = body
        body.mass, body.ipos, body.inertia, body.explicitinertial = link.mass, link.com, link.inertia, True
        if link.joint:
            body.add_joint(name=link.joint, type=mujoco.mjtJoint.mjJNT_HINGE, axis=link.axis)
    bodies["upper"].add_site(name="sensor")
    for name in ("force", "torque"):
        kind = getattr(mujoco.mjtSensor, f"mjSENS_{name.upper()}")
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="sensor")
    model = spec.compile()
    data = mujoco.MjData(model)
    tau, wrench = np.zeros((len(q), 3)), np.zeros((len(q), 6))
    for i in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[i], v[i], a[i]
        mujoco.mj_inverse(model, data)
        tau[i] = data.qfrc_inverse
        data.qfrc_applied[:] = tau[i]
        mujoco.mj_forward(model, data)
        wrench[i] = data.sensordata
    return tau, wrench


def _text(numbers: tuple[float, float, float]) -> str:
    return " ".join(f"{x:g}" for x in numbers)
