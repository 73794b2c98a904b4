"""Two or three effects on one joint that explain its residual only together.

Where a joint lacks several effects, each alone may increase the error in parts of the log, or need parameters that no
robot has, so that a round of the search rejects all of them. Here the candidates of a joint, each at its best
parameters, are screened in pairs, and the best pairs are fitted with the whole model. Several effects can imitate more
than one can, so they must explain nearly all that the residual of the joint has above its noise. Where no pair does,
the best one is completed by a third effect.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
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
    probe_key,
)
from idtool.diagnosis.quiet_joints import quiet_joints
from idtool.diagnosis.screen import ScreenedProbe, screen_pairs, screen_probes
from idtool.diagnosis.summarize_data import summarize_data
from idtool.diagnosis.trial import FAILURES, TrialFit, fit_trial, has_fixed_inertia, on_rows_of
from idtool.dynamics.effects import effect_types
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.estimation.dataset.experiment import Progress

_STAGE = "trying several effects together"
_MAX_GAUSS_NEWTON_STEPS = 8
_MAX_FITS = 3  # pairs of a joint that are fitted with the whole model, and third effects beside the best of them
_MIN_SCREENED_SHARE = 0.4  # of a joint's squared residual, that effects must explain to first order to be fitted


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
class EffectGroup:
    """Effects on one joint, fitted together with the whole model.

    Attributes
    ----------
    effects
        The effects, each with its gain beside the others; those of the first two are beside each other alone.
    trial
        Fit of the model with all of them; they are its last entries.
    """

    effects: tuple[FittedCandidate, ...]
    trial: TrialFit


def find_groups(
    selection: SelectionStep,
    screening: Screening,
    initial: LinearizedFit,
    movable: Sequence[int],
    progress: Progress,
) -> Iterator[EffectGroup]:
    """Groups of effects that explain the residual of a joint together, where a round found no single one.

    They come joint by joint, those with the largest gain in the screening first. Effects that cannot be screened or
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
    summary = summarize_data(selection.base, fixed_inertia=has_fixed_inertia(selection.base.experiment))
    quiet = quiet_joints(selection.base, progress)
    for joint in selection.base.experiment.equation.joints:
        if joint not in quiet:
            yield from _GroupSearch(joint, selection, screening, initial, summary, movable, progress).groups()


@dataclass(frozen=True)
class _GroupSearch:
    """Search for the groups of one joint.

    Attributes
    ----------
    joint
        Name of the joint.
    summary
        The robot and its data.
    selection, screening, initial, movable, progress
        As for `find_groups`.
    """

    joint: str
    selection: SelectionStep
    screening: Screening
    initial: LinearizedFit
    summary: DataSummary
    movable: Sequence[int]
    progress: Progress

    @property
    def _base(self) -> LinearizedFit:
        """The model that lacks the effects."""
        return self.selection.base

    def groups(self) -> Iterator[EffectGroup]:
        """Pairs that explain nearly all of the residual; if there are none, the best one with a third effect."""
        incomplete: list[tuple[float, EffectGroup]] = []
        is_explained = False
        for pair in self._screened_pairs():
            group = self._fitted_pair(pair)
            if group is None:
                continue
            explained = self._explained(group)
            if explained >= NEARLY_ALL and self._is_possible(group):
                is_explained = True
                yield group
            else:
                incomplete.append((explained, group))
        if incomplete and not is_explained:
            _, best = max(incomplete, key=lambda one: one[0])
            yield from self._completed(best)

    def _completed(self, pair: EffectGroup) -> Iterator[EffectGroup]:
        """A pair with third effects beside which it explains nearly all of the residual."""
        for third in self._screened_beside(pair):
            group = self._fitted_with_third(pair, third)
            if group is not None and self._explained(group) >= NEARLY_ALL and self._is_possible(group):
                yield group

    def _screened_pairs(self) -> list[_ScreenedPair]:
        """The best pairs, the largest gain first, of those that explain much of the residual to first order."""
        try:
            pairs = self._all_screened_pairs()
        except FAILURES:
            return []
        large = []
        for pair in pairs:
            is_large = explained_share(pair.gain, self._base, joint_count=1) > _MIN_SCREENED_SHARE
            if is_large and all(self._is_worthwhile(effect, self._base) for effect in pair.effects):
                large.append(pair)
        return sorted(large, key=lambda pair: -pair.gain)[:_MAX_FITS]

    def _all_screened_pairs(self) -> list[_ScreenedPair]:
        """All pairs of effects on the joint; none if nothing on the joint explains anything."""
        candidates = list(best_by_key(self._probes_on_joint()).values())
        largest_gain = max((candidate.gain for candidate in candidates), default=0.0)
        choices = list(combinations(range(len(candidates)), 2))
        if not choices or largest_gain < MIN_SIGNIFICANCE**2 * self.selection.inflation:
            return []
        probes = [candidate.probe for candidate in candidates]
        screened = screen_pairs(self.screening.reference, probes, choices, self.progress, _STAGE)
        pairs = []
        for (i, j), joined in zip(choices, screened, strict=True):
            pairs.append(_screened_pair(candidates[i], candidates[j], joined))
        return pairs

    def _screened_beside(self, pair: EffectGroup) -> list[ScreenedProbe]:
        """The best effects beside a pair, the largest gain first, of those that explain much of what it leaves."""
        present = {probe_key(effect.probe) for effect in pair.effects}
        probes = [one.probe for one in self._probes_on_joint() if probe_key(one.probe) not in present]
        with_pair = pair.trial.linearized
        try:
            screened = screen_probes(with_pair, probes, self.progress, _STAGE)
        except FAILURES:
            return []
        large = []
        for third in best_by_key(screened).values():
            is_large = explained_share(third.gain, with_pair, joint_count=1) > _MIN_SCREENED_SHARE
            if is_large and self._is_worthwhile(third, with_pair):
                large.append(third)
        return sorted(large, key=lambda third: -third.gain)[:_MAX_FITS]

    def _probes_on_joint(self) -> list[ScreenedProbe]:
        """Screened probes that may be in a group: of effects that are reported, and defined where they act.

        With one that is undefined there, a group would be judged by other samples.
        """
        on_joint = []
        for one in self.screening.screened:
            is_defined = not effect_types()[one.probe.effect].is_undefined_where_it_acts
            if one.probe.joint == self.joint and is_reportable(one.probe.effect) and is_defined and not one.failure:
                on_joint.append(one)
        return on_joint

    def _is_worthwhile(self, effect: ScreenedProbe, base: LinearizedFit) -> bool:
        """True if an effect of a group is possible, and its gain beside the others, in a base, is worthwhile."""
        inflation = self.selection.inflation
        is_gain_large_enough = is_worthwhile(effect.gain, base, inflation, True, effect.probe.complexity)
        return effect.is_possible and is_gain_large_enough

    def _fitted_pair(self, pair: _ScreenedPair) -> EffectGroup | None:
        """Pair fitted with the whole model; None if it cannot be."""
        trial = self._fit(self._base, pair.effects)
        if trial is None:
            return None
        gains = block_gains(self._base, trial.linearized)
        first, second = pair.effects
        first_alone, second_alone = pair.gains_alone
        first_fitted = FittedCandidate(first, trial, gains - second_alone)
        second_fitted = FittedCandidate(second, trial, gains - first_alone)
        return EffectGroup((first_fitted, second_fitted), trial)

    def _fitted_with_third(self, pair: EffectGroup, third: ScreenedProbe) -> EffectGroup | None:
        """Pair and a third effect, fitted with the whole model; None if they cannot be."""
        trial = self._fit(pair.trial.linearized, [third], refitted_count=len(pair.effects))
        if trial is None:
            return None
        gains = block_gains(pair.trial.linearized, trial.linearized)
        of_pair = [replace(effect, trial=trial) for effect in pair.effects]
        return EffectGroup((*of_pair, FittedCandidate(third, trial, gains)), trial)

    def _fit(self, base: LinearizedFit, effects: Sequence[ScreenedProbe], refitted_count: int = 0) -> TrialFit | None:
        """Effects fitted with a model, and the last ``refitted_count`` of its own anew; None if they cannot be."""
        entries = list(base.experiment.config.effects)
        entries += [effect.entry for effect in effects if effect.entry is not None]
        count = len(entries)
        newest = range(count - len(effects) - refitted_count, count)
        optimized = [*possible_imitators(self._base, self.joint, self.movable), *newest]
        try:
            trial = fit_trial(base, entries, optimized, self.progress, _MAX_GAUSS_NEWTON_STEPS)
            return on_rows_of(self._base, trial, self.progress)  # a backlash may have been fitted anew
        except FAILURES:
            return None

    def _is_possible(self, group: EffectGroup) -> bool:
        """True if there is no reason to reject a group."""
        gains = block_gains(self._base, group.trial.linearized)
        whole = FittedCandidate(group.effects[-1].screened, group.trial, gains)
        count = len(group.effects)
        try:
            return not rejection_reason(whole, self._base, self.initial, self.summary, self.progress, count)
        except FAILURES:
            return False

    def _explained(self, group: EffectGroup) -> float:
        """Share of the joint's squared residual above its noise that a group explains; 0 if it is not known."""
        try:
            return explained_share_above_noise(self._base, group.trial.linearized, self.joint, self.progress)
        except FAILURES:
            return 0.0


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
