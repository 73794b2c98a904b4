"""A base that is not level."""

from __future__ import annotations

from dataclasses import replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from idtool.config import EffectEntry
from idtool.effects.held_effect import HeldEffect
from idtool.effects.named import check_names, place, vector
from idtool.exceptions import ConfigError
from idtool.mechanism import Mechanism
from idtool.model import Model

Array = NDArray[np.float64]


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

    @property
    def key(self) -> tuple[str | float, ...]:
        """See `NamedEffect.key`."""
        return self.id, "base"

    def alter(self, model: Model) -> Model:
        """See `Effect.alter`."""
        return replace(model, gravity=self.gravity)

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`; gravity comes with the bodies."""
