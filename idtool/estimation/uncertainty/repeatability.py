"""Agreement between several logs of one robot, each by itself, base parameter by base parameter.

Their estimates are independent, with errors of different size that are themselves estimated: Welch's test.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.processes import Progress, shared_among_processes
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.blocks import Blocks
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.sensor_offsets import with_offsets_of
from idtool.estimation.uncertainty.base_parameters import BaseParameters
from idtool.estimation.uncertainty.cluster_robust import cluster_robust_estimate
from idtool.estimation.uncertainty.welch import birge_ratio, significant_differences, welch_p_values

_DUPLICATE = 1e-4  # standard errors, by which logs of the same data may differ
_OUTLIER = 0.5  # share of the disagreement that is left without a log: below, it is an outlier


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
        True where the logs differ by no more than chance explains, shape (r,).
    outlier
        Index of the log without which the others agree far better; None where there is none.
    cross_error
        Root mean square torque error of the model fitted to the log of the row on the log of the column, all joints in
        units of their noise, shape (L, L).
    """

    logs: tuple[str, ...]
    value: Array
    standard_error: Array
    ratio: Array
    agrees: Mask
    outlier: int | None
    cross_error: Array

    @property
    def duplicates(self) -> tuple[str, ...]:
        """Logs with the values of every parameter of one before them: copies of it, since chance does not do that."""
        error = np.where(np.isfinite(self.standard_error), self.standard_error, 0.0)
        duplicates = []
        for k in range(1, len(self.logs)):
            difference = np.abs(self.value[:, :k] - self.value[:, [k]])
            is_close = difference < _DUPLICATE * np.minimum(error[:, :k], error[:, [k]])
            is_undetermined = np.isnan(self.value[:, :k]) & np.isnan(self.value[:, [k]])
            is_duplicate = (is_close | is_undetermined).all(axis=0) & is_close.any(axis=0)
            if is_duplicate.any():
                duplicates.append(self.logs[k])
        return tuple(duplicates)


def repeatability(
    equation: LinearModel,
    data: Sequence[Blocks],
    noise: Array,
    theta: Array,
    equalities: EqualityConstraints,
    base: BaseParameters,
    theta_from: Callable[[Reduction], Array],
    rng: np.random.Generator,
    progress: Progress,
) -> Repeatability:
    """Compare logs.

    Parameters
    ----------
    equation, equalities, base
        The model.
    data
        Two logs or more.
    noise, theta
        Residual noise and coefficients of the fit to all of them.
    theta_from
        Identification from some of the data, with prior and constraints: the coefficients, shape (p,).
    rng
        Source of the bootstrap's weights.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """

    def theta_of_log(index: int, progress: Progress) -> Array:
        progress("comparing logs", index / len(data))
        return theta_from(data[index].total)

    thetas = np.stack(shared_among_processes(theta_of_log, range(len(data)), progress))
    estimates = [cluster_robust_estimate(equation, [log], noise, theta, equalities, rng) for log in data]
    error = np.column_stack([estimate.uncertainty.of(base.B) for estimate in estimates])
    value = np.column_stack([base.B @ estimate.theta for estimate in estimates])
    value = np.where(np.isfinite(error), value, np.nan)
    freedom = np.column_stack([estimate.uncertainty.degrees_of_freedom(base.B) for estimate in estimates])
    differs = significant_differences(welch_p_values(value, error, freedom))
    return Repeatability(
        logs=tuple(log.name for log in data),
        value=value,
        standard_error=error,
        ratio=birge_ratio(value, error),
        agrees=~differs,
        outlier=_outlier(value[differs], error[differs]),
        cross_error=_cross_error(equation, data, noise, thetas),
    )


def _outlier(value: Array, error: Array) -> int | None:
    """The log without which the others disagree less than half as much, if there are three or more.

    Given are only parameters that differ: of many that agree, one log more or less says nothing.
    """
    logs = value.shape[1]
    if logs < 3 or not len(value):
        return None

    def disagreement(kept: list[int]) -> float:
        return float(np.nanmean(np.square(birge_ratio(value[:, kept], error[:, kept]))))

    without = [disagreement([i for i in range(logs) if i != k]) for k in range(logs)]
    least = int(np.nanargmin(without))
    return least if without[least] < _OUTLIER * disagreement(list(range(logs))) else None


def _cross_error(equation: LinearModel, data: Sequence[Blocks], noise: Array, thetas: Array) -> Array:
    """Error of each model, with coefficients of shape (models, p), on each log, in units of the joints' noise.

    Shape (models, logs).
    """
    errors = np.zeros((len(thetas), len(data)))
    for column, log in enumerate(data):
        with_offsets = with_offsets_of(equation, log.total, noise, thetas)
        squares = np.zeros(len(thetas))
        for factor, active, sigma in zip(log.total, equation.active(), noise.tolist(), strict=True):
            squares += factor.squared_errors(with_offsets[:, active]) / max(factor.rows, 1) / sigma**2
        errors[:, column] = np.sqrt(squares / len(log.total))
    return errors
