"""Effects without enough evidence: their joints stay above the noise floor with them, and more speaks against them.

- They explain little of what their joint has.
- They are small beside another one. A large effect whose model is only nearly right, such as that of an elastic joint,
  leaves a residual in proportion to itself. Some other effect always imitates a part of that, while one that is truly
  there explains all that is left.
- Their size differs between parts of the data, or they explain something only now and then. What has no name is
  imitated by the effect that resembles it most.
"""

from __future__ import annotations

from collections.abc import Container, Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.diagnosis.confirmation import contradiction, estimate_on_parts
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.model_selection import block_gains
from idtool.diagnosis.noise_floor import estimate_noise_floor
from idtool.diagnosis.screen import sum_standard_error
from idtool.dynamics.effects import effect_from_entry
from idtool.estimation.dataset.experiment import Progress
from idtool.robot.config import EffectEntry

_MIN_RATIO_TO_LARGEST = 0.1  # of the mean squares that two effects explain; an effect with less is small
_MIN_EXPLAINED_SHARE = 0.2  # of its joint's residual above the noise floor, that every effect must explain
_MIN_EXPLAINED_SHARE_IF_VARYING = 0.5  # likewise, by an effect that differs between parts of the data
_MIN_EXPLAINED_SHARE_IF_SMALL = 0.5  # likewise, by an effect that is small
_MIN_EXPLAINED_SHARE_IF_SMALL_ON_JOINT = 0.7  # likewise, by one that is small even beside those on its joint
_MIN_GAIN_SIGNIFICANCE = 2.0  # standard errors of a gain, by its scatter over blocks of time; less is varying


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
    exempt: Container[int] = (),
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
    exempt
        Indices of effects that are not judged.
    """
    theta = current.estimate.theta
    margin = current.reversal_margin
    floor = estimate_noise_floor(current.experiment, theta, progress, margin, of_true_torque=True)
    above_floor = np.maximum(current.mean_squared_residual - np.square(floor.noise), 0.0)
    explained = []
    gains = []
    for reduced in without:
        complete = linearize_fit(current.experiment, progress, reduced)
        explained.append(reduced.mean_squared_residual - complete.mean_squared_residual)
        gains.append(block_gains(reduced, complete))
    totals = np.sum(explained, axis=1)

    largest = int(np.argmax(totals))
    largest_on_joint = np.max(explained, axis=0)
    for k in np.argsort(totals).tolist():
        if k in exempt:
            continue
        j = _clearest_joint(explained[k], np.square(floor.noise))
        share = _explained_share(float(explained[k][j]), float(above_floor[j]))
        is_small = k != largest and totals[k] < _MIN_RATIO_TO_LARGEST * totals[largest]
        is_small_on_joint = explained[k][j] < _MIN_RATIO_TO_LARGEST * largest_on_joint[j]
        min_share = _MIN_EXPLAINED_SHARE_IF_SMALL_ON_JOINT if is_small_on_joint else _MIN_EXPLAINED_SHARE_IF_SMALL
        if is_small and share < min_share:
            return UnprovenEffect(k, "it explains less than a tenth of what another effect does")
        if share < _MIN_EXPLAINED_SHARE_IF_VARYING:
            (sizes,) = estimate_on_parts(current, [entries[k]], progress)
            units = effect_from_entry(entries[k], current.experiment.model).parameter_units()
            if difference := contradiction(sizes, units):
                return UnprovenEffect(k, f"it is not the same everywhere in the data ({difference})")
            if gains[k].sum() < _MIN_GAIN_SIGNIFICANCE * sum_standard_error(gains[k]):
                return UnprovenEffect(
                    k,
                    "it explains less than half of what its joint's residual has above the noise floor, and only in "
                    "parts of the data",
                )
        if share < _MIN_EXPLAINED_SHARE:
            return UnprovenEffect(
                k, "it explains less than a fifth of what its joint's residual has above the noise floor"
            )
    return None


def _clearest_joint(explained: Array, noise_squares: Array) -> int:
    """Index of the joint on which an effect shows most clearly.

    Parameters
    ----------
    explained
        Mean square that it explains of each joint's residual, shape (nv,).
    noise_squares
        Mean square of each joint's noise, shape (nv,); 0: the joint rests, and shows nothing.
    """
    moves = noise_squares > 0
    if not moves.any():
        return int(np.argmax(explained))
    clarity = np.full(len(explained), -np.inf)
    clarity[moves] = explained[moves] / noise_squares[moves]
    return int(np.argmax(clarity))


def _explained_share(explained: float, above_floor: float) -> float:
    """Share of a joint's residual above the noise floor that an effect explains.

    Parameters
    ----------
    explained
        Mean square that it explains.
    above_floor
        Mean square that remains above the noise floor with it, at the rows where it is defined.
    """
    return explained / max(explained + above_floor, np.finfo(float).tiny)
