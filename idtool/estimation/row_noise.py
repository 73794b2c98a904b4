"""Noise of the rows of a robot with contacts, by which unknown contact forces are eliminated.

Forces, moments and joint torques differ in unit and in noise. An unknown contact force appears in several rows: how it
is eliminated depends on the ratios of their noise. These follow from what a fit without constraints leaves of the rows,
as the weights of the joints do, so that elimination and fit alternate. A part of long logs tells them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.contact_model import ContactModel
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.training_sample import training_sample
from idtool.estimation.dataset.weights import free_noise

_SAMPLE_DURATION = 30.0  # s, of the training data that the noise is determined from, at least
_SAMPLE_PERIODS = 300.0  # of the band's highest frequency, at least
_ELIMINATIONS = 2
_MIN_SHARE = 1e-3  # of the largest number of samples of a row; a row with fewer keeps its noise


def with_row_noise(experiment: Experiment, progress: Progress) -> Experiment:
    """The experiment, in whose equation the rows of a robot with contacts have their noise; without contacts, as it is.

    Parameters
    ----------
    experiment
        Model and data.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    contacts = experiment.equation.contacts
    if contacts is None:
        return experiment
    sample = noise_sample(experiment)
    for _ in range(_ELIMINATIONS):
        reduction = sample.reduce_unchecked(progress)
        contacts = contacts.with_noise(_row_noise(sample, contacts, reduction))
        sample = replace(sample, equation=sample.equation.with_contacts(contacts))
    return replace(experiment, equation=experiment.equation.with_contacts(contacts))


def noise_sample(experiment: Experiment) -> Experiment:
    """The experiment with as much of its training data as it takes to determine the noise of the rows."""
    return training_sample(experiment, max(_SAMPLE_DURATION, _SAMPLE_PERIODS / experiment.band_hz))


def _row_noise(experiment: Experiment, contacts: ContactModel, reduction: Reduction) -> Array:
    """Noise of every row, shape (nv,); as before where contact forces leave next to nothing of a row."""
    noise = free_noise(experiment.equation, reduction, experiment.equalities)
    rows = np.array([factor.rows for factor in reduction])
    return np.where(rows > _MIN_SHARE * rows.max(), noise, contacts.noise)
