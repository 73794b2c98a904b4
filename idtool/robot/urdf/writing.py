"""Estimates written into the URDF's own text: inertials and joint dynamics are replaced, every other byte is kept.

For another folder, the relative paths of mesh files are changed so that they stay valid.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.robot.body import Body
from idtool.robot.inertia import is_realizable, round_to_digits, rounded_inertial, symmetric_entries
from idtool.robot.urdf.reading import Robot
from idtool.robot.urdf.text import Edit, Element, apply_edits, quoted_attribute, root_element, set_attribute, set_child


@dataclass(frozen=True)
class JointDynamics:
    """Viscous [N·m·s/rad or N·s/m] and Coulomb [N·m or N] friction; None leaves the URDF's value."""

    damping: float | None = None
    friction: float | None = None


def link_parameters(body: Body, pi: Array, links: Collection[str]) -> dict[str, Array | None]:
    """New inertials of a body's links, in the links' frames, which together are the body's.

    The first link takes the difference between the identified parameters and those that the URDF gives the links lumped
    with it. If that difference is not realizable, it takes all, and the others become links without mass (None).

    Parameters
    ----------
    body
        The body.
    pi
        Its identified parameters, shape (10,).
    links
        Names of the URDF's links; a locked rotor that is none of them stays in the configuration.
    """
    if not body.members:
        return {}
    first, *others = body.members
    lumped = [member for member in others if member.link in links]
    zero = np.zeros(len(pi))
    of_links = pi - sum((member.pi_in_body for member in others if member.link not in links), zero)
    of_first = of_links - sum((member.pi_in_body for member in lumped), zero)
    if is_realizable(of_first):
        return {first.link: of_first}
    massless: dict[str, Array | None] = {member.link: None for member in lumped}
    return {first.link: of_links} | massless


def replace_parameters(text: bytes, links: Mapping[str, Array | None], joints: Mapping[str, JointDynamics]) -> bytes:
    """The URDF with other inertials and joint dynamics.

    Parameters
    ----------
    text
        The URDF, well-formed and without a document type.
    links
        Link name to parameters in the link's frame, shape (10,), or None for a link without mass.
    joints
        Joint name to its dynamics.
    """
    root = root_element(text)
    edits: list[Edit] = []
    for link in root.with_tag("link"):
        if link.name in links:
            pi = links[link.name]
            rows = [] if pi is None else _inertial(pi)
            edits.append(set_child(text, link, "inertial", rows))
    for joint in root.with_tag("joint"):
        if joint.name in joints:
            edits += _dynamics(text, joint, joints[joint.name])
    return apply_edits(text, edits)


def _inertial(pi: Array) -> list[bytes]:
    """The rows of an inertial element."""
    mass, com, inertia = rounded_inertial(pi)
    xx, xy, yy, xz, yz, zz = (repr(float(x)) for x in symmetric_entries(inertia))
    xyz = " ".join(repr(float(x)) for x in com)
    rows = [
        "<inertial>",
        f'  <origin xyz="{xyz}" rpy="0 0 0"/>',
        f'  <mass value="{mass!r}"/>',
        f'  <inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/>',
        "</inertial>",
    ]
    return [row.encode() for row in rows]


def _dynamics(text: bytes, joint: Element, dynamics: JointDynamics) -> list[Edit]:
    """The edits that give a joint the values that are not None."""
    values = {"damping": dynamics.damping, "friction": dynamics.friction}
    written = {name: repr(float(round_to_digits(value))) for name, value in values.items() if value is not None}
    element = joint.first("dynamics")
    if element is not None:
        return [set_attribute(text, element, name, value) for name, value in written.items()]
    if not written:
        return []
    attributes = b"".join(b" " + name.encode() + b"=" + quoted_attribute(value) for name, value in written.items())
    return [set_child(text, joint, "dynamics", [b"<dynamics" + attributes + b"/>"])]


def identified_urdf(
    robot: Robot, bodies: Mapping[str, tuple[Body, Array]], joints: Mapping[str, JointDynamics]
) -> bytes:
    """The robot's URDF with identified bodies and friction.

    Parameters
    ----------
    robot
        From the URDF.
    bodies
        Body name to the body and its parameters, shape (10,).
    joints
        Joint name to its dynamics.
    """
    links: dict[str, Array | None] = {}
    for body, pi in bodies.values():
        links.update(link_parameters(body, pi, robot.links))
    return replace_parameters(robot.text, links, joints)


def relocate_meshes(text: bytes, urdf: Path, folder: Path) -> bytes:
    """The URDF's text for a file in another folder, with new relative paths of its meshes and textures.

    Parameters
    ----------
    text
        The text.
    urdf
        The file it was read from.
    folder
        The folder it is written to.
    """
    old_folder = os.path.realpath(urdf.parent)
    new_folder = os.path.realpath(folder)
    if old_folder == new_folder:
        return text
    edits: list[Edit] = []
    for element in root_element(text).descendants():
        name = element.attributes.get("filename", "")
        is_relative = name and "://" not in name and not os.path.isabs(name)
        file = os.path.join(old_folder, name)
        if element.tag in ("mesh", "texture") and is_relative and os.path.isfile(file):
            path = Path(os.path.relpath(file, new_folder)).as_posix()
            edits.append(set_attribute(text, element, "filename", path))
    return apply_edits(text, edits)
