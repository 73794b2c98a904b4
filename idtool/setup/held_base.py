"""Logs in which something holds a robot that is none of its contacts, such as a rope on which it hangs."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from idtool.estimation.dataset.experiment import Experiment, Run
from idtool.robot.config import Config
from idtool.robot.model import RobotModel

_GRAVITY = 9.81  # m/s²
_IN_FLIGHT = 0.5  # of gravity, below which a robot that nothing holds has its acceleration
_AVERAGE = 0.3  # s
_MIN_SHARE = 0.05  # of a log


def held_logs(experiment: Experiment) -> list[str]:
    """Names of the logs in which the base feels gravity for long while no contact is closed.

    Parameters
    ----------
    experiment
        Of a robot with a floating base; without flags of all contacts, there are no such logs.
    """
    if any(contact.flag_channel is None for contact in experiment.config.contacts):
        return []
    return [run.signals.log.path.name for run in experiment.runs if _is_held(run, experiment.model, experiment.config)]


def _is_held(run: Run, model: RobotModel, config: Config) -> bool:
    log = run.signals.log
    held = count = 0
    for batch in run.signals.batches():
        proper_acceleration = batch.filter(batch.motion.a)[model.base_coordinates][:3]
        t = log.start + batch.t
        samples = max(round(_AVERAGE / (log.dt * batch.low_pass.stride)), 1)
        mean = uniform_filter1d(proper_acceleration, samples, axis=1)
        is_supported = np.linalg.norm(mean, axis=0) > _IN_FLIGHT * _GRAVITY
        is_closed = np.zeros(len(t), dtype=bool)
        for contact in config.contacts:
            is_closed |= log.channels[str(contact.flag_channel)].is_set(t, contact.widen)
        held += int((is_supported & ~is_closed).sum())
        count += len(t)
    return held > _MIN_SHARE * count
