"""`InitTrial` and `InitSearch`: the way in which `init` tries an effect, and the words for the result."""

from __future__ import annotations

from idtool.common.dataclass import dataclass
from idtool.common.number_text import short_number


@dataclass(frozen=True)
class InitTrial:
    """Trial of a `JointTerm` on every joint that may have it; it is kept where it reduces the held-out torque error.

    Attributes
    ----------
    name
        In a sentence, such as "rotor inertia" in "rotor inertia does not show".
    heading
        In the list of what was found.
    comment
        Text in the configuration that is written; ``{value}`` stands for the value with its unit.
    needs_measured_torque
        True if it is not tried where the torque is computed from commands.
    """

    name: str
    heading: str
    comment: str = "{value}"
    needs_measured_torque: bool = False


@dataclass(frozen=True, kw_only=True)
class InitSearch(InitTrial):
    """Search for one nonlinear parameter of an effect on the whole robot, starting from 0.

    Attributes
    ----------
    parameter
        Its name.
    step
        First step of the search, as a share of the period of the filter's cut-off [s].
    maximum
        Largest size that is looked for.
    at_maximum
        Warnings where the best value is as large as that, positive and negative; ``{maximum}`` stands for the size with
        its unit.
    display_unit, display_factor
        Unit in which the value is shown, and how many of it make one in SI.
    """

    parameter: str
    step: float
    maximum: float
    at_maximum: tuple[str, str]
    display_unit: str
    display_factor: float

    def shown(self, value: float) -> str:
        """A value with its unit, for people."""
        return f"{short_number(self.display_factor * value)} {self.display_unit}"
