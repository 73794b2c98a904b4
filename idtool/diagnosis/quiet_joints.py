"""Quiet joints: those whose residual is only noise, so that nothing is left to explain."""

from __future__ import annotations

import numpy as np

from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.diagnosis.model_selection import MIN_SHARE
from idtool.diagnosis.noise_floor import estimate_noise_floor
from idtool.diagnosis.reversal_rows import REVERSAL_MARGIN
from idtool.diagnosis.trial import FAILURES
from idtool.estimation.dataset.experiment import Progress


def quiet_joints(fit: LinearizedFit, progress: Progress) -> frozenset[str]:
    """Joints whose squared residual on the training data has less above the noise than an effect must explain of it.

    Those whose noise is not known are not among them. It is that away from reversals: what a model lacks near them is
    so short that it would pass for noise. The residual is that of all rows, or away from reversals if that is larger.

    Parameters
    ----------
    fit
        The model.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    margin = max(fit.reversal_margin, REVERSAL_MARGIN)
    try:
        floor = estimate_noise_floor(
            fit.experiment, fit.theta, progress, margin, of_true_torque=True, on_training_data=True
        )
    except FAILURES:
        return frozenset()
    squared_residual = np.maximum(fit.mean_squared_residual, np.square(floor.residual))
    is_quiet = floor.is_joint_estimated & (np.square(floor.noise) > (1 - MIN_SHARE) * squared_residual)
    joints = fit.experiment.equation.joints
    return frozenset(joints[j] for j in np.flatnonzero(is_quiet))


def are_all_quiet(fit: LinearizedFit, progress: Progress) -> bool:
    """True if all joints are quiet; see `quiet_joints`."""
    return quiet_joints(fit, progress).issuperset(fit.experiment.equation.joints)
