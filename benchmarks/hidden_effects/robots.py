"""Robots in which effects are hidden: their tables, their URDF text, and their true bodies and friction.

Three robots: a planar arm in a vertical plane, a leg that hangs from its body, and an arm of six joints and 25 kg. The
URDF has the designer's inertias. The true ones differ from them by 10 to 20 %, are drawn anew for every seed, and are
physically realizable. This folder uses nothing of idtool.

Letters: inertia about the centre of mass [kg m^2]; gear: turns of the rotor per turn of the joint.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

_STRETCH = 0.07  # of lengths and of the root of the mass: masses differ by some 15 %, inertias by more
_COM_SHIFT = 0.15  # of a link's radius of gyration
_ROTOR_ERROR = 0.05  # of a rotor's mass and inertia
_UPPER_TRIANGLE = ("xx", "xy", "xz", "yy", "yz", "zz")


@dataclass(frozen=True)
class Body:
    """Mass [kg], centre of mass (3,) [m] in the link's frame, and inertia about it (3, 3), axes as the link's."""

    mass: float
    com: Array
    inertia: Array


@dataclass(frozen=True)
class Joint:
    """A joint with its motor.

    Attributes
    ----------
    xyz, rpy, axis
        Pose in the parent's frame [m, rad], and axis in the joint's own.
    lower, upper, velocity, effort
        Limits [rad, rad, rad/s, N m].
    viscous, coulomb
        Typical friction [N m s/rad, N m].
    gear
        Turns of the rotor per turn of the joint.
    reflected_inertia
        The rotor's inertia at the joint [kg m^2].
    rotor_mass
        [kg].
    """

    name: str
    parent: str
    child: str
    xyz: tuple[float, float, float]
    axis: tuple[float, float, float]
    lower: float
    upper: float
    velocity: float
    effort: float
    viscous: float
    coulomb: float
    gear: float
    reflected_inertia: float
    rotor_mass: float
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Robot:
    """A serial robot as its designer describes it.

    Attributes
    ----------
    joints
        From the base to the tip.
    links
        The designer's bodies.
    encoder_bits
        Resolution of the encoders per turn of the joint.
    min_frequency, max_frequency
        Range of the frequencies of its motions [Hz].
    """

    name: str
    joints: tuple[Joint, ...]
    links: Mapping[str, Body]
    encoder_bits: int
    min_frequency: float
    max_frequency: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.joints)

    def index(self, joint: str) -> int:
        """Index of a joint."""
        return self.names.index(joint)


@dataclass(frozen=True)
class Truth:
    """True bodies of links by link and of rotors by joint, and friction of every joint, shape (n,)."""

    links: Mapping[str, Body]
    rotors: Mapping[str, Body]
    viscous: Array
    coulomb: Array


def _box(mass: float, com: tuple[float, ...], sides: tuple[float, ...], rpy: tuple[float, ...]) -> Body:
    """A homogeneous box with sides [m], rotated by roll, pitch and yaw."""
    squares = np.square(sides)
    R = Rotation.from_euler("xyz", rpy).as_matrix()
    inertia = R @ np.diag(mass / 12 * (squares.sum() - squares)) @ R.T
    return Body(mass, np.array(com, float), (inertia + inertia.T) / 2)


def rotor(joint: Joint) -> Body:
    """The rotor of a joint's motor as in its data sheet, with its centre of mass on its axis."""
    axis = np.array(joint.axis, float)
    axial_inertia = joint.reflected_inertia / joint.gear**2
    along = np.outer(axis, axis)
    return Body(joint.rotor_mass, np.zeros(3), axial_inertia * along + 0.7 * axial_inertia * (np.eye(3) - along))


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

PLANAR2 = Robot(
    "planar2",
    (
        Joint("shoulder", "base", "upper", (0, 0, 0.6), Y, -2.4, 2.4, 7, 90, 0.9, 1.8, 15, 0.15, 0.6),
        Joint("elbow", "upper", "lower", (0, 0.03, -0.45), Y, -2.5, 2.5, 9, 35, 0.25, 0.55, 12, 0.04, 0.35),
    ),
    {
        "upper": _box(3.8, (0.015, 0.02, -0.21), (0.09, 0.07, 0.48), (0.05, -0.1, 0.1)),
        "lower": _box(2.1, (-0.012, 0.01, -0.19), (0.07, 0.06, 0.42), (-0.1, 0.07, 0.2)),
    },
    encoder_bits=18,
    min_frequency=0.12,
    max_frequency=2.0,
)

LEG3 = Robot(
    "leg3",
    (
        Joint("abad", "trunk", "hip_link", (0.22, 0.07, 0), X, -0.95, 0.95, 16, 34, 0.09, 0.24, 9, 0.011, 0.32),
        Joint("hip", "hip_link", "thigh", (0.02, 0.085, 0), Y, -1.3, 2.4, 16, 34, 0.1, 0.26, 9, 0.011, 0.32),
        Joint("knee", "thigh", "shank", (0, 0.01, -0.24), Y, -2.6, -0.5, 14, 42, 0.08, 0.16, 11, 0.016, 0.3),
    ),
    {
        "hip_link": _box(1.3, (-0.01, 0.03, 0.004), (0.12, 0.1, 0.09), (0.2, 0.1, -0.15)),
        "thigh": _box(1.9, (-0.008, 0.015, -0.06), (0.08, 0.07, 0.27), (0.06, -0.12, 0.05)),
        "shank": _box(0.42, (0.012, -0.002, -0.12), (0.035, 0.03, 0.27), (-0.05, 0.1, 0.1)),
    },
    encoder_bits=18,
    min_frequency=0.3,
    max_frequency=2.5,
)

ARM6 = Robot(
    "arm6",
    (
        Joint("j1", "base", "column", (0, 0, 0.12), Z, -3.0, 3.0, 2.8, 260, 7.0, 6.0, 101, 2.2, 1.0),
        Joint("j2", "column", "upper_arm", (0, 0.16, 0.06), Y, -2.7, 0.6, 2.8, 300, 8.0, 10.0, 101, 2.2, 1.0),
        Joint("j3", "upper_arm", "forearm", (0, -0.12, 0.58), Y, -2.6, 2.6, 3.1, 160, 4.0, 6.0, 101, 1.1, 0.7),
        Joint("j4", "forearm", "wrist1", (0, 0, 0.52), Y, -2.9, 2.9, 4.0, 55, 0.9, 0.7, 80, 0.2, 0.3),
        Joint("j5", "wrist1", "wrist2", (0, 0.11, 0), Z, -2.9, 2.9, 4.0, 55, 0.8, 0.5, 80, 0.16, 0.3, (0, 0.15, 0)),
        Joint("j6", "wrist2", "flange", (0, 0, 0.1), Y, -3.0, 3.0, 4.5, 40, 0.6, 0.4, 80, 0.12, 0.25),
    ),
    {
        "column": _box(5.2, (0.01, 0.03, 0.02), (0.15, 0.16, 0.18), (0.1, 0.2, 0.1)),
        "upper_arm": _box(7.6, (0.012, -0.02, 0.25), (0.13, 0.12, 0.62), (0.05, 0.04, 0.2)),
        "forearm": _box(4.1, (-0.01, 0.03, 0.21), (0.1, 0.1, 0.55), (-0.04, 0.06, -0.2)),
        "wrist1": _box(1.7, (0.008, 0.04, 0.006), (0.1, 0.13, 0.1), (0.2, -0.1, 0.1)),
        "wrist2": _box(1.6, (-0.006, 0.012, 0.05), (0.1, 0.1, 0.13), (0.1, 0.2, -0.1)),
        "flange": _box(1.1, (0.03, 0.06, -0.02), (0.09, 0.11, 0.12), (0.3, -0.2, 0.15)),
    },
    encoder_bits=20,
    min_frequency=0.1,
    max_frequency=1.8,
)

ROBOTS = {robot.name: robot for robot in (PLANAR2, LEG3, ARM6)}


def draw_truth(robot: Robot, seed: int, exact: bool = False) -> Truth:
    """Draw the true bodies and friction of a robot; if ``exact``, the bodies are those of the URDF."""
    rng = np.random.default_rng([seed, 11])
    links = {name: _perturbed_link(body, rng) for name, body in robot.links.items()}
    rotors = {joint.name: _perturbed_rotor(rotor(joint), rng) for joint in robot.joints}
    viscous, coulomb = np.transpose([(joint.viscous, joint.coulomb) for joint in robot.joints])
    viscous_factors, coulomb_factors = rng.uniform(0.75, 1.25, (2, len(robot.joints)))
    if exact:
        links = dict(robot.links)
        rotors = {joint.name: rotor(joint) for joint in robot.joints}
    return Truth(links, rotors, viscous * viscous_factors, coulomb * coulomb_factors)


def _perturbed_link(body: Body, rng: np.random.Generator) -> Body:
    """A body whose mass density went through a random affine map, so that it stays realizable."""
    second_moments = np.trace(body.inertia) / 2 * np.eye(3) - body.inertia  # about the centre of mass
    stretch = np.eye(3) + rng.uniform(-_STRETCH, _STRETCH, (3, 3))
    scale = 1 + rng.uniform(-2 * _STRETCH, 2 * _STRETCH)
    gyration = np.sqrt(np.trace(second_moments) / body.mass)
    second_moments = scale * stretch @ second_moments @ stretch.T
    com = body.com + _COM_SHIFT * gyration * rng.uniform(-1, 1, 3)
    return Body(scale * body.mass, com, np.trace(second_moments) * np.eye(3) - second_moments)


def _perturbed_rotor(body: Body, rng: np.random.Generator) -> Body:
    mass_factor, inertia_factor = 1 + rng.uniform(-_ROTOR_ERROR, _ROTOR_ERROR, 2)
    return Body(mass_factor * body.mass, body.com, inertia_factor * body.inertia)


def urdf_text(robot: Robot, links: Mapping[str, Body] | None = None) -> str:
    """The robot's URDF, with the designer's links or with others."""
    lines = [f'<robot name="{robot.name}">', f'<link name="{robot.joints[0].parent}"/>']
    for name, body in (robot.links if links is None else links).items():
        entries = []
        for axes in _UPPER_TRIANGLE:
            row, column = ("xyz".index(axis) for axis in axes)
            entries.append(f'i{axes}="{float(body.inertia[row, column])!r}"')
        com = f'<origin xyz="{_text(body.com)}" rpy="0 0 0"/><mass value="{float(body.mass)!r}"/>'
        lines.append(f'<link name="{name}"><inertial>{com}<inertia {" ".join(entries)}/></inertial></link>')
    for joint in robot.joints:
        ends = f'<parent link="{joint.parent}"/><child link="{joint.child}"/>'
        pose = f'<origin xyz="{_text(joint.xyz)}" rpy="{_text(joint.rpy)}"/><axis xyz="{_text(joint.axis)}"/>'
        position = f'lower="{joint.lower}" upper="{joint.upper}"'
        limit = f'<limit {position} effort="{joint.effort}" velocity="{joint.velocity}"/>'
        lines.append(f'<joint name="{joint.name}" type="revolute">{ends}{pose}{limit}</joint>')
    return "\n".join([*lines, "</robot>\n"])


def links_with_motors(robot: Robot, joints: Collection[str]) -> dict[str, Body]:
    """Bodies of the designer's links, those that carry the motors of some joints as one body with them.

    Without a rotor of its own in the configuration, a motor is part of its link, as in any drawing.
    """
    links = dict(robot.links)
    for joint in robot.joints:
        if joint.name in joints and joint.parent in links:
            links[joint.parent] = _joined(links[joint.parent], _on_parent(rotor(joint), joint))
    return links


def _on_parent(body: Body, joint: Joint) -> Body:
    """A body in the frame of a joint, in that of the joint's parent."""
    R = Rotation.from_euler("xyz", joint.rpy).as_matrix()
    return Body(body.mass, np.array(joint.xyz) + R @ body.com, R @ body.inertia @ R.T)


def _joined(a: Body, b: Body) -> Body:
    """Two bodies as one."""
    mass = a.mass + b.mass
    com = (a.mass * a.com + b.mass * b.com) / mass
    inertia = a.inertia + b.inertia
    for body in (a, b):
        d = body.com - com
        inertia = inertia + body.mass * (d @ d * np.eye(3) - np.outer(d, d))
    return Body(mass, com, inertia)


def _text(values: Array | tuple[float, ...]) -> str:
    return " ".join(repr(float(x)) for x in values)
