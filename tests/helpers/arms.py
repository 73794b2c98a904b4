"""Arms of one and two joints whose effects are written out by hand: MuJoCo moves them, none of it comes from idtool.

Letters: q, v, a positions, velocities, accelerations (nv,), tau the actuators' torque (nv,), t time [s].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Law = Callable[[float, Array, Array, Array], Array]  # t, q, v, tau (nv,) → torque on the load's side (nv,)

JOINTS = ("shoulder", "elbow")
RATE = 1000  # samples per second in a log
_STEPS = 2  # of the simulation, a sample

_LINK = (
    '<link name="{0}"><inertial><origin xyz="{1}"/><mass value="{2}"/>'
    '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.01"/></inertial></link>'
)
_JOINT = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="{3}"/>'
    '<axis xyz="0 1 0"/><limit lower="-3" upper="2" effort="100" velocity="20"/></joint>'
)
ARM = "\n".join(
    [
        '<robot name="arm"><link name="base"/>',
        _LINK.format("upper", "0.02 0 -0.2", "1.5"),
        _LINK.format("lower", "0.01 0 -0.15", "0.8"),
        _JOINT.format("shoulder", "base", "upper", "0 0 0"),
        _JOINT.format("elbow", "upper", "lower", "0 0 -0.4"),
        "</robot>",
    ]
)
PENDULUM = "\n".join(
    [
        '<robot name="pendulum"><link name="base"/>',
        _LINK.format("bob", "0 0 -0.2", "1"),
        _JOINT.format("hinge", "base", "bob", "0 0 0"),
        "</robot>",
    ]
)
INERTIA, WEIGHT = 0.03 + 1 * 0.2**2, 1 * 9.81 * 0.2  # of the pendulum about its hinge [kg·m²]; its moment [N·m]


@dataclass(frozen=True)
class Physics:
    """What acts on an arm beside rigid bodies and actuators.

    Attributes
    ----------
    smooth
        Torque that resists the actuators.
    level
        Of the dry friction, at least 0.
    armature
        Inertia on the joints, shape (nv,).
    """

    smooth: Law = lambda t, q, v, tau: 0 * q
    level: Law = lambda t, q, v, tau: 0 * q
    armature: tuple[float, ...] | float = 0.0


def machine(physics: Physics, step: float = 1e-3) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The arm of two joints in MuJoCo."""
    spec = mujoco.MjSpec.from_string(ARM)
    spec.compiler.fusestatic = False
    spec.option.timestep = step
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    model = spec.compile()
    model.dof_armature[:] = physics.armature
    model.dof_solref[:] = [2 * step, 1.0]
    model.dof_solimp[:, :2] = 0.9999
    return model, mujoco.MjData(model)


def acceleration(physics: Physics) -> Law:
    """That of the arm without dry friction, as a function of t, q, v and tau."""
    model, data = machine(physics)

    def slope(t: float, q: Array, v: Array, tau: Array) -> Array:
        data.qpos[:], data.qvel[:] = q, v
        data.qfrc_applied[:] = tau - physics.smooth(t, q, v, tau)
        mujoco.mj_forward(model, data)
        return np.array(data.qacc)

    return slope


def tracked(t: float) -> Array:
    """A motion through all angles and speeds [rad], shape (2,)."""
    shoulder = 1.3 * np.sin(0.9 * t) + 0.3 * np.sin(5.1 * t + 2)
    return np.array([shoulder, 1.1 * np.sin(1.3 * t + 1) + 0.4 * np.sin(6.7 * t)])


def recording(physics: Physics, seconds: float) -> dict[str, Array]:
    """The arm follows `tracked`: its t (N,), q, v and tau, shape (N, 2) each.

    A sample lies in the middle of its steps, of whose torque it has the mean.
    """
    step = 1 / (RATE * _STEPS)
    model, data = machine(physics, step)
    samples = round(seconds * RATE)
    out = {"t": (np.arange(samples) + 0.5) / RATE, **{name: np.zeros((samples, 2)) for name in ("q", "v", "tau")}}
    data.qpos[:] = tracked(0.0)
    for k in range(samples * _STEPS):
        q, v, t = data.qpos.copy(), data.qvel.copy(), data.time
        if k % _STEPS == _STEPS // 2:
            out["q"][k // _STEPS], out["v"][k // _STEPS] = q, v
        tau = 80 * (tracked(t) - q) - 4 * v
        out["tau"][k // _STEPS] += tau / _STEPS
        data.qfrc_applied[:] = tau - physics.smooth(t, q, v, tau)
        model.dof_frictionloss[:] = physics.level(t, q, v, tau)
        mujoco.mj_step(model, data)
    return out


def written(folder: Path, log: dict[str, Array]) -> tuple[Path, Path]:
    """The arm's URDF and a recording as CSV."""
    urdf, csv = folder / "arm.urdf", folder / "arm.csv"
    urdf.write_text(ARM)
    names = ["t", *(f"{signal}_{joint}" for signal in ("q", "v", "tau") for joint in JOINTS)]
    table = np.column_stack([log[signal] for signal in ("t", "q", "v", "tau")])
    np.savetxt(csv, table, delimiter=",", header=",".join(names), comments="")
    return urdf, csv
