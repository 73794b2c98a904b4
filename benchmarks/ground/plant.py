"""A robot in motion: mass matrix and bias from MuJoCo, soft feet with sticking friction, spinning rotors.

Coordinates: the base's six, as MuJoCo has them, then the joints. Rotors are bodies of their own on hinges that turn
with the joints by the gear ratio. Each step is semi-implicit Euler's; dry friction determines the velocity after it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco  # type: ignore[import-untyped]
import numpy as np
from hidden_effects.friction import velocity_with_dry_friction

from ground.robot import Array, Body, Foot, Robot

BASE = 6  # coordinates of the base

_HOLD = np.array([4e3, 4e3, 4e3, 400.0, 400.0, 400.0])  # N/m, N m/rad, of the frame that holds a hanging base
_HOLD_DAMPING = np.array([120.0, 120.0, 120.0, 12.0, 12.0, 12.0])
_ROPE, _ROPE_DAMPING = 1e4, 200.0  # N/m, N s/m
_HOOK = "hook"


@dataclass
class Payload:
    """A further body on a link."""

    link: str
    body: Body


@dataclass
class Physics:
    """What differs from the robot on level ground.

    Attributes
    ----------
    friction_coefficient
        Of the feet on the ground.
    slippery_feet
        Friction coefficient of single feet that have another.
    is_held
        True if the base hangs in the air.
    payloads
        Further bodies.
    """

    friction_coefficient: float = 0.8
    slippery_feet: dict[str, float] = field(default_factory=dict)
    is_held: bool = False
    payloads: list[Payload] = field(default_factory=list)


class Plant:
    """The robot in motion.

    Parameters
    ----------
    robot
        The true robot.
    physics
        What acts on it.
    step
        Time step [s].
    q
        First positions of the n joints, shape (n,).
    height
        First height of the base [m].

    Attributes
    ----------
    wrenches
        Force and moment of the ground on each foot, shape (feet, 6) [N, N m]: on a ball along the world's axes, on a
        sole along and about its own.
    sensor_wrenches
        Force and moment on the child link of each joint with a wrench sensor, along and about its axes, shape
        (sensors, 6) [N, N m].
    """

    def __init__(self, robot: Robot, physics: Physics, step: float, q: Array, height: float) -> None:
        self._physics = physics
        self._step = step
        self._robot = robot
        self.model = _model(robot, physics)
        self.data = mujoco.MjData(self.model)
        joints = [self.model.joint(name) for name in robot.joints]
        rotors = [self.model.joint(f"{name}_rotor") for name in robot.joints]
        self._joint_qpos = np.array([joint.qposadr[0] for joint in joints])
        self._joint_dofs = np.array([joint.dofadr[0] for joint in joints])
        self._rotor_qpos = np.array([joint.qposadr[0] for joint in rotors])
        self._foot_sites = [self.model.site(foot.name).id for foot in robot.feet]
        self._balls = [[_Ball(self.model, foot, k) for k in range(len(foot.corners))] for foot in robot.feet]
        self.G = np.zeros((self.model.nv, BASE + len(joints)))
        self.G[:BASE, :BASE] = np.eye(BASE)
        self.G[self._joint_dofs, np.arange(BASE, BASE + len(joints))] = 1.0
        for j, joint in enumerate(rotors):
            self.G[joint.dofadr[0], BASE + j] = robot.gear
        self.data.qpos[:7] = [0, 0, height, 1, 0, 0, 0]
        self._set_joints(q)
        self.v = np.zeros(BASE + len(joints))
        self._height = height
        self._hook_at: Array | None = None  # of a robot that hangs on a rope, as it begins
        self.wrenches = np.zeros((len(robot.feet), 6))
        self.sensor_wrenches = np.zeros((len(robot.wrench_sensors), 6))
        self._max_impulse = np.concatenate([np.zeros(BASE), step * robot.coulomb])
        self._M = np.zeros((self.model.nv, self.model.nv))
        self._bias = np.zeros(self.model.nv)
        self.acceleration = np.zeros(BASE + len(joints))

    @property
    def q(self) -> Array:
        """Positions of the joints, shape (n,)."""
        return np.asarray(self.data.qpos[self._joint_qpos])

    @property
    def base(self) -> tuple[Array, Array]:
        """Position of the base [m] and its rotation to the world, shape (3, 3)."""
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, self.data.qpos[3:7])
        return np.array(self.data.qpos[:3]), R.reshape(3, 3)

    @property
    def slip(self) -> Array:
        """Way that each foot has slipped over the ground so far, the mean of its balls, shape (feet,) [m]."""
        return np.array([np.mean([ball.slip for ball in balls]) for balls in self._balls])

    def _set_joints(self, q: Array) -> None:
        self.data.qpos[self._joint_qpos] = q
        self.data.qpos[self._rotor_qpos] = self._robot.gear * q

    def step(self, tau: Array) -> None:
        """Take one step under the motors' torque, shape (n,)."""
        model, data, dt = self.model, self.data, self._step
        data.qvel[:] = self.G @ self.v
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, self._bias)
        mujoco.mj_fullM(model, data, self._M)
        force = -self._bias
        self._push_feet(force)
        if self._physics.is_held and self._robot.hook is not None:
            self._pull_rope(force)
        generalized = self.G.T @ force
        if self._physics.is_held and self._robot.hook is None:
            generalized[:BASE] += self._hold()
        generalized[BASE:] += tau - self._robot.viscous * self.v[BASE:]
        M_inverse = np.linalg.inv(self.G.T @ self._M @ self.G)
        v_free = self.v + dt * M_inverse @ generalized
        v = velocity_with_dry_friction(M_inverse, v_free, self._max_impulse, self.v)
        self.acceleration = (v - self.v) / dt
        if len(self.sensor_wrenches):
            self._read_sensors()
        self.v = v
        mujoco.mj_integratePos(model, data.qpos, self.G @ v, dt)
        self._set_joints(self.q)

    def _push_feet(self, force: Array) -> None:
        """Add the forces of the ground on all feet to the forces on all coordinates."""
        self.wrenches[:] = 0.0
        self.data.xfrc_applied[:] = 0.0
        for foot, site, wrench, balls in zip(
            self._robot.feet, self._foot_sites, self.wrenches, self._balls, strict=True
        ):
            friction = self._physics.slippery_feet.get(foot.name, self._physics.friction_coefficient)
            for ball in balls:
                contact = ball.touch(self.model, self.data, friction, self._step)
                if contact is None:
                    continue
                point, push = contact
                mujoco.mj_applyFT(self.model, self.data, push, np.zeros(3), point, ball.body, force)
                about_com = _cross(point - self.data.xipos[ball.body], push)
                applied = self.data.xfrc_applied[ball.body]
                applied[:3] += push
                applied[3:] += about_com
                if foot.is_sole:
                    R = self.data.site_xmat[site].reshape(3, 3)
                    wrench[:3] += R.T @ push
                    wrench[3:] += R.T @ _cross(point - self.data.site_xpos[site], push)
                else:
                    wrench[:3] += push

    def _read_sensors(self) -> None:
        """Read MuJoCo's sensors of force and moment at this step's accelerations."""
        self.data.qacc[:] = self.G @ self.acceleration
        mujoco.mj_rnePostConstraint(self.model, self.data)
        mujoco.mj_sensorAcc(self.model, self.data)
        self.sensor_wrenches = self.data.sensordata.reshape(self.sensor_wrenches.shape).copy()

    def _pull_rope(self, force: Array) -> None:
        """Add the force of the rope to the forces on all coordinates."""
        site = self.data.site(_HOOK)
        if self._hook_at is None:
            self._hook_at = site.xpos.copy()
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_SITE, site.id, velocity, 0)
        pull = -_ROPE * (site.xpos - self._hook_at) - _ROPE_DAMPING * velocity[3:]
        body = self.model.site_bodyid[site.id]
        mujoco.mj_applyFT(self.model, self.data, pull, np.zeros(3), site.xpos, body, force)

    def _hold(self) -> Array:
        """Force and moment of what holds the base, in MuJoCo's coordinates of a free joint."""
        position, _ = self.base
        rotation = np.zeros(3)
        mujoco.mju_quat2Vel(rotation, self.data.qpos[3:7], 1.0)
        error = np.concatenate([position - [0, 0, self._height], rotation])
        return -_HOLD * error - _HOLD_DAMPING * self.v[:BASE]


class _Ball:
    """A soft ball of a foot, which sticks to the ground where it first touches it.

    Parameters
    ----------
    model
        In MuJoCo.
    foot
        The foot.
    corner
        Number of the ball.

    Attributes
    ----------
    slip
        Way that it has slipped over the ground so far [m].
    """

    def __init__(self, model: mujoco.MjModel, foot: Foot, corner: int) -> None:
        self._softness, self._radius = foot.softness, foot.radius
        self._site = model.site(_ball_name(foot, corner)).id
        self.body = model.body(foot.link).id
        self._anchor = np.full(2, np.nan)
        self.slip = 0.0

    def touch(
        self, model: mujoco.MjModel, data: mujoco.MjData, friction_coefficient: float, dt: float
    ) -> tuple[Array, Array] | None:
        """Where the ground pushes it [m], and the force [N]; None in the air."""
        softness = self._softness
        center = data.site_xpos[self._site]
        depth = self._radius - center[2]
        if depth <= 0:
            self._anchor[:] = np.nan
            return None
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, self._site, velocity, 0)
        point = np.array([center[0], center[1], 0.0])
        at_point = velocity[3:] + _cross(velocity[:3], point - center)
        normal = max(softness.stiffness * depth - softness.damping * at_point[2], 0.0)
        if np.isnan(self._anchor).any():
            self._anchor = point[:2]
        # a ball rolls: the point of contact moves over the ground by more than it slips
        self._anchor = self._anchor + dt * (velocity[3:5] - at_point[:2])
        shear = -softness.shear_stiffness * (point[:2] - self._anchor) - softness.shear_damping * at_point[:2]
        largest = friction_coefficient * normal
        size = np.linalg.norm(shear)
        if size > largest:
            shear *= largest / size
            dragged = point[:2] + shear / softness.shear_stiffness
            self.slip += float(np.linalg.norm(dragged - self._anchor))
            self._anchor = dragged
        return point, np.array([*shear, normal])


def _cross(a: Array, b: Array) -> Array:
    """Cross product of two vectors; NumPy's takes ten times as long."""
    (x, y, z), (u, v, w) = a, b
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])


def _ball_name(foot: Foot, corner: int) -> str:
    return f"{foot.name}_ball{corner}"


def _model(robot: Robot, physics: Physics) -> mujoco.MjModel:
    """The bodies on a free joint."""
    spec = mujoco.MjSpec()
    spec.option.gravity = (0.0, 0.0, -9.81)
    bodies = {robot.base: spec.worldbody.add_body(name=robot.base)}
    bodies[robot.base].add_freejoint()
    for name, mount in robot.mounts.items():
        parent = bodies[mount.parent]
        if mount.axis is not None:
            rotor_body = parent.add_body(name=f"{name}_rotor", pos=mount.position)
            _set_inertia(rotor_body, robot.rotors[name])
            rotor_body.add_joint(name=f"{name}_rotor", type=mujoco.mjtJoint.mjJNT_HINGE, axis=mount.axis)
        bodies[mount.child] = parent.add_body(name=mount.child, pos=mount.position)
        if mount.axis is not None:
            bodies[mount.child].add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=mount.axis)
    for name, body in robot.links.items():
        _set_inertia(bodies[name], body)
    for foot in robot.feet:
        bodies[foot.link].add_site(name=foot.name, pos=foot.position)
        for k, corner in enumerate(foot.corners):
            bodies[foot.link].add_site(name=_ball_name(foot, k), pos=foot.position + corner)
    for joint in robot.wrench_sensors:
        bodies[robot.mounts[joint].child].add_site(name=joint)
        for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
            name = f"{joint}_{kind.name}"
            spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=joint)
    if robot.hook is not None:
        bodies[robot.hook.link].add_site(name=_HOOK, pos=robot.hook.position)
    for k, payload in enumerate(physics.payloads):
        _set_inertia(bodies[payload.link].add_body(name=f"payload{k}"), payload.body)
    return spec.compile()


def _set_inertia(target: mujoco.MjsBody, body: Body) -> None:
    target.explicitinertial = True
    target.mass = body.mass
    target.ipos = body.com
    target.fullinertia = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
