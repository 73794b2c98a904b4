"""A quadruped in MuJoCo whose hind legs soon come to rest in dry friction, with a spring and an offset hidden in it."""

from __future__ import annotations

from pathlib import Path

import mujoco  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

RATE, STEPS, SECONDS = 200, 20, 8.0  # Hz, of the simulation in a sample, s
REST = 2.0  # s after which the hind legs do not move
NOISE = 0.02  # N·m
KP, KD = 25.0, 0.6  # N·m/rad, N·m·s/rad
VISCOUS, COULOMB = 0.2, 0.4  # N·m·s/rad, N·m
STIFFNESS, OFFSET = 6.0, 0.8  # N·m/rad on the hip, N·m on the knee of the front legs
SPRING_JOINT, OFFSET_JOINT = "FL_hip", "FR_knee"

LEGS = {"FL": (0.2, 0.1), "FR": (0.2, -0.1), "RL": (-0.2, 0.1), "RR": (-0.2, -0.1)}
PARTS = (("abad", "1 0 0", "0 0.04 0", 0.6), ("hip", "0 1 0", "0 0 -0.1", 0.9), ("knee", "0 1 0", "0 0 -0.09", 0.3))
JOINTS = [f"{leg}_{part}" for leg in LEGS for part, *_ in PARTS]
MOVING = 6  # joints, of the front legs


def _leg(leg: str, x: float, y: float) -> str:
    """Links and joints of a leg."""
    parent, place, text = "trunk", f"{x} {y} 0", ""
    for part, axis, com, mass in PARTS:
        link = f"{leg}_{part}_link"
        inertia = f'ixx="{0.004 * mass}" iyy="{0.004 * mass}" izz="{0.001 * mass}" ixy="0" ixz="0" iyz="0"'
        text += (
            f'<link name="{link}"><inertial><origin xyz="{com}"/><mass value="{mass}"/><inertia {inertia}/></inertial>'
        )
        text += f'</link><joint name="{leg}_{part}" type="revolute"><parent link="{parent}"/><child link="{link}"/>'
        text += f'<origin xyz="{place}"/><axis xyz="{axis}"/>'
        text += '<limit lower="-2" upper="2" effort="30" velocity="20"/></joint>'
        parent, place = link, "0 0.05 0" if part == "abad" else "0 0 -0.2"
    return text


URDF = (
    f'<robot name="quadruped"><link name="trunk"/>{"".join(_leg(leg, *place) for leg, place in LEGS.items())}</robot>'
)


def _command(t: Array) -> Array:
    """Positions, shape (N, 12); those of the hind legs stop."""
    rng = np.random.default_rng(3)
    frequency, phase = rng.uniform(0.3, 2.0, (12, 4)), rng.uniform(0, 2 * np.pi, (12, 4))
    hind = np.arange(12) >= MOVING
    own_time = np.where(hind, np.minimum(t[:, None], REST), t[:, None])
    return np.asarray((0.2 * np.sin(2 * np.pi * frequency * own_time[..., None] + phase)).sum(axis=2))


def recorded() -> Array:
    """Rows t, q, v, tau, shape (N, 37)."""
    model = mujoco.MjModel.from_xml_string(URDF)
    model.opt.timestep = 1 / (RATE * STEPS)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.dof_damping[:], model.dof_frictionloss[:] = VISCOUS, COULOMB
    model.dof_solref[:], model.dof_solimp[:, :2] = [0.0005, 1.0], 0.9999
    order = [model.joint(name).dofadr[0] for name in JOINTS]
    data = mujoco.MjData(model)
    t = np.arange(round(RATE * SECONDS)) / RATE
    command = _command(t)
    velocity = np.gradient(command, 1 / RATE, axis=0)
    data.qpos[order] = command[0]
    spring, offset = JOINTS.index(SPRING_JOINT), JOINTS.index(OFFSET_JOINT)
    rows = []
    for now, q_command, v_command in zip(t, command, velocity, strict=True):
        q, v = data.qpos[order].copy(), data.qvel[order].copy()
        tau = KP * (q_command - q) + KD * (v_command - v)
        rows.append([now, *q, *v, *tau])
        for _ in range(STEPS):
            on_joints = tau.copy()
            on_joints[spring] -= STIFFNESS * (data.qpos[order[spring]] - 0.3)
            on_joints[offset] -= OFFSET
            data.qfrc_applied[order] = on_joints
            mujoco.mj_step(model, data)
    log = np.array(rows)
    log[:, 25:] += NOISE * np.random.default_rng(1).standard_normal((len(log), 12))
    return log


def write_quadruped(folder: Path) -> tuple[Path, Path]:
    """Write URDF and log."""
    urdf, csv = folder / "quadruped.urdf", folder / "log.csv"
    urdf.write_text(URDF)
    head = ",".join(["t", *(f"{signal}_{joint}" for signal in ("q", "v", "tau") for joint in JOINTS)])
    np.savetxt(csv, recorded(), fmt="%.9g", delimiter=",", header=head, comments="")
    return urdf, csv


def quadruped_experiment(folder: Path) -> Experiment:
    """Model and log; the last 30 %, in which the hind legs rest, are held out."""
    urdf, csv = write_quadruped(folder)
    return prepare(read_robot(urdf), parse_config({}, ""), [csv], holdout=0.3)
