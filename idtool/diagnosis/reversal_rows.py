"""Rows near reversals, and the joints that are known much more accurately without them.

Near a reversal, the friction of real robots does not follow Coulomb's law, and simulators smooth the sign.
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.trial import FAILURES
from idtool.estimation.dataset.experiment import Progress

REVERSAL_MARGIN = 0.04  # s from reversals, within which rows may be excluded
_MIN_INFORMATION_GAIN = 4.0  # factor on a joint's information for which they are; it halves the standard errors
_MIN_INFORMATION_LEFT = 0.5  # share of its information that every joint must keep


def joints_clearer_away_from_reversals(current: LinearizedFit, progress: Progress) -> dict[str, tuple[float, float]]:
    """Joints with much more information without the rows near reversals; none if another joint loses too much.

    Parameters
    ----------
    current
        The model, fitted to all rows.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    Their rms residual with and without these rows [N·m or N].
    """
    try:
        away = linearize_fit(current.experiment, progress, reversal_margin=REVERSAL_MARGIN)
    except FAILURES:
        return {}
    information = _information(current)
    information_away = _information(away)
    if (information_away < _MIN_INFORMATION_LEFT * information).any():
        return {}
    is_clearer = information_away > _MIN_INFORMATION_GAIN * information
    rms = np.sqrt(current.mean_squared_residual)
    rms_away = np.sqrt(away.mean_squared_residual)
    joints = away.experiment.equation.joints
    return {joints[j]: (float(rms[j]), float(rms_away[j])) for j in np.flatnonzero(is_clearer)}


def _information(fit: LinearizedFit) -> Array:
    """Fisher information of the rows on an offset of each joint's torque, shape (nv,) [1/(N·m)² or 1/N²]."""
    variance = np.maximum(fit.mean_squared_residual, np.finfo(float).tiny)
    return np.asarray(fit.row_counts.sum(axis=0) / variance)
