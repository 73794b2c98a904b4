"""Description of a robot on the ground: bodies, joints, feet and sensors, and the URDF that a user would have.

Letters: com centre of mass [m]; inertia about it [kg m^2]; gear: turns of the rotor per turn of the joint; q positions
of the joints, shape (n,).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Body:
    """Inertia of a body, and the half axes of an ellipsoid at ``center`` that bounds it [m]."""

    mass: float
    com: Array
    inertia: Array
    center: Array
    semi_axes: Array

    @classmethod
    def ellipsoid(cls, mass: float, center: Array, semi_axes: Array) -> Body:
        """A body of constant density in the inner 80 % of its bounding ellipsoid."""
        squares = np.square(0.8 * semi_axes)
        inertia = np.diag(mass / 5 * (squares.sum() - squares))
        return cls(mass, center, inertia, center, semi_axes)

    @classmethod
    def rotor(cls, axis: Array, mass: float, axial: float, transverse: float) -> Body:
        """A balanced rotor with moments of inertia about its axis and across it."""
        along = np.outer(axis, axis)
        inertia = axial * along + transverse * (np.eye(3) - along)
        return cls(mass, np.zeros(3), inertia, np.zeros(3), np.full(3, 0.05))

    def perturbed(self, spread: float, rng: np.random.Generator) -> Body:
        """A body inside the same ellipsoid with another mass, centre of mass and inertia."""
        sign = rng.choice([-1.0, 1.0])
        mass = self.mass * (1 + sign * rng.uniform(spread / 3, spread))
        com = self.com + 0.15 * spread * self.semi_axes * rng.uniform(-1, 1, 3)
        scale = np.diag(np.sqrt(1 + spread * rng.uniform(-0.5, 0.0, 3)))
        return replace(self, mass=mass, com=com, inertia=scale @ self.inertia @ scale * mass / self.mass)


@dataclass(frozen=True)
class Mount:
    """A joint: the link that carries it, its position there at zero [m], and its axis; None: it is fixed."""

    parent: str
    child: str
    position: Array
    axis: Array | None = None


@dataclass(frozen=True)
class Softness:
    """Stiffness [N/m] and damping [N s/m] of a ball on the ground, across the ground and along it."""

    stiffness: float = 3e4
    damping: float = 120.0
    shear_stiffness: float = 2e4
    shear_damping: float = 80.0


@dataclass(frozen=True)
class Foot:
    """A foot, which touches the ground with soft balls.

    Attributes
    ----------
    name
        Of the contact, and of the URDF's link at its place.
    link
        Body that it belongs to.
    position
        Its place in the body [m].
    corners
        Centres of the balls from there, shape (k, 3) [m]. With one ball the ground exerts a force, with more a moment
        too.
    radius
        Of the balls [m].
    softness
        Of each ball.
    """

    name: str
    link: str
    position: Array
    corners: Array
    radius: float
    softness: Softness

    @property
    def is_sole(self) -> bool:
        """True if the ground exerts a moment on it."""
        return len(self.corners) > 1


@dataclass(frozen=True)
class Imu:
    """Place of the IMU in the base [m], and its angle about z [rad]."""

    position: Array
    turn: float


@dataclass(frozen=True)
class Hook:
    """Where a rope is tied to a robot: a link, and a place in it [m]."""

    link: str
    position: Array


@dataclass(frozen=True)
class Robot:
    """A robot on a floating base.

    Attributes
    ----------
    name
        Of the URDF.
    links
        Bodies by link; the first is the base.
    mounts
        All joints by name, parents before children.
    rotors
        By joint that moves.
    gear
        Of all rotors.
    feet, imu
        What touches the ground, and the IMU on the base.
    viscous, coulomb
        Friction of every joint that moves, shape (n,) [N m s/rad, N m].
    wrench_sensors
        Reading without load of the sensor in a fixed joint, shape (6,) [N, N m].
    fallen_height
        Height of the base below which the robot has fallen [m].
    hook
        Of the rope on which it hangs; None: a frame holds its base in the air.
    """

    name: str
    links: Mapping[str, Body]
    mounts: Mapping[str, Mount]
    rotors: Mapping[str, Body]
    gear: float
    feet: tuple[Foot, ...]
    imu: Imu
    viscous: Array
    coulomb: Array
    wrench_sensors: Mapping[str, Array]
    fallen_height: float
    hook: Hook | None = None

    @property
    def base(self) -> str:
        """The link that floats."""
        return next(iter(self.links))

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that move."""
        return tuple(self.rotors)

    @property
    def mass(self) -> float:
        """Mass of the whole robot [kg]."""
        return sum(body.mass for body in (*self.links.values(), *self.rotors.values()))

    @property
    def center_of_mass(self) -> Array:
        """Centre of mass of the whole robot in the base, all joints at zero [m]."""
        return self.center_of_mass_at(np.zeros(len(self.joints)))

    def center_of_mass_at(self, q: Array) -> Array:
        """Centre of mass of the whole robot in the base [m]."""
        poses = self.poses(q)
        moment = np.zeros(3)
        for joint, rotor in self.rotors.items():
            moment += rotor.mass * poses[self.mounts[joint].child][1]
        for name, body in self.links.items():
            R, p = poses[name]
            moment += body.mass * (p + R @ body.com)
        return moment / self.mass

    def poses(self, q: Array) -> dict[str, tuple[Array, Array]]:
        """Rotation to the base, shape (3, 3), and position in it, shape (3,) [m], of every link."""
        poses = {self.base: (np.eye(3), np.zeros(3))}
        angles = dict(zip(self.joints, q, strict=True))
        for joint, mount in self.mounts.items():
            R, p = poses[mount.parent]
            turned = R if mount.axis is None else R @ rotation_about(mount.axis, angles[joint])
            poses[mount.child] = (turned, p + R @ mount.position)
        return poses


def rotation_about(axis: Array, angle: float) -> Array:
    """Rotation matrix by Rodrigues' formula."""
    K = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def prior_robot(truth: Robot, seed: int) -> Robot:
    """The robot as its maker describes it: masses 10 to 30 % off, centres of mass and inertias too."""
    rng = np.random.default_rng([seed, 2])
    links = {name: body.perturbed(0.3, rng) for name, body in truth.links.items()}
    return replace(truth, links=links)


def urdf_text(robot: Robot) -> str:
    """URDF of the links; the rotors are in the configuration."""
    parts = ['<?xml version="1.0"?>', f'<robot name="{robot.name}">']
    for name, body in robot.links.items():
        parts.append(_link_text(name, body))
    parts.append('<link name="imu_link"/>')
    parts.append(_fixed_text("imu_joint", robot.base, "imu_link", robot.imu.position, robot.imu.turn))
    for name, mount in robot.mounts.items():
        if mount.axis is None:
            parts.append(_fixed_text(name, mount.parent, mount.child, mount.position))
            continue
        parts.append(
            f'<joint name="{name}" type="revolute"><origin xyz="{_text(mount.position)}"/>'
            f'<parent link="{mount.parent}"/><child link="{mount.child}"/><axis xyz="{_text(mount.axis)}"/>'
            '<limit lower="-3" upper="3" effort="40" velocity="25"/></joint>'
        )
    for foot in robot.feet:
        parts.append(f'<link name="{foot.name}"/>')
        parts.append(_fixed_text(f"{foot.name}_joint", foot.link, foot.name, foot.position))
    return "\n".join([*parts, "</robot>", ""])


def _link_text(name: str, body: Body) -> str:
    inertia = body.inertia
    values = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    moments = " ".join(f'{key}="{inertia[i]:.12g}"' for key, i in values.items())
    return (
        f'<link name="{name}"><inertial><origin xyz="{_text(body.com)}"/><mass value="{body.mass:.12g}"/>'
        f"<inertia {moments}/></inertial></link>"
    )


def _fixed_text(name: str, parent: str, child: str, position: Array, turn: float = 0.0) -> str:
    return (
        f'<joint name="{name}" type="fixed"><origin xyz="{_text(position)}" rpy="0 0 {turn:g}"/>'
        f'<parent link="{parent}"/><child link="{child}"/></joint>'
    )


def _text(vector: Array) -> str:
    return " ".join(f"{x:.12g}" for x in vector)
