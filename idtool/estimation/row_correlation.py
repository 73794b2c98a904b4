"""Correlation of the noise between the rows of a robot with contacts, so that the fit weighs them as they err together.

An error in the measured acceleration of the base or of a joint is in all rows, by the inertia that it accelerates: the
rows err together, and some of their combinations are far more exact than any row. Generalized least squares gives these
their weight (Aitken 1936). As they hold little noise of accelerations, they are also little biased by it.

Unknown contact forces leave only a part of the rows at a sample, so that the correlation is the most likely one by
expectation-maximization (Dempster, Laird & Rubin 1977). It is then shrunk towards none, by its uncertainty (Schäfer &
Strimmer 2005).

Shapes: nv rows, n filtered samples that are about independent.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.contact_model import ContactModel
from idtool.dynamics.row_filter import ProjectedRows
from idtool.estimation.dataset.experiment import Experiment, Progress, tracked
from idtool.estimation.dataset.training_sample import training_sample
from idtool.estimation.dataset.weights import free_fit
from idtool.estimation.row_noise import SAMPLE_DURATION

_MAX_LOSS = 0.01  # share of a direction that may be eliminated near a sample that tells of it
_MOST_ITERATIONS = 50
_CONVERGED = 3e-3  # change of the covariance
_LEAST_VARIANCE = 0.01  # of a combination of rows relative to a row: no combination weighs more than ten times as much


def with_row_correlation(experiment: Experiment, progress: Progress) -> Experiment:
    """Determine the correlation of the rows' noise from what a fit without constraints leaves of them.

    Parameters
    ----------
    experiment
        Model and data; with contacts, the equation has the noise of the rows.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    The experiment, whose equation has the correlation; as it is without contacts, or if the data are too short for a
    fit without constraints.
    """
    contacts = experiment.equation.contacts
    if contacts is None:
        return experiment
    sample = training_sample(experiment, SAMPLE_DURATION)
    fit = free_fit(sample.equation, sample.reduce(progress), sample.equalities)
    if not fit.is_determined:
        return experiment
    residuals, seen = _residuals(sample, contacts, fit.theta, progress)
    covariance = most_likely_covariance(residuals, seen)
    independent_samples = len(residuals) * np.trace(seen.mean(axis=0)) / len(covariance)
    contacts = contacts.with_correlation(shrunk_correlation(covariance, independent_samples))
    return replace(experiment, equation=replace(experiment.equation, contacts=contacts))


def _residuals(experiment: Experiment, contacts: ContactModel, theta: Array, progress: Progress) -> tuple[Array, Array]:
    """What a model leaves of the rows, in units of their noise, and the projector onto what is seen of them.

    Parameters
    ----------
    experiment, contacts
        Model and data.
    theta
        Coefficients, shape (p,).
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    Shapes (n, nv) and (n, nv, nv).
    """
    equation = experiment.equation
    trained = [run for run in experiment.runs if run.train]
    low_pass = trained[0].signals.low_pass
    step = max(round(low_pass.redundancy), 1)
    residuals, seen = [], []
    for run in trained:
        stage = f"reading {run.signals.log.path.name}"
        for batch in tracked(experiment.batches(run, held_out=False), run.train, progress, stage):
            row_filter = cast(ProjectedRows, equation.row_filter(batch))
            rows_left = row_filter.filter_rows(equation.residual(batch.motion, theta))[:, ::step]
            part_seen = _seen(row_filter.filtered_projector()[::step])
            residuals.append(np.einsum("nij,nj->ni", part_seen, rows_left.T / contacts.noise))
            seen.append(part_seen)
    return np.concatenate(residuals), np.concatenate(seen)


def _seen(filtered_projector: Array) -> Array:
    """Projector onto directions of which next to nothing is eliminated within the filter's length, as its argument."""
    shares, directions = np.linalg.eigh(filtered_projector)
    is_seen = np.abs(shares - 1) < _MAX_LOSS
    return np.asarray((directions * is_seen[:, None, :]) @ directions.transpose(0, 2, 1))


def most_likely_covariance(residuals: Array, seen: Array) -> Array:
    """Covariance of normally distributed rows of which a part is seen, shape (nv, nv) (Dempster, Laird & Rubin 1977).

    Parameters
    ----------
    residuals
        What is seen of them, shape (n, nv).
    seen
        Orthogonal projectors onto that part, shape (n, nv, nv).
    """
    identity = np.eye(residuals.shape[1])
    unseen = identity - seen
    covariance = identity
    for _ in range(_MOST_ITERATIONS):
        before = covariance
        of_seen = seen @ covariance @ seen + unseen  # regular
        gain = covariance @ seen @ np.linalg.inv(of_seen) @ seen
        expected_rows = np.einsum("nij,nj->ni", gain, residuals)
        remaining = covariance - (gain @ covariance).mean(axis=0)
        covariance = expected_rows.T @ expected_rows / len(residuals) + remaining
        covariance = (covariance + covariance.T) / 2
        if np.abs(covariance - before).max() < _CONVERGED:
            break
    return covariance


def shrunk_correlation(covariance: Array, independent_samples: float) -> Array:
    """Correlation shrunk towards none by its uncertainty, shape (nv, nv) (Schäfer & Strimmer 2005).

    Its eigenvalues are bounded from below.

    Parameters
    ----------
    covariance
        Covariance of rows, shape (nv, nv).
    independent_samples
        Number of independent samples that it was computed from.
    """
    deviations = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(deviations, deviations)
    off_diagonal = correlation - np.diag(np.diag(correlation))
    pairs = ~np.eye(len(correlation), dtype=bool)
    variance = np.square(1 - np.square(correlation[pairs])).sum() / max(independent_samples, 1.0)
    total = np.square(off_diagonal).sum()
    kept_share = max(1 - variance / total, 0.0) if total > 0 else 0.0
    eigenvalues, eigenvectors = np.linalg.eigh(np.eye(len(correlation)) + kept_share * off_diagonal)
    return np.asarray((eigenvectors * np.maximum(eigenvalues, _LEAST_VARIANCE)) @ eigenvectors.T)
