"""Correlation of the rows' noise, for generalized least squares on a robot with contacts.

An error in the measured acceleration of the base or of a joint appears in all rows, multiplied by the inertia: the rows
err together, and some of their combinations are far more exact than any row. Generalized least squares gives these
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
from idtool.estimation.dataset.weights import free_fit
from idtool.estimation.row_noise import noise_sample

_MAX_ELIMINATED = 0.01  # largest share of a direction lost to unknown forces that still counts as seen
_MOST_ITERATIONS = 50
_CONVERGED = 3e-3  # change of the covariance, relative to its largest entry
_LEAST_VARIANCE = 0.01  # smallest eigenvalue of the correlation: no combination counts as ten times as exact as a row


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
    sample = noise_sample(experiment)
    fit = free_fit(sample.equation, sample.reduce_unchecked(progress), sample.equalities)
    if not fit.has_enough_samples:
        return experiment
    residuals, seen = _residuals(sample, contacts, fit.theta, progress)
    covariance = most_likely_covariance(residuals, seen)
    independent_samples = len(residuals) * np.trace(seen.mean(axis=0)) / len(covariance)
    contacts = contacts.with_correlation(shrunk_correlation(covariance, independent_samples))
    return replace(experiment, equation=experiment.equation.with_contacts(contacts))


def _residuals(experiment: Experiment, contacts: ContactModel, theta: Array, progress: Progress) -> tuple[Array, Array]:
    """Seen part of the residual of a model, and the projectors onto what is seen.

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
    The residual in units of the rows' noise, shape (n, nv), and the projectors, shape (n, nv, nv).
    """
    equation = experiment.equation
    residuals, seen = [], []
    for run in experiment.runs:
        step = round(run.signals.low_pass.redundancy)
        stage = f"reading {run.signals.log.path.name}"
        for batch in tracked(experiment.batches(run, held_out=False), run.train, progress, stage):
            row_filter = cast(ProjectedRows, equation.row_filter(batch))
            residual = equation.residual(batch.motion, theta)
            projected_residual = row_filter.filter_rows(residual)[:, ::step]
            projectors = _projectors_onto_seen(row_filter.filtered_projector()[::step])
            residuals.append(np.einsum("nij,nj->ni", projectors, projected_residual.T / contacts.noise))
            seen.append(projectors)
    return np.concatenate(residuals), np.concatenate(seen)


def _projectors_onto_seen(filtered_projector: Array) -> Array:
    """Projectors onto directions of which next to nothing is eliminated within the filter's length.

    Parameters
    ----------
    filtered_projector
        From `ProjectedRows.filtered_projector`, shape (n, nv, nv).
    """
    kept_shares, directions = np.linalg.eigh(filtered_projector)
    is_seen = np.abs(kept_shares - 1) < _MAX_ELIMINATED
    return np.asarray((directions * is_seen[:, None, :]) @ directions.transpose(0, 2, 1))


def most_likely_covariance(residuals: Array, seen: Array) -> Array:
    """Covariance of normally distributed rows of which a part is seen, shape (nv, nv) (Dempster, Laird & Rubin 1977).

    One more sample of little variance keeps it regular.

    Parameters
    ----------
    residuals
        Seen part of the rows, shape (n, nv).
    seen
        Orthogonal projectors onto that part, shape (n, nv, nv).
    """
    identity = np.eye(residuals.shape[1])
    unseen = identity - seen
    covariance = identity
    for _ in range(_MOST_ITERATIONS):
        previous = covariance
        seen_rows = seen @ covariance
        seen_covariance = seen_rows @ seen + unseen  # regular, with 1 in unseen directions
        transposed_gain = np.linalg.solve(seen_covariance, seen_rows)
        expected_rows = np.einsum("nji,nj->ni", transposed_gain, residuals)
        explained = np.einsum("nji,njk->ik", seen_rows, transposed_gain, optimize=True) / len(residuals)
        scatter = expected_rows.T @ expected_rows + _LEAST_VARIANCE * identity
        covariance = scatter / len(residuals) + covariance - explained
        covariance = (covariance + covariance.T) / 2
        if np.abs(covariance - previous).max() < _CONVERGED * np.abs(covariance).max():
            break
    return covariance


def shrunk_correlation(covariance: Array, independent_samples: float) -> Array:
    """Correlation shrunk towards none by its uncertainty, shape (nv, nv) (Schäfer & Strimmer 2005).

    Its eigenvalues are bounded from below, which may make entries of its diagonal slightly larger than 1.

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
