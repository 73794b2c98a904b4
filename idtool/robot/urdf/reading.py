"""`Robot`: links and joints of a URDF, checked.

Read from a tree that lxml has parsed strictly: no document type, no entities, no network. Visuals, plugins and all
else that is not needed are passed over, however unusual.
"""

from __future__ import annotations

import math
import os
import shlex
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from lxml import etree

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ModelError
from idtool.common.input_files import read_error_text
from idtool.common.names import join_names
from idtool.common.provenance import InputFile, source_from_bytes
from idtool.robot.inertia import from_mass_com_inertia, symmetric_matrix
from idtool.robot.rotation import rotation_from_rpy

_MAX_BYTES = 64 << 20
_MAX_VALUE = 1e12  # SI, of any number that enters the equations; what is larger is taken for infinite
_CHILDREN = {"link": ("inertial",), "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic")}
_TYPES = ("revolute", "continuous", "prismatic", "fixed")
_SUFFIXES = (".urdf", ".xml", "")
_LOG_SUFFIXES = (".csv", ".mcap", ".bag", ".db3")
_XACRO = "xacro"  # in the namespaces that xacro has had
_INERTIA_ENTRIES = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")  # as in `symmetric_matrix`
_MOMENTS = ("ixx", "iyy", "izz")  # must be there; a product that is not is zero


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
    is_log = data.startswith(b"\x89MCAP") or path.suffix.lower() in _LOG_SUFFIXES
    if is_log and not data.lstrip().startswith(b"<"):
        raise ModelError(path, "is a log; give the URDF first and the logs after it")
    if path.suffix.lower() not in _SUFFIXES and not data.lstrip().startswith(b"<"):
        raise ModelError(path, "is not a URDF, which is XML; give the URDF first and the logs after it")
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
    root = _root_element(path, data)
    link_elements = root.findall("link")
    joint_elements = root.findall("joint")
    for element in (*link_elements, *joint_elements):
        _check_required(path, element)
        if any("${" in text or "$(" in text for text in _attributes_read(element)):
            raise ModelError(path, _expand(path))
    with np.errstate(all="ignore"):  # numbers that are not finite are found by their results
        joints = [_joint(path, element) for element in joint_elements]
        links = {element.get("name", ""): _parameters(path, element) for element in link_elements}
    for kind, elements in (("links", link_elements), ("joints", joint_elements)):
        names = Counter(element.get("name", "") for element in elements)
        name, count = names.most_common(1)[0] if names else ("", 1)
        if count > 1:
            raise ModelError(path, f"has {count} {kind} of the name {name}; rename all but one")
    root_link, ordered = _tree(path, links, joints)
    return Robot(path, data, root_link, links, ordered, source_from_bytes("URDF", path, data))


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


def _root_element(path: Path, data: bytes) -> etree._Element:
    """The <robot> of a URDF's text."""
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
    return root


def _attributes_read(element: etree._Element) -> Iterator[str]:
    """Values of all attributes of a link or joint that are read here."""
    yield from map(str, element.attrib.values())
    for child in element:
        if child.tag in _CHILDREN[str(element.tag)]:
            for descendant in child.iter():
                yield from map(str, descendant.attrib.values())


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
            if not _linked(element, tag):
                raise ModelError(where, f"has no {tag} link; add <{tag} link=.../>")
    for inertia in element.iterfind("inertial/inertia"):
        missing = [name for name in _MOMENTS if name not in inertia.attrib]
        if missing:
            raise ModelError(where, f"its inertia lacks {', '.join(missing)}; add it")


def _parameters(path: Path, link: etree._Element) -> Array | None:
    """Inertia parameters of a link in its frame, shape (10,); None without an inertial."""
    inertial = link.find("inertial")
    if inertial is None:
        return None
    where = f"{path}: link {link.get('name')}"
    R, p = _origin(where, inertial)
    mass = _number(where, inertial.find("mass"), "value", 0.0)
    inertia = inertial.find("inertia")
    moments = [_number(where, inertia, name, 0.0) for name in _INERTIA_ENTRIES]
    pi = from_mass_com_inertia(mass, p, R @ symmetric_matrix(moments) @ R.T)
    if not (np.abs(pi) < _MAX_VALUE).all():
        raise ModelError(where, "its inertial has a value that is not a finite number")
    return pi


def _joint(path: Path, joint: etree._Element) -> UrdfJoint:
    name = joint.get("name", "")
    where = f"{path}: joint {name}"
    kind = joint.get("type")
    if kind not in _TYPES:
        raise ModelError(where, f"type {kind} is not supported; use one of {', '.join(_TYPES)}")
    R, p = _origin(where, joint)
    axis = _vector(where, joint.find("axis"), "xyz", "1 0 0")
    if not (np.abs([*R, p, axis]) < _MAX_VALUE).all():
        raise ModelError(where, "its origin or axis does not consist of three finite numbers")
    if kind != "fixed":
        if not np.linalg.norm(axis) > 0:
            raise ModelError(where, "its axis is zero; give its direction of motion")
        axis = axis / np.linalg.norm(axis)

    dynamics = joint.find("dynamics")
    damping = _number(where, dynamics, "damping", 0.0)
    friction = _number(where, dynamics, "friction", 0.0)
    mimic = _mimic(where, joint.find("mimic"))
    values = [damping, friction, *((mimic.multiplier, mimic.offset) if mimic else ())]
    if not (np.abs(values) < _MAX_VALUE).all():
        raise ModelError(where, "its dynamics or mimic has a value that is not a finite number")

    limit = joint.find("limit")
    position_limit = None if kind == "continuous" else limit
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=_linked(joint, "parent"),
        child=_linked(joint, "child"),
        R=R,
        p=p,
        axis=axis,
        damping=damping,
        friction=friction,
        lower=_finite_or(-math.inf, _number(where, position_limit, "lower", -math.inf)),
        upper=_finite_or(math.inf, _number(where, position_limit, "upper", math.inf)),
        velocity=_finite_or(math.inf, _number(where, limit, "velocity", math.inf)),
        effort=_finite_or(math.inf, _number(where, limit, "effort", math.inf)),
        mimic=mimic,
    )


def _linked(joint: etree._Element, tag: str) -> str:
    """The link that a joint's parent or child names, empty where there is none."""
    end = joint.find(tag)
    return "" if end is None else str(end.get("link", ""))


def _mimic(where: str, element: etree._Element | None) -> Mimic | None:
    if element is None:
        return None
    multiplier = _number(where, element, "multiplier", 1.0)
    return Mimic(element.get("joint", ""), multiplier, _number(where, element, "offset", 0.0))


def _origin(where: str, element: etree._Element) -> tuple[Array, Array]:
    """Rotation (3, 3) and position (3,) [m] of an element's origin; its numbers need not be finite."""
    origin = element.find("origin")
    rpy = _vector(where, origin, "rpy", "0 0 0")
    R = rotation_from_rpy(rpy) if np.isfinite(rpy).all() else np.full((3, 3), np.nan)
    return R, _vector(where, origin, "xyz", "0 0 0")


def _vector(where: str, element: etree._Element | None, name: str, default: str) -> Array:
    """Three numbers in an attribute, shape (3,); they need not be finite."""
    text = default if element is None else element.get(name, default)
    numbers = [_to_number(word) for word in text.split()]
    if len(numbers) != 3 or None in numbers:
        tag = "" if element is None else element.tag
        raise ModelError(where, f"its {tag} {name} '{text[:40]}' should be three finite numbers")
    return np.array(numbers, dtype=float)


def _number(where: str, element: etree._Element | None, name: str, default: float) -> float:
    """A number in an attribute, which need not be finite; the default where there is none."""
    text = None if element is None else element.get(name)
    if element is None or text is None:
        return default
    number = _to_number(text)
    if number is None:
        raise ModelError(where, f"its {element.tag} {name} '{text[:40]}' should be a finite number")
    return number


def _to_number(text: str) -> float | None:
    """The number that a text is; None if it is none."""
    if "_" in text:  # which is part of a number in Python alone
        return None
    try:
        return float(text)
    except ValueError:
        return None


def _finite_or(default: float, value: float) -> float:
    """The value if it is a finite number, else the default."""
    return value if math.isfinite(value) else default


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
        which = f"{len(roots)} root links ({join_names(roots)})" if roots else "no root link"
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
