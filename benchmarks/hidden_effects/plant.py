"""A simulated robot with hidden effects: mass matrix and bias from MuJoCo, and dry friction of several kinds.

Links and rotors are bodies of one MuJoCo tree. Each rotor is on a hinge of its own at the link that carries it, so that
it turns with that link too. The tree's coordinates are G x: a rotor's is its gear ratio times the joint's or, in an
elastic transmission, times the motor side's, which is then a coordinate of its own. Each step is semi-implicit Euler's,
and dry friction determines the velocity after it; see `hidden_effects.friction`.

Coordinates x: the n joints on the link side, then the motor sides of the joints with an elastic transmission.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import mujoco  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hidden_effects.friction import FreeStep, Friction, friction_law
from hidden_effects.robots import Body, Robot, Truth, urdf_text

Array = NDArray[np.float64]

RATE = 1000  # samples a second
_STICKING = Friction("sign")


@dataclass
class JointState:
    """State of the joints' links at one time, or along a motion.

    Attributes
    ----------
    t
        Time [s]; along a motion, shape (N,).
    q, v, a
        Position, velocity and acceleration, shape (n,) [rad, rad/s, rad/s^2]; along a motion, (n, N).
    tau
        Torque of the actuators [N m], same shape.
    dt
        Time step [s].
    """

    t: Array | float
    q: Array
    v: Array
    a: Array
    tau: Array
    dt: float = 1e-3


JointTorque = Callable[[JointState], Array]  # the torque [N m] on one joint


@dataclass(frozen=True)
class Transmission:
    """An elastic transmission between motor and link of a joint: a spring with a damper and backlash.

    Attributes
    ----------
    stiffness, damping
        [N m/rad, N m s/rad].
    backlash
        Play between the teeth [rad].
    motor_friction
        Share of the joint's friction that acts on the motor side.
    """

    stiffness: float
    damping: float
    backlash: float = 0.0
    motor_friction: float = 0.0

    def torque(self, deflection: float, speed: float) -> float:
        """Torque on the link, from motor less link position [rad] and its rate; teeth push and do not pull."""
        if not self.backlash:
            return float(self.stiffness * deflection + self.damping * speed)
        beyond = deflection - np.clip(deflection, -self.backlash / 2, self.backlash / 2)
        push = self.stiffness * beyond + self.damping * speed
        return float(push if push * beyond > 0 else 0.0)


@dataclass(frozen=True)
class Contact:
    """A wrench on a link in windows of time, constant in the root's frame.

    Attributes
    ----------
    link
        The link.
    windows
        Start and end of each window [s].
    wrench
        Force and moment along the root's axes [N, N m], shape (6,).
    rise_time
        Time in which it comes and goes [s].
    point
        Where it acts, in the link's frame [m], shape (3,).
    is_half_sine
        True if each window has half a sine wave instead.
    """

    link: str
    windows: Sequence[Sequence[float]]
    wrench: Array
    rise_time: float = 0.005
    point: Sequence[float] = (0.0, 0.0, 0.0)
    is_half_sine: bool = False

    def acting_share(self, t: float) -> float:
        """Share of the wrench that acts at a time."""
        for start, stop in self.windows:
            if self.is_half_sine:
                if start < t < stop:
                    return float(np.sin(np.pi * (t - start) / (stop - start)))
                continue
            x = min(t - start, stop - t) / self.rise_time
            if x > -0.5:
                return 1.0 if x > 0.5 else float(0.5 + x + np.sin(2 * np.pi * x) / (2 * np.pi))
        return 0.0


@dataclass
class AddedPhysics:
    """Physics in addition to the true bodies and their viscous and Coulomb friction; joints by index.

    Attributes
    ----------
    smooth_torques, friction_levels
        Torques that resist, and levels of dry friction.
    contacts, transmissions, payloads
        Wrenches on links, elastic transmissions, and bodies in addition to those of links.
    motor_curves
        Functions from the commanded to the true torque of a motor.
    command_limits
        Largest torque that a motor is commanded, if not its joint's effort [N m].
    gravity
        [m/s^2].
    """

    smooth_torques: list[tuple[int, JointTorque]] = field(default_factory=list)
    friction_levels: list[tuple[int, JointTorque]] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)
    transmissions: dict[int, Transmission] = field(default_factory=dict)
    payloads: list[tuple[str, Body]] = field(default_factory=list)
    motor_curves: list[tuple[int, Callable[[float], float]]] = field(default_factory=list)
    command_limits: dict[int, float] = field(default_factory=dict)
    gravity: tuple[float, ...] = (0.0, 0.0, -9.81)

    def motor_torque(self, commanded: Array) -> Array:
        """True torque of the motors for a commanded torque, shape (n,)."""
        torque = commanded.copy()
        for j, curve in self.motor_curves:
            torque[j] = curve(commanded[j])
        return torque


class MujocoTree:
    """The bodies in MuJoCo: mass matrix and bias in the coordinates x."""

    def __init__(self, robot: Robot, truth: Truth, physics: AddedPhysics) -> None:
        spec = mujoco.MjSpec.from_string(urdf_text(robot, truth.links))
        spec.compiler.fusestatic = False
        spec.option.gravity = physics.gravity
        for joint in robot.joints:
            rotation = Rotation.from_euler("xyz", joint.rpy).as_quat(scalar_first=True)
            rotor_body = spec.body(joint.parent).add_body(name=f"{joint.name}_rotor", pos=joint.xyz, quat=rotation)
            _set_inertia(rotor_body, truth.rotors[joint.name])
            rotor_body.add_joint(name=f"{joint.name}_rotor", type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis)
        for k, (link, body) in enumerate(physics.payloads):
            _set_inertia(spec.body(link).add_body(name=f"payload{k}"), body)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

        n = len(robot.joints)
        self.G = np.zeros((self.model.nv, n + len(physics.transmissions)))
        motor_sides = {j: n + k for k, j in enumerate(physics.transmissions)}
        for j, joint in enumerate(robot.joints):
            self.G[self.model.joint(joint.name).dofadr[0], j] = 1.0
            self.G[self.model.joint(f"{joint.name}_rotor").dofadr[0], motor_sides.get(j, j)] = joint.gear
        self._M = np.zeros((self.model.nv, self.model.nv))
        self._bias = np.zeros(self.model.nv)

    def mass_matrix_and_bias(self, x: Array, dx: Array) -> tuple[Array, Array]:
        """Mass matrix and bias at positions x and velocities dx."""
        model, data = self.model, self.data
        data.qpos[:] = self.G @ x
        data.qvel[:] = self.G @ dx
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, self._bias)
        mujoco.mj_fullM(model, data, self._M)
        return self.G.T @ self._M @ self.G, self.G.T @ self._bias

    def contact_torque(self, contact: Contact, share: float) -> Array:
        """Torque of a share of a contact's wrench on the coordinates, at the last positions."""
        body = self.model.body(contact.link).id
        force, moment = share * contact.wrench[:3], share * contact.wrench[3:]
        torque = np.zeros(self.model.nv)
        point = self.data.xpos[body]
        if any(contact.point):
            point = point + self.data.xmat[body].reshape(3, 3) @ contact.point
        mujoco.mj_applyFT(self.model, self.data, force, moment, point, body, torque)
        return np.asarray(self.G.T @ torque)


def _set_inertia(target: mujoco.MjsBody, body: Body) -> None:
    target.explicitinertial = True
    target.mass = body.mass
    target.ipos = body.com
    target.fullinertia = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


class Plant:
    """A robot in motion.

    Parameters
    ----------
    robot, truth, physics
        The robot, its true bodies and friction, and further physics.
    step
        Time step [s].
    q, v
        First position and velocity, shape (n,).
    friction
        The way in which dry friction is simulated.

    Attributes
    ----------
    x, v
        Present coordinates and their velocities.
    motors
        Index in x of each joint's motor side, shape (n,).
    """

    def __init__(
        self,
        robot: Robot,
        truth: Truth,
        physics: AddedPhysics,
        step: float,
        q: Array,
        v: Array,
        friction: Friction = _STICKING,
    ) -> None:
        n = len(q)
        self._tree = MujocoTree(robot, truth, physics)
        self._physics = physics
        self._n = n
        self._step = step
        self._t = 0.0
        self._transmissions = [(j, n + k, gear) for k, (j, gear) in enumerate(physics.transmissions.items())]
        self.motors = np.arange(n)
        joints = list(range(n))  # of each coordinate
        for j, motor, _ in self._transmissions:
            self.motors[j] = motor
            joints.append(j)
        self.x = q[joints].astype(float)
        self.v = v[joints].astype(float)
        self._a = np.zeros(len(joints))
        friction_share = np.ones(len(joints))
        for j, motor, transmission in self._transmissions:
            friction_share[j] = 1 - transmission.motor_friction
            friction_share[motor] = transmission.motor_friction
        self._viscous = truth.viscous[joints] * friction_share
        self._coulomb = truth.coulomb[joints] * friction_share
        M, _ = self._tree.mass_matrix_and_bias(np.zeros(len(joints)), np.zeros(len(joints)))
        self._friction = friction_law(friction, self._coulomb, np.diag(np.linalg.inv(M)), step)

    def step(self, tau: Array) -> None:
        """Take one step under the actuators' torque, shape (n,)."""
        n, dt = self._n, self._step
        M, bias = self._tree.mass_matrix_and_bias(self.x, self.v)
        state = JointState(self._t, self.x[:n], self.v[:n], self._a[:n], tau, dt)
        force = -bias - self._viscous * self.v
        force[self.motors] += tau
        for j, torque in self._physics.smooth_torques:
            force[j] -= torque(state)
        friction_level = self._coulomb.copy()
        for j, level in self._physics.friction_levels:
            friction_level[j] += level(state)
        for contact in self._physics.contacts:
            share = contact.acting_share(self._t)
            if share:
                force += self._tree.contact_torque(contact, share)
        for j, motor, transmission in self._transmissions:
            transmitted = transmission.torque(self.x[motor] - self.x[j], self.v[motor] - self.v[j])
            force[j] += transmitted
            force[motor] -= transmitted
        M_inverse = np.linalg.inv(M)
        free_step = FreeStep(M, M_inverse, self.v, self.v + dt * M_inverse @ force, dt)
        v = self._friction.velocity_after(free_step, np.maximum(friction_level, 0.0))
        self._a = (v - self.v) / dt
        self.v = v
        self.x = self.x + dt * v
        self._t += dt


def inverse_dynamics(
    robot: Robot, links: Mapping[str, Body], rotors: Mapping[str, Body], q: Array, v: Array, a: Array
) -> Array:
    """Torque of the rigid bodies along a motion, without friction; all shapes (n, N)."""
    no_friction = np.zeros(len(q))
    tree = MujocoTree(robot, Truth(links, rotors, no_friction, no_friction), AddedPhysics())
    tau = np.zeros_like(q)
    for k in range(q.shape[1]):
        M, bias = tree.mass_matrix_and_bias(q[:, k], v[:, k])
        tau[:, k] = M @ a[:, k] + bias
    return tau
