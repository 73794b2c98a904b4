"""Effects without enough evidence: their joints stay above the noise floor with them, and more speaks against them.

- They are small beside another one. A large effect whose model is only nearly right, such as that of an elastic joint,
  leaves a residual in proportion to itself. Some other effect always imitates a part of that, while one that is truly
  there explains all that is left.
- Their size differs between parts of the data. What has no name is imitated by the effect that resembles it most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array
from idtool.diagnosis.confirmation import contradiction, estimate_on_parts
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.noise_floor import estimate_noise_floor
from idtool.dynamics.effects import effect_from_entry
from idtool.estimation.dataset.experiment import Progress
from idtool.robot.config import EffectEntry

_MIN_SHARE_OF_LARGEST = 0.1  # of what the largest effect explains, that needs no further evidence
_MIN_EXPLAINED = 0.7  # of its joints' residual above the noise floor, that a smaller effect must explain
_MIN_EXPLAINED_IF_VARYING = 0.5  # likewise, by an effect whose size differs between parts of the data


@dataclass(frozen=True)
class UnprovenEffect:
    """An effect without enough evidence.

    Attributes
    ----------
    index
        Its index among the effects that are to be judged.
    reason
        What speaks against it, a clause.
    """

    index: int
    reason: str


def find_unproven(
    current: LinearizedFit,
    entries: Sequence[EffectEntry],
    without: Sequence[LinearizedFit],
    progress: Progress,
) -> UnprovenEffect | None:
    """The effect with the least evidence; None if there is enough for all.

    Parameters
    ----------
    current
        The model with all effects.
    entries
        Entries of the effects to judge, as in the model.
    without
        The models without each of them, on the rows by which the effect is judged.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    floor = estimate_noise_floor(current.experiment, current.estimate.theta, progress, current.reversal_margin)
    above_floor = np.maximum(current.mean_squared_residual - np.square(floor.noise), 0.0)
    explained = []
    for reduced in without:
        complete = linearize_fit(current.experiment, progress, reduced)
        explained.append(reduced.mean_squared_residual - complete.mean_squared_residual)
    totals = np.sum(explained, axis=1)

    largest = int(np.argmax(totals))
    for k in np.argsort(totals).tolist():
        share = _explained_share(explained[k], above_floor, np.square(floor.noise))
        is_small = k != largest and totals[k] < _MIN_SHARE_OF_LARGEST * totals[largest]
        if is_small and share < _MIN_EXPLAINED:
            return UnprovenEffect(k, "it explains less than a tenth of what another effect does")
        if share < _MIN_EXPLAINED_IF_VARYING:
            (sizes,) = estimate_on_parts(current, [entries[k]], progress)
            units = effect_from_entry(entries[k], current.experiment.model).parameter_units()
            if difference := contradiction(sizes, units):
                return UnprovenEffect(k, f"it is not the same everywhere in the data ({difference})")
    return None


def _explained_share(explained: Array, above_floor: Array, noise: Array) -> float:
    """Share of the residual above the noise floor that an effect explains, on the joint where it shows most clearly.

    Parameters
    ----------
    explained
        Mean square that it explains of each joint's residual, shape (nv,).
    above_floor
        Mean square that remains above the noise floor with it, at the rows where it is defined, shape (nv,).
    noise
        Mean square of each joint's noise, shape (nv,).
    """
    j = int(np.argmax(explained / np.maximum(noise, np.finfo(float).tiny)))
    return float(explained[j] / max(explained[j] + above_floor[j], np.finfo(float).tiny))
