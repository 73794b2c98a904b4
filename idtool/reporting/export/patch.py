"""The identified model written into a user's own MJCF or URDF: only what is to be changed, every other byte kept."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import ModelError
from idtool.common.names import suggestion
from idtool.dynamics.effects import effect_from_entry, effect_types
from idtool.dynamics.effects.simulator_element import (
    Damping,
    FrictionLoss,
    QuadraticDamping,
    SimulatorElement,
    Spring,
)
from idtool.dynamics.mechanism import Mechanism
from idtool.reporting.diagnosis_text import BODIES, owner_name
from idtool.reporting.export.base import Export, Part
from idtool.reporting.export.identified import EffectTorque, IdentifiedModel
from idtool.reporting.export.inertia_check import is_acceptable, unrealizable_error
from idtool.reporting.export.joints import ForcesByJoint, JointForces
from idtool.reporting.export.present_values import has_mjcf_inertia, has_urdf_inertia, has_value
from idtool.reporting.number_text import four_digits
from idtool.reporting.results.diagnosis import ChangeReport
from idtool.robot.body import Body
from idtool.robot.config import EffectEntry
from idtool.robot.inertia import (
    from_mass_com_inertia,
    mass_com_inertia,
    round_to_digits,
    rounded_inertial,
    symmetric_entries,
    symmetric_matrix,
)
from idtool.robot.model import RobotModel
from idtool.robot.urdf.reading import parse_xml
from idtool.robot.urdf.text import Edit, Element, apply_edits, root_element, set_attribute
from idtool.robot.urdf.writing import JointDynamics, link_parameters, replace_parameters

_NO_PLACE = "the file has no place for it; set it in the simulator's controller or code"
_DIGITS = 6  # of what is written
_MASS_TOLERANCE = 0.01  # relative, by which a body's mass in the file may differ from the URDF's
_COM_TOLERANCE = 2e-3  # m
_ATTRIBUTES: dict[type[SimulatorElement], tuple[str, ...]] = {
    Damping: ("damping",),
    QuadraticDamping: ("damping",),
    FrictionLoss: ("frictionloss",),
    Spring: ("stiffness", "springref"),
}
_URDF_NAMES = {"damping": "damping", "frictionloss": "friction"}


@dataclass(frozen=True)
class _JointChange:
    """Attributes of a joint, by their names in MJCF, that an effect changes.

    Attributes
    ----------
    part
        The effect, as it is listed if the file has no place for it.
    attributes
        Names of the attributes; ``gravity`` is one of the whole file.
    """

    part: Part
    attributes: tuple[str, ...]


@dataclass(frozen=True)
class _BodyChange:
    """New inertia of a body.

    Attributes
    ----------
    part
        The change, as it is listed if the file has no place for it.
    body
        The body.
    pi
        Its new parameters, shape (10,).
    mass, com
        Those that the file should have now [kg; m, shape (3,)].
    """

    part: Part
    body: Body
    pi: Array
    mass: float
    com: Array


@dataclass
class _Plan:
    """New values of a file's joints, bodies and gravity, and the parts it has no place for.

    Attributes
    ----------
    identified
        The model.
    forces
        New attributes of its joints.
    gravity
        New gravity, shape (3,) [m/s²].
    joints, bodies
        The changes.
    not_carried
        Parts that the file has no place for.
    """

    identified: IdentifiedModel
    forces: ForcesByJoint = field(init=False)
    gravity: Array = field(init=False)
    joints: list[_JointChange] = field(default_factory=list)
    bodies: list[_BodyChange] = field(default_factory=list)
    not_carried: list[Part] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.gravity = self.identified.gravity
        self.forces = ForcesByJoint(self.identified.model.names)
        for j, forces in enumerate(self.forces.values()):
            forces.armature = float(self.identified.mechanism.armature[j])

    def add_all(self) -> None:
        """Write everything that the model has."""
        for term in self.identified.terms:
            self._add_term(term)
            self._add(replace(term.part(""), detail=_NO_PLACE), _attributes(term.elements))
        for part in self.identified.inertias:
            if part.detail in ("armature", "gravity"):
                self._add(replace(part, detail=_NO_PLACE), (part.detail,))
        for index, body in enumerate(self.identified.model.bodies):
            if body.kind == "link":
                self._add_body(index, Part("inertial", body.name, ""))
        self.not_carried += [replace(part, detail=_NO_PLACE) for part in self.identified.offsets]
        self.not_carried += self.identified.others

    def add_changes(self, changes: Sequence[ChangeReport]) -> None:
        """Write the changes of a diagnosis; attributes to which other effects add too, with these."""
        changed = {(change.effect, change.joint) for change in changes}
        for term in self.identified.terms:
            if (term.effect, term.joint) not in changed:
                self._add_term(term)
        for change in changes:
            if change.effect == BODIES:
                self._add_inertia(change)
            else:
                self._add_change(change)

    def _add_inertia(self, change: ChangeReport) -> None:
        """Write the inertia of a link."""
        part = _part(change, 0.0)
        bodies = {body.name: body for body in self.identified.model.bodies}
        body = bodies[part.of]
        if body.kind != "link":
            self.not_carried.append(part)
            return
        values = {name: parameter.robot for name, parameter in change.parameters.items()}
        pi = from_mass_com_inertia(values["mass"], values["com"], symmetric_matrix(values["inertia_com"]))
        mass, com = (change.parameters[name].simulator for name in ("mass", "com"))
        self.bodies.append(_BodyChange(part, body, pi, mass, np.array(com)))

    def _add_change(self, change: ChangeReport) -> None:
        """Write another effect."""
        model = self.identified.model
        simulator = _forward_effect(change, "simulator", model)
        robot = _forward_effect(change, "robot", model)
        part = _part(change, _torque_delay(simulator) - _torque_delay(robot))
        links = [body.name for body in model.bodies]
        if change.joint in self.forces:
            self._add_term(EffectTorque(change.effect, str(change.joint), robot.elements, ()))
        if robot.mechanism.pi.any() and change.link in links:
            self._add_body(links.index(change.link), part)
        elif robot.changes_gravity:
            self.gravity = robot.mechanism.gravity
            self._add(part, ("gravity",))
        elif change.joint in self.forces and (robot.mechanism.armature.any() or simulator.mechanism.armature.any()):
            self.forces[str(change.joint)].armature = float(robot.mechanism.armature.sum())
            self._add(part, ("armature",))
        else:
            self._add(part, _attributes(robot.elements or simulator.elements))

    def _add_term(self, term: EffectTorque) -> None:
        """Add torque to the attributes of a joint."""
        if _attributes(term.elements):
            self.forces.add_term(term)

    def _add(self, part: Part, attributes: tuple[str, ...]) -> None:
        if attributes:
            self.joints.append(_JointChange(part, attributes))
        else:
            self.not_carried.append(part)

    def _add_body(self, index: int, part: Part) -> None:
        """Write a body that in the file has the inertia of the URDF."""
        body = self.identified.model.bodies[index]
        mass, com, _ = mass_com_inertia(body.pi)
        self.bodies.append(_BodyChange(part, body, self.identified.pi[index], mass, com))


@dataclass(frozen=True)
class _ForwardEffect:
    """Simulator elements and mechanism of an effect; empty on a side that does not have it."""

    elements: tuple[SimulatorElement, ...]
    mechanism: Mechanism
    changes_gravity: bool = False


def _forward_effect(change: ChangeReport, side: Literal["simulator", "robot"], model: RobotModel) -> _ForwardEffect:
    """The effect of a change, as the simulator or the robot has it."""
    values = {name: getattr(parameter, side) for name, parameter in change.parameters.items()}
    if change.effect not in effect_types() or None in values.values():
        return _ForwardEffect((), Mechanism(model))
    entry = EffectEntry(effect=change.effect, joint=change.joint, link=change.link, parameters=values)
    effect = effect_from_entry(entry, model)
    theta = np.array([c.prior for c in effect.coefficients])
    changed = effect.modify_model(model)
    mechanism = Mechanism(changed)
    effect.add_to_forward_model(theta, mechanism)
    return _ForwardEffect(effect.simulator_elements(theta), mechanism, changed is not model)


def _torque_delay(effect: _ForwardEffect) -> float:
    """Delay of the torque [s]."""
    delay = effect.mechanism.torque_delay
    return float(delay[np.argmax(np.abs(delay))])


def _attributes(elements: Iterable[SimulatorElement]) -> tuple[str, ...]:
    """Attributes of a joint in MJCF that together are some elements; empty if one of them is none."""
    names: list[str] = []
    for element in elements:
        if type(element) not in _ATTRIBUTES or (isinstance(element, FrictionLoss) and element.level < 0):
            return ()
        names += _ATTRIBUTES[type(element)]
    return tuple(dict.fromkeys(names))


def _part(change: ChangeReport, delay: float) -> Part:
    """A change that the file has no place for, or one by which the torque acts ``delay`` [s] later on the robot."""
    owner = owner_name(change)
    if delay:
        late = "later" if delay > 0 else "earlier"
        detail = f"the torque acts {1e3 * abs(delay):.3g} ms {late} on the robot; change the simulator's controller"
        return Part(change.effect, owner, detail, delay, "s")
    texts = []
    for name, parameter in change.parameters.items():
        values = [_value_text(value) for value in (parameter.simulator, parameter.robot)]
        texts.append(f"{name} {' → '.join(values)} {parameter.unit or ''}".rstrip())
    first = next(iter(change.parameters.values()))
    value = first.robot if isinstance(first.robot, float) else None
    unit = first.unit if value is not None else None
    return Part(change.effect, owner, f"{', '.join(texts)}; {_NO_PLACE}", value, unit)


def _value_text(value: object) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value_text(x) for x in value)}]"
    if value is None:
        return "none"
    return four_digits(value) if isinstance(value, float | int) else str(value)


def patch_file(identified: IdentifiedModel, path: Path, changes: Sequence[ChangeReport] | None) -> Export:
    """A copy of a simulator's file with the identified values.

    Parameters
    ----------
    identified
        The model.
    path
        MJCF or URDF.
    changes
        The changes to make; None: all values of the model.

    Raises
    ------
    ModelError
        If the file is neither, lacks a joint, or an inertia is not realizable.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise ModelError(path, f"cannot be read ({error.strerror})") from None
    tag = parse_xml(path, text).tag
    if tag not in ("mujoco", "robot"):
        raise ModelError(path, f"is neither MJCF nor URDF: its root element is <{tag}>, not <mujoco> or <robot>")
    plan = _Plan(identified)
    if changes is None:
        plan.add_all()
    else:
        plan.add_changes(changes)
    write = _write_mjcf if tag == "mujoco" else _write_urdf
    content, carried = write(plan, path, text)
    return Export(f"{path.stem}_patched{path.suffix}", content, tuple(carried), tuple(dict.fromkeys(plan.not_carried)))


def _write_mjcf(plan: _Plan, path: Path, text: bytes) -> tuple[bytes, list[Part]]:
    """The patched MJCF, and the parts that are in it; those that are not are added to the plan."""
    root = root_element(text)
    if root.first("worldbody") is None:
        raise ModelError(path, "has no <worldbody>; give the file that has the robot's bodies")
    world = [element for section in root.with_tag("worldbody") for element in section.descendants()]
    joints = {element.name: element for element in world if element.tag == "joint"}
    bodies = {element.name: element for element in world if element.tag == "body"}
    default = None if b"<default" in text or b"<include" in text else "0"  # of every attribute of a joint
    edits: dict[tuple[int, str], Edit] = {}
    carried = []
    for change in plan.joints:
        if change.attributes == ("gravity",):
            gravity = _text(plan.gravity)
            option = root.first("option")
            if not has_value(option.attributes.get("gravity") if option else None, gravity, _DIGITS):
                edits[0, "gravity"] = _set_option(text, root, "gravity", gravity)
                carried.append(replace(change.part, detail=f"gravity → {gravity}"))
            continue
        element = _find_joint(path, joints, change.part.of, has_include=b"<include" in text)
        details = []
        for name in change.attributes:
            value = _mjcf_value(path, plan.forces[change.part.of], name, element, root)
            if not has_value(element.attributes.get(name, default), value, _DIGITS):
                edits[element.start, name] = set_attribute(text, element, name, value)
                details.append(f"{name} {element.attributes.get(name, 'default')} → {value}")
        if details:
            carried.append(replace(change.part, detail=", ".join(details)))
    for body_change in plan.bodies:
        name = body_change.body.name
        inertial = bodies[name].first("inertial") if name in bodies else None
        if inertial is None:
            plan.not_carried.append(replace(body_change.part, detail="the file has no inertial of this body"))
            continue
        if reason := _inertial_mismatch(path, inertial, body_change):
            plan.not_carried.append(replace(body_change.part, detail=reason))
            continue
        pi = _realizable(plan, body_change)
        if has_mjcf_inertia(inertial, pi):
            continue
        mass, new = _mjcf_inertial(pi)
        edits[inertial.start, ""] = Edit(inertial.start, inertial.stop, new.encode())
        detail = f"inertial, mass {inertial.attributes['mass']} → {mass!r}"
        carried.append(replace(body_change.part, detail=detail))
    return apply_edits(text, _merged(edits.values())), carried


def _mjcf_inertial(pi: Array) -> tuple[float, str]:
    """Mass [kg] and MJCF element of a body's inertia."""
    mass, com, inertia = rounded_inertial(pi)
    xx, xy, yy, xz, yz, zz = symmetric_entries(inertia)
    full_inertia = _text([xx, yy, zz, xy, xz, yz])
    return mass, f'<inertial pos="{_text(com)}" mass="{mass!r}" fullinertia="{full_inertia}"/>'


def _realizable(plan: _Plan, change: _BodyChange) -> Array:
    """New parameters of a body, shape (10,).

    Raises
    ------
    ModelError
        If no body can have them.
    """
    if not is_acceptable(change.pi):
        raise unrealizable_error(plan.identified.robot, change.body.name)
    return change.pi


def _merged(edits: Iterable[Edit]) -> list[Edit]:
    """The edits, those that insert at the same place as one."""
    insertions: dict[int, bytes] = {}
    others = []
    for edit in edits:
        if edit.start == edit.stop:
            insertions[edit.start] = insertions.get(edit.start, b"") + edit.new
        else:
            others.append(edit)
    return [*others, *(Edit(start, start, new) for start, new in insertions.items())]


def _find_joint(path: Path, joints: dict[str, Element], name: str, has_include: bool) -> Element:
    """The joint of a name.

    Raises
    ------
    ModelError
        If there is none.
    """
    if name in joints:
        return joints[name]
    hint = "give the file that it includes" if has_include else suggestion(name, joints)
    raise ModelError(path, f"has no joint named {name}; {hint}")


def _read_numbers(path: Path, element: Element, name: str, default: str) -> Array:
    """The numbers in an attribute.

    Raises
    ------
    ModelError
        If it holds something else.
    """
    written = element.attributes.get(name, default)
    try:
        return np.array([float(x) for x in written.split()])
    except ValueError:
        raise ModelError(
            f"{path}: {element.tag} {element.name}".rstrip(), f"{name} is not a number: {written}"
        ) from None


def _mjcf_value(path: Path, forces: JointForces, name: str, joint: Element, root: Element) -> str:
    """An attribute of a joint in MJCF."""
    if name == "springref":
        shift = float(_read_numbers(path, joint, "ref", "0").sum())  # in the file's own unit
        is_angle = joint.attributes.get("type", "hinge") == "hinge"
        unit = np.degrees(1.0) if is_angle and _uses_degrees(root) else 1.0
        return _number(forces.springref * unit + shift)
    if name == "damping" and forces.drag:
        return f"{_number(forces.damping)} {_number(forces.drag)}"
    return _number(getattr(forces, name))


def _uses_degrees(root: Element) -> bool:
    """True if angles in an MJCF are in degrees, its default."""
    angles = [compiler.attributes["angle"] for compiler in root.with_tag("compiler") if "angle" in compiler.attributes]
    return not angles or angles[-1] != "radian"


def _set_option(text: bytes, root: Element, name: str, value: str) -> Edit:
    """The edit that sets an option of an MJCF."""
    option = root.first("option")
    if option is not None:
        return set_attribute(text, option, name, value)
    return Edit(root.content, root.content, f'\n  <option {name}="{value}"/>'.encode())


def _inertial_mismatch(path: Path, inertial: Element, change: _BodyChange) -> str:
    """Reason why an inertial cannot be replaced, since it is not the URDF's; empty if it is."""
    mass = float(_read_numbers(path, inertial, "mass", "0").sum())
    com = _read_numbers(path, inertial, "pos", "0 0 0")
    is_same_mass = abs(mass - change.mass) <= _MASS_TOLERANCE * change.mass
    if is_same_mass and com.shape == (3,) and np.abs(com - change.com).max() <= _COM_TOLERANCE:
        return ""
    return (
        f"the file's inertial, {four_digits(mass)} kg at [{_text(com)}] m, is not the URDF's, "
        f"{four_digits(change.mass)} kg at [{_text(round_to_digits(change.com, 4))}] m, so its frame is unknown"
    )


def _number(value: float) -> str:
    """A number as an attribute."""
    return repr(float(round_to_digits(value, _DIGITS)))


def _text(values: Iterable[float]) -> str:
    """Numbers as an attribute."""
    return " ".join(repr(float(x)) for x in values)


def _write_urdf(plan: _Plan, path: Path, text: bytes) -> tuple[bytes, list[Part]]:
    """The patched URDF, and the parts that are in it; those that are not are added to the plan."""
    root = root_element(text)
    joints = {element.name: element for element in root.with_tag("joint")}
    links = {element.name: element for element in root.with_tag("link")}
    dynamics: dict[str, JointDynamics] = {}
    inertias: dict[str, Array | None] = {}
    carried = []
    for change in plan.joints:
        if not set(change.attributes) <= set(_URDF_NAMES) or plan.forces[change.part.of].drag:
            plan.not_carried.append(change.part)
            continue
        element = _find_joint(path, joints, change.part.of, has_include=False)
        old = element.first("dynamics")
        details = []
        for name in change.attributes:
            value = float(round_to_digits(getattr(plan.forces[change.part.of], name), _DIGITS))
            written = _URDF_NAMES[name]
            if has_value(old.attributes.get(written, "0") if old else "0", _number(value), _DIGITS):
                continue
            present = dynamics.get(change.part.of, JointDynamics())
            dynamics[change.part.of] = replace(present, **{written: value})
            before = old.attributes.get(written, "none") if old else "none"
            details.append(f"{written} {before} → {_number(value)}")
        if details:
            carried.append(replace(change.part, detail=", ".join(details)))
    for body_change in plan.bodies:
        pi = _realizable(plan, body_change)
        new = link_parameters(body_change.body, pi, plan.identified.robot.links)
        if not set(new) <= set(links):
            plan.not_carried.append(replace(body_change.part, detail="the file has no such link"))
            continue
        if all(has_urdf_inertia(links[name], own) for name, own in new.items()):
            continue
        inertias |= new
        mass = four_digits(float(pi[0]))
        carried.append(replace(body_change.part, detail=f"inertial, mass {four_digits(body_change.mass)} → {mass}"))
    return replace_parameters(text, inertias, dynamics), carried
