"""A quadruped with twelve joints: its true bodies, and the URDF and configuration that a user would have.

Letters: com centre of mass [m]; inertia about it [kg m^2]; gear: turns of the rotor per turn of the joint.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEGS = ("FL", "FR", "RL", "RR")
PARTS = ("hip", "thigh", "calf")
JOINTS = tuple(f"{leg}_{part}_joint" for leg in LEGS for part in PARTS)
FEET = tuple(f"{leg}_foot" for leg in LEGS)
FOOT_RADIUS = 0.022  # m
GEAR = 8.0
IMU_POSITION = np.array([0.06, -0.025, 0.04])  # m
IMU_TURN = 0.3  # rad, about z

_HIP = np.array([0.19, 0.05, 0.0])  # m, of the left front leg
_THIGH_OFFSET = 0.08  # m
_THIGH = _CALF = 0.21  # m


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


@dataclass(frozen=True)
class Quadruped:
    """Bodies by link, rotors by joint, and friction of every joint, shape (12,) [N m s/rad, N m]."""

    links: Mapping[str, Body]
    rotors: Mapping[str, Body]
    viscous: Array
    coulomb: Array

    @property
    def mass(self) -> float:
        """Mass of the whole robot [kg]."""
        return sum(body.mass for body in (*self.links.values(), *self.rotors.values()))

    @property
    def center_of_mass(self) -> Array:
        """Centre of mass of the whole robot in the trunk, all joints at zero [m]."""
        places = {"trunk": np.zeros(3)}
        moment = np.zeros(3)
        for joint, mount in mounts().items():
            places[mount.child] = places[mount.parent] + mount.position
            moment += self.rotors[joint].mass * places[mount.child]
        for name, body in self.links.items():
            moment += body.mass * (places[name] + body.com)
        return moment / self.mass


@dataclass(frozen=True)
class Mount:
    """A joint: the link that carries it, its position there at zero [m], and its axis."""

    parent: str
    child: str
    position: Array
    axis: Array


def mounts() -> dict[str, Mount]:
    """All joints by name."""
    found = {}
    for leg in LEGS:
        forward, left = (1.0 if leg[0] == "F" else -1.0), (1.0 if leg[1] == "L" else -1.0)
        found[f"{leg}_hip_joint"] = Mount("trunk", f"{leg}_hip", _HIP * [forward, left, 1.0], np.array([1.0, 0.0, 0.0]))
        offset = np.array([0.0, left * _THIGH_OFFSET, 0.0])
        found[f"{leg}_thigh_joint"] = Mount(f"{leg}_hip", f"{leg}_thigh", offset, np.array([0.0, 1.0, 0.0]))
        below = np.array([0.0, 0.0, -_THIGH])
        found[f"{leg}_calf_joint"] = Mount(f"{leg}_thigh", f"{leg}_calf", below, np.array([0.0, 1.0, 0.0]))
    return found


def foot_position() -> Array:
    """Centre of a foot's ball in its calf [m]."""
    return np.array([0.0, 0.0, -_CALF])


def true_quadruped(seed: int) -> Quadruped:
    """A robot with bodies and friction of its own."""
    rng = np.random.default_rng([seed, 1])
    links = {"trunk": Body.ellipsoid(7.5, np.array([0.01, 0.0, 0.005]), np.array([0.26, 0.13, 0.08]))}
    for leg in LEGS:
        left = 1.0 if leg[1] == "L" else -1.0
        hip, thigh = np.array([0.0, 0.01 * left, 0.0]), np.array([0.0, 0.0, -0.07])
        links[f"{leg}_hip"] = Body.ellipsoid(0.6, hip, np.array([0.06, 0.06, 0.06]))
        links[f"{leg}_thigh"] = Body.ellipsoid(1.0, thigh, np.array([0.05, 0.05, 0.15]))
        links[f"{leg}_calf"] = Body.ellipsoid(0.22, np.array([0.0, 0.0, -0.1]), np.array([0.04, 0.04, 0.14]))
    links = {name: _perturbed(body, 0.1, rng) for name, body in links.items()}
    axes = {joint: mount.axis for joint, mount in mounts().items()}
    rotors = {joint: rotor(axis) for joint, axis in axes.items()}
    return Quadruped(links, rotors, rng.uniform(0.02, 0.08, 12), rng.uniform(0.15, 0.5, 12))


def prior_quadruped(truth: Quadruped, seed: int) -> Quadruped:
    """The robot as its maker describes it: masses 10 to 30 % off, centres of mass and inertias too."""
    rng = np.random.default_rng([seed, 2])
    links = {name: _perturbed(body, 0.3, rng) for name, body in truth.links.items()}
    return replace(truth, links=links)


def rotor(axis: Array) -> Body:
    """A motor's rotor, which is balanced."""
    along = np.outer(axis, axis)
    inertia = 8e-5 * along + 5e-5 * (np.eye(3) - along)
    return Body(0.09, np.zeros(3), inertia, np.zeros(3), np.full(3, 0.05))


def _perturbed(body: Body, spread: float, rng: np.random.Generator) -> Body:
    """A body inside the same ellipsoid with another mass, centre of mass and inertia."""
    sign = rng.choice([-1.0, 1.0])
    mass = body.mass * (1 + sign * rng.uniform(spread / 3, spread))
    com = body.com + 0.15 * spread * body.semi_axes * rng.uniform(-1, 1, 3)
    scale = np.diag(np.sqrt(1 + spread * rng.uniform(-0.5, 0.0, 3)))
    return replace(body, mass=mass, com=com, inertia=scale @ body.inertia @ scale * mass / body.mass)


def urdf_text(robot: Quadruped) -> str:
    """URDF of the links; the rotors are in the configuration."""
    parts = ['<?xml version="1.0"?>', '<robot name="quadruped">']
    for name, body in robot.links.items():
        parts.append(_link_text(name, body))
    parts.append('<link name="imu_link"/>')
    parts.append(_fixed_text("imu_joint", "trunk", "imu_link", IMU_POSITION, IMU_TURN))
    for name, mount in mounts().items():
        parts.append(
            f'<joint name="{name}" type="revolute"><origin xyz="{_text(mount.position)}"/>'
            f'<parent link="{mount.parent}"/><child link="{mount.child}"/><axis xyz="{_text(mount.axis)}"/>'
            '<limit lower="-3" upper="3" effort="40" velocity="25"/></joint>'
        )
    for leg, foot in zip(LEGS, FEET, strict=True):
        parts.append(f'<link name="{foot}"/>')
        parts.append(_fixed_text(f"{foot}_joint", f"{leg}_calf", foot, foot_position(), 0.0))
    return "\n".join([*parts, "</robot>", ""])


def _link_text(name: str, body: Body) -> str:
    inertia = body.inertia
    values = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    moments = " ".join(f'{key}="{inertia[i]:.12g}"' for key, i in values.items())
    return (
        f'<link name="{name}"><inertial><origin xyz="{_text(body.com)}"/><mass value="{body.mass:.12g}"/>'
        f"<inertia {moments}/></inertial></link>"
    )


def _fixed_text(name: str, parent: str, child: str, position: Array, turn: float) -> str:
    return (
        f'<joint name="{name}" type="fixed"><origin xyz="{_text(position)}" rpy="0 0 {turn:g}"/>'
        f'<parent link="{parent}"/><child link="{child}"/></joint>'
    )


def _text(vector: Array) -> str:
    return " ".join(f"{x:.12g}" for x in vector)
