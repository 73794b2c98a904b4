"""Noise of the rows of a robot with contacts, by which unknown contact forces are eliminated.

Forces, moments and joint torques differ in unit and in noise. An unknown contact force appears in several rows: how it
is eliminated depends on the ratios of their noise. These follow from what a fit without constraints leaves of the rows,
as the weights of the joints do, so that elimination and fit take turns.
"""

from __future__ import annotations

from dataclasses import replace

from idtool.common.arrays import Array
from idtool.dynamics.contact_forces import ContactForces
from idtool.estimation.dataset.blocks import Blocks, merge_reductions
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.weights import free_noise

_ELIMINATIONS = 2  # after the first one


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
        noise = free_noise(experiment.equation, merge_reductions([log.total for log in data]), experiment.equalities)
        experiment = _with_noise(experiment, contacts, noise)
        data = _reduced(experiment, progress)
    return experiment, data


def _reduced(experiment: Experiment, progress: Progress) -> tuple[Blocks, ...]:
    """The training data as R-factors."""
    return experiment.blocks(lambda run: experiment.rows(run, progress))


def _with_noise(experiment: Experiment, contacts: ContactForces, noise: Array) -> Experiment:
    """The experiment with contact forces eliminated according to the noise of the rows, shape (nv,)."""
    equation = replace(experiment.equation, contacts=contacts.with_noise(noise))
    return replace(experiment, equation=equation)
