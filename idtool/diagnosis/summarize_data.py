"""Summary of the training data, for the search."""

from __future__ import annotations

import numpy as np

from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.dynamics.effects import NamedEffect
from idtool.dynamics.effects.data_summary import Burst, DataSummary

_PEAK_QUANTILE = 0.995


def summarize_data(
    linearized: LinearizedFit, bursts: tuple[Burst, ...] = (), fixed_inertia: bool = False
) -> DataSummary:
    """Ranges of the training data.

    Parameters
    ----------
    linearized
        The model and its data.
    bursts
        Time intervals in which the residual is unusually large.
    fixed_inertia
        True if the URDF's inertia is taken as true.
    """
    experiment = linearized.experiment
    joint_count = len(experiment.equation.joints)
    q_min = np.full(joint_count, np.inf)
    q_max = np.full(joint_count, -np.inf)
    peak_torque = np.zeros(joint_count)
    velocity_squares = np.zeros(joint_count)
    velocity_deadband = np.zeros(joint_count)
    samples = 0
    duration = 0.0
    for run in experiment.runs:
        if not run.train:
            continue
        for batch in experiment.batches(run, held_out=False):
            motion = batch.motion
            inner = slice(batch.before, len(motion.t) - batch.after)
            q = motion.q[:, inner]
            v = motion.v[:, inner]
            tau = motion.tau[:, inner]
            q_min = np.minimum(q_min, q.min(axis=1))
            q_max = np.maximum(q_max, q.max(axis=1))
            peak_torque = np.maximum(peak_torque, np.quantile(np.abs(tau), _PEAK_QUANTILE, axis=1))
            velocity_squares = velocity_squares + np.square(v).sum(axis=1)
            velocity_deadband = np.maximum(velocity_deadband, motion.velocity_deadband)
            samples += v.shape[1]
            duration = max(duration, float(motion.t[-1]))
    return DataSummary(
        model=experiment.model,
        effect_keys=frozenset(e.key for e in experiment.equation.effects if isinstance(e, NamedEffect)),
        q_min=q_min,
        q_max=q_max,
        rms_velocity=np.sqrt(velocity_squares / max(samples, 1)),
        peak_torque=peak_torque,
        velocity_deadband=velocity_deadband,
        dt=experiment.runs[0].signals.log.dt,
        duration=duration,
        band_hz=experiment.band_hz,
        bursts=bursts,
        fixed_inertia=fixed_inertia,
        has_balls=experiment.model.has_floating_base and any(contact.radius for contact in experiment.config.contacts),
    )
