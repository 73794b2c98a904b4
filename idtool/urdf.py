"""An estimate into the URDF's own text: inertials and joint dynamics are replaced, every other byte is kept.

The file is edited at byte positions that expat reports, so that comments, order, quoting and indentation stay.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from idtool.body import Body
from idtool.inertia import mass_com_inertia, pseudo_inertia, six
from idtool.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointDynamics:
    """Viscous [N·m·s/rad or N·s/m] and Coulomb [N·m or N] friction; None leaves the URDF's value."""

    damping: float | None = None
    friction: float | None = None


def link_parameters(body: Body, pi: Array, links: Collection[str]) -> dict[str, Array | None]:
    """New inertials of a body's links, in the links' frames, which together are the body's.

    The carrying link takes the difference between what was identified and what the URDF gives the links lumped into it.
    Where no body could have that difference, it takes all, and the others become links without mass (None).

    Parameters
    ----------
    body
        The body.
    pi
        Its identified parameters, shape (10,).
    links
        Names of the URDF's links; a rotor that is locked and none of them stays in the configuration.
    """
    if not body.members:
        return {}
    first, *others = body.members
    lumped = [member for member in others if member.link in links]
    own = pi - sum((member.pi_in_body for member in others if member.link not in links), np.zeros(len(pi)))
    rest = own - sum((member.pi_in_body for member in lumped), np.zeros(len(pi)))
    if _is_realizable(rest):
        return {first.link: rest}
    return {first.link: own, **{member.link: None for member in lumped}}


def _is_realizable(pi: Array) -> bool:
    return bool(np.linalg.eigvalsh(pseudo_inertia(pi))[0] > 0)


def rewrite(text: bytes, links: Mapping[str, Array | None], joints: Mapping[str, JointDynamics]) -> bytes:
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
    edits: list[tuple[int, int, bytes]] = []
    elements = _elements(text)
    for element in elements:
        if element.tag == "link" and element.name in links:
            pi = links[element.name]
            new = b"" if pi is None else _inertial(pi, _indent(text, element))
            edits.append(_replacement(text, element, "inertial", new))
        elif element.tag == "joint" and element.name in joints:
            old = element.children.get("dynamics")
            written = _dynamics(text[old.start : old.stop] if old else b"", joints[element.name])
            edits.append(_replacement(text, element, "dynamics", written))
    for start, stop, new in sorted(edits, reverse=True):
        text = text[:start] + new + text[stop:]
    return text


@dataclass
class _Element:
    """A link or joint, or one of the children that are replaced, and its place in the text."""

    tag: str
    name: str
    start: int
    stop: int = 0
    children: dict[str, _Element] = field(default_factory=dict)


def _elements(text: bytes) -> list[_Element]:
    """Links and joints right below the root, with the places of their inertial and dynamics."""
    found: list[_Element] = []
    stack: list[_Element] = []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        stack.append(_Element(tag, attributes.get("name", ""), parser.CurrentByteIndex))

    def end(tag: str) -> None:
        element = stack.pop()
        opening = _tag_end(text, element.start)
        empty = text[opening - 2 : opening] == b"/>"
        element.stop = opening if empty else text.index(b">", parser.CurrentByteIndex) + 1
        if len(stack) == 1 and tag in ("link", "joint"):
            found.append(element)
        elif len(stack) == 2 and tag in ("inertial", "dynamics"):
            stack[-1].children.setdefault(tag, element)

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.Parse(text, True)
    return found


def _tag_end(text: bytes, start: int) -> int:
    """Position after the tag that begins at ``start``, a > in a quoted attribute not counted."""
    match = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""").match(text, start)
    if match is None:
        raise AssertionError  # the parser has already seen the tag's end
    return match.end()


def _indent(text: bytes, element: _Element) -> bytes:
    """White space that a child of the element begins its line with."""
    line = text.rfind(b"\n", 0, element.start) + 1
    own = re.match(rb"[ \t]*", text[line : element.start])
    return (own.group() if own else b"") + b"  "


def _replacement(text: bytes, element: _Element, tag: str, new: bytes) -> tuple[int, int, bytes]:
    """The edit that puts ``new`` in place of the element's child, or as its first child."""
    old = element.children.get(tag)
    if old is not None:
        start = old.start
        if not new:  # take the line's white space along
            start = len(text[:start].rstrip(b" \t"))
            start -= text[:start].endswith(b"\n")
        return start, old.stop, new
    indent = _indent(text, element)
    opening = _tag_end(text, element.start)
    if not new:
        return opening, opening, b""
    if text[opening - 2 : opening] == b"/>":
        close = b"\n" + indent[:-2] + b"</" + element.tag.encode() + b">"
        return opening - 2, opening, b">\n" + indent + new + close
    return opening, opening, b"\n" + indent + new


def _inertial(pi: Array, indent: bytes) -> bytes:
    mass, com, inertia = mass_com_inertia(pi)
    xx, xy, yy, xz, yz, zz = (repr(float(x)) for x in six(inertia))
    xyz = " ".join(repr(float(x)) for x in com)
    lines = [
        "<inertial>",
        f'  <origin xyz="{xyz}" rpy="0 0 0"/>',
        f'  <mass value="{mass!r}"/>',
        f'  <inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/>',
        "</inertial>",
    ]
    return (b"\n" + indent).join(line.encode() for line in lines)


def _dynamics(old: bytes, dynamics: JointDynamics) -> bytes:
    """A dynamics tag with the values that are given, others as they were."""
    values = {"damping": dynamics.damping, "friction": dynamics.friction}
    attributes = []
    for name, value in values.items():
        before = re.search(rf"""\b{name}\s*=\s*["']([^"']*)["']""".encode(), old)
        if value is not None:
            attributes.append(f'{name}="{float(value)!r}"'.encode())
        elif before:
            attributes.append(name.encode() + b'="' + before.group(1) + b'"')
    return b"<dynamics " + b" ".join(attributes) + b"/>" if attributes else old


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
    return rewrite(robot.text, links, joints)
