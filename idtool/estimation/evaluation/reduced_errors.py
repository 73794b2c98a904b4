"""Torque errors of any model from reduced logs, without reading the logs again.

With the factor R of rows [Y, tau, above] and the residual e = Y theta − tau in the band, ‖e‖² is that of R's rows, and
so is e · above. The error against the logged torque, which is the measured one in the band plus what lies above it, is
‖e − above‖² = ‖e‖² − 2 e · above + ‖above‖². Sums over filtered samples stand for those over all samples, as the band
lies below half of their rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.envelope import Trace
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.reduced_logs import ReducedLog, is_reducible, reduce_logs
from idtool.estimation.dataset.reduced_part import ReducedPart
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.evaluation.spectrum import Correlations
from idtool.estimation.evaluation.torque_errors import Errors, Evaluation, evaluate, torque_deviation


class TorqueEvaluator:
    """Torque errors of models on the logs of an experiment, which are read once, or again for every evaluation.

    Once is enough if the error is linear in the coefficients; see `is_reducible`.

    Parameters
    ----------
    experiment
        Model and data.
    progress
        Callback for the stage and its progress, from 0 to 1.
    reduced
        The logs, if they have been reduced with the same equation.
    """

    def __init__(self, experiment: Experiment, progress: Progress, reduced: Sequence[ReducedLog] | None = None) -> None:
        self._experiment = experiment
        self._progress = progress
        self._reduced = reduced
        if reduced is None and is_reducible(experiment):
            self._reduced = reduce_logs(experiment, progress)

    def evaluate(self, models: Mapping[str, Array], held_out: bool) -> Evaluation:
        """Torque errors of models on the training or the held-out parts.

        Parameters
        ----------
        models
            Name to coefficients, shape (p,).
        held_out
            If true the held-out parts, else the training parts.
        """
        if self._reduced is None:
            return evaluate(self._experiment, models, held_out, self._progress, angles=True)
        return evaluate_reduced(self._experiment.equation, self._reduced, models, held_out)


def evaluate_reduced(
    equation: LinearModel, logs: Sequence[ReducedLog], models: Mapping[str, Array], held_out: bool
) -> Evaluation:
    """Torque errors of one or more models on the training or the held-out parts of reduced logs.

    Parameters
    ----------
    equation
        The torque equation that the logs were reduced with.
    logs
        The logs.
    models
        Name to coefficients, shape (p,).
    held_out
        If true the held-out parts, else the training parts.
    """
    joints = equation.joints
    nv = len(joints)
    parts = [(log, part) for log in logs for part in log.parts(held_out) if part.rows]
    errors = {name: Errors.none(nv, 0) for name in models}
    torque_sums, known_samples = np.zeros((2, nv)), np.zeros(nv)
    for _, part in parts:
        known = part.is_compared
        torque_sums += known * part.torque_sums
        known_samples += known * part.samples
        comparison = part.comparison
        samples_per_row = part.samples / part.rows
        for name, theta in models.items():
            of_rows, cross_of_rows = _squares(equation, comparison, theta)
            in_band = samples_per_row * of_rows
            cross = samples_per_row * cross_of_rows
            as_logged = in_band - 2 * cross + part.squares_above_band
            errors[name].samples += part.samples
            errors[name].known_samples += known * part.samples
            errors[name].sum_squares_in_band += known * in_band
            errors[name].sum_squares_as_logged += known * np.maximum(as_logged, 0.0)  # rounding may make it negative
    first = next(iter(models.values()))
    independent = _independent_samples(equation, parts, first)
    return Evaluation(
        errors,
        dict(zip(joints, torque_deviation(torque_sums, known_samples).tolist(), strict=True)),
        tuple(_trace(equation, log.name, log.parts(held_out), models) for log in logs if log.parts(held_out)),
        dict(zip(joints, independent.tolist(), strict=True)),
    )


def _squares(equation: LinearModel, comparison: Reduction, theta: Array) -> tuple[Array, Array]:
    """Sums of e² and of e · above over the filtered samples, shape (nv,) each."""
    in_band, cross = np.zeros((2, len(equation.joints)))
    for joint, (factor, active) in enumerate(zip(comparison, equation.active(), strict=True)):
        Y, tau, above = factor.R[:, :-2], factor.R[:, -2], factor.R[:, -1]
        e = Y @ theta[active] - tau
        in_band[joint] = e @ e
        cross[joint] = e @ above
    return in_band, cross


def _independent_samples(equation: LinearModel, parts: Sequence[tuple[ReducedLog, ReducedPart]], theta: Array) -> Array:
    """Number of independent samples in a model's residual, shape (nv,), by the rows of some batches."""
    correlations = Correlations()
    for log, part in parts:
        for series in part.series:
            residual = _residual(equation, series, theta)
            measured = np.stack([own[-1] for own in series])
            correlations.add(residual, measured, 1, log.row_step)
    if not correlations.samples:
        return np.zeros(len(equation.joints))
    rows = sum(part.rows for _, part in parts)
    return correlations.independent(1) * rows / correlations.samples


def _residual(equation: LinearModel, rows: Sequence[Array], theta: Array) -> Array:
    """Tau − Y theta of rows [Y, tau, measured], shape (m_j + 2, ..., n) each; shape (nv, ..., n)."""
    residuals = []
    for own, active in zip(rows, equation.active(), strict=True):
        residuals.append(own[-2] - np.tensordot(theta[active], own[:-2], axes=1))
    return np.stack(residuals)


def _trace(equation: LinearModel, name: str, parts: Sequence[ReducedPart], models: Mapping[str, Array]) -> Trace:
    """Curves of a log's parts for drawing."""
    traces = [part.posture.trace(name) for part in parts]
    for trace, part in zip(traces, parts, strict=True):
        trace.curves.update(_torque_curves(equation, part, models))
    t = np.concatenate([trace.t for trace in traces])
    curves = {}
    for curve in traces[0].curves:
        curves[curve] = np.concatenate([trace.curves[curve] for trace in traces], axis=1)
    return Trace(name, t, curves)


def _torque_curves(equation: LinearModel, part: ReducedPart, models: Mapping[str, Array]) -> dict[str, Array]:
    """Least and greatest torque in the stretches of time of a part, by curve, shape (nv, 2 bins)."""
    rows = [np.moveaxis(own, -1, 0) for own in part.extremes.rows]  # (m_j + 2, bins, rows of a bin)
    measured = np.stack([own[-1] for own in rows])
    residuals = {}
    for model, theta in models.items():
        residuals[model] = np.where(part.is_compared[:, None, None], _residual(equation, rows, theta), 0.0)
    torques = {"measured": measured, "residual": residuals[next(iter(models))]}
    for model, residual in residuals.items():
        torques[model] = measured - residual
    curves = {}
    for curve, x in torques.items():
        pairs = np.stack([x.min(axis=2), x.max(axis=2)], axis=-1)
        curves[curve] = pairs.reshape(len(pairs), -1)
    return curves
