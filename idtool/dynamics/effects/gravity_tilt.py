"""A base that is not level."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Self

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.data.signals import Motion
from idtool.dynamics.effects.held_effect import HeldEffect
from idtool.dynamics.effects.named import check_names, place, vector
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.effects.survey import Present, Survey
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.config import EffectEntry
from idtool.robot.model import Model

_STEEP = 0.7  # of gravity across: a base that leans more is mounted so by intention


class GravityTilt(HeldEffect):
    """Gravity is this vector in the root link's frame [m/s²], in place of the configuration's.

    Parameters
    ----------
    model
        The robot.
    gravity
        Shape (3,).
    """

    id = "gravity_tilt"
    means = "the base is not level"
    shows = "standstill in many postures of the first joints"

    def __init__(self, model: Model, gravity: Array) -> None:
        super().__init__(model)
        self.gravity = gravity

    @classmethod
    def of(cls, entry: EffectEntry, model: Model) -> Self:
        """See `NamedEffect.of`."""
        if entry.joint is not None or entry.link is not None:
            raise ConfigError(place(entry), "acts on the whole robot; give neither joint nor link")
        check_names(entry, ("gravity",))
        return cls(model, vector(entry, "gravity", 3))

    @classmethod
    def probes(cls, survey: Survey) -> Iterator[Probe]:
        """See `NamedEffect.probes`: gravity of the same size in another direction."""
        gravity = survey.model.gravity
        size = float(np.linalg.norm(gravity))
        if survey.has(cls.id, "base") or not size:
            return
        ways = np.linalg.svd(gravity[None] / size)[2]  # along gravity, and across

        def columns(motion: Motion, present: Present) -> Mapping[int, Array]:
            pulled = np.stack([present.pulled(motion, way) for way in ways])
            return {j: pulled[:, j] for j in range(len(motion.q))}

        def entry(c: Array, information: Array) -> EffectEntry | None:
            away = float(np.linalg.norm(c[1:]))  # what lies along follows, the size being the same
            if away > _STEEP * size:
                return None
            tilted = gravity * np.sqrt(1 - (away / size) ** 2) + c[1:] @ ways[1:]
            return EffectEntry(effect=cls.id, parameters={"gravity": [float(x) for x in tilted]})

        yield Probe(cls.id, None, None, columns, 3, entry, count=2)

    @property
    def key(self) -> tuple[str | float, ...]:
        """See `NamedEffect.key`."""
        return self.id, "base"

    def alter(self, model: Model) -> Model:
        """See `Effect.alter`."""
        return replace(model, gravity=self.gravity)

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`; gravity comes with the bodies."""
