"""`PatchPlan`: new values for a simulator's file, before it is known how and whether the file can hold them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import field, replace
from typing import Literal

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.number_text import number, short_number
from idtool.diagnosis.records import RIGID_BODY
from idtool.dynamics.effects import effect_from_entry, effect_types, mechanism_of
from idtool.dynamics.effects.simulator_element import (
    Damping,
    FrictionLoss,
    QuadraticDamping,
    SimulatorElement,
    Spring,
)
from idtool.dynamics.mechanism import Mechanism
from idtool.reporting.diagnosis_text import owner_name
from idtool.reporting.export.base import Part
from idtool.reporting.export.identified import EffectTorque, IdentifiedModel
from idtool.reporting.export.joints import ForcesByJoint
from idtool.reporting.results.diagnosis import ChangeReport
from idtool.robot.body import Body
from idtool.robot.config import EffectEntry
from idtool.robot.inertia import from_mass_com_inertia, mass_com_inertia, symmetric_matrix
from idtool.robot.model import RobotModel

_NO_PLACE = "the file has no place for it; set it in the simulator's controller or code"
_ATTRIBUTES: dict[type[SimulatorElement], tuple[str, ...]] = {
    Damping: ("damping",),
    QuadraticDamping: ("damping",),
    FrictionLoss: ("frictionloss",),
    Spring: ("stiffness", "springref"),
}


@dataclass(frozen=True)
class JointChange:
    """Attributes of a joint that an effect changes.

    Attributes
    ----------
    part
        The effect, as it is listed if the file has no place for it.
    attributes
        Names of the attributes in MJCF.
    """

    part: Part
    attributes: tuple[str, ...]


@dataclass(frozen=True)
class BodyChange:
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
    source
        Whose mass and centre of mass these are, in words.
    """

    part: Part
    body: Body
    pi: Array
    mass: float
    com: Array
    source: str = "the URDF's"


@dataclass
class PatchPlan:
    """New values of a file's joints, bodies and gravity, and the parts it has no place for.

    Attributes
    ----------
    identified
        The model.
    forces
        New attributes of its joints.
    gravity
        New gravity in the root link's frame, shape (3,) [m/s²].
    joints, bodies
        The changes of joints and bodies.
    tilt
        The change of gravity, as it is listed if the file has no place for it; None: it is not to be changed.
    not_carried
        Parts that the file has no place for.
    """

    identified: IdentifiedModel
    forces: ForcesByJoint = field(init=False)
    gravity: Array = field(init=False)
    joints: list[JointChange] = field(default_factory=list)
    bodies: list[BodyChange] = field(default_factory=list)
    tilt: Part | None = None
    not_carried: list[Part] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.gravity = self.identified.gravity
        self.forces = ForcesByJoint(self.identified.model.joint_names)
        for j, forces in enumerate(self.forces.values()):
            forces.armature = float(self.identified.mechanism.armature[j])

    def add_all(self) -> None:
        """Write everything that the model has."""
        identified = self.identified
        for term in identified.terms:
            self._add_term(term)
            self._add_joint(_without_place(term.part("")), _attributes(term.elements))
        for part in identified.armatures:
            self._add_joint(_without_place(part), ("armature",))
        for part in identified.tilts:
            self.tilt = _without_place(part)
        for index, body in enumerate(identified.model.bodies):
            if body.kind == "link":
                self._add_body(index, Part("inertial", body.name, ""))
            else:
                inertia = body.axial_inertia(identified.pi[index])
                self.not_carried.append(Part("rotor", body.name, _NO_PLACE, inertia, "kg·m²"))
        self.not_carried += [_without_place(part) for part in identified.offsets]
        self.not_carried += identified.others

    def add_changes(self, changes: Sequence[ChangeReport]) -> None:
        """Write the changes of a diagnosis; attributes to which other effects add too, with these."""
        changed = {(change.effect, change.joint) for change in changes}
        for term in self.identified.terms:
            if (term.effect, term.joint) not in changed:
                self._add_term(term)
        for change in changes:
            if change.effect == RIGID_BODY:
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
        mass = change.parameters["mass"].simulator
        com = np.array(change.parameters["com"].simulator)
        self.bodies.append(BodyChange(part, body, pi, mass, com))

    def _add_change(self, change: ChangeReport) -> None:
        """Write another effect as the robot has it, or remove one that it does not have."""
        model = self.identified.model
        simulator = _forward_effect(change, "simulator", model)
        robot = _forward_effect(change, "robot", model)
        mechanisms = (simulator.mechanism, robot.mechanism)
        part = _part(change, _torque_delay(simulator.mechanism) - _torque_delay(robot.mechanism))
        if change.joint in self.forces:
            self._add_term(EffectTorque(change.effect, str(change.joint), robot.elements, ()))
        changed_bodies = np.flatnonzero(
            (simulator.mechanism.pi != 0).any(axis=1) | (robot.mechanism.pi != 0).any(axis=1)
        )
        if len(changed_bodies):  # the one that a payload's link is part of
            index = int(changed_bodies[0])
            self._add_body(index, part, simulator.mechanism.pi[index])
        elif simulator.changes_gravity or robot.changes_gravity:
            self.gravity = robot.mechanism.gravity
            self.tilt = part
        elif change.joint in self.forces and any(mechanism.armature.any() for mechanism in mechanisms):
            self.forces[str(change.joint)].armature = float(robot.mechanism.armature.sum())
            self._add_joint(part, ("armature",))
        else:
            self._add_joint(part, _attributes(robot.elements or simulator.elements))

    def _add_term(self, term: EffectTorque) -> None:
        """Add torque to the attributes of a joint."""
        if _attributes(term.elements):
            self.forces.add_term(term)

    def _add_joint(self, part: Part, attributes: tuple[str, ...]) -> None:
        """Write attributes of a joint; without any, the file has no place for the part."""
        if attributes:
            self.joints.append(JointChange(part, attributes))
        else:
            self.not_carried.append(part)

    def _add_body(self, index: int, part: Part, payload: Array | None = None) -> None:
        """Write a body that in the file has the inertia of the URDF, with a payload of the simulator, shape (10,)."""
        body = self.identified.model.bodies[index]
        present = body.pi
        source = "the URDF's"
        if payload is not None and payload.any():
            present = present + payload
            source = "the URDF's with the simulator's payload"
        mass, com, _ = mass_com_inertia(present)
        self.bodies.append(BodyChange(part, body, self.identified.pi[index], mass, com, source))


@dataclass(frozen=True)
class _ForwardEffect:
    """Simulator elements and mechanism of an effect; empty on a side that does not have it."""

    elements: tuple[SimulatorElement, ...]
    mechanism: Mechanism
    changes_gravity: bool = False


def _forward_effect(change: ChangeReport, side: Literal["simulator", "robot"], model: RobotModel) -> _ForwardEffect:
    """The effect of a change, as the simulator or the robot has it; a value that was not fitted is the other side's."""
    values = {name: getattr(parameter, side) for name, parameter in change.parameters.items()}
    if change.effect not in effect_types() or all(value is None for value in values.values()):
        return _ForwardEffect((), Mechanism(model))
    for name, parameter in change.parameters.items():
        if values[name] is None:
            values[name] = parameter.robot if side == "simulator" else parameter.simulator
    entry = EffectEntry(effect=change.effect, joint=change.joint, link=change.link, parameters=values)
    effect = effect_from_entry(entry, model)
    theta = np.array([c.prior for c in effect.coefficients])
    mechanism = mechanism_of(effect, model)
    changes_gravity = bool((mechanism.gravity != model.gravity).any())
    return _ForwardEffect(effect.simulator_elements(theta), mechanism, changes_gravity)


def _torque_delay(mechanism: Mechanism) -> float:
    """Delay of the torque [s]."""
    delay = mechanism.torque_delay
    return float(delay[np.argmax(np.abs(delay))])


def _attributes(elements: Iterable[SimulatorElement]) -> tuple[str, ...]:
    """Attributes of a joint in MJCF that together are some elements; empty if one of them is none."""
    names: list[str] = []
    for element in elements:
        if type(element) not in _ATTRIBUTES or (isinstance(element, FrictionLoss) and element.level < 0):
            return ()
        names += _ATTRIBUTES[type(element)]
    return tuple(dict.fromkeys(names))


def _without_place(part: Part) -> Part:
    """A part of the model, as it is listed if the file has no place for it."""
    return replace(part, detail=_NO_PLACE)


def _part(change: ChangeReport, delay: float) -> Part:
    """A change that the file has no place for, or one by which the torque acts ``delay`` [s] later on the robot."""
    owner = owner_name(change)
    if delay:
        late = "later" if delay > 0 else "earlier"
        detail = (
            f"the torque acts {short_number(1e3 * abs(delay))} ms {late} on the robot; change the simulator's "
            "controller"
        )
        return Part(change.effect, owner, detail, delay, "s")
    is_in_simulator = any(parameter.simulator is not None for parameter in change.parameters.values())
    texts = []
    for name, parameter in change.parameters.items():
        values = [_value_text(parameter.robot)]
        if parameter.simulator is not None or not is_in_simulator:  # else its logs do not show the value
            values.insert(0, _value_text(parameter.simulator))
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
    return number(value, 4) if isinstance(value, float | int) else str(value)
