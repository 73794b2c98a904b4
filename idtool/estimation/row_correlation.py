"""Correlation of the rows' noise, for generalized least squares on a robot with contacts.

A row is one scalar equation of motion: of a joint, of a component of the base's wrench, or of a wrench sensor. An error
in the measured acceleration of the base or of a joint appears in all rows, multiplied by the inertia. The errors of the
rows are therefore correlated. In some combinations of rows they nearly cancel, so that these are far more exact than
any single row. Generalized least squares gives these combinations a larger weight (Aitken 1936). They contain little
noise of accelerations, so that this noise also biases the estimate less.

Unknown contact forces are eliminated, so that each sample shows only a part of the rows. The covariance is therefore
the most likely one with missing data, by expectation-maximization (Dempster, Laird & Rubin 1977). Its correlations are
then reduced towards zero, the more the less certain they are (Schäfer & Strimmer 2005).

Shapes: nv rows, p coefficients, n samples behind the filter that are about independent. Residuals are in units of each
row's noise, so that covariances have no unit.
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

_MAX_LOST_SHARE = 0.01  # of a direction, up to which it counts as seen
_MAX_ITERATIONS = 50  # of expectation-maximization
_TOLERANCE = 3e-3  # change of the covariance relative to its largest entry, at which it stops
_ADDED_SCATTER = 0.01  # squared residual added to each row, that keeps the covariance regular
_MIN_EIGENVALUE = 0.01  # of the correlation: no combination counts as more than ten times as exact as a row


def with_row_correlation(experiment: Experiment, progress: Progress) -> Experiment:
    """The experiment with the correlation of the rows' noise, from the residuals of a fit without inequalities.

    Parameters
    ----------
    experiment
        Model and data. With contacts, the noise of the rows must be determined; see `with_row_noise`.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    The experiment whose equation has the correlation; unchanged if there are no contacts, or if the data are too short
    for such a fit.
    """
    contacts = experiment.equation.contacts
    if contacts is None:
        return experiment
    part = noise_sample(experiment)
    reduction = part.reduce_unchecked(progress)
    fit = free_fit(part.equation, reduction, part.equalities)
    if not fit.has_enough_samples:
        return experiment
    residuals, seen_projectors = _seen_residuals(part, contacts, fit.theta, progress)
    covariance = most_likely_covariance(residuals, seen_projectors)
    seen_dimensions = np.trace(seen_projectors, axis1=1, axis2=2)
    mean_seen_share = seen_dimensions.mean() / len(covariance)
    correlation = shrunk_correlation(covariance, len(residuals) * mean_seen_share)
    equation = experiment.equation.with_contacts(contacts.with_correlation(correlation))
    return replace(experiment, equation=equation)


def _seen_residuals(
    experiment: Experiment, contacts: ContactModel, theta: Array, progress: Progress
) -> tuple[Array, Array]:
    """Residuals in the directions that unknown contact forces do not touch, and the projectors onto these.

    Parameters
    ----------
    experiment
        Model and data.
    contacts
        Its contacts, with the noise of each row.
    theta
        Coefficients of the model, shape (p,).
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    Shapes (n, nv) and (n, nv, nv).
    """
    equation = experiment.equation
    residuals, projectors = [], []
    for run in experiment.runs:
        step = round(run.signals.low_pass.redundancy)  # from one independent sample to the next
        stage = f"reading {run.signals.log.path.name}"
        batches = experiment.batches(run, held_out=False)
        for batch in tracked(batches, run.train, progress, stage):
            row_filter = cast(ProjectedRows, equation.row_filter(batch))  # as of every equation with contacts
            filtered_residual = row_filter.filter_rows(equation.residual(batch.motion, theta))
            in_units_of_noise = filtered_residual[:, ::step].T / contacts.noise
            onto_seen = _projectors_onto_seen(row_filter.filtered_projector()[::step])
            residuals.append(np.einsum("nij,nj->ni", onto_seen, in_units_of_noise))
            projectors.append(onto_seen)
    return np.concatenate(residuals), np.concatenate(projectors)


def _projectors_onto_seen(filtered_projectors: Array) -> Array:
    """Projectors onto the directions that stay free of unknown forces within the filter's length, shape (n, nv, nv).

    Parameters
    ----------
    filtered_projectors
        Low-passed projectors behind the elimination of these forces, for whitened rows, shape (n, nv, nv).
    """
    kept_shares, directions = np.linalg.eigh(filtered_projectors)
    lost_shares = np.abs(kept_shares - 1)  # the filter also overshoots
    is_seen = lost_shares < _MAX_LOST_SHARE
    seen_directions = directions * is_seen[:, None, :]
    return np.asarray(seen_directions @ directions.transpose(0, 2, 1))


def most_likely_covariance(residuals: Array, seen_projectors: Array) -> Array:
    """Most likely covariance of normal rows of mean zero, of which each sample shows a part, shape (nv, nv).

    By expectation-maximization (Dempster, Laird & Rubin 1977). A little is added to the squares, so that the covariance
    is regular.

    Parameters
    ----------
    residuals
        Seen part of the residuals in units of the rows' noise, shape (n, nv).
    seen_projectors
        Orthogonal projectors onto that part, shape (n, nv, nv).
    """
    identity = np.eye(residuals.shape[1])
    onto_unseen = identity - seen_projectors
    covariance = identity
    for _ in range(_MAX_ITERATIONS):
        previous = covariance
        seen_with_all = seen_projectors @ previous  # covariance of the seen part with all rows, (n, nv, nv)
        seen_covariance = seen_with_all @ seen_projectors
        transposed_gain = np.linalg.solve(seen_covariance + onto_unseen, seen_with_all)
        expected_rows = np.einsum("nji,nj->ni", transposed_gain, residuals)
        summed_explained = np.einsum("nji,njk->ik", seen_with_all, transposed_gain, optimize=True)
        unexplained = previous - summed_explained / len(residuals)
        scatter = expected_rows.T @ expected_rows + _ADDED_SCATTER * identity
        covariance = scatter / len(residuals) + unexplained
        covariance = (covariance + covariance.T) / 2
        change = np.abs(covariance - previous).max()
        if change < _TOLERANCE * np.abs(covariance).max():
            break
    return covariance


def shrunk_correlation(covariance: Array, independent_samples: float) -> Array:
    """Correlation of rows, reduced towards zero by its uncertainty, shape (nv, nv) (Schäfer & Strimmer 2005).

    Eigenvalues below `_MIN_EIGENVALUE` are raised to it, so that the diagonal may be slightly above 1.

    Parameters
    ----------
    covariance
        Covariance of the rows' noise, in any units, shape (nv, nv).
    independent_samples
        Number of independent samples behind it; a fraction of one counts for a sample that shows a part of the rows.
    """
    deviations = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(deviations, deviations)
    identity = np.eye(len(correlation))
    off_diagonal = correlation - np.diag(np.diag(correlation))
    squares = np.square(off_diagonal[identity == 0])
    sampling_variances = np.square(1 - squares) / max(independent_samples, 1.0)
    kept_share = 0.0
    if squares.sum() > 0:
        kept_share = max(1 - sampling_variances.sum() / squares.sum(), 0.0)
    eigenvalues, eigenvectors = np.linalg.eigh(identity + kept_share * off_diagonal)
    raised_eigenvalues = np.maximum(eigenvalues, _MIN_EIGENVALUE)
    return np.asarray((eigenvectors * raised_eigenvalues) @ eigenvectors.T)
