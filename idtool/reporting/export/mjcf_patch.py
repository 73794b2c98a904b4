"""`MjcfPatch`: edits that bring the values of a plan into a user's MJCF."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.exceptions import ModelError
from idtool.common.number_text import number
from idtool.reporting.export.base import Part
from idtool.reporting.export.file_patch import DIGITS, FilePatch, exact_text, number_text, vector_text
from idtool.reporting.export.patch_plan import BodyChange, JointChange, PatchPlan
from idtool.reporting.export.present_values import default_attributes, has_mjcf_inertia, has_value, is_turned
from idtool.robot.inertia import round_to_digits, rounded_inertial, symmetric_entries
from idtool.robot.urdf.text import Edit, Element, apply_edits, set_attribute

_GRAVITY = "0 0 -9.81"  # MuJoCo's default
_MASS_TOLERANCE = 0.01  # relative, by which a body's mass in the file may differ from the expected one
_COM_TOLERANCE = 2e-3  # m


class MjcfPatch(FilePatch):
    """Edits of an MJCF.

    Raises
    ------
    ModelError
        If it has no ``<worldbody>``.
    """

    def __init__(self, plan: PatchPlan, path: Path, text: bytes) -> None:
        super().__init__(plan, path, text)
        if self.root.first("worldbody") is None:
            raise ModelError(path, "has no <worldbody>; give the file that has the robot's bodies")
        self._world = [element for section in self.root.with_tag("worldbody") for element in section.descendants()]
        self._joints = {element.name: element for element in self._world if element.tag == "joint"}
        self._bodies = {element.name: element for element in self._world if element.tag == "body"}
        self._has_include = b"<include" in text
        self._defaults = default_attributes(self.root, "joint")
        self._edits: dict[tuple[int, str], Edit] = {}  # by element and attribute, which several effects may change

        if plan.identified.model.has_floating_base and not self._has_free_joint():
            base = plan.identified.model.bodies[0].name
            self.not_carried.append(
                Part("floating_base", base, "the file has no free joint, so that its base is fixed")
            )

    def _has_free_joint(self) -> bool:
        """True if the base of a robot in the file moves freely, or if another file may say so."""
        joints = [element for element in self._world if element.tag in ("freejoint", "joint")]
        is_free = [joint.tag == "freejoint" or joint.attributes.get("type") == "free" for joint in joints]
        return any(is_free) or self._has_include

    @override
    def set_joint(self, change: JointChange) -> None:
        element = self.find_joint(self._joints, change.part.of)
        details = []
        for name in change.attributes:
            value = self._joint_value(element, change.part.of, name)
            present = self._present_value(element, name)
            if not has_value(present, value, DIGITS):
                self._edits[element.start, name] = set_attribute(self.text, element, name, value)
                details.append(f"{name} {present or 'default'} → {value}")
        if details:
            self.carried.append(replace(change.part, detail=", ".join(details)))

    @override
    def set_gravity(self, tilt: Part) -> None:
        turned = self._turned_base()
        if turned is not None:
            values = ", ".join(number(float(x), 4) for x in self.plan.gravity)
            detail = (
                f"the file turns {turned.tag} {turned.name}".rstrip() + " and the robot with it; set gravity by hand: "
                f"it is [{values}] m/s² in the root link's frame"
            )
            self.not_carried.append(replace(tilt, detail=detail))
            return
        gravity = vector_text(self.plan.gravity)
        option = self.root.first("option")
        default = None if self._has_include else _GRAVITY
        present = option.attributes.get("gravity", default) if option else default
        if not has_value(present, gravity, DIGITS):
            self._edits[0, "gravity"] = self._set_option("gravity", gravity)
            self.carried.append(replace(tilt, detail=f"gravity → {gravity}"))

    @override
    def set_body(self, change: BodyChange) -> None:
        body = self._bodies.get(change.body.name)
        inertial = body.first("inertial") if body else None
        if inertial is None:
            self.not_carried.append(replace(change.part, detail="the file has no inertial of this body"))
            return
        if reason := self._inertial_mismatch(inertial, change):
            self.not_carried.append(replace(change.part, detail=reason))
            return
        if has_mjcf_inertia(inertial, change.pi):
            return
        mass, new = _inertial(change.pi)
        self._edits[inertial.start, ""] = Edit(inertial.start, inertial.stop, new.encode())
        detail = f"inertial, mass {inertial.attributes['mass']} → {mass!r}"
        self.carried.append(replace(change.part, detail=detail))

    @override
    def edited_text(self) -> bytes:
        return apply_edits(self.text, _merged(self._edits.values()))

    def _attribute(self, joint: Element, name: str) -> str | None:
        """An attribute of a joint, its own or that of its default class; None if neither has it."""
        own_class = joint.attributes.get("class", self._child_class(joint))
        inherited = self._defaults.get(own_class, {})
        return joint.attributes.get(name, inherited.get(name))

    def _present_value(self, joint: Element, name: str) -> str | None:
        """An attribute of a joint that is 0 by default; None if another file may have it."""
        value = self._attribute(joint, name)
        return "0" if value is None and not self._has_include else value

    def _child_class(self, joint: Element) -> str:
        """Default class of a joint that names none: that of the innermost body around it that gives one."""
        child_class = ""
        for element in self._world:
            if element.start < joint.start < element.stop:
                child_class = element.attributes.get("childclass", child_class)
        return child_class

    def _joint_value(self, joint: Element, joint_name: str, name: str) -> str:
        """New value of an attribute of a joint."""
        forces = self.plan.forces[joint_name]
        if name == "springref":
            zero = self._numbers(joint, "ref", self._attribute(joint, "ref") or "0")[0]  # in the file's own unit
            is_angle = (self._attribute(joint, "type") or "hinge") == "hinge"
            unit = np.degrees(1.0) if is_angle and self._uses_degrees() else 1.0
            return number_text(forces.springref * unit + zero)
        if name == "damping" and forces.drag:
            return f"{number_text(forces.damping)} {number_text(forces.drag)}"
        return number_text(getattr(forces, name))

    def _uses_degrees(self) -> bool:
        """True if angles are in degrees, the default."""
        compilers = self.root.with_tag("compiler")
        angles = [compiler.attributes["angle"] for compiler in compilers if "angle" in compiler.attributes]
        return not angles or angles[-1] != "radian"

    def _turned_base(self) -> Element | None:
        """The body or frame by which the axes of the robot's root link are not those of the world; None: they are.

        The body of a joint of the root link is turned in the file if the URDF turns it too.
        """
        model = self.plan.identified.model
        joint_names = {joint.child: joint.name for joint in model.robot.joints.values()}
        for body in model.bodies:
            joint = self._joints.get(joint_names.get(body.name, ""))
            if joint is None or body.mount.body >= 0:
                continue
            enclosing = [element for element in self._world if element.start < joint.start < element.stop]
            holders = [element for element in enclosing if element.tag in ("body", "frame")]
            if not holders:
                raise ModelError(self.path, f"joint {joint.name} is in no body")
            *ancestors, own = holders
            is_turned_in_urdf = not np.allclose(body.mount.R, np.eye(3))
            for element in ancestors if is_turned_in_urdf else [*ancestors, own]:
                if is_turned(element):
                    return element
        return None

    def _set_option(self, name: str, value: str) -> Edit:
        """The edit that sets an option."""
        option = self.root.first("option")
        if option is not None:
            return set_attribute(self.text, option, name, value)
        start = self.root.content
        return Edit(start, start, f'\n  <option {name}="{value}"/>'.encode())

    def _inertial_mismatch(self, inertial: Element, change: BodyChange) -> str:
        """Reason why an inertial cannot be replaced, since it is not the expected one; empty if it is."""
        mass = float(self._numbers(inertial, "mass", inertial.attributes.get("mass", "0"))[0])
        com = self._numbers(inertial, "pos", inertial.attributes.get("pos", "0 0 0"), count=3)
        is_same_mass = abs(mass - change.mass) <= _MASS_TOLERANCE * change.mass
        if is_same_mass and np.abs(com - change.com).max() <= _COM_TOLERANCE:
            return ""
        return (
            f"the file's inertial, {_mass_and_com(mass, com)}, is not {change.source}, "
            f"{_mass_and_com(change.mass, change.com)}, so its frame is unknown"
        )

    def _numbers(self, element: Element, name: str, written: str, count: int = 1) -> Array:
        """The numbers in an attribute as written.

        Raises
        ------
        ModelError
            If it holds something else.
        """
        try:
            numbers = np.array([float(x) for x in written.split()])
        except ValueError:
            numbers = np.empty(0)
        if len(numbers) != count:
            expected = "a number" if count == 1 else f"{count} numbers"
            subject = f"{self.path}: {element.tag} {element.name}".rstrip()
            raise ModelError(subject, f"{name} is not {expected}: {written}")
        return numbers


def _mass_and_com(mass: float, com: Array) -> str:
    """Mass and centre of mass, for people."""
    return f"{number(mass, 4)} kg at [{exact_text(round_to_digits(com, 4))}] m"


def _inertial(pi: Array) -> tuple[float, str]:
    """Mass [kg] and element of a body's inertia."""
    mass, com, inertia = rounded_inertial(pi)
    xx, xy, yy, xz, yz, zz = symmetric_entries(inertia)
    full_inertia = exact_text([xx, yy, zz, xy, xz, yz])
    return mass, f'<inertial pos="{exact_text(com)}" mass="{mass!r}" fullinertia="{full_inertia}"/>'


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
