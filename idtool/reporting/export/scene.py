"""`Scene`: a MuJoCo model while it is written, and how MJCF spells things."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.reporting.export.base import Part
from idtool.reporting.export.identified import IdentifiedModel
from idtool.reporting.export.inertia_check import is_acceptable, slack, unrealizable_error
from idtool.reporting.export.joints import ForcesByJoint
from idtool.robot.inertia import PI_SIZE, mass_com_inertia, symmetric_entries

MUJOCO_MINIMUM = (
    1e-12  # kg, kg·m²: what MuJoCo takes for a body that can move, and by how much triangle inequalities must hold
)


@dataclass
class Scene:
    """A MuJoCo model while it is written.

    Attributes
    ----------
    identified
        The identified model.
    moving
        Index in the model of every link that moves.
    pi
        Parameters that are written, by index in the model, shape (10,) each; −1 is the root link.
    forces
        Attributes of the model's joints.
    bodies
        Link or rotor name to its body's element.
    tendons, equalities, actuators
        Sections.
    constants
        Actuators that take no control.
    carried, not_carried
        Parts of the model in the file, and those that are missing.
    """

    identified: IdentifiedModel
    moving: dict[str, int] = field(init=False)
    pi: dict[int, Array] = field(init=False)
    forces: ForcesByJoint = field(init=False)
    bodies: dict[str, etree._Element] = field(default_factory=dict)
    tendons: etree._Element = field(default_factory=lambda: etree.Element("tendon"))
    equalities: etree._Element = field(default_factory=lambda: etree.Element("equality"))
    actuators: etree._Element = field(default_factory=lambda: etree.Element("actuator"))
    constants: list[etree._Element] = field(default_factory=list)
    carried: list[Part] = field(default_factory=list)
    not_carried: list[Part] = field(default_factory=list)

    def __post_init__(self) -> None:
        bodies = self.identified.model.bodies
        self.moving = {body.name: i for i, body in enumerate(bodies) if body.kind == "link"}
        self.pi = {i: self.identified.pi[i].copy() for i in self.moving.values()}
        self.pi[-1] = self.urdf_parameters(self.identified.robot.root)
        self.forces = ForcesByJoint(self.identified.model.joint_names)

    def urdf_parameters(self, link: str) -> Array:
        """A link's parameters in the URDF, shape (10,)."""
        pi = self.identified.robot.links[link]
        return np.zeros(PI_SIZE) if pi is None else pi.copy()

    def carrier(self, index: int) -> str:
        """The link whose frame is that of a body of the model, −1 being the root."""
        return self.identified.robot.root if index < 0 else self.identified.model.bodies[index].name

    def add_tendon(
        self, name: str, coefficients: Mapping[str, float], attributes: Mapping[str, str] | None = None
    ) -> str:
        """Add a tendon whose length is a combination of joint positions; returns its name, which nothing else bears."""
        while any(tendon.get("name") == name for tendon in self.tendons):
            name += "_"
        tendon = etree.SubElement(self.tendons, "fixed", {"name": name, **(attributes or {})})
        for joint, coefficient in coefficients.items():
            etree.SubElement(tendon, "joint", joint=joint, coef=repr(float(coefficient)))
        return name

    def add_inertial(self, name: str, pi: Array, moves: bool) -> None:
        """Give a body its inertial; what stands still needs none.

        Raises
        ------
        ModelError
            If it moves and its inertia is none that a body can have.
        """
        if not moves and not pi[0] > 0:
            return
        if not is_acceptable(pi):
            if moves:
                raise unrealizable_error(self.identified.robot, name)
            return
        mass, com, inertia = mass_com_inertia(pi)
        if not mass:
            self.not_carried.append(
                Part(
                    "inertial",
                    name,
                    "MuJoCo does not accept a body without mass, so the body gets the smallest accepted mass",
                    MUJOCO_MINIMUM,
                    "kg",
                )
            )
        if moves:
            self.carried.append(Part("inertial", name, "mass including everything fixed to it", mass, "kg"))
        inertia = inertia + max(0.0, MUJOCO_MINIMUM - slack(inertia)) * np.eye(3)
        xx, xy, yy, xz, yz, zz = symmetric_entries(inertia)
        full = text([xx, yy, zz, xy, xz, yz])
        etree.SubElement(
            self.bodies[name], "inertial", pos=text(com), mass=repr(max(mass, MUJOCO_MINIMUM)), fullinertia=full
        )


def text(values: Array | list[float]) -> str:
    """Numbers as an attribute, to the last digit."""
    return " ".join(repr(float(x)) for x in values)


def quaternion(R: Array) -> str:
    """A rotation (3, 3) as an attribute, the real part first."""
    return text(Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True))


def comment(lines: list[str]) -> etree._Comment:
    """Lines as a comment; two hyphens in a row, which a name may have, would end it."""
    text = "\n".join(["", *lines, ""])
    return etree.Comment(text.replace("--", "- -").replace("--", "- -"))
