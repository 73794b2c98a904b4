"""A quadruped on a stand and an arm of six joints, in MuJoCo: what they truly are, and logs of random motions.

The quadruped has four mirrored legs of three joints, whose geared rotors are bodies: carried along as bodies of the
MuJoCo model, their spin the armature of a tendon. That is exact here, as they are balanced and each one's spin, its
carrier's share included, is a constant times the joints' velocities. The arm's rotors are MuJoCo's armature, a
reflected inertia at the joint. A PD controller that reads the encoders follows random sines within the joints' limits.
Nothing of idtool takes part but its `Log`.

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

from idtool.data.logs import Log, make_log

Array = NDArray[np.float64]

RATE = 500  # samples a second
_STEPS = 2  # of the integrator, a sample
_EVERY = hidden_plant.RATE // RATE  # of the drawn motion's samples
_BANDWIDTH, _DAMPING = 60.0, 0.8  # of the position loop [rad/s]
_LAG = 2e-3  # of the velocity that is differenced from the encoder and smoothed [s]
_SPIN_LEFT = 1e-8  # share of its spin inertia that a rotor's body keeps, as MuJoCo wants one
_HARD = 0.9999  # the hardest friction constraint that MuJoCo knows
_COLOURED_TIME = 0.2  # s
_FINE = 32  # bits

SIDES = {"FL": (1, 1), "FR": (1, -1), "RL": (-1, 1), "RR": (-1, -1)}  # of the trunk: front or rear, left or right


def _quadruped() -> Robot:
    joints: list[Joint] = []
    links = {}
    for leg, (front, left) in SIDES.items():
        for joint in LEG3.joints:
            x, y, z = joint.xyz
            on_trunk = joint.parent == "trunk"
            place = (front * x if on_trunk else x, left * y, z)
            parent = "trunk" if on_trunk else f"{leg}_{joint.parent}"
            child = f"{leg}_{joint.child}"
            joints.append(replace(joint, name=f"{leg}_{joint.name}", parent=parent, child=child, xyz=place))
        for name, link in LEG3.links.items():
            image = np.diag([1, left, 1])
            links[f"{leg}_{name}"] = replace(link, com=image @ link.com, inertia=image @ link.inertia @ image)
    return replace(LEG3, name="quadruped", joints=tuple(joints), links=links)


@dataclass(frozen=True)
class Sensors:
    """Noise of the torque that the drives log.

    Attributes
    ----------
    noise
        White, on the torque, as a share of each joint's rms torque.
    coloured
        First-order autoregressive noise of a correlation time of 0.2 s on top of it, as such a share.
    """

    noise: float = 0.02
    coloured: float = 0.0


@dataclass(frozen=True)
class Run:
    """A simulated motion: t (N,); q and v as logged and tau as it truly was, (N, n)."""

    t: Array
    q: Array
    v: Array
    tau: Array

    def log(self, name: str, joints: tuple[str, ...]) -> Log:
        """The signals as they stand as a log."""
        return make_log(Path(name), self.t, joints, {"q": self.q, "v": self.v, "tau": self.tau})

    def noisy(self, sensors: Sensors, rng: np.random.Generator) -> Run:
        """Copy with noise on the torque."""
        rms = np.sqrt(np.mean(np.square(self.tau), axis=0))
        white = rng.normal(size=self.tau.shape)
        keep = np.exp(-1 / (_COLOURED_TIME * RATE))
        coloured = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.normal(size=self.tau.shape), axis=0)
        return replace(self, tau=self.tau + rms * (sensors.noise * white + sensors.coloured * coloured))


@dataclass(frozen=True)
class SimulatedRobot:
    """A robot and its MuJoCo model.

    Attributes
    ----------
    robot
        Its joints, and the links that it truly has.
    geared
        Whether the rotors are bodies; else they are the joints' armature.
    """

    robot: Robot
    geared: bool

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

    def confined(self, share: float) -> SimulatedRobot:
        """Copy that moves within a share of its joints' travel."""
        joints = []
        for joint in self.robot.joints:
            middle, half = (joint.upper + joint.lower) / 2, share * (joint.upper - joint.lower) / 2
            joints.append(replace(joint, lower=middle - half, upper=middle + half))
        return replace(self, robot=replace(self.robot, joints=tuple(joints)))

    def without_stiction(self) -> SimulatedRobot:
        """Copy without Coulomb friction, whose encoders have steps that are not felt: all is smooth."""
        joints = tuple(replace(joint, coulomb=0.0) for joint in self.robot.joints)
        return replace(self, robot=replace(self.robot, joints=joints, bits=_FINE))

    @cached_property
    def model(self) -> mujoco.MjModel:
        """With rotors and friction, without limits."""
        spec = mujoco.MjSpec.from_string(urdf_text(self.robot))
        spec.compiler.fusestatic = False
        spec.option.timestep = step = 1 / (RATE * _STEPS)
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_REFSAFE
        for joint in self.robot.joints if self.geared else ():
            self._add_rotor(spec, joint)
        model = spec.compile()
        for joint in self.robot.joints:
            place = model.joint(joint.name).dofadr[0]
            model.dof_damping[place], model.dof_frictionloss[place] = joint.viscous, joint.coulomb
            model.dof_armature[place] = 0.0 if self.geared else joint.reflected
        model.dof_solref[:] = [step, 1.0]  # friction is whole beyond about the deceleration times the step
        model.dof_solimp[:, :2] = _HARD
        return model

    def _add_rotor(self, spec: mujoco.MjSpec, joint: Joint) -> None:
        axis, body = np.array(joint.axis), rotor(joint)
        spin = float(axis @ body.inertia @ axis)
        turn = Rotation.from_euler("xyz", joint.rpy).as_quat(scalar_first=True)
        carried = spec.body(joint.parent).add_body(name=rotor_name(joint), pos=joint.xyz, quat=turn)
        inertia = body.inertia - (1 - _SPIN_LEFT) * spin * np.outer(axis, axis)
        carried.explicitinertial, carried.mass, carried.ipos = True, body.mass, body.com
        carried.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        tendon = spec.add_tendon(name=rotor_name(joint), armature=spin)
        tendon.wrap_joint(joint.name, joint.gear)
        for carrier in self.robot.joints:
            if carrier.child == joint.parent and carrier.axis == joint.axis:
                tendon.wrap_joint(carrier.name, 1.0)

    @cached_property
    def places(self) -> NDArray[np.int64]:
        """Degrees of freedom of the joints in MuJoCo, (n,)."""
        return np.array([self.model.joint(name).dofadr[0] for name in self.joints])

    @cached_property
    def bodies(self) -> dict[str, Body]:
        """Links and geared rotors as the MuJoCo model has them, each in its own frame."""
        found = {name: self._body(name) for name in self.links}
        for joint in self.robot.joints if self.geared else ():
            name = rotor_name(joint)
            body, spin = self._body(name), float(self.model.tendon_armature[self.model.tendon(name).id])
            found[name] = replace(body, inertia=body.inertia + spin * np.outer(joint.axis, joint.axis))
        return found

    def _body(self, name: str) -> Body:
        body = self.model.body(name)
        R = Rotation.from_quat(body.iquat, scalar_first=True).as_matrix()
        return Body(float(body.mass[0]), np.array(body.ipos), R @ np.diag(body.inertia) @ R.T)

    @cached_property
    def joint_terms(self) -> dict[tuple[str, str], float]:
        """Friction and armature of every joint as the MuJoCo model has them, by joint and coefficient."""
        terms = {"viscous": "dof_damping", "coulomb": "dof_frictionloss", "inertia": "dof_armature"}
        return {
            (joint, name): float(getattr(self.model, field)[place])
            for joint, place in zip(self.joints, self.places, strict=True)
            for name, field in terms.items()
        }

    def urdf(self, bodies: dict[str, Body]) -> str:
        """The URDF with these inertias of its links."""
        return urdf_text(self.robot, {name: bodies[name] for name in self.links})

    def config(self, bodies: dict[str, Body]) -> dict[str, Any]:
        """The configuration as plain data: rotors with these inertias, or that every joint has one."""
        if self.geared:
            return {"rotors": {rotor_name(joint): _rotor_entry(joint, bodies) for joint in self.robot.joints}}
        parameters = {"inertia": 0.0}
        entries = [{"effect": "rotor_inertia", "joint": j, "parameters": parameters} for j in self.joints]
        return {"effects": entries}

    def run(self, seed: int, seconds: float) -> Run:
        """A random motion, under the control of drives that read the encoders.

        Raises
        ------
        RuntimeError
            If there is no such motion within the robot's limits.
        """
        command = draw_motion(self.robot, seed, seconds)
        q_cmd, v_cmd = (x[:, ::_EVERY].T for x in (command.q, command.v))
        model, data, places = self.model, mujoco.MjData(self.model), self.places
        data.qpos[places], data.qvel[places] = q_cmd[0], v_cmd[0]
        kp, kd = self._gains(command)
        step = 2 * np.pi / 2**self.robot.bits
        keep = 1 / (0.5 + _LAG * RATE)
        q, v, tau = np.zeros((3, *q_cmd.shape))
        read, speed = q_cmd[0], v_cmd[0]
        for k in range(len(q_cmd)):
            tau[k] = kp * (q_cmd[k] - read) + kd * (v_cmd[k] - speed)
            data.qfrc_applied[places] = tau[k]
            mujoco.mj_step(model, data, _STEPS // 2)
            before, read = read, np.round(data.qpos[places] / step) * step
            speed = speed + keep * ((read - before) * RATE - speed)
            q[k], v[k] = read, speed
            mujoco.mj_step(model, data, _STEPS // 2)
        return Run((np.arange(len(q)) + 0.5) / RATE, q, v, tau)

    def _gains(self, command: Motion) -> tuple[Array, Array]:
        """Gains of the PD controller, by each joint's inertia in the middle of its travel, (n,) each."""
        data = mujoco.MjData(self.model)
        data.qpos[self.places] = np.median(command.q, axis=1)
        mujoco.mj_forward(self.model, data)
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, data, full)
        inertia = np.diag(full)[self.places]
        return _BANDWIDTH**2 * inertia, 2 * _DAMPING * _BANDWIDTH * inertia


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


QUADRUPED = SimulatedRobot(_quadruped(), geared=True)
ARM = SimulatedRobot(ARM6, geared=False)
ROBOTS = {"quadruped": QUADRUPED, "arm": ARM}
