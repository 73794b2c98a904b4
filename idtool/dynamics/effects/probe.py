"""`Probe`: an effect that may be missing, as columns of first order about the present model.

The residual of the present model is compared with the columns times free coefficients. An effect that is linear in its
coefficients has its own columns. One that changes what was measured, or the links' motion, has the derivative of the
predicted torque by its parameter, in units of the measured torque.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import field

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.data.signals import Motion
from idtool.dynamics.effects.linearization import Linearization
from idtool.robot.config import EffectEntry

ProbeColumns = Callable[[Motion, Linearization], Mapping[int, Array]]


@dataclass(frozen=True)
class Probe:
    """A hypothesis: one effect on one joint or link.

    Attributes
    ----------
    effect, joint, link
        As in a configuration.
    columns
        Columns of the k coefficients: joint index to shape (k, N).
    coefficient_count
        k.
    to_entry
        Configuration entry, from the coefficients, shape (k,), and the data's information on them, (k, k); None if
        there is no such effect.
    nonlinear_values
        Values, by name, that the columns depend on.
    lower, upper
        Physical bounds of the coefficients, shape (k,); empty: none.
    rebuild
        The probe at other nonlinear values; None if it has none.
    is_local
        True if it acts in time intervals of its own, so that other times tell nothing of it.
    parameter_count
        Number of parameters; 0: as many as coefficients and nonlinear values.
    column_key
        Key of the columns, if they are those of one joint and depend on nothing but q, v and a; see
        `Effect.column_key`.
    log
        File name of the log in which it acts; empty: in all.
    """

    effect: str
    joint: str | None
    link: str | None
    columns: ProbeColumns
    coefficient_count: int
    to_entry: Callable[[Array, Array], EffectEntry | None]
    nonlinear_values: Mapping[str, float] = field(default_factory=dict)
    lower: Sequence[float] = ()
    upper: Sequence[float] = ()
    rebuild: Callable[[Mapping[str, float]], Probe] | None = None
    is_local: bool = False
    parameter_count: int = 0
    column_key: Hashable | None = None
    log: str = ""

    def at(self, nonlinear_values: Mapping[str, float]) -> Probe:
        """The probe at other nonlinear values."""
        return self.rebuild(nonlinear_values) if self.rebuild else self

    @property
    def complexity(self) -> int:
        """Count of the numbers that describe the effect."""
        return self.parameter_count or self.coefficient_count + len(self.nonlinear_values)

    @property
    def subject(self) -> tuple[str, str]:
        """The effect and the joint or link that it acts on."""
        return self.effect, self.joint or self.link or ""

    def is_feasible(self, c: Array) -> bool:
        """True if coefficients, shape (k,), are within the physical bounds."""
        lower = np.asarray(self.lower) if len(self.lower) else -np.inf
        upper = np.asarray(self.upper) if len(self.upper) else np.inf
        return bool((c >= lower).all() and (c <= upper).all())


def joined_probe(first: Probe, second: Probe) -> Probe:
    """Probe with the columns of two; it is of no effect, so that it has no configuration entry."""

    def columns(motion: Motion, model: Linearization) -> Mapping[int, Array]:
        first_columns = first.columns(motion, model)
        second_columns = second.columns(motion, model)
        no_first = np.zeros((first.coefficient_count, len(motion.t)))
        no_second = np.zeros((second.coefficient_count, len(motion.t)))
        joined = {}
        for j in sorted(first_columns.keys() | second_columns.keys()):
            joined[j] = np.concatenate([first_columns.get(j, no_first), second_columns.get(j, no_second)])
        return joined

    count = first.coefficient_count + second.coefficient_count
    return Probe("", None, None, columns, count, lambda c, information: None)


def geometric_grid(low: float, high: float, count: int) -> list[float]:
    """Values in equal ratios from ``low`` to ``high``; none if the range is empty."""
    if not 0 < low < high:
        return []
    return [float(x) for x in np.geomspace(low, high, count)]
