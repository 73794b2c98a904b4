"""Balls by which the feet touch the ground that are larger or smaller than configured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Self

from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.entry_parameters import check_parameter_names, entry_location, read_number
from idtool.dynamics.effects.fixed_effect import FixedEffect
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel

_MIN_CHANGE = 1.5e-3  # m; a soft foot gives way by a millimetre
_MAX_CHANGE = 0.1  # m


class FootRadius(FixedEffect):
    """Error of the radius of the balls by which a robot with a floating base touches the ground, the same for all.

    Parameters
    ----------
    model
        The robot, with a floating base.
    change
        True less configured radius [m].
    """

    id = "foot_radius"
    label = "foot radius"
    is_countable = True
    whole_robot_owner = "the feet"
    is_screened_to_first_order = True
    description = "the feet are larger than the `radius` of their contacts (smaller if the change is negative)"
    excitation_hint = "swaying and steps"
    cause = "time"

    def __init__(self, model: RobotModel, change: float) -> None:
        super().__init__(model)
        self.change = change

    @classmethod
    @override
    def from_entry(cls, entry: EffectEntry, model: RobotModel) -> Self:
        if entry.joint is not None or entry.link is not None:
            raise ConfigError(entry_location(entry), "acts on all feet; give neither joint nor link")
        check_parameter_names(entry, ("change",))
        if not model.has_floating_base:
            raise ConfigError(entry_location(entry), "needs a floating base; set base.kind, or remove it")
        change = read_number(entry, "change")
        if abs(change) > _MAX_CHANGE:
            raise ConfigError(entry_location(entry), f"a change of {change:g} m is too large for a foot; give it in m")
        return cls(model, change)

    @classmethod
    @override
    def probes(cls, summary: DataSummary) -> Iterator[Probe]:
        """One probe of all balls together."""
        if not summary.has_balls or summary.has_effect(cls.id, "feet"):
            return

        def columns(motion: Motion, linearized: Linearization) -> Mapping[int, Array]:
            return {row: own[None] for row, own in enumerate(linearized.torque_change_by_ball_radius())}

        def to_entry(c: Array, information: Array) -> EffectEntry | None:
            change = float(c[0])
            if not _MIN_CHANGE < abs(change) < _MAX_CHANGE:
                return None
            return EffectEntry(effect=cls.id, parameters={"change": change})

        yield Probe(effect=cls.id, joint=None, link=None, columns=columns, coefficient_count=1, to_entry=to_entry)

    @classmethod
    @override
    def gradient_parameters(cls) -> tuple[str, ...]:
        return ("change",)

    @override
    def parameter_units(self) -> dict[str, str]:
        return {"change": "m"}

    @property
    @override
    def key(self) -> tuple[str | float, ...]:
        return self.id, "feet"

    @override
    def correct_motion(self, motion: Motion) -> Motion:
        """Motion whose contacts have the true radius."""
        contacts = motion.contacts
        if contacts is None or not self.change:
            return motion
        return replace(motion, contacts=replace(contacts, radius_change=contacts.radius_change + self.change))

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        """Add nothing: the legs are simulated in the air."""
