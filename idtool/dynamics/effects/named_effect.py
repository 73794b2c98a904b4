"""`NamedEffect`: an effect that a configuration can name under `effects`.

Its parameters (docs/pages/effects.md) are of two kinds: linear ones, which follow from its coefficients and are
identified, and nonlinear ones, which a fit leaves as they are and on which its columns depend.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.effect import Effect
from idtool.dynamics.effects.init_trial import InitTrial
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.effects.simulator_element import SimulatorElement
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel

ParameterValue = tuple[float, float | None]  # and its standard error; None: not known
Cause = Literal[
    "position", "velocity", "acceleration", "torque", "torque_rate", "distance_since_reversal", "time"
]  # of a torque


@dataclass(frozen=True)
class NonlinearParameter:
    """A parameter on which an effect's columns depend.

    Attributes
    ----------
    name
        As in docs/pages/effects.md.
    units
        On a revolute joint, and on a prismatic one; "1": without a unit.
    positive
        True if it must be above 0.
    is_joint
        True if it names another joint; the effect then has that joint's index.
    distinguishes_instances
        True if a joint may have the effect more than once, with different values of this.
    max_standard_error
        Largest standard error with which the effect is still reported; None: a share of the value, if that is positive.
    max_relative_error
        That share.
    optional_maximum
        Largest value of a parameter that may be left out and is then 0; None: it may not be left out.
    choices
        The only values that it may have; it may then be left out. Empty: it is continuous.
    open_ended
        True if the effect is reported whatever the value's standard error, even at an end of what the search tries.
    arbitrary_beside
        Id of an effect; on a joint that has it, the value has no influence. None: it always has.
    """

    name: str
    units: tuple[str, str] = ("1", "1")
    positive: bool = False
    is_joint: bool = False
    distinguishes_instances: bool = False
    max_standard_error: float | None = None
    max_relative_error: float = 0.4
    optional_maximum: float | None = None
    choices: tuple[float, ...] = ()
    open_ended: bool = False
    arbitrary_beside: str | None = None

    @property
    def may_be_left_out(self) -> bool:
        """True if an entry need not give it."""
        return self.optional_maximum is not None or bool(self.choices)

    @property
    def is_continuous(self) -> bool:
        """False if it names a joint, or has a few values only."""
        return not self.is_joint and not self.choices


class NamedEffect(Effect):
    """An effect with an id. One that acts on a joint is a `JointEffect`.

    All that other parts of the package need to know of an effect is here, with defaults that suit a new one.

    Attributes
    ----------
    id
        Its name in a configuration; empty for a base class or a part of another effect.
    label
        Its name in a sentence; empty: the id with spaces.
    is_countable
        True if the label takes an article, as in "a payload".
    whole_robot_owner
        What it acts on in a sentence, where an entry names neither joint nor link.
    description
        What the effect is, in a few words for the user.
    excitation_hint
        The motion that excites it.
    nonlinear_parameters
        The parameters on which its columns depend.
    generalizes
        Simpler effects that it can imitate. They are preferred unless the data insist.
    requires
        Effects of which the joint must have at least one, since this effect modifies them.
    cause
        What a diagnosis draws its torque against. The torque is that of the actuator as the model predicts it.
    follows_direction
        True if its torque changes its sign with the direction of motion, and is drawn along this direction.
    is_friction
        True for friction, which may act on the motor side of a transmission.
    acts_at_reversals
        True if it is visible where a joint reverses; not needed for friction.
    is_undefined_where_it_acts
        True if its columns are undefined at the very samples that show it, as while the teeth of a backlash are apart.
        It is then judged by the samples at which the model without it is defined.
    is_screened_to_first_order
        True if a candidate's torque is taken to first order in its parameter, so that its fit may explain much more.
    reportable
        True if `diagnose` may name it; else it is only included in the fit, so that it does not hide other effects.
    acts_in_bursts
        True if it explains intervals of time in which the residual is unusually large.
    may_act_on_all_joints
        True if it acts on one joint or, where an entry names none, on all.
    is_commonplace
        True if any joint may well have it, so that torque which it explains shows no fault of the data.
    is_rotor_inertia
        True for inertia of a joint's rotor, which is on the motor side of a transmission. It is not tried on a joint
        with a rotor under `rotors`.
    friction_key
        Key under `friction` by which a configuration has it too, and by which reports list it; empty: none.
    urdf_attribute
        Attribute of `<dynamics>` in a URDF that is its prior; empty: none.
    init_trial
        How `init` tries it; None: it does not.
    """

    id: str = ""
    label: str = ""
    is_countable: bool = False
    whole_robot_owner: str = "all joints"
    description: str = ""
    excitation_hint: str = ""
    nonlinear_parameters: tuple[NonlinearParameter, ...] = ()
    generalizes: tuple[str, ...] = ()
    requires: tuple[str, ...] = ()
    cause: Cause = "velocity"
    follows_direction: bool = False
    is_friction: bool = False
    acts_at_reversals: bool = False
    is_undefined_where_it_acts: bool = False
    is_screened_to_first_order: bool = False
    reportable: bool = True
    acts_in_bursts: bool = False
    may_act_on_all_joints: bool = False
    is_commonplace: bool = False
    is_rotor_inertia: bool = False
    friction_key: str = ""
    urdf_attribute: Literal["", "damping", "friction"] = ""
    init_trial: InitTrial | None = None

    @classmethod
    def probes(cls, summary: DataSummary) -> Iterator[Probe]:
        """Hypotheses of this effect missing from a model."""
        yield from ()

    @classmethod
    def gradient_parameters(cls) -> tuple[str, ...]:
        """Nonlinear parameters that a search moves along a gradient; ``com.0`` is the first element of a list."""
        return ()

    @classmethod
    def feasible_entry(cls, entry: EffectEntry, model: RobotModel) -> EffectEntry:
        """The entry after a step along the gradient, or the nearest one that physics allows."""
        return entry

    @classmethod
    def coefficients_of(cls, entry: EffectEntry, model: RobotModel) -> tuple[Probe, Array] | None:
        """Probe in whose k coefficients an entry is linear, and their values, shape (k,); None: in none."""
        return None

    @classmethod
    def grid_parameters(cls) -> tuple[str, ...]:
        """Nonlinear parameters that a search finds by trying values, since the columns jump with them."""
        return ()

    @classmethod
    def joint_parameters(cls) -> tuple[str, ...]:
        """Nonlinear parameters that name another joint."""
        return tuple(parameter.name for parameter in cls.nonlinear_parameters if parameter.is_joint)

    @classmethod
    def background_entry(cls) -> EffectEntry | None:
        """Entry that a search fits along without naming it, since every log has a little of it; None: no log has."""
        return None

    @classmethod
    def is_background(cls, entry: EffectEntry, dt: float) -> bool:
        """True if an entry has no more of the effect than every log with a sample time ``dt`` [s]."""
        return False

    @classmethod
    def implausibility(cls, values: Mapping[str, Any], joint: str | None, summary: DataSummary) -> str:
        """Reason why no robot has such an effect, as a clause; empty if one may.

        Parameters
        ----------
        values
            All parameters by name.
        joint
            The joint; None if the effect acts on none.
        summary
            The robot and its data.
        """
        return ""

    @classmethod
    def doubt(cls, entries: Sequence[EffectEntry], model: RobotModel) -> str:
        """Reason to doubt effects of this kind, which may stand in for something else, as a sentence; empty if none.

        Parameters
        ----------
        entries
            All effects of this kind that were found.
        model
            The robot.
        """
        return ""

    @classmethod
    @abstractmethod
    def from_entry(cls, entry: EffectEntry, model: RobotModel) -> NamedEffect:
        """Effect that an entry describes; the entry's values are the prior of its coefficients.

        Raises
        ------
        ConfigError
            If the entry names something that does not exist, or a parameter is missing, unknown or out of range.
        """

    @property
    @abstractmethod
    def key(self) -> tuple[str | float, ...]:
        """Id, what the effect acts on, and what distinguishes it from others on the same."""

    def distance_to(self, other: NamedEffect) -> float:
        """Distance to an effect of another model, as a share of what distinguishes several on one joint; 0: the same.

        It is infinite if the two cannot be the same with other values.
        """
        return 0.0 if self.key == other.key else np.inf

    @abstractmethod
    def parameters(self, theta: Array, covariance: Array) -> dict[str, ParameterValue]:
        """Linear parameters with their standard errors.

        Parameters
        ----------
        theta
            The coefficients, shape (m,).
        covariance
            Covariance of their errors, shape (m, m); infinite where it is not known.
        """

    @property
    def cause_joint(self) -> int | None:
        """Index of the joint that the `cause` is of; None: the one whose torque is drawn."""
        return None

    @property
    def cause_period(self) -> float | None:
        """Period of the torque over the position, if that is the `cause` [rad or m]; None: it has none."""
        return None

    def parameter_units(self) -> dict[str, str]:
        """Unit of each parameter; "1" for one without."""
        return {}

    def simulator_elements(self, theta: Array) -> tuple[SimulatorElement, ...]:
        """Simulator elements whose torques sum to the effect's; empty if simulators have none.

        Parameters
        ----------
        theta
            The coefficients, shape (m,).
        """
        return ()


def config_parameters(values: Mapping[str, ParameterValue]) -> dict[str, dict[str, float]]:
    """Parameters in the form that a configuration has."""
    parameters = {}
    for name, (value, error) in values.items():
        parameters[name] = {"value": value}
        if error is not None:
            parameters[name]["standard_error"] = error
    return parameters
