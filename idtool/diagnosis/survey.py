"""What the training data cover, for the search."""

from __future__ import annotations

import numpy as np

from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.dynamics.effects import NamedEffect
from idtool.dynamics.effects.data_summary import DataSummary


def survey(linearized: LinearizedFit, bursts: tuple[tuple[float, float], ...] = (), fixed: bool = False) -> DataSummary:
    """What was logged.

    Parameters
    ----------
    linearized
        The model and its data.
    bursts
        Stretches of time in which the residual is out of the ordinary [s].
    fixed
        Whether the URDF's inertia is taken as true.
    """
    experiment = linearized.experiment
    low, high, torque = (np.full(len(experiment.equation.joints), x) for x in (np.inf, -np.inf, 0.0))
    squares, count, seconds, still = np.zeros_like(torque), 0, 0.0, np.zeros_like(torque)
    for run in (run for run in experiment.runs if run.train):
        for batch in run.signals.batches(run.train):
            m, inner = batch.motion, slice(batch.before, len(batch.motion.t) - batch.after)
            low, high = np.minimum(low, m.q[:, inner].min(axis=1)), np.maximum(high, m.q[:, inner].max(axis=1))
            torque = np.maximum(torque, np.quantile(np.abs(m.tau[:, inner]), 0.995, axis=1))
            squares, count = squares + np.square(m.v[:, inner]).sum(axis=1), count + m.v[:, inner].shape[1]
            still = np.maximum(still, m.velocity_deadband)
            seconds = max(seconds, float(m.t[-1]))
    taken = frozenset(e.key for e in experiment.equation.effects if isinstance(e, NamedEffect))
    speed = np.sqrt(squares / max(count, 1))
    band = experiment.band_hz
    return DataSummary(
        experiment.model,
        taken,
        low,
        high,
        speed,
        torque,
        still,
        experiment.runs[0].signals.log.dt,
        seconds,
        band,
        bursts,
        fixed,
    )
