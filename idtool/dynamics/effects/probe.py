"""`Probe`: an effect that may be missing, as columns of first order about the model that is there.

What the present model leaves of the measured torque is compared with the columns times free coefficients. An effect
that is linear in its coefficients has its own columns; one that changes what was measured, or the links' motion, has
the derivative of the predicted torque by its parameter, in units of the measured torque.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.survey import Present
from idtool.robot.config import EffectEntry

Columns = Callable[[Motion, Present], Mapping[int, Array]]


@dataclass(frozen=True)
class Probe:
    """A hypothesis.

    Attributes
    ----------
    effect, joint, link
        As in a configuration.
    columns
        Of k coefficients: by joint index, shape (k, N).
    size
        k.
    shape
        Values of what is searched by trying, by name: of what the columns depend on.
    entry
        Coefficients, shape (k,), and the data's information on them, (k, k), to an entry of a configuration; None: no
        such effect can be.
    lower, upper
        Of the coefficients, shape (k,): beyond, it is no explanation.
    again
        Makes it at other values of the shape; None where it has none.
    local
        Whether it acts in stretches of time of its own, so that other times tell nothing of it.
    count
        How many parameters it has; 0: as many as coefficients and shape values.
    """

    effect: str
    joint: str | None
    link: str | None
    columns: Columns
    size: int
    entry: Callable[[Array, Array], EffectEntry | None]
    shape: Mapping[str, float] = field(default_factory=dict)
    lower: Sequence[float] = ()
    upper: Sequence[float] = ()
    again: Callable[[Mapping[str, float]], Probe] | None = None
    local: bool = False
    count: int = 0

    def at(self, shape: Mapping[str, float]) -> Probe:
        """The same with other values of what is searched by trying."""
        return self.again(shape) if self.again else self

    @property
    def parameters(self) -> int:
        """How many numbers it takes to write it down."""
        return self.count or self.size + len(self.shape)

    @property
    def on(self) -> tuple[str, str]:
        """Its effect and what it acts on."""
        return self.effect, self.joint or self.link or ""

    def allowed(self, c: Array) -> bool:
        """Whether physics allows coefficients, shape (k,)."""
        low = np.asarray(self.lower) if len(self.lower) else -np.inf
        high = np.asarray(self.upper) if len(self.upper) else np.inf
        return bool((c >= low).all() and (c <= high).all())


def spread(low: float, high: float, count: int) -> list[float]:
    """Values to try in equal ratios."""
    return [float(x) for x in np.geomspace(low, high, count)] if 0 < low < high else []
