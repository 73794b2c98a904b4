"""Quiet joints: those whose residual is hardly more than noise, so that nothing is left to explain."""

from __future__ import annotations

import numpy as np

from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.diagnosis.model_selection import MIN_SHARE
from idtool.diagnosis.noise_floor import estimate_noise_floor
from idtool.diagnosis.reversal_rows import REVERSAL_MARGIN
from idtool.diagnosis.trial import FAILURES
from idtool.estimation.dataset.experiment import Progress


def quiet_joints(fit: LinearizedFit, progress: Progress) -> frozenset[str]:
    """Joints on which no effect could explain enough to be added.

    On a quiet joint, the part of the squared residual that is above the noise is a smaller share of it than an effect
    must explain. Training data count. A joint whose noise is not known is not quiet.

    The noise is estimated away from reversals: what a model lacks near them is so short that it would pass for noise.
    The residual is that of all rows, or that away from reversals, whichever is larger.

    Parameters
    ----------
    fit
        The model.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    Names of the joints.
    """
    margin = max(fit.reversal_margin, REVERSAL_MARGIN)
    try:
        floor = estimate_noise_floor(
            fit.experiment, fit.theta, progress, margin, of_true_torque=True, on_training_data=True
        )
    except FAILURES:
        return frozenset()
    squared_residual = np.maximum(fit.mean_squared_residual, np.square(floor.residual))
    above_noise = squared_residual - np.square(floor.noise)
    is_quiet = floor.is_joint_estimated & (above_noise < MIN_SHARE * squared_residual)
    joints = fit.experiment.equation.joints
    return frozenset(joints[j] for j in np.flatnonzero(is_quiet))


def are_all_quiet(fit: LinearizedFit, progress: Progress) -> bool:
    """True if all joints are quiet; see `quiet_joints`."""
    return quiet_joints(fit, progress).issuperset(fit.experiment.equation.joints)
