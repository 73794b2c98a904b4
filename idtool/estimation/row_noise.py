"""Noise of the rows of a robot with contacts, by which unknown contact forces are eliminated.

Forces, moments and joint torques differ in unit and in noise. An unknown contact force appears in several rows: how it
is eliminated depends on the ratios of their noise. These follow from what a fit without constraints leaves of the rows,
as the weights of the joints do, so that elimination and fit take turns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.contact_model import ContactModel
from idtool.estimation.dataset.blocks import Blocks, merge_reductions
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import free_noise

_ELIMINATIONS = 2  # after the first one
_MIN_SHARE = 1e-3  # of the rows of the joint with most, that tell a row's noise


def with_row_noise(experiment: Experiment, progress: Progress) -> tuple[Experiment, tuple[Blocks, ...] | None]:
    """Determine the noise of the rows of a robot with contacts.

    Returns
    -------
    The experiment, whose equation has the noise, and the training data with it; without contacts, the experiment as it
    is, and None.
    """
    contacts = experiment.equation.contacts
    if contacts is None:
        return experiment, None
    data = _reduced(experiment, progress)
    for _ in range(_ELIMINATIONS):
        reduction = merge_reductions([log.total for log in data])
        del data  # which is large, before the next one is made
        contacts = contacts.with_noise(_row_noise(experiment, contacts, reduction))
        experiment = replace(experiment, equation=replace(experiment.equation, contacts=contacts))
        data = _reduced(experiment, progress)
    return experiment, data


def _row_noise(experiment: Experiment, contacts: ContactModel, reduction: Reduction) -> Array:
    """Noise of every row, shape (nv,); as before where contact forces leave next to nothing of a row."""
    noise = free_noise(experiment.equation, reduction, experiment.equalities)
    rows = np.array([factor.rows for factor in reduction])
    return np.where(rows > _MIN_SHARE * rows.max(), noise, contacts.noise)


def _reduced(experiment: Experiment, progress: Progress) -> tuple[Blocks, ...]:
    """The training data as R-factors."""
    return experiment.blocks(lambda run: experiment.rows(run, progress))
