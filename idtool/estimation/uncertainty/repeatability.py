"""Whether several logs of one robot say the same, each by itself, base parameter by base parameter.

Their estimates are independent, with errors of different size that are themselves estimated: Welch's test for unequal
variances (1951). Of many such tests some fail by chance: of the parameters named, 5 % are expected to be named for
nothing (Benjamini & Hochberg 1995).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from idtool.common.arrays import Array, Mask
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.blocks import Blocks
from idtool.estimation.dataset.knowledge import Knowledge
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.uncertainty.base import BaseParameters
from idtool.estimation.uncertainty.scatter import scatter

_FALSE = 0.05  # of the parameters that are said not to agree
_MANY = 1e6  # degrees of freedom, as good as infinitely many
_COPIED = 1e-4  # standard errors, by which logs of the same data may differ
_CLEARER = 0.5  # of the others' disagreement that is left without a log: then it is the odd one


@dataclass(frozen=True)
class Repeatability:
    """Logs against each other; L logs, r base parameters.

    Attributes
    ----------
    logs
        Their names.
    value, standard_error
        Of each base parameter in each log alone, without prior and inequalities, shape (r, L); NaN and infinite where
        the log does not determine it.
    ratio
        Scatter between the logs in units of what their standard errors predict, about 1 where they agree; shape (r,),
        NaN where fewer than two logs determine it.
    agrees
        Whether the logs differ by no more than chance explains, shape (r,).
    odd
        Index of the log without which the others agree far better; None where there is none.
    cross
        Root mean square torque error of the model fitted to the log of the row on the log of the column, all joints in
        units of their noise, shape (L, L).
    """

    logs: tuple[str, ...]
    value: Array
    standard_error: Array
    ratio: Array
    agrees: Mask
    odd: int | None
    cross: Array

    @property
    def copies(self) -> tuple[str, ...]:
        """The logs that say the same of every parameter as one before them: copies of it, chance does not do that."""
        error, again = np.where(np.isfinite(self.standard_error), self.standard_error, 0.0), []
        for k in range(1, len(self.logs)):
            close = np.abs(self.value[:, :k] - self.value[:, [k]]) < _COPIED * np.minimum(error[:, :k], error[:, [k]])
            neither = np.isnan(self.value[:, :k]) & np.isnan(self.value[:, [k]])
            if ((close | neither).all(axis=0) & close.any(axis=0)).any():
                again.append(self.logs[k])
        return tuple(again)


def repeatability(
    equation: LinearModel,
    data: Sequence[Blocks],
    noise: Array,
    theta: Array,
    known: Knowledge,
    base: BaseParameters,
    alone: Callable[[Reduction], Array],
    rng: np.random.Generator,
) -> Repeatability:
    """Compare logs.

    Parameters
    ----------
    equation, known, base
        The model.
    data
        Two logs or more.
    noise, theta
        Of the fit to all of them.
    alone
        The identification from some of the data, with prior and constraints: the coefficients, shape (p,).
    rng
        Source of the bootstrap's weights.
    """
    found = [scatter(equation, [log], noise, theta, known, rng) for log in data]
    error = np.column_stack([each.uncertainty.of(base.B) for each in found])
    value = np.where(np.isfinite(error), np.column_stack([base.B @ each.theta for each in found]), np.nan)
    freedom = np.column_stack([each.uncertainty.freedom(base.B) for each in found])
    differs = _differs(_welch(value, error, freedom))
    return Repeatability(
        logs=tuple(log.name for log in data),
        value=value,
        standard_error=error,
        ratio=_ratio(value, error),
        agrees=~differs,
        odd=_odd(value[differs], error[differs]),
        cross=_cross(equation, data, noise, [alone(log.total) for log in data]),
    )


def _welch(value: Array, error: Array, freedom: Array) -> Array:
    """Chance of differences as large as these, shape (r, L) to (r,); NaN where fewer than two logs have an error."""
    weight = _weights(error)
    count, total = np.count_nonzero(weight, axis=1), weight.sum(axis=1, keepdims=True)
    asked = count > 1
    rest = np.where(weight > 0, np.square(1 - weight / np.where(total > 0, total, 1.0)) / freedom, 0.0).sum(axis=1)
    squares = np.maximum(np.square(count) - 1.0, 1.0)
    F = np.square(_ratio(value, error)) / (1 + 2 * (count - 2) / squares * rest)
    second = np.where(rest > 0, squares / np.where(rest > 0, 3 * rest, 1.0), np.inf)
    return np.where(
        asked, stats.f.sf(np.where(asked, F, 0.0), np.maximum(count - 1, 1), np.minimum(second, _MANY)), np.nan
    )


def _differs(p_values: Array) -> Mask:
    """Which tests fail, shape (r,)."""
    asked = np.flatnonzero(~np.isnan(p_values))
    differs = np.zeros(len(p_values), dtype=bool)
    if len(asked):
        differs[asked] = stats.false_discovery_control(p_values[asked]) < _FALSE
    return differs


def _weights(error: Array) -> Array:
    """One over the squares of errors that there are, 0 for others."""
    there = np.isfinite(error) & (error > 0)
    return np.where(there, 1 / np.square(np.where(there, error, 1.0)), 0.0)


def _ratio(value: Array, error: Array) -> Array:
    """Birge's ratio: the scatter of several estimates in units of what their errors predict, shape (r,)."""
    weight = _weights(error)
    count = np.count_nonzero(weight, axis=1)
    known = np.where(weight > 0, value, 0.0)
    mean = (weight * known).sum(axis=1) / np.where(count > 0, weight.sum(axis=1), 1.0)
    chi_square = (weight * np.square(known - mean[:, None])).sum(axis=1)
    return np.where(count > 1, np.sqrt(chi_square / np.maximum(count - 1, 1)), np.nan)


def _odd(value: Array, error: Array) -> int | None:
    """The log without which the others disagree less than half as much, if there are three or more.

    Only what differs is asked: of many parameters that agree, one log more or less says nothing.
    """
    logs = value.shape[1]
    if logs < 3 or not len(value):
        return None

    def disagreement(kept: list[int]) -> float:
        return float(np.nanmean(np.square(_ratio(value[:, kept], error[:, kept]))))

    without = [disagreement([i for i in range(logs) if i != k]) for k in range(logs)]
    least = int(np.nanargmin(without))
    return least if without[least] < _CLEARER * disagreement(list(range(logs))) else None


def _cross(equation: LinearModel, data: Sequence[Blocks], noise: Array, models: Sequence[Array]) -> Array:
    """Each model's error on each log, in units of the joints' noise."""
    cross = np.zeros((len(models), len(data)))
    for column, log in enumerate(data):
        for row, theta in enumerate(models):
            joints = zip(log.total, equation.active(), noise, strict=True)
            means = [f.squares(theta[own]) / max(f.rows, 1) / sigma**2 for f, own, sigma in joints]
            cross[row, column] = np.sqrt(np.mean(means))
    return cross
