"""`RobotModel`: URDF and configuration → a tree of bodies that move with the joint coordinates.

Every body, link or rotor, hangs on its parent by one axis, along or about which it moves by

    phi = ratios · q + offset,

one entry of `ratios` for a plain joint, a multiple for a mimic joint, the gear ratio for a rotor, several for a belt or
differential. Links on fixed or locked joints are lumped into the body that carries them. Letters as in `body`.

A floating base is the first body. It has six coordinates after those of the joints: three translations and three
rotations along the axes of its frame. The equation of motion holds in any frame that moves uniformly, so at every
sample the base is at position 0 with velocity 0 of its origin; its acceleration is the proper one, which an
accelerometer measures and which includes gravity. The generalized forces on these coordinates are the external force
[N] and moment about its origin [N·m] on the robot.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.names import join_names, printable, suggestion
from idtool.common.notice import Notice
from idtool.robot.body import Body, Frame, Member
from idtool.robot.bounding import bounding_shape
from idtool.robot.config import BoundingEllipsoid, Config, RotorConfig, WrenchSensor
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import PI_SIZE, from_mass_com_inertia, skew, symmetric_matrix
from idtool.robot.rotation import rotation_about, rotation_from_rpy
from idtool.robot.shapes import Shape
from idtool.robot.urdf.reading import Robot, UrdfJoint

_WRENCH = ("force_x", "force_y", "force_z", "moment_x", "moment_y", "moment_z")
WRENCH_SIZE = len(_WRENCH)
BASE_COORDINATES = tuple(f"base_{part}" for part in _WRENCH)


@dataclass(frozen=True)
class RobotModel:
    """A robot as identification sees it.

    Attributes
    ----------
    robot
        The URDF it came from.
    joints
        The moving joints, in the order of q, and those that stand for the coordinates of wrench sensors and of a
        floating base; nv in all.
    bodies
        A floating base, links in the URDF's order, then rotors; parents before children. What a wrench sensor carries
        is a body of its own.
    frames
        Frame of every URDF link.
    wrench_sensors
        By fixed joint, what turns the reading of its sensor into the wrench on the body that it carries, about the
        origin and along the axes of the body's frame; shape (6, 6).
    offset_logs
        Logs in which wrench sensors have offsets of their own: `Motion.recording`, and the times after which the rate
        of a drift is constant [s]; see `WrenchSensorOffset`.
    gravity
        In the root link's frame, shape (3,) [m/s²]; 0 with a floating base, whose acceleration includes it.
    notices
        What a user should know of how the model was put together, a plain sentence each.
    """

    robot: Robot
    joints: tuple[UrdfJoint, ...]
    bodies: tuple[Body, ...]
    gravity: Array
    notices: tuple[Notice, ...] = ()
    frames: Mapping[str, Frame] = field(default_factory=dict)
    wrench_sensors: Mapping[str, Array] = field(default_factory=dict)
    offset_logs: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the moving joints, of the coordinates of wrench sensors, and of those of a floating base."""
        return tuple(joint.name for joint in self.joints)

    @property
    def has_floating_base(self) -> bool:
        """True if the root link moves freely."""
        return bool(self.bodies) and self.bodies[0].is_base

    @property
    def joint_count(self) -> int:
        """Number of moving joints; after them come the coordinates of wrench sensors, then those of a floating base."""
        return len(self.joints) - WRENCH_SIZE * (len(self.wrench_sensors) + self.has_floating_base)

    @property
    def base_coordinates(self) -> slice:
        """Coordinates of a floating base."""
        return slice(len(self.joints) - WRENCH_SIZE, len(self.joints))

    def sensor_coordinates(self, sensor: int) -> slice:
        """Coordinates of a wrench sensor, by its place in ``wrench_sensors``."""
        first = self.joint_count + WRENCH_SIZE * sensor
        return slice(first, first + WRENCH_SIZE)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints."""
        return self.names[: self.joint_count]

    @property
    def row_kinds(self) -> dict[str, tuple[str, ...]]:
        """Names of the rows of one kind: of the joints, and of the force and the moment of each sensor and the base."""
        kinds = {}
        if self.joint_names:
            kinds["joints"] = self.joint_names
        for i, joint in enumerate(self.wrench_sensors):
            kinds |= _force_and_moment(joint, self.names[self.sensor_coordinates(i)])
        if self.has_floating_base:
            kinds |= _force_and_moment("base", self.names[self.base_coordinates])
        return kinds

    @property
    def units(self) -> dict[str, str]:
        """Unit of each joint's torque or force."""
        return {joint.name: "N" if joint.kind == "prismatic" else "N·m" for joint in self.joints}

    @property
    def mass(self) -> float:
        """Mass of all bodies by their prior [kg]."""
        return float(sum(body.pi[0] for body in self.bodies))

    def support(self) -> Mask:
        """Mask of the coordinates that move each body, shape (bodies, nv)."""
        support = np.zeros((len(self.bodies), len(self.joints)), dtype=bool)
        for i, body in enumerate(self.bodies):
            support[i] = body.ratios != 0
            first = body.first_free_coordinate
            if first is not None:
                support[i, first : first + WRENCH_SIZE] = True
            if body.mount.body >= 0:
                support[i] |= support[body.mount.body]
        return support

    def reflected_inertia(self) -> Array:
        """Reflected inertia of the rotors by their prior, shape (nv, nv) [kg·m² or kg].

        It is the torque on each joint per acceleration of each: a rotor with the inertia I about its own axis, which
        turns by ratios · q, takes the torque I ratios (ratios · d²q/dt²).
        """
        inertia = np.zeros((len(self.joints), len(self.joints)))
        for body in self.bodies:
            if body.kind == "rotor":
                inertia += body.axial_inertia(body.pi) * np.outer(body.ratios, body.ratios)
        return inertia


def _force_and_moment(name: str, rows: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Rows of the force and of the moment of a sensor or the base."""
    return {f"{name}_force": rows[:3], f"{name}_moment": rows[3:]}


def _free_coordinates(names: Sequence[str], link: str) -> Iterator[UrdfJoint]:
    """Six coordinates of a link as joints: three that slide and three that turn."""
    kinds = 3 * ("prismatic",) + 3 * ("revolute",)
    axes = [*np.eye(3), *np.eye(3)]
    for name, kind, axis in zip(names, kinds, axes, strict=True):
        yield UrdfJoint(
            name=name,
            kind=kind,
            parent="",
            child=link,
            R=np.eye(3),
            p=np.zeros(3),
            axis=axis,
            damping=0.0,
            friction=0.0,
            lower=-np.inf,
            upper=np.inf,
            velocity=np.inf,
            effort=np.inf,
            mimic=None,
        )


def _free_body(link: str, mount: Frame, first: int, coordinates: int, is_base: bool = False) -> Body:
    """A body with six coordinates of its own, before links are lumped into it."""
    return Body(
        name=link,
        kind="link",
        pi=np.zeros(PI_SIZE),
        ellipsoids=(),
        mount=mount,
        axis=np.array([0.0, 0.0, 1.0]),
        prismatic=False,
        ratios=np.zeros(coordinates),
        is_base=is_base,
        first_free_coordinate=first,
    )


def check_wrench_sensors(robot: Robot, config: Config) -> None:
    """Refuse a wrench sensor at a joint that does not exist or that moves.

    Raises
    ------
    ConfigError
        If there is one.
    """
    fixed = [joint.name for joint in robot.joints.values() if joint.kind == "fixed"]
    for i, sensor in enumerate(config.wrench_sensors):
        if sensor.joint not in fixed:
            what = f"is not a fixed joint of the URDF; {suggestion(sensor.joint, fixed)}"
            raise ConfigError(f"wrench_sensors.{i}.joint: {sensor.joint}", what)


def build_model(robot: Robot, config: Config, logged: Iterable[str]) -> RobotModel:
    """The model of a robot of which some joints were logged.

    Parameters
    ----------
    robot
        From the URDF.
    config
        Joints, locked joints, bounding ellipsoids, rotors, gravity.
    logged
        Names of the joints that every log holds.

    Raises
    ------
    ConfigError
        If the configuration names a joint or link that is not there, or a rotor lacks something.
    ModelError
        If no joint of the URDF was logged.
    """
    return _Builder(robot, config, tuple(logged)).build()


@dataclass
class _Builder:
    robot: Robot
    config: Config
    logged: tuple[str, ...]
    bodies: list[Body] = field(default_factory=list)
    frames: dict[str, Frame] = field(default_factory=dict)  # of every URDF link
    members: dict[int, list[Member]] = field(default_factory=dict)
    ellipsoids: dict[int, list[Ellipsoid]] = field(default_factory=dict)
    shapes: dict[int, list[Shape]] = field(default_factory=dict)
    notices: list[Notice] = field(default_factory=list)

    def build(self) -> RobotModel:
        is_floating = self.config.base.kind == "floating"
        self.joints = self._moving_joints()
        self.index = {joint.name: i for i, joint in enumerate(self.joints)}
        self._check_names()
        check_wrench_sensors(self.robot, self.config)
        self.sensors: dict[str, int] = {}  # fixed joint with a wrench sensor → its first coordinate
        for sensor in self.config.wrench_sensors:
            self.sensors[sensor.joint] = len(self.joints)
            names = [f"{sensor.joint}_{part}" for part in _WRENCH]
            self.joints = (*self.joints, *_free_coordinates(names, self.robot.joints[sensor.joint].child))
        if is_floating:
            first = len(self.joints)
            self.joints = (*self.joints, *_free_coordinates(BASE_COORDINATES, self.robot.root))
            at_origin = Frame(-1, np.eye(3), np.zeros(3))
            self.bodies.append(_free_body(self.robot.root, at_origin, first, len(self.joints), is_base=True))
        self._place(self.robot.root, Frame(len(self.bodies) - 1, np.eye(3), np.zeros(3)))
        for joint in self.robot.joints.values():
            self._attach(joint)
        links = len(self.bodies)
        for name, rotor in self.config.rotors.items():
            self._add_rotor(name, rotor)
        lumped = tuple(self._with_lumped_links(i, body) for i, body in enumerate(self.bodies))
        bodies = self._with_known_coms(lumped)
        for body in bodies[:links]:
            if not body.pi[0] > 0:
                message = "no mass in the URDF, so it has no prior"
                meaningless = "its parameters that the data do not determine are meaningless"
                advice = f"add an inertial to the link; otherwise {meaningless}"
                self.notices.append(Notice("massless_link", "warning", body.name, message, advice))
        self._check_base()
        gravity = np.zeros(3) if is_floating else np.asarray(self.config.gravity)
        return RobotModel(
            robot=self.robot,
            joints=self.joints,
            bodies=bodies,
            gravity=gravity,
            notices=tuple(self.notices),
            frames=self.frames,
            wrench_sensors={sensor.joint: self._sensor_to_body(sensor) for sensor in self.config.wrench_sensors},
        )

    def _sensor_to_body(self, sensor: WrenchSensor) -> Array:
        """Matrix from a sensor's reading to the wrench on the body that it carries, shape (6, 6)."""
        frame = self.frames[sensor.frame or self.robot.joints[sensor.joint].child]
        to_body = np.zeros((WRENCH_SIZE, WRENCH_SIZE))
        to_body[:3, :3] = frame.R
        to_body[3:, 3:] = frame.R
        to_body[3:, :3] = skew(frame.p) @ frame.R
        return sensor.sign * to_body

    def _check_base(self) -> None:
        """Refuse a base, a sensor or a contact on a link on which it cannot be."""
        base = self.config.base
        on_base = {"base.link": base.link, "base.imu.link": base.imu.link}
        if base.pose is not None:
            on_base["base.pose.link"] = base.pose.link
        for key, link in on_base.items():
            if link is None:
                continue
            if link not in self.frames:
                raise ConfigError(f"{key}: {link}", f"is not a link of the URDF; {suggestion(link, self.frames)}")
            if self.frames[link].body != self.frames[self.robot.root].body:
                raise ConfigError(
                    f"{key}: {link}", f"moves against the root link {self.robot.root}; name a link that is fixed to it"
                )
        for i, sensor in enumerate(self.config.wrench_sensors):
            if sensor.frame is None:
                continue
            key = f"wrench_sensors.{i}.frame: {sensor.frame}"
            if sensor.frame not in self.frames:
                raise ConfigError(key, f"is not a link of the URDF; {suggestion(sensor.frame, self.frames)}")
            child = self.robot.joints[sensor.joint].child
            if self.frames[sensor.frame].body != self.frames[child].body:
                raise ConfigError(key, f"moves against link {child}; name a link that is fixed to it")
        for i, contact in enumerate(self.config.contacts):
            key = f"contacts.{i}.link: {contact.link}"
            if contact.link not in self.frames:
                raise ConfigError(key, f"is not a link of the URDF; {suggestion(contact.link, self.frames)}")
            if self.frames[contact.link].body < 0:
                what = "is moved by no joint; remove the contact, or set base: {kind: floating} if the base moves"
                raise ConfigError(key, what)
            if base.kind == "fixed" and contact.radius and not any(self.config.gravity):
                what = "has no lowest point without gravity; set gravity, or give the point of contact"
                raise ConfigError(f"contacts.{i}.radius: {contact.radius:g}", what)

    def _moving_joints(self) -> tuple[UrdfJoint, ...]:
        actuated = {j.name: j for j in self.robot.joints.values() if j.kind != "fixed" and j.mimic is None}
        if self.config.joints is not None:
            for name in self.config.joints:
                if name not in actuated:
                    raise ConfigError(
                        f"joints: {name}", f"is not an actuated joint of the URDF; {suggestion(name, actuated)}"
                    )
                if name not in self.logged:
                    raise ConfigError(
                        f"joints: {name}", f"is not in every log; the joints in every log: {join_names(self.logged)}"
                    )
            chosen = list(dict.fromkeys(self.config.joints))
        else:
            chosen = [name for name in actuated if name in self.logged]
        if not chosen:
            if not actuated:
                raise ModelError(self.robot.path, "has no actuated joint; nothing can be identified")
            own, logged = join_names(actuated), join_names(self.logged)
            raise ModelError(
                self.robot.path, f"none of its actuated joints is in the logs; it has {own}, the logs have {logged}"
            )
        strangers = [name for name in self.logged if name not in self.robot.joints]
        if strangers:
            message = f"joints in the log but not in the URDF are ignored: {join_names(strangers)}"
            advice = "if these joints belong to this robot, correct their names"
            self.notices.append(Notice("unknown_joints", "note", None, message, advice))
        locked = [name for name in actuated if name not in chosen]
        if locked:
            values = ", ".join(f"{printable(name)} at {self.config.locked_joints.get(name, 0.0):g}" for name in locked)
            advice = "if their positions were different, set them under locked_joints"
            self.notices.append(
                Notice("joints_held_still", "note", None, f"joints assumed to stand still: {values}", advice)
            )
        return tuple(actuated[name] for name in chosen)

    def _check_names(self) -> None:
        actuated = [j.name for j in self.robot.joints.values() if j.kind != "fixed" and j.mimic is None]
        of_joints: dict[str, Iterable[str]] = {"locked_joints": self.config.locked_joints}
        if isinstance(self.config.friction, dict):
            of_joints["friction"] = self.config.friction
        if isinstance(self.config.armature, dict):
            of_joints["armature"] = self.config.armature
        controller = self.config.controller
        if controller is not None and isinstance(controller.kp, dict):
            of_joints["controller.kp"] = controller.kp
        if controller is not None and isinstance(controller.kd, dict):
            of_joints["controller.kd"] = controller.kd
        of_links: dict[str, Iterable[str]] = {
            "bounding_ellipsoids": self.config.bounding_ellipsoids,
            "bounding_shapes": self.config.bounding_shapes,
        }
        for key, names in of_joints.items():
            for name in names:
                if name not in actuated:
                    hint = suggestion(name, actuated)
                    raise ConfigError(f"{key}: {name}", f"is not an actuated joint of the URDF; {hint}")
        for key, names in of_links.items():
            for name in names:
                if name not in self.robot.links:
                    hint = suggestion(name, self.robot.links)
                    raise ConfigError(f"{key}: {name}", f"is not a link of the URDF; {hint}")
        for name in self.config.locked_joints:
            if name in self.index:
                raise ConfigError(
                    f"locked_joints: {name}", "is also listed as a moving joint; remove it from one of the two"
                )

    def _motion(self, joint: UrdfJoint) -> tuple[Array, float]:
        """Ratios (nv,) and offset of a joint's position; no ratios where it is locked."""
        ratios = np.zeros(len(self.joints))
        scale = 1.0
        offset = 0.0
        visited = {joint.name}
        while joint.mimic is not None:
            offset += scale * joint.mimic.offset
            scale *= joint.mimic.multiplier
            leader = self.robot.joints.get(joint.mimic.joint)
            if leader is None or leader.name in visited:
                where = f"{self.robot.path}: joint {joint.name}"
                what = f"mimics {joint.mimic.joint}, which does not exist or itself mimics this joint"
                raise ModelError(where, what)
            visited.add(leader.name)
            joint = leader
        if joint.name in self.index:
            ratios[self.index[joint.name]] = scale
            return ratios, offset
        return ratios, offset + scale * self.config.locked_joints.get(joint.name, 0.0)

    def _attach(self, joint: UrdfJoint) -> None:
        mount = self.frames[joint.parent].compose(joint.R, joint.p)
        prismatic = joint.kind == "prismatic"
        if joint.kind != "fixed":
            ratios, offset = self._motion(joint)
            if ratios.any():
                self.bodies.append(
                    Body(joint.child, "link", np.zeros(PI_SIZE), (), mount, joint.axis, prismatic, ratios, offset)
                )
                mount = Frame(len(self.bodies) - 1, np.eye(3), np.zeros(3))
            elif prismatic:
                mount = mount.compose(np.eye(3), joint.axis * offset)
            else:
                mount = mount.compose(rotation_about(joint.axis, offset), np.zeros(3))
        elif joint.name in self.sensors:
            self.bodies.append(_free_body(joint.child, mount, self.sensors[joint.name], len(self.joints)))
            mount = Frame(len(self.bodies) - 1, np.eye(3), np.zeros(3))
        self._place(joint.child, mount)

    def _place(self, link: str, frame: Frame) -> None:
        self.frames[link] = frame
        if link not in self.config.rotors:  # a rotor is no part of the body that carries it
            self._lump(link, self.robot.links[link], frame, self.config.bounding_ellipsoids.get(link, ()))

    def _lump(self, link: str, pi: Array | None, frame: Frame, bounds: tuple[BoundingEllipsoid, ...]) -> None:
        if pi is not None:
            self.members.setdefault(frame.body, []).append(Member(link, pi, frame))
        for bounding in bounds:
            self.ellipsoids.setdefault(frame.body, []).append(frame.transform(bounding.to_ellipsoid()))
        for shape in self.config.bounding_shapes.get(link, ()):
            solid = bounding_shape(shape, self.robot, link).transformed(frame.R, frame.p)
            self.shapes.setdefault(frame.body, []).append(solid)

    def _rotor_motion(self, name: str, rotor: RotorConfig) -> tuple[Array, float]:
        """Ratios (nv,) and offset of a rotor's angle; no ratios where all that drives it is locked."""
        ratios = np.zeros(len(self.joints))
        offset = 0.0
        not_fixed = {j.name: j for j in self.robot.joints.values() if j.kind != "fixed"}
        for joint, gear_ratio in rotor.ratios.items():
            if joint not in not_fixed:
                raise ConfigError(f"rotors.{name}", f"{joint} is not a moving joint; {suggestion(joint, not_fixed)}")
            joint_ratios, joint_offset = self._motion(not_fixed[joint])
            ratios += gear_ratio * joint_ratios
            offset += gear_ratio * joint_offset
        return ratios, offset

    def _add_rotor(self, name: str, rotor: RotorConfig) -> None:
        if not name.isprintable():
            raise ConfigError(f"rotors.{name}", "is a name with unprintable characters; choose another")
        ratios, offset = self._rotor_motion(name, rotor)
        mount = self._rotor_mount(name, rotor)
        axis = np.asarray(rotor.axis) if rotor.axis is not None else self._driven_axis(rotor, mount)
        axis = axis / np.linalg.norm(axis)
        if rotor.inertia is not None:
            rotor = self._filled_in(name, rotor, axis)
        pi = self._rotor_prior(name, rotor)
        bounds = self.config.bounding_ellipsoids.get(name, ())
        if rotor.bounding_ellipsoid is not None:
            bounds = (rotor.bounding_ellipsoid,)
        if not ratios.any():  # dead weight
            locked = mount.compose(rotation_about(axis, offset), np.zeros(3))
            self._lump(name, pi, locked, bounds)
            return
        shapes = self.config.bounding_shapes.get(name, ())
        own = Member(name, pi, Frame(len(self.bodies), np.eye(3), np.zeros(3)))
        rotor_body = Body(
            name=name,
            kind="rotor",
            pi=pi,
            ellipsoids=tuple(bound.to_ellipsoid() for bound in bounds),
            mount=mount,
            axis=axis,
            prismatic=False,
            ratios=ratios,
            offset=offset,
            members=(own,) if name in self.robot.links else (),
            shapes=tuple(bounding_shape(shape, self.robot, name) for shape in shapes),
        )
        self.bodies.append(rotor_body)

    def _rotor_mount(self, name: str, rotor: RotorConfig) -> Frame:
        """Frame of a rotor: that of its URDF link, the configured one, or that of the joint it drives."""
        key = f"rotors.{name}"
        links = self.robot.links
        if name in links:
            if name in {body.name for body in self.bodies}:
                raise ConfigError(key, "has the name of a moving link; rename the rotor")
            if name in {joint.parent for joint in self.robot.joints.values()}:
                raise ConfigError(key, "is a URDF link that carries other links; a rotor cannot carry links")
            if rotor.parent is not None or rotor.origin is not None:
                raise ConfigError(
                    key, "has the name of a URDF link, which defines its placement; leave out parent and origin"
                )
            return self.frames[name]
        if rotor.parent is not None and rotor.parent not in links:
            raise ConfigError(f"{key}.parent", f"{rotor.parent} is not a link; {suggestion(rotor.parent, links)}")
        driven = self._driven_joint(rotor)
        stator = self.frames[rotor.parent or driven.parent]
        if rotor.origin is not None:
            return stator.compose(rotation_from_rpy(rotor.origin.rpy), np.asarray(rotor.origin.xyz))
        if rotor.parent in (None, driven.parent):
            return stator.compose(driven.R, driven.p)
        raise ConfigError(f"{key}.origin", "is missing; give the rotor's placement in its parent")

    def _filled_in(self, name: str, rotor: RotorConfig, axis: Array) -> RotorConfig:
        """A rotor of which only the inertia about its axis is given, with all else, and a notice of what was chosen."""
        filled = rotor.with_disc(axis, self.config.has_bound(name))
        joint = self._driven_joint(rotor)
        parts = []
        if name not in self.robot.links and rotor.origin is None:
            parts.append(f"its place on {printable(joint.parent)}, at the origin of {printable(joint.name)}")
        if filled.inertial is not None:
            parts.append(f"mass {filled.inertial.mass:.3g} kg")
        if rotor.bounding_ellipsoid is None and filled.bounding_ellipsoid is not None:
            radius = filled.bounding_ellipsoid.semi_axes[0]
            parts.append(f"bounding ellipsoid, a sphere of radius {radius:.3g} m")
        message = f"filled in, as for a typical rotor with this inertia: {'; '.join(parts)}"
        advice = "if you know better, give origin, inertial or bounding_ellipsoid"
        self.notices.append(Notice("rotor_filled_in", "note", name, message, advice))
        return filled

    def _rotor_prior(self, name: str, rotor: RotorConfig) -> Array:
        if rotor.inertial is not None:
            return from_mass_com_inertia(
                rotor.inertial.mass, rotor.inertial.com, symmetric_matrix(rotor.inertial.inertia)
            )
        pi = self.robot.links.get(name)
        if pi is None:
            hint = "is missing; give inertia about the axis, or inertial, or name the rotor after its URDF link"
            raise ConfigError(f"rotors.{name}.inertial", hint)
        return pi

    def _driven_joint(self, rotor: RotorConfig) -> UrdfJoint:
        return self.robot.joints[next(iter(rotor.ratios))]

    def _driven_axis(self, rotor: RotorConfig, mount: Frame) -> Array:
        """The driven joint's axis in the rotor's frame, all joints at zero."""
        joint = self._driven_joint(rotor)
        return self._rotation(mount).T @ self._rotation(self.frames[joint.parent]) @ joint.R @ joint.axis

    def _rotation(self, frame: Frame) -> Array:
        """Orientation in the root link, moving joints at zero."""
        return frame.R if frame.body < 0 else self._rotation(self.bodies[frame.body].mount) @ frame.R

    def _with_known_coms(self, bodies: tuple[Body, ...]) -> tuple[Body, ...]:
        names = [body.name for body in bodies]
        for name in self.config.known_com:
            if name not in names:
                hint = f"is not a body of the model (a body includes the links fixed to it); {suggestion(name, names)}"
                raise ConfigError(f"known_com: {name}", hint)
        return tuple(replace(body, com=self.config.known_com.get(body.name)) for body in bodies)

    def _with_lumped_links(self, index: int, body: Body) -> Body:
        if body.kind == "rotor":
            return body
        members = tuple(self.members.get(index, ()))
        if not members or members[0].link != body.name:
            own = Member(body.name, np.zeros(PI_SIZE), Frame(index, np.eye(3), np.zeros(3)))
            members = (own, *members)
        pi = np.sum([member.pi_in_body for member in members], axis=0)
        return replace(
            body,
            pi=pi,
            members=members,
            ellipsoids=tuple(self.ellipsoids.get(index, ())),
            shapes=tuple(self.shapes.get(index, ())),
        )
