"""Motors in a URDF: gear ratios of transmissions, and links on fixed joints that are rotors by their name."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.robot.inertia import mass_com_inertia
from idtool.robot.rotation import rpy_from_rotation
from idtool.robot.urdf.reading import Robot, UrdfJoint, parse_xml

_RATIOS = ("mechanicalReduction", "mechanical_reduction")  # of ROS 1, and of ros2_control


def gear_ratios(robot: Robot) -> dict[str, float]:
    """Gear ratio by joint, from transmissions of one joint and one ratio."""
    found = {}
    for transmission in parse_xml(robot.path, robot.text).iter("transmission"):
        joints = {element.get("name") for element in transmission.iter("joint")}
        ratios = {_number(element.text) for tag in _RATIOS for element in transmission.iter(tag)}
        name, ratio = next(iter(joints), None), next(iter(ratios), None)
        if len(joints) == len(ratios) == 1 and name in robot.joints and ratio:
            found[str(name)] = ratio
    return found


def _number(text: str | None) -> float | None:
    """The gear ratio in a text; None if it is not a finite number other than zero."""
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if 0 < abs(value) < math.inf else None


def rotor_links(robot: Robot, joints: Sequence[str]) -> dict[str, str]:
    """Rotor links by joint: links with mass and a rotor's name on a fixed joint at the link that carries the joint."""
    carrying = {joint.parent for joint in robot.joints.values()}
    fixed = {
        joint.child: joint.parent
        for joint in robot.joints.values()
        if joint.kind == "fixed" and joint.child not in carrying and "rotor" in joint.child.lower()
    }
    pairs = sorted(
        (-_alike(link, name), link, name)
        for link, parent in fixed.items()
        for name in joints
        if robot.joints[name].parent == parent and robot.links[link] is not None
    )
    found: dict[str, str] = {}
    for _, link, name in pairs:
        if name not in found and link not in found.values():
            found[name] = link
    return found


def _alike(link: str, joint: str) -> float:
    return difflib.SequenceMatcher(None, link.lower().replace("rotor", ""), joint.lower().replace("joint", "")).ratio()


def rotor_template(robot: Robot, joint: UrdfJoint, ratio: float | None, link: str | None) -> dict[str, Any]:
    """An entry under ``rotors`` for a joint, null where only a person knows.

    Parameters
    ----------
    robot
        The robot.
    joint
        The joint that it spins with.
    ratio
        Its gear ratio, if known.
    link
        The URDF link that it is, if any.
    """
    drive: dict[str, Any] = {"joint": joint.name, "gear_ratio": ratio}
    if link is not None:
        pi = robot.links[link]
        com = [0.0, 0.0, 0.0] if pi is None else [round(float(x), 4) + 0.0 for x in mass_com_inertia(pi)[1]]
        return {**drive, "bounding_ellipsoid": {"center": com, "semi_axes": [None] * 3}}
    rpy = rpy_from_rotation(joint.R)
    return {
        **drive,
        "parent": joint.parent,
        "origin": {"xyz": [round(float(x), 6) + 0.0 for x in joint.p], "rpy": [round(float(x), 6) + 0.0 for x in rpy]},
        "axis": [round(float(x), 6) + 0.0 for x in joint.axis],
        "inertial": {"mass": None, "com": [0.0, 0.0, 0.0], "inertia": [None, 0.0, None, 0.0, 0.0, None]},
        "bounding_ellipsoid": {"center": [0.0, 0.0, 0.0], "semi_axes": [None] * 3},
    }


def solid_ellipsoid(pi: Array) -> dict[str, Any] | None:
    """The homogeneous ellipsoid that has a link's inertia parameters, shape (10,), as an entry; None: there is none.

    A solid ellipsoid of mass m and semi-axes a_k has second moments m a_k² / 5 along them.
    """
    mass, com, inertia = mass_com_inertia(pi)
    if not mass > 0:
        return None
    moments, axes = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    if not moments[0] > 0:
        return None
    axes = axes * np.sign(np.linalg.det(axes))
    rpy = rpy_from_rotation(axes)
    return {
        "center": [round(float(x), 4) + 0.0 for x in com],
        "semi_axes": [float(f"{math.sqrt(5 * x / mass):.3g}") for x in moments],
        "rpy": [round(float(x), 4) + 0.0 for x in rpy],
    }
