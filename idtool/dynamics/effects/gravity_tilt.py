"""A base that is not level."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Self

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.entry_parameters import check_parameter_names, entry_location, read_vector
from idtool.dynamics.effects.fixed_effect import FixedEffect
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel

_MAX_TILT = 0.7  # share of gravity across: a base that leans more is mounted so by intention


class GravityTilt(FixedEffect):
    """Gravity is this vector in the root link's frame [m/s²], in place of the configuration's.

    Parameters
    ----------
    model
        The robot.
    gravity
        Shape (3,) [m/s²].
    """

    id = "gravity_tilt"
    whole_robot_owner = "the base"
    description = "the base is not level"
    excitation_hint = "standstill in many postures of the first joints"
    cause = "position"
    is_screened_to_first_order = True

    def __init__(self, model: RobotModel, gravity: Array) -> None:
        super().__init__(model)
        self.gravity = gravity

    @classmethod
    @override
    def from_entry(cls, entry: EffectEntry, model: RobotModel) -> Self:
        if entry.joint is not None or entry.link is not None:
            raise ConfigError(entry_location(entry), "acts on the whole robot; give neither joint nor link")
        check_parameter_names(entry, ("gravity",))
        if model.has_floating_base:
            raise ConfigError(
                entry_location(entry), "needs a fixed base; the accelerometer of a floating one shows gravity"
            )
        return cls(model, read_vector(entry, "gravity", 3))

    @classmethod
    @override
    def probes(cls, summary: DataSummary) -> Iterator[Probe]:
        """One probe: gravity of the same size in another direction."""
        gravity = summary.model.gravity
        size = float(np.linalg.norm(gravity))
        if summary.has_effect(cls.id, "base") or not size:
            return
        directions = np.linalg.svd(gravity[None] / size)[2]  # the first along gravity, the others across

        def columns(motion: Motion, linearized: Linearization) -> Mapping[int, Array]:
            changes = np.stack([linearized.torque_change_by_gravity(direction) for direction in directions])
            return {j: changes[:, j] for j in range(len(motion.q))}

        def to_entry(c: Array, information: Array) -> EffectEntry | None:
            # The component along gravity follows from those across, since the size is known.
            across = float(np.linalg.norm(c[1:]))
            if across > _MAX_TILT * size:
                return None
            tilted = gravity * np.sqrt(1 - (across / size) ** 2) + c[1:] @ directions[1:]
            return EffectEntry(effect=cls.id, parameters={"gravity": [float(x) for x in tilted]})

        yield Probe(
            effect=cls.id,
            joint=None,
            link=None,
            columns=columns,
            coefficient_count=3,
            to_entry=to_entry,
            parameter_count=2,
        )

    @classmethod
    @override
    def gradient_parameters(cls) -> tuple[str, ...]:
        return "gravity.0", "gravity.1", "gravity.2"

    @classmethod
    @override
    def feasible_entry(cls, entry: EffectEntry, model: RobotModel) -> EffectEntry:
        """Gravity in the same direction, of the size of the robot's."""
        given = np.asarray(entry.values["gravity"], dtype=float)
        gravity = given * (np.linalg.norm(model.gravity) / np.linalg.norm(given))
        return entry.model_copy(update={"parameters": {"gravity": gravity.tolist()}})

    @property
    @override
    def key(self) -> tuple[str | float, ...]:
        return self.id, "base"

    @override
    def parameter_units(self) -> dict[str, str]:
        return {"gravity": "m/s²"}

    @override
    def modify_model(self, model: RobotModel) -> RobotModel:
        return replace(model, gravity=self.gravity)

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        """Add nothing: gravity comes with the rigid bodies."""
