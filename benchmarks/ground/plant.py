"""A quadruped in motion: mass matrix and bias from MuJoCo, soft feet with sticking friction, spinning rotors.

Coordinates: the trunk's six, as MuJoCo has them, then the joints. Rotors are bodies of their own on hinges that turn
with the joints by the gear ratio. Each step is semi-implicit Euler's; dry friction determines the velocity after it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco  # type: ignore[import-untyped]
import numpy as np
from hidden_effects.friction import velocity_with_dry_friction

from ground.robot import FEET, FOOT_RADIUS, GEAR, JOINTS, LEGS, Array, Body, Quadruped, foot_position, mounts

BASE = 6  # coordinates of the trunk

_STIFFNESS = 3e4  # N/m, of a foot
_DAMPING = 120.0  # N s/m
_SHEAR_STIFFNESS = 2e4  # N/m
_SHEAR_DAMPING = 80.0  # N s/m
_HOLD = np.array([4e3, 4e3, 4e3, 400.0, 400.0, 400.0])  # N/m, N m/rad, of the rope that holds a hanging trunk
_HOLD_DAMPING = np.array([120.0, 120.0, 120.0, 12.0, 12.0, 12.0])


@dataclass
class Payload:
    """A further body on a link."""

    link: str
    body: Body


@dataclass
class Physics:
    """What differs from the quadruped on level ground.

    Attributes
    ----------
    friction_coefficient
        Of the feet on the ground.
    is_held
        True if the trunk hangs in the air.
    payloads
        Further bodies.
    """

    friction_coefficient: float = 0.8
    is_held: bool = False
    payloads: list[Payload] = field(default_factory=list)


class Plant:
    """The quadruped in motion.

    Parameters
    ----------
    robot
        The true robot.
    physics
        What acts on it.
    step
        Time step [s].
    q
        First positions of the joints, shape (12,).
    height
        First height of the trunk [m].

    Attributes
    ----------
    forces
        Force of the ground on each foot along the world's axes, shape (4, 3) [N].
    """

    def __init__(self, robot: Quadruped, physics: Physics, step: float, q: Array, height: float) -> None:
        self._physics = physics
        self._step = step
        self._robot = robot
        self.model = _model(robot, physics)
        self.data = mujoco.MjData(self.model)
        joints = [self.model.joint(name) for name in JOINTS]
        rotors = [self.model.joint(f"{name}_rotor") for name in JOINTS]
        self._joint_qpos = np.array([joint.qposadr[0] for joint in joints])
        self._joint_dofs = np.array([joint.dofadr[0] for joint in joints])
        self._rotor_qpos = np.array([joint.qposadr[0] for joint in rotors])
        self._feet = np.array([self.model.site(foot).id for foot in FEET])
        self._calves = np.array([self.model.body(f"{leg}_calf").id for leg in LEGS])
        self.G = np.zeros((self.model.nv, BASE + len(JOINTS)))
        self.G[:BASE, :BASE] = np.eye(BASE)
        self.G[self._joint_dofs, np.arange(BASE, BASE + len(JOINTS))] = 1.0
        for j, joint in enumerate(rotors):
            self.G[joint.dofadr[0], BASE + j] = GEAR
        self.data.qpos[:7] = [0, 0, height, 1, 0, 0, 0]
        self._set_joints(q)
        self.v = np.zeros(BASE + len(JOINTS))
        self._height = height
        self._anchors = np.full((len(FEET), 2), np.nan)
        self.forces = np.zeros((len(FEET), 3))
        self._M = np.zeros((self.model.nv, self.model.nv))
        self._bias = np.zeros(self.model.nv)
        self.acceleration = np.zeros(BASE + len(JOINTS))

    @property
    def q(self) -> Array:
        """Positions of the joints, shape (12,)."""
        return np.asarray(self.data.qpos[self._joint_qpos])

    @property
    def trunk(self) -> tuple[Array, Array]:
        """Position of the trunk [m] and its rotation to the world, shape (3, 3)."""
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, self.data.qpos[3:7])
        return np.array(self.data.qpos[:3]), R.reshape(3, 3)

    def _set_joints(self, q: Array) -> None:
        self.data.qpos[self._joint_qpos] = q
        self.data.qpos[self._rotor_qpos] = GEAR * q

    def step(self, tau: Array) -> None:
        """Take one step under the motors' torque, shape (12,)."""
        model, data, dt = self.model, self.data, self._step
        data.qvel[:] = self.G @ self.v
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, self._bias)
        mujoco.mj_fullM(model, data, self._M)
        force = -self._bias
        for foot in range(len(FEET)):
            self._push_foot(foot, force)
        generalized = self.G.T @ force
        if self._physics.is_held:
            generalized[:BASE] += self._hold()
        generalized[BASE:] += tau - self._robot.viscous * self.v[BASE:]
        M_inverse = np.linalg.inv(self.G.T @ self._M @ self.G)
        v_free = self.v + dt * M_inverse @ generalized
        largest = np.concatenate([np.zeros(BASE), dt * self._robot.coulomb])
        v = velocity_with_dry_friction(M_inverse, v_free, largest, self.v)
        self.acceleration = (v - self.v) / dt
        self.v = v
        mujoco.mj_integratePos(model, data.qpos, self.G @ v, dt)
        self._set_joints(self.q)

    def _push_foot(self, foot: int, force: Array) -> None:
        """Add the force of the ground on a foot to the forces on all coordinates."""
        center = self.data.site_xpos[self._feet[foot]]
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_SITE, self._feet[foot], velocity, 0)
        point = np.array([center[0], center[1], 0.0])
        at_point = velocity[3:] + np.cross(velocity[:3], point - center)
        depth = FOOT_RADIUS - center[2]
        self.forces[foot] = 0.0
        if depth <= 0:
            self._anchors[foot] = np.nan
            return
        normal = max(_STIFFNESS * depth - _DAMPING * at_point[2], 0.0)
        if np.isnan(self._anchors[foot]).any():
            self._anchors[foot] = point[:2]
        # a ball rolls: the point of contact moves over the ground by more than it slips
        self._anchors[foot] += self._step * (velocity[3:5] - at_point[:2])
        shear = -_SHEAR_STIFFNESS * (point[:2] - self._anchors[foot]) - _SHEAR_DAMPING * at_point[:2]
        largest = self._physics.friction_coefficient * normal
        size = np.linalg.norm(shear)
        if size > largest:
            shear *= largest / size
            self._anchors[foot] = point[:2] + shear / _SHEAR_STIFFNESS
        self.forces[foot] = [*shear, normal]
        mujoco.mj_applyFT(self.model, self.data, self.forces[foot], np.zeros(3), point, self._calves[foot], force)

    def _hold(self) -> Array:
        """Force and moment of what holds the trunk, in MuJoCo's coordinates of a free joint."""
        position, _ = self.trunk
        rotation = np.zeros(3)
        mujoco.mju_quat2Vel(rotation, self.data.qpos[3:7], 1.0)
        error = np.concatenate([position - [0, 0, self._height], rotation])
        return -_HOLD * error - _HOLD_DAMPING * self.v[:BASE]


def _model(robot: Quadruped, physics: Physics) -> mujoco.MjModel:
    """The bodies on a free joint."""
    spec = mujoco.MjSpec()
    spec.option.gravity = (0.0, 0.0, -9.81)
    bodies = {"trunk": spec.worldbody.add_body(name="trunk")}
    bodies["trunk"].add_freejoint()
    for name, mount in mounts().items():
        parent = bodies[mount.parent]
        rotor_body = parent.add_body(name=f"{name}_rotor", pos=mount.position)
        _set_inertia(rotor_body, robot.rotors[name])
        rotor_body.add_joint(name=f"{name}_rotor", type=mujoco.mjtJoint.mjJNT_HINGE, axis=mount.axis)
        bodies[mount.child] = parent.add_body(name=mount.child, pos=mount.position)
        bodies[mount.child].add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=mount.axis)
    for name, body in robot.links.items():
        _set_inertia(bodies[name], body)
    for leg, foot in zip(LEGS, FEET, strict=True):
        bodies[f"{leg}_calf"].add_site(name=foot, pos=foot_position())
    for k, payload in enumerate(physics.payloads):
        _set_inertia(bodies[payload.link].add_body(name=f"payload{k}"), payload.body)
    return spec.compile()


def _set_inertia(target: mujoco.MjsBody, body: Body) -> None:
    target.explicitinertial = True
    target.mass = body.mass
    target.ipos = body.com
    target.fullinertia = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
