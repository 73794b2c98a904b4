"""Robots in MuJoCo, the witness of forward dynamics: rotors and mimic joints are bodies with coordinates of their own.

`Tree` gives mass matrix and bias of links and rotors apart, and takes them to the joints by phi = G q + offset: rigid
gears, exactly. `Simulation` runs MuJoCo's own integrator and its own friction; there a rotor's spin is an armature on
a tendon, which is exact where the rotor is balanced and its spin, its carrier's share included, a constant times v.

Letters: q, v positions and velocities (nv,), M mass matrix (nv, nv), h bias (nv,), phi coordinates of the tree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco  # type: ignore[import-untyped]
import numpy as np
from lxml import etree
from mujoco.rollout import rollout  # type: ignore[import-untyped]
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

_HARD = 0.9999  # the hardest constraint that MuJoCo knows
_ALMOST_NONE = 1e-8  # share of its spin inertia that a body keeps where MuJoCo wants one


class Tree:
    """Links and rotors with the dynamics of their joints.

    Parameters
    ----------
    text
        The URDF, every moving link with mass.
    names
        Joints in the order of q.
    config
        As the configuration has it: ``gravity`` and ``rotors``, each with ``parent``, ``origin``, ``axis`` and
        ``inertial``.
    """

    def __init__(self, text: str, names: Sequence[str], config: Mapping[str, Any]) -> None:
        spec = _spec(text, config)
        rows = {str(j.get("name")): _row(j, text, names) for j in _moving(text)}
        for name, rotor in config.get("rotors", {}).items():
            body = _carried(spec, name, rotor, 1.0)
            body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=rotor["axis"])
            rows[name] = np.sum([ratio * rows[joint] for joint, ratio in _coupling(rotor).items()], axis=0)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        table = np.array([rows[self._model.joint(i).name] for i in range(self._model.njnt)])
        self.G, self.offset = table[:, :-1], table[:, -1]

    def __call__(self, q: Array, v: Array) -> tuple[Array, Array]:
        """M and h."""
        self._forward(q, v)
        product, M = np.empty(len(self.G)), np.empty((len(q), len(q)))
        for k, column in enumerate(self.G.T):
            mujoco.mj_mulM(self._model, self._data, product, np.ascontiguousarray(column))
            M[k] = self.G.T @ product
        return M, self.G.T @ self._data.qfrc_bias

    def energy(self, q: Array, v: Array) -> tuple[float, float]:
        """Potential and kinetic energy [J]."""
        self._forward(q, v)
        mujoco.mj_energyPos(self._model, self._data)
        mujoco.mj_energyVel(self._model, self._data)
        return tuple(map(float, self._data.energy))

    def _forward(self, q: Array, v: Array) -> None:
        self._data.qpos[:], self._data.qvel[:] = self.G @ q + self.offset, self.G @ v
        mujoco.mj_fwdPosition(self._model, self._data)
        mujoco.mj_fwdVelocity(self._model, self._data)


class Simulation:
    """MuJoCo's own forward dynamics, viscous and Coulomb friction as the URDF has them.

    Friction holds by a force that grows with the speed, whole beyond about the deceleration times the step.

    Parameters
    ----------
    text, names, config
        As for `Tree`, without mimic joints.
    spins
        Per rotor, how fast it spins in all about its axis, carrier included: factor of each joint's velocity.
    step
        Of the integrator [s].
    """

    def __init__(
        self,
        text: str,
        names: Sequence[str],
        config: Mapping[str, Any],
        spins: Mapping[str, Mapping[str, float]],
        step: float,
    ) -> None:
        spec = _spec(text, config)
        spec.option.timestep, spec.option.integrator = step, mujoco.mjtIntegrator.mjINT_RK4
        spec.option.tolerance = 1e-10
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_REFSAFE  # which would make friction half as stiff
        for name, rotor in config.get("rotors", {}).items():
            _carried(spec, name, rotor, _ALMOST_NONE)
            tendon = spec.add_tendon(name=name, armature=_spin_inertia(rotor))
            for joint, factor in spins[name].items():
                tendon.wrap_joint(joint, factor)
        self._model = spec.compile()
        self._model.dof_solref[:] = [step, 1.0]
        self._model.dof_solimp[:, :2] = _HARD
        self._places = [int(self._model.joint(name).dofadr[0]) for name in names]

    def run(self, q: Array, v: Array, torque: Callable[[Array], Array], samples: Array) -> Array:
        """Positions at even samples from time 0, the first left out; (nv, N). Each step has the torque of its middle.

        ``torque`` gives (nv, n) at times (n,).
        """
        model, data = self._model, mujoco.MjData(self._model)
        data.qpos[self._places], data.qvel[self._places] = q, v
        start = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        step = model.opt.timestep
        every = round((samples[1] - samples[0]) / step)
        control = np.zeros((every * (len(samples) - 1), len(q)))
        control[:, self._places] = torque((np.arange(len(control)) + 0.5) * step).T
        applied = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
        states, _ = rollout(model, data, start[None], control[None], control_spec=applied)
        return np.asarray(states[0, every - 1 :: every, 1:][:, self._places].T)


def _spec(text: str, config: Mapping[str, Any]) -> mujoco.MjSpec:
    """The URDF, all bodies kept, gravity set, limits and mimic constraints off."""
    spec = mujoco.MjSpec.from_string(text)
    spec.compiler.fusestatic = False
    spec.option.gravity = config.get("gravity", [0, 0, -9.81])
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_EQUALITY
    return spec


def _moving(text: str) -> list[Any]:
    return [j for j in etree.fromstring(text.encode()).iterfind("joint") if j.get("type") != "fixed"]


def _row(joint: Any, text: str, names: Sequence[str]) -> Array:
    """How much of each coordinate moves a joint, and its offset behind them, shape (nv + 1,)."""
    mimic = joint.find("mimic")
    if mimic is None:
        return np.array([*(float(joint.get("name") == name) for name in names), 0.0])
    (source,) = [j for j in _moving(text) if j.get("name") == mimic.get("joint")]
    row = float(mimic.get("multiplier", 1)) * _row(source, text, names)
    row[-1] += float(mimic.get("offset", 0))
    return row


def _coupling(rotor: Mapping[str, Any]) -> Mapping[str, float]:
    return rotor["coupling"] if "coupling" in rotor else {rotor["joint"]: rotor["gear_ratio"]}


def _axis(rotor: Mapping[str, Any]) -> Array:
    return np.asarray(rotor["axis"] / np.linalg.norm(rotor["axis"]))


def _inertia(rotor: Mapping[str, Any]) -> Array:
    """About the centre of mass, shape (3, 3)."""
    xx, xy, yy, xz, yz, zz = rotor["inertial"]["inertia"]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _spin_inertia(rotor: Mapping[str, Any]) -> float:
    return float(_axis(rotor) @ _inertia(rotor) @ _axis(rotor))


def _carried(spec: mujoco.MjSpec, name: str, rotor: Mapping[str, Any], spin: float) -> mujoco.MjsBody:
    """The rotor as a body on its stator's link, with a share of its inertia about its axis."""
    origin, axis, inertial = rotor["origin"], _axis(rotor), rotor["inertial"]
    turn = Rotation.from_euler("xyz", origin["rpy"]).as_quat(scalar_first=True)
    body = spec.body(rotor["parent"]).add_body(name=name, pos=origin["xyz"], quat=turn)
    inertia = _inertia(rotor) - (1 - spin) * _spin_inertia(rotor) * np.outer(axis, axis)
    body.explicitinertial, body.mass, body.ipos = True, inertial["mass"], inertial["com"]
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return body
