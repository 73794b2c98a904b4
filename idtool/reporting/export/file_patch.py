"""`FilePatch`: edits that bring the values of a plan into a simulator's file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path

from idtool.common.arrays import Array
from idtool.common.exceptions import ModelError
from idtool.common.names import suggestion
from idtool.reporting.export.base import Part
from idtool.reporting.export.inertia_check import is_acceptable, unrealizable_error
from idtool.reporting.export.patch_plan import BodyChange, JointChange, PatchPlan
from idtool.robot.inertia import round_to_digits
from idtool.robot.urdf.text import Element, root_element

DIGITS = 6  # of what is written


class FilePatch(ABC):
    """Edits of a simulator's file.

    Attributes
    ----------
    plan
        The new values.
    path, text
        The file and its content.
    root
        Its root element.
    carried
        Parts that are in the patched file and were not in it before.
    not_carried
        Parts of the plan that the file turns out to have no place for.
    """

    def __init__(self, plan: PatchPlan, path: Path, text: bytes) -> None:
        self.plan = plan
        self.path = path
        self.text = text
        self.root = root_element(text)
        self.carried: list[Part] = []
        self.not_carried: list[Part] = []

    def patched(self) -> bytes:
        """The file with the values of the plan."""
        for joint_change in self.plan.joints:
            self.set_joint(joint_change)
        if self.plan.tilt is not None:
            self.set_gravity(self.plan.tilt)
        for body_change in self.plan.bodies:
            if not is_acceptable(body_change.pi):
                raise unrealizable_error(self.plan.identified.robot, body_change.body.name)
            self.set_body(body_change)
        return self.edited_text()

    @abstractmethod
    def set_joint(self, change: JointChange) -> None:
        """Edit the attributes of a joint."""

    @abstractmethod
    def set_gravity(self, tilt: Part) -> None:
        """Edit gravity."""

    @abstractmethod
    def set_body(self, change: BodyChange) -> None:
        """Edit the inertia of a body."""

    @abstractmethod
    def edited_text(self) -> bytes:
        """The file with the edits."""

    def find_joint(self, joints: Mapping[str, Element], name: str) -> Element:
        """The joint of a name.

        Raises
        ------
        ModelError
            If there is none.
        """
        if name in joints:
            return joints[name]
        hint = "give the file that it includes" if b"<include" in self.text else suggestion(name, joints)
        raise ModelError(self.path, f"has no joint named {name}; {hint}")


def number_text(value: float) -> str:
    """A number as an attribute."""
    return repr(float(round_to_digits(value, DIGITS)))


def vector_text(values: Array) -> str:
    """Numbers of one unit as an attribute."""
    return exact_text(round_to_digits(values, DIGITS))


def exact_text(values: Iterable[float]) -> str:
    """Numbers as an attribute, with all their digits."""
    return " ".join(repr(float(x)) for x in values)
