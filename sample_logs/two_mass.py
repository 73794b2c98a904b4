"""Two-mass simulation of a robot in MuJoCo: every rotor is a body of its own, behind an elastic gear.

A rotor hangs on a hinge at its stator's link and is tied to the joints by a stiff, damped fixed tendon of length
``coupling @ q - rotor angle``. The motor torque acts on the rotor's hinge. Friction acts on the joint, at the link:
MuJoCo's viscous damping, and its frictionloss, which is exactly the Coulomb value in sliding and holds in sticking.
None of this comes from idtool: the logs have to be an independent witness.

Letters: q [rad], v [rad/s], a [rad/s^2] of the joints, at the link; tau [N m] at the joint output, coupling' times
the motor torques. N samples, nj joints, nr rotors.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from bodies import Array, Body
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

RATE = 1000  # samples per second in the log
STEPS = 10  # simulation steps per sample


@dataclass(frozen=True)
class Friction:
    """Viscous [N m s/rad] and Coulomb [N m] coefficient of one joint."""

    viscous: float
    coulomb: float


@dataclass(frozen=True)
class Robot:
    """A compiled two-mass model; ``links`` and ``rotors`` index its degrees of freedom, coupling is (nr, nj)."""

    model: mujoco.MjModel
    links: NDArray[np.int64]
    rotors: NDArray[np.int64]
    coupling: Array
    friction: tuple[Friction, ...]


@dataclass(frozen=True)
class Run:
    """True motion, torque and friction torque at every sample, without sensors, each (N, nj).

    q and v are those at the sample; a, tau and friction are means over the sample's millisecond, as a drive reports
    torque, so that what happens within it does not alias.
    """

    q: Array
    v: Array
    a: Array
    tau: Array
    friction: Array

    def part(self, span: slice) -> Run:
        """Cut some samples out."""
        return Run(self.q[span], self.v[span], self.a[span], self.tau[span], self.friction[span])


def coupling_of(rotor: Mapping[str, Any]) -> dict[str, float]:
    """Joint name to turns of the rotor per turn of the joint."""
    return dict(rotor["coupling"]) if "coupling" in rotor else {rotor["joint"]: rotor["gear_ratio"]}


def build(
    urdf: Path,
    config: Mapping[str, Any],
    bodies: Mapping[str, Body],
    friction: Mapping[str, Friction],
    stiffness: float,
    damping: float,
) -> Robot:
    """Compile the URDF's kinematics with other bodies, rotors and friction.

    Parameters
    ----------
    urdf
        Robot whose link inertias are replaced.
    config
        Its idtool config, for joints and rotors.
    bodies
        True parameters of every link and rotor.
    friction
        True friction of every joint.
    stiffness, damping
        Of each gear, seen from a joint with gear ratio ``max |coupling|`` [N m/rad, N m s/rad].
    """
    spec = mujoco.MjSpec.from_file(str(urdf))
    spec.compiler.fusestatic = False
    spec.option.timestep = 1 / (RATE * STEPS)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    for name, rotor in config["rotors"].items():
        _add_rotor(spec, name, rotor)
    for name, body in bodies.items():
        _set_inertia(spec.body(name), body)
    model = spec.compile()
    joints, rotors = config["joints"], config["rotors"]
    coupling = np.array([[coupling_of(r).get(j, 0.0) for j in joints] for r in rotors.values()])
    gear = np.abs(coupling).max(axis=1)
    model.tendon_stiffness[:] = stiffness / gear**2
    model.tendon_damping[:] = damping / gear**2
    links = np.array([model.joint(name).dofadr[0] for name in joints])
    model.dof_damping[links] = [friction[name].viscous for name in joints]
    model.dof_frictionloss[links] = [friction[name].coulomb for name in joints]
    model.dof_solref[links] = [4e-4, 1.0]  # Coulomb friction is whole above about 10 mrad/s
    spinning = np.array([model.joint(name).dofadr[0] for name in rotors])
    return Robot(model, links, spinning, coupling, tuple(friction[name] for name in joints))


def _add_rotor(spec: mujoco.MjSpec, name: str, rotor: Mapping[str, Any]) -> None:
    """Hang a rotor on its stator's link and tie it to its joints."""
    turn = Rotation.from_euler("xyz", rotor["origin"]["rpy"])
    body = spec.body(rotor["parent"]).add_body(
        name=name, pos=rotor["origin"]["xyz"], quat=turn.as_quat(scalar_first=True)
    )
    body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=rotor["axis"])
    gear = spec.add_tendon(name=name)
    gear.wrap_joint(name, -1.0)
    for joint, ratio in coupling_of(rotor).items():
        gear.wrap_joint(joint, ratio)


def _set_inertia(target: mujoco.MjsBody, body: Body) -> None:
    target.explicitinertial = True
    target.mass = body.mass
    target.ipos = body.com
    target.fullinertia = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def prior_links(urdf: Path, names: list[str]) -> dict[str, Body]:
    """Inertial parameters of the URDF's links, as MuJoCo reads them."""
    spec = mujoco.MjSpec.from_file(str(urdf))
    found = {}
    for name in names:
        body = spec.body(name)
        xx, yy, zz, xy, xz, yz = body.fullinertia
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        found[name] = Body(float(body.mass), np.array(body.ipos), inertia)
    return found


def simulate(
    robot: Robot, control: Callable[[float, mujoco.MjData], Array], q0: Array, v0: Array, seconds: float
) -> Run:
    """Run from (q0, v0) under ``control(t, data)``, which returns torques at the joint outputs (nj,) [N m].

    The torque is held for one simulation step. Each sample lies in the middle of `STEPS` of them.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[robot.links], data.qvel[robot.links] = q0, v0
    data.qpos[robot.rotors], data.qvel[robot.rotors] = robot.coupling @ q0, robot.coupling @ v0
    to_motors = np.linalg.inv(robot.coupling.T)
    viscous = model.dof_damping[robot.links]
    steps = round(seconds * RATE) * STEPS
    tau = np.zeros((steps, len(q0)))
    q, v, friction = np.zeros((3, steps + 1, len(q0)))
    q[0], v[0], friction[0] = q0, v0, viscous * v0
    for k in range(steps):
        tau[k] = control(data.time, data)
        data.qfrc_applied[robot.rotors] = to_motors @ tau[k]
        mujoco.mj_step(model, data)
        q[k + 1], v[k + 1] = data.qpos[robot.links], data.qvel[robot.links]
        friction[k + 1] = viscous * v[k + 1] - data.qfrc_constraint[robot.links]
    middle = slice(STEPS // 2, None, STEPS)
    a = np.diff(v[::STEPS], axis=0) * RATE
    return Run(q[middle], v[middle], a, _mean(tau), _mean((friction[:-1] + friction[1:]) / 2))


def _mean(values: Array) -> Array:
    """Mean over each sample's steps: (N STEPS, nj) to (N, nj)."""
    return np.asarray(values.reshape(-1, STEPS, values.shape[1]).mean(axis=1))


def rigid_torque(robot: Robot, run: Run) -> Array:
    """Torque (N, nj) that MuJoCo's inverse dynamics asks for if the gears were rigid, friction added.

    Links and rotors move with the recorded motion, the tendons at rest; the rotors' torques are geared to the joints.
    """
    model = copy.copy(robot.model)
    model.dof_frictionloss[:] = 0
    model.dof_damping[:] = 0
    data = mujoco.MjData(model)
    needed = np.zeros((len(run.q), model.nv))
    for k in range(len(run.q)):
        for state, motion in ((data.qpos, run.q), (data.qvel, run.v), (data.qacc, run.a)):
            state[robot.links], state[robot.rotors] = motion[k], robot.coupling @ motion[k]
        mujoco.mj_inverse(model, data)
        needed[k] = data.qfrc_inverse
    return np.asarray(needed[:, robot.links] + needed[:, robot.rotors] @ robot.coupling + run.friction)
