"""Quiet joints: those whose residual is only noise, so that nothing is left to explain."""

from __future__ import annotations

import numpy as np

from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.diagnosis.model_selection import MIN_SHARE
from idtool.diagnosis.noise_floor import estimate_noise_floor
from idtool.diagnosis.trial import FAILURES
from idtool.estimation.dataset.experiment import Progress

_MAX_SLOW_POWER_RATIO = 2.0  # of white noise: power at the motion's frequencies over what higher ones suggest
_MAX_SHARE_ABOVE_NOISE = 0.55  # of the squared residual, if its power is that of white noise: 1.5 times the rms noise


def quiet_joints(
    fit: LinearizedFit, progress: Progress, max_slow_power_ratio: float = _MAX_SLOW_POWER_RATIO
) -> frozenset[str]:
    """Joints whose residual on the training data is only noise; those whose noise is not known are not among them.

    Either less of the squared residual is above the noise than an effect must explain. Or it is of the size of the
    noise, and its power at the motion's frequencies is about what that at higher ones suggests.

    Parameters
    ----------
    fit
        The model.
    progress
        Callback for the stage and its progress, from 0 to 1.
    max_slow_power_ratio
        Ratio of the residual's power at the motion's frequencies to that of its noise, up to which it is noise.
    """
    try:
        floor = estimate_noise_floor(fit.experiment, fit.theta, progress, fit.reversal_margin, on_training_data=True)
    except FAILURES:
        return frozenset()
    share = floor.share_above_noise  # NaN where the noise is not known, and no joint is quiet there
    is_flat = (floor.slow_power_ratio < max_slow_power_ratio) & (share < _MAX_SHARE_ABOVE_NOISE)
    joints = fit.experiment.equation.joints
    return frozenset(joints[j] for j in np.flatnonzero((share < MIN_SHARE) | is_flat))
