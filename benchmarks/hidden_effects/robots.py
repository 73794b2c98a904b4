"""Robots for data whose effects are hidden: tables, their URDF text, and what they truly weigh.

Three robots: a planar arm in a vertical plane, a leg that hangs from its body, an arm of six joints and 25 kg. The URDF
has the designer's inertias; the true ones differ by 10 to 20 %, drawn anew for every seed, and can be those of bodies.
Nothing of idtool takes part.

Letters: inertia about the centre of mass [kg m^2]; gear turns of the rotor per turn of the joint.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

_STRETCH = 0.07  # of lengths and of the root of the mass: masses differ by some 15 %, inertias by more
_SHIFT = 0.15  # of a link's radius of gyration, by which its centre lies elsewhere
_ROTOR = 0.05  # of a rotor's mass and inertia


@dataclass(frozen=True)
class Body:
    """Mass [kg], centre [m] in the frame of the link, inertia about it (3, 3), axes as the link's."""

    mass: float
    com: Array
    inertia: Array


@dataclass(frozen=True)
class Joint:
    """A joint with its motor. Limits: position (lower, upper) [rad], velocity [rad/s], effort [N m].

    ``viscous`` and ``coulomb`` are its typical friction [N m s/rad, N m], ``reflected`` the rotor's inertia at the
    joint [kg m^2], ``rotor_mass`` in kg.
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
    reflected: float
    rotor_mass: float
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Robot:
    """Joints in order, each link on the one before; what the designer believed of the links; encoder bits a turn.

    ``slowest`` and ``fastest`` bound the frequencies it is moved with [Hz].
    """

    name: str
    joints: tuple[Joint, ...]
    links: Mapping[str, Body]
    bits: int
    slowest: float
    fastest: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of the joints."""
        return tuple(joint.name for joint in self.joints)

    def index(self, joint: str) -> int:
        """Number of a joint."""
        return self.names.index(joint)


@dataclass(frozen=True)
class Truth:
    """Bodies of links by link and of rotors by joint, and friction of every joint, (n,)."""

    links: Mapping[str, Body]
    rotors: Mapping[str, Body]
    viscous: Array
    coulomb: Array


def _solid(mass: float, com: tuple[float, ...], box: tuple[float, ...], turn: tuple[float, ...] = (0, 0, 0)) -> Body:
    """A box with these sides [m], turned."""
    squares = np.square(box)
    R = Rotation.from_euler("xyz", turn).as_matrix()
    inertia = R @ np.diag(mass / 12 * (squares.sum() - squares)) @ R.T
    return Body(mass, np.array(com, float), (inertia + inertia.T) / 2)


def rotor(joint: Joint) -> Body:
    """The rotor as its data sheet has it, its centre on its axis."""
    axis = np.array(joint.axis, float)
    spin = joint.reflected / joint.gear**2
    along = np.outer(axis, axis)
    return Body(joint.rotor_mass, np.zeros(3), spin * along + 0.7 * spin * (np.eye(3) - along))


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

PLANAR2 = Robot(
    "planar2",
    (
        Joint("shoulder", "base", "upper", (0, 0, 0.6), Y, -2.4, 2.4, 7, 90, 0.9, 1.8, 15, 0.15, 0.6),
        Joint("elbow", "upper", "lower", (0, 0.03, -0.45), Y, -2.5, 2.5, 9, 35, 0.25, 0.55, 12, 0.04, 0.35),
    ),
    {
        "upper": _solid(3.8, (0.015, 0.02, -0.21), (0.09, 0.07, 0.48), (0.05, -0.1, 0.1)),
        "lower": _solid(2.1, (-0.012, 0.01, -0.19), (0.07, 0.06, 0.42), (-0.1, 0.07, 0.2)),
    },
    bits=18,
    slowest=0.12,
    fastest=2.0,
)

LEG3 = Robot(
    "leg3",
    (
        Joint("abad", "trunk", "hip_link", (0.22, 0.07, 0), X, -0.95, 0.95, 16, 34, 0.09, 0.24, 9, 0.011, 0.32),
        Joint("hip", "hip_link", "thigh", (0.02, 0.085, 0), Y, -1.3, 2.4, 16, 34, 0.1, 0.26, 9, 0.011, 0.32),
        Joint("knee", "thigh", "shank", (0, 0.01, -0.24), Y, -2.6, -0.5, 14, 42, 0.08, 0.16, 11, 0.016, 0.3),
    ),
    {
        "hip_link": _solid(1.3, (-0.01, 0.03, 0.004), (0.12, 0.1, 0.09), (0.2, 0.1, -0.15)),
        "thigh": _solid(1.9, (-0.008, 0.015, -0.06), (0.08, 0.07, 0.27), (0.06, -0.12, 0.05)),
        "shank": _solid(0.42, (0.012, -0.002, -0.12), (0.035, 0.03, 0.27), (-0.05, 0.1, 0.1)),
    },
    bits=18,
    slowest=0.3,
    fastest=2.5,
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
        "column": _solid(5.2, (0.01, 0.03, 0.02), (0.15, 0.16, 0.18), (0.1, 0.2, 0.1)),
        "upper_arm": _solid(7.6, (0.012, -0.02, 0.25), (0.13, 0.12, 0.62), (0.05, 0.04, 0.2)),
        "forearm": _solid(4.1, (-0.01, 0.03, 0.21), (0.1, 0.1, 0.55), (-0.04, 0.06, -0.2)),
        "wrist1": _solid(1.7, (0.008, 0.04, 0.006), (0.1, 0.13, 0.1), (0.2, -0.1, 0.1)),
        "wrist2": _solid(1.6, (-0.006, 0.012, 0.05), (0.1, 0.1, 0.13), (0.1, 0.2, -0.1)),
        "flange": _solid(1.1, (0.03, 0.06, -0.02), (0.09, 0.11, 0.12), (0.3, -0.2, 0.15)),
    },
    bits=20,
    slowest=0.1,
    fastest=1.8,
)

ROBOTS = {robot.name: robot for robot in (PLANAR2, LEG3, ARM6)}


def draw_truth(robot: Robot, seed: int, exact: bool = False) -> Truth:
    """What a robot truly is; ``exact``: its bodies are those of the URDF and the config, the friction is drawn."""
    rng = np.random.default_rng([seed, 11])
    links = {name: _altered(body, rng) for name, body in robot.links.items()}
    rotors = {joint.name: _respun(rotor(joint), rng) for joint in robot.joints}
    viscous, coulomb = np.transpose([(joint.viscous, joint.coulomb) for joint in robot.joints])
    shares = rng.uniform(0.75, 1.25, (2, len(robot.joints)))
    if exact:
        links, rotors = dict(robot.links), {joint.name: rotor(joint) for joint in robot.joints}
    return Truth(links, rotors, viscous * shares[0], coulomb * shares[1])


def _altered(body: Body, rng: np.random.Generator) -> Body:
    """Its mass density under a random affine map, and scaled: what comes out can be, whatever is drawn."""
    scatter = np.trace(body.inertia) / 2 * np.eye(3) - body.inertia  # second moments about the centre
    stretch = np.eye(3) + rng.uniform(-_STRETCH, _STRETCH, (3, 3))
    scale = 1 + rng.uniform(-2 * _STRETCH, 2 * _STRETCH)
    size = np.sqrt(np.trace(scatter) / body.mass)
    scatter = scale * stretch @ scatter @ stretch.T
    com = body.com + _SHIFT * size * rng.uniform(-1, 1, 3)
    return Body(scale * body.mass, com, np.trace(scatter) * np.eye(3) - scatter)


def _respun(body: Body, rng: np.random.Generator) -> Body:
    mass, inertia = 1 + rng.uniform(-_ROTOR, _ROTOR, 2)
    return Body(mass * body.mass, body.com, inertia * body.inertia)


def urdf_text(robot: Robot, links: Mapping[str, Body] | None = None) -> str:
    """The robot with the designer's links, or others."""
    parts = [f'<robot name="{robot.name}">', f'<link name="{robot.joints[0].parent}"/>']
    for name, body in (robot.links if links is None else links).items():
        I = {a + b: repr(float(body.inertia["xyz".index(a), "xyz".index(b)])) for a, b in _UPPER}  # noqa: E741
        entries = " ".join(f'i{axes}="{value}"' for axes, value in I.items())
        at = f'<origin xyz="{_text(body.com)}" rpy="0 0 0"/><mass value="{float(body.mass)!r}"/>'
        parts.append(f'<link name="{name}"><inertial>{at}<inertia {entries}/></inertial></link>')
    for j in robot.joints:
        place = f'<origin xyz="{_text(j.xyz)}" rpy="{_text(j.rpy)}"/><axis xyz="{_text(j.axis)}"/>'
        limit = f'<limit lower="{j.lower}" upper="{j.upper}" effort="{j.effort}" velocity="{j.velocity}"/>'
        ends = f'<parent link="{j.parent}"/><child link="{j.child}"/>'
        parts.append(f'<joint name="{j.name}" type="revolute">{ends}{place}{limit}</joint>')
    return "\n".join([*parts, "</robot>\n"])


_UPPER = ("xx", "xy", "xz", "yy", "yz", "zz")


def _text(values: Array | tuple[float, ...]) -> str:
    return " ".join(repr(float(x)) for x in values)
