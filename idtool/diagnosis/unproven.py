"""Effects without enough evidence: small beside another one, and their joints stay above the noise floor with them.

What an effect is only nearly right about, such as the deflection of an elastic joint, leaves a residual in proportion
to it, which some other effect always imitates in part. An effect that is truly there explains all that is left.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.diagnosis.noise_floor import estimate_noise_floor
from idtool.estimation.dataset.experiment import Progress

_MIN_SHARE_OF_LARGEST = 0.1  # of what the largest effect explains, that needs no further evidence
_MIN_EXPLAINED = 0.7  # of its joints' residual above the noise floor, that a smaller effect must explain


def find_unproven(current: LinearizedFit, without: Sequence[LinearizedFit], progress: Progress) -> int | None:
    """Index of the effect with the least evidence; None if there is enough for all.

    Parameters
    ----------
    current
        The model with all effects.
    without
        The models without each of them, on the same rows and in the same units.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    rows = np.maximum(current.row_counts.sum(axis=0), 1.0)
    unit = np.square(current.noise) / rows
    explained = np.array([(one.sse - current.sse).sum(axis=0) * unit for one in without])  # (effects, nv) mean squares
    totals = explained.sum(axis=1)
    remaining = current.sse.sum(axis=0) * unit
    theta = current.estimate.theta
    floor = estimate_noise_floor(current.experiment, theta, progress, current.reversal_margin)
    above_floor = np.maximum(remaining - np.square(floor.noise), 0.0)

    unproven = []
    for k, own in enumerate(explained):
        if totals[k] >= _MIN_SHARE_OF_LARGEST * totals.max():
            continue
        if _explained_share(own, above_floor) < _MIN_EXPLAINED:
            unproven.append(k)
    return min(unproven, key=lambda k: float(totals[k])) if unproven else None


def _explained_share(explained: Array, above_floor: Array) -> float:
    """Share of the residual above the noise floor that an effect explains, on the joint where it explains most."""
    j = int(np.argmax(explained))
    return float(explained[j] / max(explained[j] + above_floor[j], np.finfo(float).tiny))
