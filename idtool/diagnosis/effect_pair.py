"""Two effects on one joint that explain its residual only together.

Where a joint lacks two effects, each alone may increase the error in parts of the log, or need parameters that no robot
has, so that a round of the search rejects both. Here the candidates of a joint, each at its best parameters, are
screened in pairs, and the best pairs are fitted with the whole model. Two effects can imitate more than one can, so
they must explain nearly all that the residual of the joint has above its noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from idtool.common.arrays import Array
from idtool.diagnosis.candidate_fit import (
    NEARLY_ALL,
    explained_share_above_noise,
    possible_imitators,
    rejection_reason,
)
from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.diagnosis.model_selection import (
    MIN_SIGNIFICANCE,
    FittedCandidate,
    Screening,
    SelectionStep,
    best_by_key,
    block_gains,
    explained_share,
    is_reportable,
    is_worthwhile,
)
from idtool.diagnosis.quiet_joints import quiet_joints
from idtool.diagnosis.screen import ScreenedProbe, screen_pairs
from idtool.diagnosis.summarize_data import summarize_data
from idtool.diagnosis.trial import FAILURES, TrialFit, fit_trial, has_fixed_inertia, on_rows_of
from idtool.dynamics.effects import effect_types
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.estimation.dataset.experiment import Progress

_STAGE = "trying pairs of effects"
_MAX_GAUSS_NEWTON_STEPS = 8
_MAX_FITS = 3  # pairs of a joint that are fitted with the whole model
_MIN_SCREENED_SHARE = 0.4  # of a joint's squared residual, that a pair must explain to first order to be fitted


@dataclass(frozen=True)
class _ScreenedPair:
    """Two effects on one joint, screened together.

    Attributes
    ----------
    effects
        Both, each with its coefficients in the pair and its gain beside the other.
    gains
        Gain of the pair in each block of time, shape (F,).
    gains_alone
        Gain of each effect alone, shape (F,); 0 in a block where it is below 0.
    """

    effects: tuple[ScreenedProbe, ScreenedProbe]
    gains: Array
    gains_alone: tuple[Array, Array]

    @property
    def gain(self) -> float:
        """Gain of the pair over all blocks."""
        return float(self.gains.sum())


@dataclass(frozen=True)
class FittedEffectPair:
    """Two effects on one joint, fitted together with the whole model.

    Attributes
    ----------
    effects
        Both, each with its gain beside the other.
    trial
        Fit of the model with both; they are its last entries.
    """

    effects: tuple[FittedCandidate, FittedCandidate]
    trial: TrialFit


def find_pairs(
    selection: SelectionStep,
    screening: Screening,
    initial: LinearizedFit,
    movable: Sequence[int],
    progress: Progress,
) -> Iterator[FittedEffectPair]:
    """Pairs of effects that explain the residual of a joint together, where a round found no single one.

    They come joint by joint, those with the largest gain in the screening first. Pairs that cannot be screened or
    fitted are left out.

    Parameters
    ----------
    selection, screening
        The last round, which has no winner, and its screening.
    initial
        The model without any of the effects found.
    movable
        Indices of the model's effects whose nonlinear parameters may be moved.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    base = selection.base
    summary = summarize_data(base, fixed_inertia=has_fixed_inertia(base.experiment))
    quiet = quiet_joints(base, progress)
    for joint in base.experiment.equation.joints:
        if joint in quiet:
            continue
        try:
            pairs = _pairs_on_joint(selection, screening, joint, progress)
        except FAILURES:
            continue
        for pair in pairs[:_MAX_FITS]:
            try:
                fitted = _fit_pair(pair, base, initial, summary, movable, progress)
            except FAILURES:
                continue
            if fitted is not None:
                yield fitted


def _pairs_on_joint(
    selection: SelectionStep, screening: Screening, joint: str, progress: Progress
) -> list[_ScreenedPair]:
    """Pairs of effects on a joint that explain much of its residual, the largest gain first."""
    base = selection.base
    on_joint = [one for one in screening.screened if one.probe.joint == joint and _may_be_in_pair(one)]
    candidates = list(best_by_key(on_joint).values())
    largest_gain = max((candidate.gain for candidate in candidates), default=0.0)
    if largest_gain < MIN_SIGNIFICANCE**2 * selection.inflation:  # nothing on this joint explains anything
        return []
    choices = list(combinations(range(len(candidates)), 2))
    if not choices:
        return []
    probes = [candidate.probe for candidate in candidates]
    screened = screen_pairs(screening.reference, probes, choices, progress, _STAGE)
    pairs = []
    for (i, j), joined in zip(choices, screened, strict=True):
        pair = _screened_pair(candidates[i], candidates[j], joined)
        is_large = explained_share(pair.gain, base, joint_count=1) > _MIN_SCREENED_SHARE
        if is_large and all(_is_worthwhile_in_pair(effect, selection) for effect in pair.effects):
            pairs.append(pair)
    return sorted(pairs, key=lambda pair: -pair.gain)


def _may_be_in_pair(one: ScreenedProbe) -> bool:
    """True if an effect is reported, and defined where it acts: else a pair would be judged by other samples."""
    is_defined = not effect_types()[one.probe.effect].is_undefined_where_it_acts
    return is_reportable(one.probe.effect) and is_defined and not one.failure


def _screened_pair(first: ScreenedProbe, second: ScreenedProbe, joined: ScreenedProbe) -> _ScreenedPair:
    """Pair of two probes, from the screening of each and of both together."""
    count = first.probe.coefficient_count
    # one that increases the error of a block would not be in the model without the other
    first_alone = np.maximum(first.gains, 0.0)
    second_alone = np.maximum(second.gains, 0.0)
    first_in_pair = _part_of_pair(first, joined, slice(0, count), joined.gains - second_alone)
    second_in_pair = _part_of_pair(second, joined, slice(count, None), joined.gains - first_alone)
    return _ScreenedPair((first_in_pair, second_in_pair), joined.gains, (first_alone, second_alone))


def _part_of_pair(one: ScreenedProbe, joined: ScreenedProbe, part: slice, gains: Array) -> ScreenedProbe:
    """A probe with its coefficients in a pair, a part of the pair's, and its gain beside the other one, shape (F,)."""
    return replace(
        one,
        c=joined.c[part],
        covariance=joined.covariance[part, part],
        information=joined.marginal_information(part),
        gains=gains,
    )


def _is_worthwhile_in_pair(effect: ScreenedProbe, selection: SelectionStep) -> bool:
    """True if an effect of a pair is possible, and worthwhile beside the other."""
    is_gain_large_enough = is_worthwhile(
        effect.gain,
        selection.base,
        selection.inflation,
        on_joint=True,
        parameter_count=effect.probe.complexity,
    )
    return effect.is_possible and is_gain_large_enough


def _fit_pair(
    pair: _ScreenedPair,
    base: LinearizedFit,
    initial: LinearizedFit,
    summary: DataSummary,
    movable: Sequence[int],
    progress: Progress,
) -> FittedEffectPair | None:
    """Pair fitted with the whole model; None if it is rejected. Raises as `fit_trial`."""
    first, second = pair.effects
    joint = str(first.probe.joint)
    entries = list(base.experiment.config.effects)
    entries += [effect.entry for effect in pair.effects if effect.entry is not None]
    newest = [len(entries) - 2, len(entries) - 1]
    optimized = [*possible_imitators(base, joint, movable), *newest]
    trial = fit_trial(base, entries, optimized, progress, _MAX_GAUSS_NEWTON_STEPS)
    trial = on_rows_of(base, trial, progress)  # a backlash may have been fitted anew
    gains = block_gains(base, trial.linearized)
    both = FittedCandidate(second, trial, gains)
    if rejection_reason(both, base, initial, summary, progress, new_count=2):
        return None
    if explained_share_above_noise(base, trial.linearized, joint, progress) < NEARLY_ALL:
        return None
    first_alone, second_alone = pair.gains_alone
    first_fitted = FittedCandidate(first, trial, gains - second_alone)
    second_fitted = FittedCandidate(second, trial, gains - first_alone)
    return FittedEffectPair((first_fitted, second_fitted), trial)
