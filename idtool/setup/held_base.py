"""Logs in which something holds a robot that is none of its contacts, such as a rope on which it hangs."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from idtool.common.units import STANDARD_GRAVITY
from idtool.estimation.dataset.contact_detection import flag_channels, is_any_set, measured_loads
from idtool.estimation.dataset.experiment import Experiment, Run

_IN_FLIGHT = 0.5  # of gravity, below which a robot that nothing holds has its acceleration
_AVERAGE = 0.3  # s
_WIDENING = 0.12  # s, by which contacts last longer than their flags
_MIN_SHARE = 0.05  # of a log


def held_logs(experiment: Experiment) -> list[str]:
    """Names of the logs in which the base feels gravity for long while no contact is closed.

    Parameters
    ----------
    experiment
        Of a robot with a floating base; without flags or forces of all contacts, there are no such logs.
    """
    contacts = experiment.config.contacts
    if any(contact.flag is None and not contact.is_measured for contact in contacts):
        return []
    return [run.signals.log.path.name for run in experiment.runs if _is_held(run, experiment)]


def _is_held(run: Run, experiment: Experiment) -> bool:
    log, model = run.signals.log, experiment.model
    contacts = experiment.config.contacts
    closed = [*flag_channels(contacts, log), *measured_loads(contacts, log, model)]
    held = count = 0
    for batch in run.signals.batches():
        proper_acceleration = batch.filter(batch.motion.a)[model.base_coordinates][:3]
        t = log.start + batch.t
        samples = max(round(_AVERAGE / (log.dt * batch.low_pass.stride)), 1)
        mean = uniform_filter1d(proper_acceleration, samples, axis=1)
        is_supported = np.linalg.norm(mean, axis=0) > _IN_FLIGHT * STANDARD_GRAVITY
        held += int((is_supported & ~is_any_set(closed, t, _WIDENING)).sum())
        count += len(t)
    return held > _MIN_SHARE * count
