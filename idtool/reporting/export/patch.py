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
from idtool.dynamics.effects import NamedEffect, effect_from_entry, effect_types
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
from idtool.reporting.export.identified import IdentifiedModel
from idtool.reporting.export.inertia_check import is_acceptable, unrealizable_error
from idtool.reporting.export.joints import ForcesByJoint, JointForces
from idtool.reporting.number_text import four_digits
from idtool.reporting.results.diagnosis import ChangeReport
from idtool.robot.body import Body
from idtool.robot.config import EffectEntry
from idtool.robot.inertia import mass_com_inertia, round_to_digits, rounded_inertial, symmetric_entries
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
_SIDES: tuple[Literal["simulator"], Literal["robot"]] = ("simulator", "robot")
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
    index
        Index of the body in the model.
    mass, com
        Those that the file should have now [kg; m, shape (3,)].
    """

    part: Part
    index: int
    mass: float
    com: Array


@dataclass
class _Plan:
    """What to write into a file."""

    identified: IdentifiedModel
    forces: ForcesByJoint = field(init=False)
    joints: list[_JointChange] = field(default_factory=list)
    bodies: list[_BodyChange] = field(default_factory=list)
    not_carried: list[Part] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.forces = ForcesByJoint(self.identified.model.names)
        for j, forces in enumerate(self.forces.values()):
            forces.armature = float(self.identified.mechanism.armature[j])
        for term in self.identified.terms:
            if _attributes(term.elements):
                self.forces.add_term(term)

    def add_all(self) -> None:
        """Write everything that the model has."""
        for term in self.identified.terms:
            self._add(replace(term.part(""), detail=_NO_PLACE), _attributes(term.elements))
        for part in self.identified.inertias:
            if part.detail in ("armature", "gravity"):
                self._add(replace(part, detail=_NO_PLACE), (part.detail,))
        for index, body in enumerate(self.identified.model.bodies):
            if body.kind == "link":
                self._add_body(index, Part("inertial", body.name, ""))
        self.not_carried += [replace(part, detail=_NO_PLACE) for part in self.identified.offsets]
        self.not_carried += self.identified.others

    def add_changes(self, changes: Iterable[ChangeReport]) -> None:
        """Write the changes of a diagnosis."""
        links = [body.name for body in self.identified.model.bodies]
        for change in changes:
            part = _part(change, self.identified.model)
            if change.effect == BODIES:
                mass, com = (change.parameters[name].simulator for name in ("mass", "com"))
                index = links.index(part.of)
                if self.identified.model.bodies[index].kind == "link":
                    self.bodies.append(_BodyChange(part, index, mass, np.array(com)))
                else:
                    self.not_carried.append(part)
                continue
            forms = {inertia.detail for inertia in self.identified.inertias if _is_of(inertia, change)}
            if "in the inertials" in forms and change.link in links:
                self._add_body(links.index(change.link), part)
            elif forms & {"armature", "gravity"}:
                self._add(part, tuple(forms & {"armature", "gravity"}))
            else:
                self._add(part, self._changed_attributes(change))

    def _changed_attributes(self, change: ChangeReport) -> tuple[str, ...]:
        """Attributes of a joint that are an effect, on the robot or, if it has none, in the simulator."""
        elements: list[SimulatorElement] = []
        for term in self.identified.terms:
            if (term.effect, term.joint) == (change.effect, change.joint):
                elements += term.elements
        if elements:
            return _attributes(elements)
        effect = _effect(change, "simulator", self.identified.model)
        if effect is None:
            return ()
        return _attributes(effect.simulator_elements(np.array([c.prior for c in effect.coefficients])))

    def _add(self, part: Part, attributes: tuple[str, ...]) -> None:
        if attributes:
            self.joints.append(_JointChange(part, attributes))
        else:
            self.not_carried.append(part)

    def _add_body(self, index: int, part: Part) -> None:
        """Write a body that in the file has the inertia of the URDF."""
        mass, com, _ = mass_com_inertia(self.identified.model.bodies[index].pi)
        self.bodies.append(_BodyChange(part, index, mass, com))

    def pi(self, change: _BodyChange) -> Array:
        """New parameters of a body, shape (10,).

        Raises
        ------
        ModelError
            If no body can have them.
        """
        pi = self.identified.pi[change.index]
        if not is_acceptable(pi):
            raise unrealizable_error(self.identified.robot, self.body(change).name)
        return np.asarray(pi)

    def body(self, change: _BodyChange) -> Body:
        """The body of a change."""
        return self.identified.model.bodies[change.index]


def _effect(change: ChangeReport, side: Literal["simulator", "robot"], model: RobotModel) -> NamedEffect | None:
    """The effect of a change as it is on one side; None if that side has none."""
    values = {name: getattr(parameter, side) for name, parameter in change.parameters.items()}
    if change.effect not in effect_types() or None in values.values():
        return None
    entry = EffectEntry(effect=change.effect, joint=change.joint, link=change.link, parameters=values)
    return effect_from_entry(entry, model)


def _torque_delay(change: ChangeReport, model: RobotModel) -> float:
    """How much later the torque acts on the robot than in the simulator [s]; 0 for another effect."""
    delays = []
    for side in _SIDES:
        mechanism = Mechanism(model)
        effect = _effect(change, side, model)
        if effect is not None:
            effect.add_to_forward_model(np.array([c.prior for c in effect.coefficients]), mechanism)
        delays.append(mechanism.torque_delay[np.argmax(np.abs(mechanism.torque_delay))])
    simulator, robot = delays
    return float(simulator - robot)


def _attributes(elements: Iterable[SimulatorElement]) -> tuple[str, ...]:
    """Attributes of a joint in MJCF that together are some elements; empty if one of them is none."""
    names: list[str] = []
    for element in elements:
        if type(element) not in _ATTRIBUTES or (isinstance(element, FrictionLoss) and element.level < 0):
            return ()
        names += _ATTRIBUTES[type(element)]
    return tuple(dict.fromkeys(names))


def _is_of(part: Part, change: ChangeReport) -> bool:
    """True for the part of the identified model that a change is about."""
    return part.what == change.effect and part.of in (change.joint, change.link, "robot", "all joints")


def _part(change: ChangeReport, model: RobotModel) -> Part:
    """A change that the file has no place for."""
    owner = owner_name(change)
    if delay := _torque_delay(change, model):
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


def patched(identified: IdentifiedModel, path: Path, changes: Sequence[ChangeReport] | None) -> Export:
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
    world = [element for section in root.with_tag("worldbody") for element in section.descendants()]
    joints = {element.name: element for element in world if element.tag == "joint"}
    bodies = {element.name: element for element in world if element.tag == "body"}
    edits: dict[tuple[int, str], Edit] = {}
    carried = []
    for change in plan.joints:
        if change.attributes == ("gravity",):
            gravity = _text(plan.identified.gravity)
            edits[0, "gravity"] = _set_option(text, root, "gravity", gravity)
            carried.append(replace(change.part, detail=f"gravity → {gravity}"))
            continue
        element = _find_joint(path, joints, change.part.of, has_include=b"<include" in text)
        details = []
        for name in change.attributes:
            value = _mjcf_value(plan.forces[change.part.of], name, element, root)
            edits[element.start, name] = set_attribute(text, element, name, value)
            details.append(f"{name} {element.attributes.get(name, 'default')} → {value}")
        carried.append(replace(change.part, detail=", ".join(details)))
    for body_change in plan.bodies:
        name = plan.body(body_change).name
        inertial = bodies[name].first("inertial") if name in bodies else None
        reason = _inertial_mismatch(inertial, body_change) if inertial else "the file has no inertial of this body"
        if inertial is None or reason:
            plan.not_carried.append(replace(body_change.part, detail=reason))
            continue
        mass, com, inertia = rounded_inertial(plan.pi(body_change))
        xx, xy, yy, xz, yz, zz = symmetric_entries(inertia)
        full = _text([xx, yy, zz, xy, xz, yz])
        new = f'<inertial pos="{_text(com)}" mass="{mass!r}" fullinertia="{full}"/>'
        edits[inertial.start, ""] = Edit(inertial.start, inertial.stop, new.encode())
        detail = f"inertial, mass {inertial.attributes['mass']} → {mass!r}"
        carried.append(replace(body_change.part, detail=detail))
    return apply_edits(text, _merged(edits.values())), carried


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


def _mjcf_value(forces: JointForces, name: str, joint: Element, root: Element) -> str:
    """An attribute of a joint in MJCF."""
    if name == "springref":
        shift = float(joint.attributes.get("ref", 0.0))  # in the file's own unit
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


def _inertial_mismatch(inertial: Element, change: _BodyChange) -> str:
    """Reason why an inertial cannot be replaced, since it is not the URDF's; empty if it is."""
    mass = float(inertial.attributes.get("mass", 0.0))
    com = np.array([float(x) for x in inertial.attributes.get("pos", "0 0 0").split()])
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
    links = {element.name for element in root.with_tag("link")}
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
            present = dynamics.get(change.part.of, JointDynamics())
            dynamics[change.part.of] = replace(present, **{written: value})
            before = old.attributes.get(written, "none") if old else "none"
            details.append(f"{written} {before} → {_number(value)}")
        carried.append(replace(change.part, detail=", ".join(details)))
    for body_change in plan.bodies:
        body = plan.body(body_change)
        new = link_parameters(body, plan.pi(body_change), plan.identified.robot.links)
        if not set(new) <= links:
            plan.not_carried.append(replace(body_change.part, detail="the file has no such link"))
            continue
        inertias |= new
        mass = four_digits(float(plan.pi(body_change)[0]))
        carried.append(replace(body_change.part, detail=f"inertial, mass {four_digits(body_change.mass)} → {mass}"))
    return replace_parameters(text, inertias, dynamics), carried
