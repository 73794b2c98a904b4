"""An estimate into the URDF's own text: inertials and joint dynamics are replaced, every other byte is kept.

In another folder than its own, relative names of mesh files are made to hold there.

The file is edited at byte positions that expat reports, so that comments, order, quoting and indentation stay.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np

from idtool.common.arrays import Array
from idtool.robot.body import Body
from idtool.robot.inertia import pseudo_inertia, rounded, rounded_inertial, six
from idtool.robot.urdf.reading import Robot

_ATTRIBUTE = re.compile(rb"""([^\s="'/<>]+)\s*=\s*("[^"]*"|'[^']*')""")


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
    for element in _elements(text):
        if element.tag == "link" and element.name in links:
            pi = links[element.name]
            new = b"" if pi is None else _inertial(pi, _break(text, element, "inertial"))
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


def _break(text: bytes, element: _Element, child: str) -> bytes:
    """Line end and white space before an element's child, the one that is there or a new one."""
    place = element.children.get(child, element)
    line = text.rfind(b"\n", 0, place.start) + 1
    before = text[line : place.start]
    indent = before[: len(before) - len(before.lstrip(b" \t"))]
    end = b"\r\n" if text[:line].endswith(b"\r\n") else b"\n"
    return end + indent + (b"" if child in element.children else b"  ")


def _replacement(text: bytes, element: _Element, tag: str, new: bytes) -> tuple[int, int, bytes]:
    """The edit that puts ``new`` in place of the element's child, or as its first child."""
    old = element.children.get(tag)
    if old is not None:
        start = old.start
        if not new:  # take the line's white space along
            start = len(text[:start].rstrip(b" \t").removesuffix(b"\n").removesuffix(b"\r"))
        return start, old.stop, new
    opening = _tag_end(text, element.start)
    if not new:
        return opening, opening, b""
    line = _break(text, element, tag)
    if text[opening - 2 : opening] == b"/>":
        close = line[:-2] + b"</" + element.tag.encode() + b">"
        return opening - 2, opening, b">" + line + new + close
    return opening, opening, line + new


def _inertial(pi: Array, line: bytes) -> bytes:
    mass, com, inertia = rounded_inertial(pi)
    xx, xy, yy, xz, yz, zz = (repr(float(x)) for x in six(inertia))
    xyz = " ".join(repr(float(x)) for x in com)
    rows = [
        "<inertial>",
        f'  <origin xyz="{xyz}" rpy="0 0 0"/>',
        f'  <mass value="{mass!r}"/>',
        f'  <inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/>',
        "</inertial>",
    ]
    return line.join(row.encode() for row in rows)


def _dynamics(old: bytes, dynamics: JointDynamics) -> bytes:
    """A dynamics tag with the values that are given, all else as it was."""
    values = {"damping": dynamics.damping, "friction": dynamics.friction}
    given = {name.encode(): repr(float(rounded(value))).encode() for name, value in values.items() if value is not None}
    tag = old or b"<dynamics/>"
    for name, number in given.items():
        opening = tag[: _tag_end(tag, 0)]
        places = {match.group(1): match.span(2) for match in _ATTRIBUTE.finditer(opening)}
        end = len(re.sub(rb"\s*/?>\Z", b"", opening))
        start, stop = places.get(name, (end, end))
        written = b'"' + number + b'"' if name in places else b" " + name + b'="' + number + b'"'
        tag = tag[:start] + written + tag[stop:]
    return tag if given else old


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


def moved(text: bytes, urdf: Path, folder: Path) -> bytes:
    """The URDF's text for a file in another folder: relative names of files that are there, meshes and textures.

    Parameters
    ----------
    text
        The text.
    urdf
        The file it stood in.
    folder
        Where it will stand.
    """
    home, there = os.path.realpath(urdf.parent), os.path.realpath(folder)
    places: list[tuple[int, str]] = []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        name = attributes.get("filename", "")
        if tag in ("mesh", "texture") and name and "://" not in name and not os.path.isabs(name):
            places.append((parser.CurrentByteIndex, name))

    parser.StartElementHandler = start
    parser.Parse(text, True)
    for at, name in reversed(places if home != there else []):
        file = os.path.join(home, name)
        if os.path.isfile(file):
            tag = text[at : (stop := _tag_end(text, at))]
            low, high = next(m.span(2) for m in _ATTRIBUTE.finditer(tag) if m.group(1) == b"filename")
            new = quoteattr(Path(os.path.relpath(file, there)).as_posix()).encode("ascii", "xmlcharrefreplace")
            text = text[:at] + tag[:low] + new + tag[high:] + text[stop:]
    return text
