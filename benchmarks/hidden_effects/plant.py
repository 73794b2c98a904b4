"""A robot of hidden_robots.py moving in small steps: MuJoCo's mass matrix and bias, friction that truly sticks.

Links and rotors are bodies of one MuJoCo tree, each rotor on a hinge at its carrier, so that it turns with it too. The
tree's coordinates are G x: a rotor's is its gear ratio times the joint's, or, behind a gear that gives way, times that
of the motor's side, which is then a coordinate of its own. Each step is Moreau's: the velocities after it are those
that dry friction allows, found by Gauss and Seidel's method on the impulses, so that a joint at rest rests.

Coordinates x: the n joints on the link's side, then the motors' sides of the joints with a gear.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import mujoco  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hidden_effects.robots import Body, Robot, Truth, urdf_text

Array = NDArray[np.float64]

RATE = 1000  # samples a second
_SWEEPS = 60
_DONE = 1e-9  # rad/s


@dataclass
class Now:
    """A moment of the joints' links: q, v, a, tau the actuators' torque, (n,) each; t time, dt the step [s].

    Of a whole motion, t (N,) and the others (n, N).
    """

    t: Array | float
    q: Array
    v: Array
    a: Array
    tau: Array
    dt: float = 1e-3


Law = Callable[[Now], Array]  # the torque [N m] on one joint


@dataclass(frozen=True)
class Gear:
    """What lies between motor and link of a joint: a spring [N m/rad] with a damper [N m s/rad] and play [rad].

    ``share`` of the joint's friction acts on the motor's side.
    """

    stiffness: float
    damping: float
    play: float = 0.0
    share: float = 0.0

    def torque(self, way: float, speed: float) -> float:
        """On the link, the motor being ahead by a way; teeth push and do not pull."""
        beyond = way - np.clip(way, -self.play / 2, self.play / 2)
        if not self.play:
            return float(self.stiffness * way + self.damping * speed)
        push = self.stiffness * beyond + self.damping * speed
        return float(push if push * beyond > 0 else 0.0)


@dataclass(frozen=True)
class Contact:
    """A wrench [N, N m], along the root's axes, at the origin of a link's frame, from time to time [s]."""

    link: str
    windows: Sequence[Sequence[float]]
    wrench: Array
    comes: float = 0.005

    def share(self, t: float) -> float:
        """Of it at a time."""
        for start, stop in self.windows:
            x = min(t - start, stop - t) / self.comes
            if x > -0.5:
                return 1.0 if x > 0.5 else float(0.5 + x + np.sin(2 * np.pi * x) / (2 * np.pi))
        return 0.0


@dataclass
class Physics:
    """What acts beside the bodies and the friction of the truth; joints by number."""

    smooth: list[tuple[int, Law]] = field(default_factory=list)
    dry: list[tuple[int, Law]] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)
    gears: dict[int, Gear] = field(default_factory=dict)
    payloads: list[tuple[str, Body]] = field(default_factory=list)
    gravity: tuple[float, ...] = (0.0, 0.0, -9.81)


class Machine:
    """The tree in MuJoCo: mass matrix and bias in the coordinates x."""

    def __init__(self, robot: Robot, truth: Truth, physics: Physics) -> None:
        spec = mujoco.MjSpec.from_string(urdf_text(robot, truth.links))
        spec.compiler.fusestatic = False
        spec.option.gravity = physics.gravity
        for joint in robot.joints:
            turn = Rotation.from_euler("xyz", joint.rpy).as_quat(scalar_first=True)
            carried = spec.body(joint.parent).add_body(name=f"{joint.name}_rotor", pos=joint.xyz, quat=turn)
            _weigh(carried, truth.rotors[joint.name])
            carried.add_joint(name=f"{joint.name}_rotor", type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis)
        for k, (link, body) in enumerate(physics.payloads):
            _weigh(spec.body(link).add_body(name=f"payload{k}"), body)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        n = len(robot.joints)
        self.G = np.zeros((self.model.nv, n + len(physics.gears)))
        motors = {j: n + k for k, j in enumerate(physics.gears)}
        for j, joint in enumerate(robot.joints):
            self.G[self.model.joint(joint.name).dofadr[0], j] = 1.0
            self.G[self.model.joint(f"{joint.name}_rotor").dofadr[0], motors.get(j, j)] = joint.gear
        self._M, self._bias = np.zeros((self.model.nv, self.model.nv)), np.zeros(self.model.nv)

    def __call__(self, x: Array, dx: Array) -> tuple[Array, Array]:
        """Mass matrix and bias."""
        model, data = self.model, self.data
        data.qpos[:], data.qvel[:] = self.G @ x, self.G @ dx
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, self._bias)
        mujoco.mj_fullM(model, data, self._M)
        return self.G.T @ self._M @ self.G, self.G.T @ self._bias

    def push(self, contact: Contact, share: float) -> Array:
        """Torque of a contact on the coordinates, where the machine was last."""
        body, full = self.model.body(contact.link).id, np.zeros(self.model.nv)
        force, moment = share * contact.wrench[:3], share * contact.wrench[3:]
        mujoco.mj_applyFT(self.model, self.data, force, moment, self.data.xpos[body], body, full)
        return np.asarray(self.G.T @ full)


def _weigh(target: mujoco.MjsBody, body: Body) -> None:
    target.explicitinertial, target.mass, target.ipos = True, body.mass, body.com
    target.fullinertia = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


class Plant:
    """A machine in motion.

    Parameters
    ----------
    robot, truth, physics
        What it is.
    step
        [s].
    q, v
        Where it starts, shape (n,).
    """

    def __init__(self, robot: Robot, truth: Truth, physics: Physics, step: float, q: Array, v: Array) -> None:
        self._machine, self._physics = Machine(robot, truth, physics), physics
        self._n, self._pairs = len(q), [(j, len(q) + k, gear) for k, (j, gear) in enumerate(physics.gears.items())]
        self.motors = np.arange(self._n)
        for j, motor, _ in self._pairs:
            self.motors[j] = motor
        lanes = [*range(self._n), *(j for j, *_ in self._pairs)]
        self.x, self.v = q[lanes].astype(float), v[lanes].astype(float)
        self._a, self._t, self._step = np.zeros(len(lanes)), 0.0, step
        split = np.ones(len(lanes))
        for j, motor, gear in self._pairs:
            split[j], split[motor] = 1 - gear.share, gear.share
        self._viscous, self._coulomb = truth.viscous[lanes] * split, truth.coulomb[lanes] * split

    def step(self, tau: Array) -> None:
        """One step under the actuators' torque, (n,)."""
        n, dt = self._n, self._step
        M, bias = self._machine(self.x, self.v)
        now = Now(self._t, self.x[:n], self.v[:n], self._a[:n], tau, dt)
        force = -bias - self._viscous * self.v
        force[self.motors] += tau
        level = self._coulomb.copy()
        for j, law in self._physics.smooth:
            force[j] -= law(now)
        for j, law in self._physics.dry:
            level[j] += law(now)
        for contact in self._physics.contacts:
            share = contact.share(self._t)
            if share:
                force += self._machine.push(contact, share)
        for j, motor, gear in self._pairs:
            carried = gear.torque(self.x[motor] - self.x[j], self.v[motor] - self.v[j])
            force[j] += carried
            force[motor] -= carried
        W = np.linalg.inv(M)
        after = slid(W, self.v + dt * W @ force, dt * np.maximum(level, 0.0), self.v)
        self._a = (after - self.v) / dt
        self.v = after
        self.x = self.x + dt * after
        self._t += dt


def slid(W: Array, free: Array, most: Array, before: Array) -> Array:
    """Velocities after a step, from those without dry friction, whose impulse on each is ``most`` or less."""
    impulse = most * np.sign(before)
    after = free - W @ impulse
    if ((after * before > 0) | (most == 0)).all():
        return np.asarray(after)
    rubbing = np.flatnonzero(most)
    for _ in range(_SWEEPS):
        change = 0.0
        for j in rubbing:
            own = min(max(impulse[j] + after[j] / W[j, j], -most[j]), most[j])
            if own != impulse[j]:
                change = max(change, abs(own - impulse[j]) * W[j, j])
                after = after - W[:, j] * (own - impulse[j])
                impulse[j] = own
        if change < _DONE:
            break
    after[np.abs(impulse) < most] = 0.0
    return np.asarray(after)


def needed(robot: Robot, links: Mapping[str, Body], rotors: Mapping[str, Body], q: Array, v: Array, a: Array) -> Array:
    """Torque of rigid bodies along a motion, without friction; all (n, N)."""
    zero = np.zeros(len(q))
    machine = Machine(robot, Truth(links, rotors, zero, zero), Physics())
    out = np.zeros_like(q)
    for k in range(q.shape[1]):
        M, bias = machine(q[:, k], v[:, k])
        out[:, k] = M @ a[:, k] + bias
    return out
