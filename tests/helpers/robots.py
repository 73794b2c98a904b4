"""Random robots as URDF text: trees that branch, every kind of joint, axes and inertials aligned with nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
from numpy.typing import NDArray

from idtool.robot.body import Body
from idtool.robot.model import RobotModel
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]

KINDS = ("revolute", "continuous", "prismatic", "fixed")


def random_urdf(
    rng: np.random.Generator,
    size: int = 7,
    kinds: Sequence[str] = KINDS,
    mimic: float = 0.2,
    massless: float = 0.15,
) -> str:
    """A robot of links ``link0`` (the root) to ``link<size>`` and joints ``joint1`` to ``joint<size>``.

    Parameters
    ----------
    rng
        Source of all that is random.
    size
        Number of joints; the first of them is actuated.
    kinds
        Types of joint to choose from.
    mimic
        Share of the moving joints that follow an earlier one, itself perhaps a follower.
    massless
        Share of the links without inertial.
    """
    lines = ['<robot name="random">', _link("link0", inertial(rng))]
    sources: list[str] = []
    for i in range(1, size + 1):
        kind = str(rng.choice([k for k in kinds if k != "fixed"] if i == 1 else list(kinds)))
        parent = f"link{rng.integers(max(0, i - 3), i)}"
        extra = ""
        if kind != "fixed":
            if sources and rng.random() < mimic:
                multiplier, offset = rng.choice([-1, 1]) * rng.uniform(0.3, 2), rng.uniform(-0.5, 0.5)
                extra = f'<mimic joint="{rng.choice(sources)}" multiplier="{multiplier}" offset="{offset}"/>'
            sources.append(f"joint{i}")
        lines.append(_link(f"link{i}", "" if rng.random() < massless else inertial(rng)))
        lines.append(joint(f"joint{i}", kind, parent, f"link{i}", origin(rng) + axis(rng) + extra))
    return "\n".join([*lines, "</robot>\n"])


def joint(name: str, kind: str, parent: str, child: str, inside: str = '<axis xyz="0 0 1"/>') -> str:
    """A joint; ``inside`` is what it holds beside its links and limits."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}'
        '<limit lower="-3" upper="3" effort="100" velocity="20"/></joint>'
    )


def inertial(rng: np.random.Generator) -> str:
    """The inertial of a body that could exist, in a frame off and turned against the link's."""
    mass = rng.uniform(0.2, 3)
    axes = rotation(rng)
    sigma = axes @ np.diag(mass * rng.uniform(0.01, 0.1, 3) ** 2) @ axes.T  # second moments about the centre
    I = np.trace(sigma) * np.eye(3) - sigma  # noqa: E741
    entries = {"ixx": I[0, 0], "ixy": I[0, 1], "ixz": I[0, 2], "iyy": I[1, 1], "iyz": I[1, 2], "izz": I[2, 2]}
    inertia = " ".join(f'{name}="{float(value)!r}"' for name, value in entries.items())
    return f'<inertial>{origin(rng)}<mass value="{mass}"/><inertia {inertia}/></inertial>'


def origin(rng: np.random.Generator) -> str:
    """A place up to 0.3 m away, turned any way."""
    return f'<origin xyz="{_text(rng.uniform(-0.3, 0.3, 3))}" rpy="{_text(rng.uniform(-3, 3, 3))}"/>'


def axis(rng: np.random.Generator) -> str:
    """A direction: along a coordinate axis, either way, one time in three."""
    direction = rng.permutation([0.0, 0.0, rng.choice([-1.0, 1.0])]) if rng.random() < 1 / 3 else rng.normal(size=3)
    return f'<axis xyz="{_text(direction / np.linalg.norm(direction))}"/>'


def rotation(rng: np.random.Generator) -> Array:
    """A rotation matrix, shape (3, 3)."""
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return np.asarray(Q * np.sign(np.linalg.det(Q)))


def chain(*joints: str) -> str:
    """Links l0, l1, … in a row, joined by the joints' texts in order."""
    links = "".join(f'<link name="l{i}"/>' for i in range(len(joints) + 1))
    return f'<robot name="r">{links}{"".join(joints)}</robot>'


def link(i: int, mimic: str = "", kind: str = "revolute", axis: str = "0 0 2") -> str:
    """Joint j<i> from l<i − 1> to l<i>."""
    return joint(f"j{i}", kind, f"l{i - 1}", f"l{i}", f'<axis xyz="{axis}"/>{mimic}')


def leg_urdf(rng: np.random.Generator) -> str:
    """A leg: joints abad, hip and knee, a foot fixed to the shank, a hip motor to the abad, a tail on the base."""
    links = ("base", "abad_link", "thigh", "shank", "foot", "hip_motor", "tail_link")
    joints = (
        ("abad", "revolute", "base", "abad_link"),
        ("hip", "revolute", "abad_link", "thigh"),
        ("knee", "revolute", "thigh", "shank"),
        ("ankle", "fixed", "shank", "foot"),
        ("hip_mount", "fixed", "abad_link", "hip_motor"),
        ("tail", "prismatic", "base", "tail_link"),
    )
    parts = [_link(link, inertial(rng)) for link in links]
    parts += [joint(*names, origin(rng) + axis(rng)) for names in joints]
    return "\n".join(['<robot name="leg">', *parts, "</robot>\n"])


def random_rotors(rng: np.random.Generator, robot: Robot) -> dict[str, Any]:
    """A geared rotor, a belt that leads past a joint, and the two rotors of a differential."""
    joints = [j.name for j in robot.joints.values() if j.kind != "fixed"]
    one, two, three = rng.choice(joints), *rng.choice(joints, 2, replace=False)
    couplings = {
        "geared": {one: 10.604},
        "belt": {two: 8.0, three: -8.0},
        "left": {two: 5.5, three: 3.0},
        "right": {two: 5.5, three: -3.0},
    }
    return {name: random_rotor(rng, robot, coupling) for name, coupling in couplings.items()}


def random_rotor(rng: np.random.Generator, robot: Robot, coupling: Mapping[str, float]) -> dict[str, Any]:
    """A rotor in any link, its centre off its axis."""
    A = rng.normal(size=(3, 3))
    sigma = 1e-3 * A @ A.T
    I = np.trace(sigma) * np.eye(3) - sigma  # noqa: E741
    return {
        "coupling": {str(joint): ratio for joint, ratio in coupling.items()},
        "parent": str(rng.choice(list(robot.links))),
        "origin": {"xyz": rng.normal(size=3).tolist(), "rpy": rng.uniform(-3, 3, 3).tolist()},
        "axis": rng.normal(size=3).tolist(),
        "inertial": {
            "mass": float(rng.uniform(0.1, 1)),
            "com": rng.normal(size=3).tolist(),
            "inertia": [I[0, 0], I[0, 1], I[1, 1], I[0, 2], I[1, 2], I[2, 2]],
        },
    }


def link_pi(text: str, link: str) -> Array:
    """A link's parameters in its own frame, from Pinocchio: the link alone, on a joint of its own."""
    inside = text.partition(f'<link name="{link}">')[2].partition("</link>")[0]
    alone = f'<robot name="r"><link name="a"/><link name="b">{inside}</link>{joint("j", "revolute", "a", "b")}</robot>'
    return np.asarray(pin.buildModelFromXML(alone).inertias[1].toDynamicParameters())


def actuated(robot: Robot) -> list[str]:
    """Names of the joints that move on their own."""
    return [j.name for j in robot.joints.values() if j.kind != "fixed" and j.mimic is None]


def body(model: RobotModel, name: str) -> Body:
    """A model's body by name."""
    (found,) = [b for b in model.bodies if b.name == name]
    return found


def _link(name: str, inside: str) -> str:
    return f'<link name="{name}">{inside}</link>'


def _text(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)
