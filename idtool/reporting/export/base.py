"""`Export`: a file's content, the parts of the model in it, and the parts that are missing."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from idtool.common.dataclass import dataclass
from idtool.common.number_text import short_number


@dataclass(frozen=True)
class Part:
    """A part of the model.

    Attributes
    ----------
    what
        Its kind: an effect's id, or one of inertial, rotor, gravity, joint_limit, mimic, locked_joint, geometry.
    of
        The joint, link or rotor.
    detail
        How the file carries it, or what of it is not carried.
    value, unit
        How much that is.
    """

    what: str
    of: str
    detail: str
    value: float | None = None
    unit: str | None = None

    def __str__(self) -> str:
        amount = "" if self.value is None else f", {short_number(self.value)} {self.unit}"
        return f"{self.what} of {self.of}: {self.detail}{amount}"


@dataclass(frozen=True)
class Export:
    """A model file for a simulator.

    Attributes
    ----------
    name
        What the file is called where the user does not say.
    text
        Its contents.
    carried, not_carried
        The model's parts that are in it, and those that are not, or not all of them.
    """

    name: str
    text: bytes
    carried: tuple[Part, ...]
    not_carried: tuple[Part, ...]

    def to_dict(self) -> dict[str, Any]:
        """The parts that are carried and those that are not, as plain data."""
        return {
            "carried": [asdict(part) for part in self.carried],
            "not_carried": [asdict(part) for part in self.not_carried],
        }
