"""`Robot`: links and joints of a URDF, checked.

Read with yourdfpy from a tree that lxml has parsed strictly: no document type, no entities, no network.
"""

from __future__ import annotations

import io
import math
import os
import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yourdfpy
from lxml import etree

from idtool.common.arrays import Array
from idtool.common.exceptions import ModelError
from idtool.common.input_files import read_error_text
from idtool.common.provenance import InputFile, source_from_bytes
from idtool.robot.inertia import PI_SIZE, from_mass_com_inertia

_MAX_BYTES = 64 << 20
_MAX_VALUE = 1e12  # SI, of any number that enters the equations; what is larger is taken for infinite
_CHILDREN = {"link": ("inertial",), "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic")}
_TYPES = ("revolute", "continuous", "prismatic", "fixed")
_SUFFIXES = (".urdf", ".xml", "")
_XACRO = "xacro"  # in the namespaces that xacro has had
_MOMENTS = ("ixx", "iyy", "izz")  # for one that is missing the parser takes 1 kg·m²


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: position = multiplier × that joint's + offset [rad or m]."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class UrdfJoint:
    """A URDF joint.

    Attributes
    ----------
    name, kind, parent, child
        As in the URDF; ``kind`` is revolute, continuous, prismatic or fixed.
    R, p
        The child's frame in the parent's at position zero: rotation (3, 3), position (3,) [m].
    axis
        Unit vector in the joint's frame, shape (3,).
    damping, friction
        Viscous [N·m·s/rad or N·s/m] and Coulomb [N·m or N] friction, 0 where the URDF has none.
    lower, upper, velocity, effort
        Limits [rad or m, rad/s or m/s, N·m or N], infinite where the URDF has none.
    mimic
        The joint it follows, if any.
    """

    name: str
    kind: str
    parent: str
    child: str
    R: Array
    p: Array
    axis: Array
    damping: float
    friction: float
    lower: float
    upper: float
    velocity: float
    effort: float
    mimic: Mimic | None


@dataclass(frozen=True)
class Robot:
    """A tree of links and joints.

    Attributes
    ----------
    path
        The URDF.
    text
        Its bytes.
    root
        The link that has no parent.
    links
        Link name to inertia parameters in the link's frame, shape (10,); None where the URDF gives no inertial.
    joints
        Joint name to joint, parents before children.
    source
        Path and hash of the file.
    """

    path: Path
    text: bytes
    root: str
    links: dict[str, Array | None]
    joints: dict[str, UrdfJoint]
    source: InputFile

    def path_to_root(self, joint: str) -> list[str]:
        """Names of the joints from one to the root, itself first; empty for an unknown joint."""
        parent_joint = {other.child: other for other in self.joints.values()}
        path: list[str] = []
        current = self.joints.get(joint)
        while current is not None:
            path.append(current.name)
            current = parent_joint.get(current.parent)
        return path

    def on_same_branch(self, joint: str, other: str) -> bool:
        """True if one of two joints carries the other."""
        return joint in self.path_to_root(other) or other in self.path_to_root(joint)


def read_robot(path: Path) -> Robot:
    """The robot in a URDF.

    Raises
    ------
    ModelError
        If the file cannot be read, is not a URDF, or its links and joints make no tree.
    """
    if path.suffix == ".xacro" and path.is_file():  # even without macros: by its name it may get some
        raise ModelError(path, _expand(path))
    if os.path.isdir(path):
        identified = path / "identified.urdf"
        raise ModelError(path, f"is a folder; give {identified if identified.is_file() else 'a URDF'}")
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise ModelError(path, read_error_text(path, error)) from None
    if data.startswith(b"\x89MCAP") or not (path.suffix.lower() in _SUFFIXES or data.lstrip().startswith(b"<")):
        raise ModelError(path, "is a log; give the URDF first and the logs after it")
    return parse_robot(path, data)


def parse_robot(path: Path, data: bytes) -> Robot:
    """The robot in a URDF's text.

    Parameters
    ----------
    path
        Where the text comes from; errors name it.
    data
        The text.

    Raises
    ------
    ModelError
        If it is not a URDF, or its links and joints make no tree.
    """
    if len(data) > _MAX_BYTES:
        raise ModelError(path, f"is larger than {_MAX_BYTES >> 20} MiB, too large for a URDF")
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise ModelError(path, "is in UTF-16; save it as UTF-8")
    try:
        with np.errstate(all="ignore"):  # numbers that are not finite are found below
            text = io.BytesIO(_kinematic_urdf(path, data))
            urdf = yourdfpy.URDF.load(text, build_scene_graph=False, load_meshes=False).robot
            joints = [_joint(path, joint) for joint in urdf.joints]
            links = {link.name: _parameters(path, link) for link in urdf.links}
    except ModelError:
        raise
    except Exception as error:  # the parser has no error of its own for a missing tag or a word in place of a number
        raise ModelError(path, f"is not a well-formed URDF ({type(error).__name__}: {error})") from None
    if len(links) != len(urdf.links) or len({joint.name for joint in joints}) != len(joints):
        raise ModelError(path, "two links or two joints have the same name; rename one")
    root, ordered = _tree(path, links, joints)
    return Robot(path, data, root, links, ordered, source_from_bytes("URDF", path, data))


def parse_xml(path: Path, data: bytes) -> etree._Element:
    """The root element of untrusted XML.

    Raises
    ------
    ModelError
        If it is not well-formed, or declares a document type or entities.
    """
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        raise ModelError(path, f"is not XML: {_syntax_error_text(error)}; correct the file there") from None
    if root.getroottree().docinfo.internalDTD is not None:
        raise ModelError(path, "declares a document type, which it does not need; remove it")
    return root


def _syntax_error_text(error: etree.XMLSyntaxError) -> str:
    """The parser's message with the place, which libxml2 may name a second time within it."""
    line, column = error.position
    text = (error.msg or "").removesuffix(f", line {line}, column {column}").removesuffix(f" line {line}")
    return f"{text} (line {line}, column {column})"


def _kinematic_urdf(path: Path, data: bytes) -> bytes:
    """The URDF with only what is read here, so that an unusual visual or plugin tag cannot stop the parser."""
    try:
        root = parse_xml(path, data)
    except ModelError:
        if b"<xacro:" in data:  # a prefix that it does not declare
            raise ModelError(path, _expand(path)) from None
        raise
    if any(_XACRO in str(etree.QName(element).namespace) for element in root.iter(etree.Element)):
        raise ModelError(path, _expand(path))
    if root.tag != "robot":
        raise ModelError(path, f"is not a URDF: its root element is <{root.tag}>, not <robot>")
    reduced = etree.Element("robot", name=root.get("name", "robot"))
    for element in root:
        children = _CHILDREN.get(element.tag) if isinstance(element.tag, str) else None
        if children is None:
            continue
        _check_required(path, element)
        attributes = {str(name): str(value) for name, value in element.attrib.items()}
        copy = etree.SubElement(reduced, element.tag, attributes)
        copy.extend([child for child in element if child.tag in children])
    for element in reduced.iter():
        for value in element.attrib.values():
            if "${" in value or "$(" in value:
                raise ModelError(path, _expand(path))
    return bytes(etree.tostring(reduced))


def _expand(path: Path) -> str:
    """Message: how to expand xacro macros."""
    plain = path.name.removesuffix(".xacro").removesuffix(".urdf")
    urdf = shlex.quote(f"{plain}.urdf" if path.suffix == ".xacro" else f"{plain}_expanded.urdf")
    return f"contains xacro macros; run xacro on it and use the result: xacro {shlex.quote(path.name)} > {urdf}"


def _check_required(path: Path, element: etree._Element) -> None:
    """Raise ModelError if a link or joint lacks a required name, parent, child or moment of inertia."""
    where = f"{path}: line {element.sourceline}: {element.tag} {element.get('name', '')}".rstrip()
    if not element.get("name"):
        raise ModelError(where, "has no name; give it one")
    if not element.get("name", "").isprintable():
        raise ModelError(where, "has a name with unprintable characters; rename it")
    if element.tag == "joint":
        for tag in ("parent", "child"):
            end = element.find(tag)
            if end is None or not end.get("link"):
                raise ModelError(where, f"has no {tag} link; add <{tag} link=.../>")
    for inertia in element.iterfind("inertial/inertia"):
        missing = [name for name in _MOMENTS if name not in inertia.attrib]
        if missing:
            raise ModelError(where, f"its inertia lacks {', '.join(missing)}")


def _parameters(path: Path, link: yourdfpy.Link) -> Array | None:
    """Inertia parameters of a link in its frame, shape (10,); None without an inertial."""
    if link.inertial is None:
        return None
    inertial = link.inertial
    mass = inertial.mass if inertial.mass is not None else 0.0
    inertia = inertial.inertia if inertial.inertia is not None else np.zeros((3, 3))
    origin = inertial.origin if inertial.origin is not None else np.eye(4)
    R = origin[:3, :3]
    pi = from_mass_com_inertia(mass, origin[:3, 3], R @ inertia @ R.T)
    if pi.shape != (PI_SIZE,) or not (np.abs(pi) < _MAX_VALUE).all():
        raise ModelError(path, f"link {link.name}: its inertial has a value that is not a finite number")
    return pi


def _joint(path: Path, joint: yourdfpy.Joint) -> UrdfJoint:
    where = f"{path}: joint {joint.name}"
    if joint.type not in _TYPES:
        raise ModelError(where, f"type {joint.type} is not supported; use one of {', '.join(_TYPES)}")
    origin = joint.origin if joint.origin is not None else np.eye(4)
    axis = np.asarray(joint.axis, dtype=float)
    if axis.shape != (3,) or not (np.abs(origin) < _MAX_VALUE).all() or not (np.abs(axis) < _MAX_VALUE).all():
        raise ModelError(where, "its origin or axis does not consist of three finite numbers")
    if joint.type != "fixed":
        if not np.linalg.norm(axis) > 0:
            raise ModelError(where, "its axis is zero; give its direction of motion")
        axis = axis / np.linalg.norm(axis)

    dynamics = joint.dynamics
    damping = float(dynamics.damping or 0.0) if dynamics else 0.0
    friction = float(dynamics.friction or 0.0) if dynamics else 0.0
    mimic = None
    if joint.mimic:
        mimic = Mimic(joint.mimic.joint, float(joint.mimic.multiplier), float(joint.mimic.offset))
    values = [damping, friction, *((mimic.multiplier, mimic.offset) if mimic else ())]
    if not (np.abs(values) < _MAX_VALUE).all():
        raise ModelError(where, "its dynamics or mimic has a value that is not a finite number")

    limit = joint.limit
    has_position_limits = limit and joint.type != "continuous"
    return UrdfJoint(
        name=joint.name,
        kind=joint.type,
        parent=joint.parent,
        child=joint.child,
        R=origin[:3, :3],
        p=origin[:3, 3],
        axis=axis,
        damping=damping,
        friction=friction,
        lower=_finite_or(-math.inf, limit.lower) if has_position_limits else -math.inf,
        upper=_finite_or(math.inf, limit.upper) if has_position_limits else math.inf,
        velocity=_finite_or(math.inf, limit.velocity) if limit else math.inf,
        effort=_finite_or(math.inf, limit.effort) if limit else math.inf,
        mimic=mimic,
    )


def _finite_or(default: float, value: float | None) -> float:
    """The value if it is a finite number, else the default."""
    return default if value is None or not math.isfinite(value) else float(value)


def _tree(path: Path, links: dict[str, Array | None], joints: list[UrdfJoint]) -> tuple[str, dict[str, UrdfJoint]]:
    """The root link, and the joints with parents before children."""
    parent_joint: dict[str, UrdfJoint] = {}
    children: dict[str, list[UrdfJoint]] = {}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise ModelError(f"{path}: joint {joint.name}", f"names link {link}, which the URDF does not define")
        if joint.child in parent_joint:
            raise ModelError(path, f"link {joint.child} is the child of two joints; a URDF must be a tree")
        parent_joint[joint.child] = joint
        children.setdefault(joint.parent, []).append(joint)
    roots = [link for link in links if link not in parent_joint]
    if len(roots) != 1:
        which = f"{len(roots)} root links ({', '.join(roots[:4])})" if roots else "no root link"
        raise ModelError(path, f"has {which}; a URDF must be one tree")
    order: list[UrdfJoint] = []
    stack = list(reversed(children.get(roots[0], [])))
    while stack:  # depth first: leg by leg, as a reader of the URDF expects them
        joint = stack.pop()
        order.append(joint)
        stack += reversed(children.get(joint.child, []))
    if len(order) != len(joints):
        raise ModelError(path, "some links are joined in a loop; a URDF must be a tree")
    return roots[0], {joint.name: joint for joint in order}
