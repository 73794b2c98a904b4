"""`UrdfPatch`: edits that bring the values of a plan into a user's URDF."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.number_text import number
from idtool.reporting.export.base import Part
from idtool.reporting.export.file_patch import DIGITS, FilePatch, number_text
from idtool.reporting.export.patch_plan import BodyChange, JointChange, PatchPlan
from idtool.reporting.export.present_values import has_urdf_inertia, has_value
from idtool.robot.inertia import round_to_digits
from idtool.robot.urdf.writing import JointDynamics, link_parameters, replace_parameters

_URDF_NAMES = {"damping": "damping", "frictionloss": "friction"}


class UrdfPatch(FilePatch):
    """Edits of a URDF."""

    def __init__(self, plan: PatchPlan, path: Path, text: bytes) -> None:
        super().__init__(plan, path, text)
        self._joints = {element.name: element for element in self.root.with_tag("joint")}
        self._links = {element.name: element for element in self.root.with_tag("link")}
        self._dynamics: dict[str, JointDynamics] = {}
        self._inertias: dict[str, Array | None] = {}

    @override
    def set_joint(self, change: JointChange) -> None:
        joint_name = change.part.of
        forces = self.plan.forces[joint_name]
        needs_drag = "damping" in change.attributes and forces.drag
        if needs_drag or not set(change.attributes) <= set(_URDF_NAMES):
            self.not_carried.append(change.part)
            return
        present = self.find_joint(self._joints, joint_name).first("dynamics")
        attributes = present.attributes if present else {}
        details = []
        for mjcf_name in change.attributes:
            name = _URDF_NAMES[mjcf_name]
            value = float(round_to_digits(getattr(forces, mjcf_name), DIGITS))
            if not has_value(attributes.get(name, "0"), number_text(value), DIGITS):
                dynamics = self._dynamics.get(joint_name, JointDynamics())
                self._dynamics[joint_name] = replace(dynamics, **{name: value})
                details.append(f"{name} {attributes.get(name, 'none')} → {number_text(value)}")
        if details:
            self.carried.append(replace(change.part, detail=", ".join(details)))

    @override
    def set_gravity(self, tilt: Part) -> None:
        """List gravity, which no URDF has."""
        self.not_carried.append(tilt)

    @override
    def set_body(self, change: BodyChange) -> None:
        new = link_parameters(change.body, change.pi, self.plan.identified.robot.links)
        if not set(new) <= set(self._links):
            self.not_carried.append(replace(change.part, detail="the file has no such link"))
            return
        if all(has_urdf_inertia(self._links[name], pi) for name, pi in new.items()):
            return
        self._inertias |= new
        mass = number(float(change.pi[0]), 4)
        self.carried.append(replace(change.part, detail=f"inertial, mass {number(change.mass, 4)} → {mass}"))

    @override
    def edited_text(self) -> bytes:
        return replace_parameters(self.text, self._inertias, self._dynamics)
