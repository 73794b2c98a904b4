"""Exported models in their simulators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml
from numpy.typing import NDArray
from reference import Reference
from robots import inertial, joint

from idtool.reporting.export import Export, IdentifiedModel, Part, identified_model
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

EXACT = {"rtol": 1e-9, "atol": 1e-9}


def state(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Positions and velocities, shape (n,) each."""
    return rng.uniform(-2, 2, n), rng.uniform(-5, 5, n)


def unsupported_parts(export: Export, what: str) -> list[Part]:
    """Parts of a kind that an exported model does not have."""
    return [part for part in export.not_carried if part.what == what]


def model_of(urdf: Path, **config: Any) -> IdentifiedModel:
    """The model of a URDF and a configuration."""
    return identified_model(read_robot(urdf), parse_config(config, "model.yaml"))


def with_couplings(config: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration with every rotor's drive as a coupling, as `Reference` reads it."""
    rotors = {}
    for name, rotor in config.get("rotors", {}).items():
        rest = {key: value for key, value in rotor.items() if key not in ("joint", "gear_ratio")}
        rotors[name] = {"coupling": {rotor["joint"]: rotor["gear_ratio"]} if "joint" in rotor else {}, **rest}
    return {"gravity": [0.0, 0.0, -9.81], **config, "rotors": rotors}


def sample(urdf: Path) -> dict[str, Any]:
    """The configuration of a sample robot, whose rotors are balanced."""
    config = yaml.safe_load(urdf.with_suffix(".yaml").read_text())
    assert isinstance(config, dict)
    return config


def arm(rng: np.random.Generator, *axes: str) -> str:
    """A chain of links l0, l1, … whose joints j1, j2, … stand at these axes, every frame as the one before it."""
    links = "".join(f'<link name="l{i}">{inertial(rng)}</link>' for i in range(len(axes) + 1))
    joints = [
        joint(f"j{i}", "revolute", f"l{i - 1}", f"l{i}", f'<origin xyz="0.1 0 0.2"/><axis xyz="{axis}"/>')
        for i, axis in enumerate(axes, 1)
    ]
    return f'<robot name="arm">{links}{"".join(joints)}</robot>'


def balanced(axis: list[int], coupling: dict[str, float], parent: str) -> dict[str, Any]:
    """A rotor that is round about its axis."""
    inertia = np.diag(1e-3 * (0.6 + 0.4 * np.array(axis)))[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return {
        "coupling": coupling,
        "parent": parent,
        "origin": {"xyz": [0.1, 0.05, 0.0], "rpy": [0, 0, 0]},
        "axis": axis,
        "inertial": {"mass": 0.3, "com": [0.02 * x for x in axis], "inertia": inertia.tolist()},
    }


def mass_and_bias(reference: Reference, q: Array, v: Array) -> tuple[Array, Array]:
    """M(q), shape (nv, nv), and h(q, v), shape (nv,), from Newton and Euler's equations."""
    still = np.zeros_like(q)
    h = reference.torque(q, still, still)
    columns = [reference.torque(q, still, unit) - h for unit in np.eye(len(q))]
    return np.array(columns).T, reference.torque(q, v, still)


class InMujoco:
    """An MJCF as MuJoCo reads it, its coordinates reduced to the model's.

    Parameters
    ----------
    export
        The file.
    joints
        The model's joints, nv of them, in its order.
    spinning
        Speed of every other joint per joint velocity, by name, shape (nv,) each, and its place at zero.
    """

    def __init__(
        self, export: Export, joints: Sequence[str], spinning: Mapping[str, tuple[Array, float]] | None = None
    ) -> None:
        self.model = mujoco.MjModel.from_xml_string(export.text.decode())
        self.data = mujoco.MjData(self.model)
        self.dofs = np.array([self.model.joint(name).dofadr[0] for name in joints])
        self.motors = np.array([self.model.actuator(name).id for name in joints])
        self.G, self.at = np.zeros((self.model.nv, len(joints))), np.zeros(self.model.nv)
        self.G[self.dofs] = np.eye(len(joints))
        for name, (row, place) in (spinning or {}).items():
            dof = self.model.joint(name).dofadr[0]
            self.G[dof], self.at[dof] = row, place
        assert self.G.any(axis=1).all()

    def set(self, q: Array, v: Array, tau: Array | None = None) -> None:
        """Bring it into a state."""
        self.data.qpos[:], self.data.qvel[:] = self.G @ q + self.at, self.G @ v
        self.data.ctrl[self.motors] = 0.0 if tau is None else tau
        mujoco.mj_forward(self.model, self.data)

    @property
    def state(self) -> Array:
        """The model's positions and velocities, shape (2, nv)."""
        return np.array([self.data.qpos[self.dofs], self.data.qvel[self.dofs]])

    def mass_and_bias(self, q: Array, v: Array) -> tuple[Array, Array]:
        """M(q), shape (nv, nv), and h(q, v), shape (nv,)."""
        self.set(q, v)
        M = np.zeros((self.model.nv, self.model.nv))
        for column, unit in zip(M, np.eye(self.model.nv), strict=True):  # it is symmetric
            mujoco.mj_mulM(self.model, self.data, column, unit)
        return self.G.T @ M @ self.G, self.G.T @ self.data.qfrc_bias

    def acceleration(self, q: Array, v: Array, tau: Array) -> Array:
        """MuJoCo's acceleration under a torque and all its own forces, shape (nv,)."""
        self.set(q, v, tau)
        return np.asarray(self.data.qacc[self.dofs])
