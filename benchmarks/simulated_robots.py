"""A quadruped on a stand and an arm of six joints, simulated in MuJoCo: true parameters and logs of random motions.

The quadruped has four mirrored legs of three joints with geared rotors. A rotor is a body of the MuJoCo model that
moves with its carrier, and its spin is the armature of a tendon. That is exact here, as rotors are balanced and each
one's spin, with its carrier's, is a linear function of the joints' velocities. The arm's rotors are MuJoCo's armature,
a reflected inertia at the joint. A PD controller with encoders follows random sines within the joints' limits. Nothing
of idtool is used but its `JointLog`.

Letters: q [rad], v [rad/s], tau [N m] at the joint output, each (N, n), at `RATE`; t [s].
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
sys.path.insert(0, str(Path(__file__).parents[1] / "sample_logs"))

from bodies import Body
from hidden_effects import plant as hidden_plant
from hidden_effects.motion import Motion, draw_motion
from hidden_effects.robots import ARM6, LEG3, Joint, Robot, rotor, urdf_text

from idtool.data.logs import JointLog, make_log

Array = NDArray[np.float64]

RATE = 500  # samples a second
_STEPS = 2  # of the integrator, per sample
_STRIDE = hidden_plant.RATE // RATE  # of the samples of a drawn motion
_BANDWIDTH = 60.0  # rad/s, of the position loop
_DAMPING_RATIO = 0.8
_VELOCITY_LAG = 2e-3  # s, of the velocity, which is differenced from the encoder and smoothed
_MIN_AXIAL_SHARE = 1e-8  # of a rotor's axial inertia that its body keeps, as MuJoCo needs some
_MAX_IMPEDANCE = 0.9999  # of MuJoCo's friction constraints
_CORRELATION_TIME = 0.2  # s, of the coloured noise
_FINE_ENCODER = 32  # bits

LEGS = {"FL": (1, 1), "FR": (1, -1), "RL": (-1, 1), "RR": (-1, -1)}  # signs of x (front or rear) and y (left or right)


def _quadruped() -> Robot:
    """Four copies of the leg on one trunk, mirrored to its corners."""
    joints: list[Joint] = []
    links = {}
    for leg, (x_sign, y_sign) in LEGS.items():
        for joint in LEG3.joints:
            x, y, z = joint.xyz
            on_trunk = joint.parent == "trunk"
            xyz = (x_sign * x if on_trunk else x, y_sign * y, z)
            parent = "trunk" if on_trunk else f"{leg}_{joint.parent}"
            child = f"{leg}_{joint.child}"
            joints.append(replace(joint, name=f"{leg}_{joint.name}", parent=parent, child=child, xyz=xyz))
        for name, link in LEG3.links.items():
            mirror = np.diag([1, y_sign, 1])
            links[f"{leg}_{name}"] = replace(link, com=mirror @ link.com, inertia=mirror @ link.inertia @ mirror)
    return replace(LEG3, name="quadruped", joints=tuple(joints), links=links)


@dataclass(frozen=True)
class TorqueNoise:
    """Noise on the logged torque.

    Attributes
    ----------
    white
        White noise, as a share of each joint's rms torque.
    coloured
        First-order autoregressive noise with a correlation time of 0.2 s in addition, as a share of the same.
    """

    white: float = 0.02
    coloured: float = 0.0


@dataclass(frozen=True)
class Run:
    """A simulated motion: t (N,); logged q and v, and true tau, (N, n)."""

    t: Array
    q: Array
    v: Array
    tau: Array

    def log(self, name: str, joints: tuple[str, ...]) -> JointLog:
        """The signals as a log."""
        return make_log(Path(name), self.t, joints, {"q": self.q, "v": self.v, "tau": self.tau})

    def with_noise(self, noise: TorqueNoise, rng: np.random.Generator) -> Run:
        """A copy with noise on the torque."""
        rms = np.sqrt(np.mean(np.square(self.tau), axis=0))
        white = rng.normal(size=self.tau.shape)
        decay = np.exp(-1 / (_CORRELATION_TIME * RATE))
        coloured = lfilter([np.sqrt(1 - decay**2)], [1, -decay], rng.normal(size=self.tau.shape), axis=0)
        return replace(self, tau=self.tau + rms * (noise.white * white + noise.coloured * coloured))


@dataclass(frozen=True)
class SimulatedRobot:
    """A robot and its MuJoCo model.

    Attributes
    ----------
    robot
        The joints, and the true links.
    has_rotor_bodies
        True if the rotors are bodies; otherwise they are the joints' armature.
    """

    robot: Robot
    has_rotor_bodies: bool

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self.robot.name

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.robot.names

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links."""
        return tuple(self.robot.links)

    def with_travel(self, share: float) -> SimulatedRobot:
        """A copy that moves within a share of its joints' travel."""
        joints = []
        for joint in self.robot.joints:
            middle = (joint.upper + joint.lower) / 2
            half = share * (joint.upper - joint.lower) / 2
            joints.append(replace(joint, lower=middle - half, upper=middle + half))
        return replace(self, robot=replace(self.robot, joints=tuple(joints)))

    def without_stiction(self) -> SimulatedRobot:
        """A copy without Coulomb friction and with ideal encoders: all signals are smooth."""
        joints = tuple(replace(joint, coulomb=0.0) for joint in self.robot.joints)
        return replace(self, robot=replace(self.robot, joints=joints, encoder_bits=_FINE_ENCODER))

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The MuJoCo model, with rotors and friction, without joint limits."""
        spec = mujoco.MjSpec.from_string(urdf_text(self.robot))
        spec.compiler.fusestatic = False
        timestep = 1 / (RATE * _STEPS)
        spec.option.timestep = timestep
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_REFSAFE
        if self.has_rotor_bodies:
            for joint in self.robot.joints:
                self._add_rotor(spec, joint)
        model = spec.compile()
        for joint in self.robot.joints:
            dof = model.joint(joint.name).dofadr[0]
            model.dof_damping[dof] = joint.viscous
            model.dof_frictionloss[dof] = joint.coulomb
            model.dof_armature[dof] = 0.0 if self.has_rotor_bodies else joint.reflected_inertia
        model.dof_solref[:] = [timestep, 1.0]  # full friction above about deceleration times timestep
        model.dof_solimp[:, :2] = _MAX_IMPEDANCE
        return model

    def _add_rotor(self, spec: mujoco.MjSpec, joint: Joint) -> None:
        axis, body = np.array(joint.axis), rotor(joint)
        axial_inertia = float(axis @ body.inertia @ axis)
        rotation = Rotation.from_euler("xyz", joint.rpy).as_quat(scalar_first=True)
        target = spec.body(joint.parent).add_body(name=rotor_name(joint), pos=joint.xyz, quat=rotation)
        inertia = body.inertia - (1 - _MIN_AXIAL_SHARE) * axial_inertia * np.outer(axis, axis)
        target.explicitinertial = True
        target.mass = body.mass
        target.ipos = body.com
        target.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        tendon = spec.add_tendon(name=rotor_name(joint), armature=axial_inertia)
        tendon.wrap_joint(joint.name, joint.gear)
        for carrier in self.robot.joints:
            if carrier.child == joint.parent and carrier.axis == joint.axis:
                tendon.wrap_joint(carrier.name, 1.0)

    @cached_property
    def dofs(self) -> NDArray[np.int64]:
        """Indices of the joints' degrees of freedom in MuJoCo, shape (n,)."""
        return np.array([self.model.joint(name).dofadr[0] for name in self.joints])

    @cached_property
    def bodies(self) -> dict[str, Body]:
        """True bodies of links and geared rotors in the MuJoCo model, each in its own frame."""
        bodies = {name: self._body(name) for name in self.links}
        if self.has_rotor_bodies:
            for joint in self.robot.joints:
                name = rotor_name(joint)
                body = self._body(name)
                axial_inertia = float(self.model.tendon_armature[self.model.tendon(name).id])
                inertia = body.inertia + axial_inertia * np.outer(joint.axis, joint.axis)
                bodies[name] = replace(body, inertia=inertia)
        return bodies

    def _body(self, name: str) -> Body:
        body = self.model.body(name)
        R = Rotation.from_quat(body.iquat, scalar_first=True).as_matrix()
        return Body(float(body.mass[0]), np.array(body.ipos), R @ np.diag(body.inertia) @ R.T)

    @cached_property
    def joint_terms(self) -> dict[tuple[str, str], float]:
        """True friction and armature of every joint, by joint and name of the coefficient."""
        terms = {}
        for joint, dof in zip(self.joints, self.dofs, strict=True):
            terms[joint, "viscous"] = float(self.model.dof_damping[dof])
            terms[joint, "coulomb"] = float(self.model.dof_frictionloss[dof])
            terms[joint, "inertia"] = float(self.model.dof_armature[dof])
        return terms

    def urdf(self, bodies: dict[str, Body]) -> str:
        """The URDF with the inertias of given bodies."""
        return urdf_text(self.robot, {name: bodies[name] for name in self.links})

    def config(self, bodies: dict[str, Body]) -> dict[str, Any]:
        """The configuration as plain data: rotors with the inertias of given bodies, or a rotor inertia per joint."""
        if self.has_rotor_bodies:
            return {"rotors": {rotor_name(joint): _rotor_entry(joint, bodies) for joint in self.robot.joints}}
        entries = []
        for joint in self.joints:
            entries.append({"effect": "rotor_inertia", "joint": joint, "parameters": {"inertia": 0.0}})
        return {"effects": entries}

    def run(self, seed: int, seconds: float) -> Run:
        """Simulate a random motion under a PD controller that reads the encoders.

        Raises
        ------
        RuntimeError
            If no motion within the robot's limits is found.
        """
        command = draw_motion(self.robot, seed, seconds)
        q_cmd, v_cmd = command.q[:, ::_STRIDE].T, command.v[:, ::_STRIDE].T
        model, data, dofs = self.model, mujoco.MjData(self.model), self.dofs
        data.qpos[dofs], data.qvel[dofs] = q_cmd[0], v_cmd[0]
        kp, kd = self._gains(command)
        resolution = 2 * np.pi / 2**self.robot.encoder_bits
        smoothing = 1 / (0.5 + _VELOCITY_LAG * RATE)
        q, v, tau = np.zeros((3, *q_cmd.shape))
        q_measured, v_measured = q_cmd[0], v_cmd[0]
        for k in range(len(q_cmd)):
            tau[k] = kp * (q_cmd[k] - q_measured) + kd * (v_cmd[k] - v_measured)
            data.qfrc_applied[dofs] = tau[k]
            mujoco.mj_step(model, data, _STEPS // 2)
            q_last = q_measured
            q_measured = np.round(data.qpos[dofs] / resolution) * resolution
            v_measured = v_measured + smoothing * ((q_measured - q_last) * RATE - v_measured)
            q[k], v[k] = q_measured, v_measured
            mujoco.mj_step(model, data, _STEPS // 2)
        return Run((np.arange(len(q)) + 0.5) / RATE, q, v, tau)

    def _gains(self, command: Motion) -> tuple[Array, Array]:
        """Gains kp and kd by each joint's inertia in the middle of its travel, shape (n,) each."""
        data = mujoco.MjData(self.model)
        data.qpos[self.dofs] = np.median(command.q, axis=1)
        mujoco.mj_forward(self.model, data)
        M = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, data, M)
        inertia = np.diag(M)[self.dofs]
        return _BANDWIDTH**2 * inertia, 2 * _DAMPING_RATIO * _BANDWIDTH * inertia


def rotor_name(joint: Joint) -> str:
    """Name of a joint's rotor."""
    return f"{joint.name}_rotor"


def _rotor_entry(joint: Joint, bodies: dict[str, Body]) -> dict[str, Any]:
    return {
        "joint": joint.name,
        "gear_ratio": joint.gear,
        "parent": joint.parent,
        "origin": {"xyz": list(joint.xyz), "rpy": list(joint.rpy)},
        "axis": list(joint.axis),
        "inertial": bodies[rotor_name(joint)].to_config(),
    }


QUADRUPED = SimulatedRobot(_quadruped(), has_rotor_bodies=True)
ARM = SimulatedRobot(ARM6, has_rotor_bodies=False)
ROBOTS = {"quadruped": QUADRUPED, "arm": ARM}
