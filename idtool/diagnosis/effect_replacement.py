"""Effects of a model that give way to another one: one that explains more than one of them, or as much as two.

Effects are found one after the other. Beside those found later, one may turn out to explain less than another would,
and two may together stand for a single one. Here each is left out in turn, then two at a time, and the best effect in
their place is searched for.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations

from idtool.common.dataclass import dataclass
from idtool.common.processes import in_processes, interleaved_shares
from idtool.diagnosis.extended_model import AddedEffect, ExtendedModel
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.model_selection import MAX_SIMPLER_LOSS, ProbeKey, block_gains, is_reportable, probe_target
from idtool.diagnosis.quiet_joints import are_all_quiet
from idtool.diagnosis.screen import sum_standard_error
from idtool.diagnosis.search_progress import SearchProgress
from idtool.diagnosis.selection_round import MAX_FULL_FITS, find_best_effect
from idtool.diagnosis.trial import FAILURES
from idtool.diagnosis.words import replacement_sentence
from idtool.dynamics.effects import effect_types
from idtool.estimation.dataset.experiment import Progress
from idtool.robot.config import EffectEntry

_MIN_SIGNIFICANCE = 2.0  # standard errors by which a model must be better to replace another

_EffectSet = tuple[AddedEffect, ...]
_Substitutes = frozenset[ProbeKey]


@dataclass(frozen=True)
class _Attempt:
    """Attempt to replace effects.

    Attributes
    ----------
    is_better
        True if the model is better with another effect in their place.
    substitutes
        Keys of the candidates that may explain as much as the effects; None if they are not known, as if the effects
        explain nothing.
    """

    is_better: bool
    substitutes: _Substitutes | None


class EffectReplacement:
    """Replaces effects of a model by others that are better.

    Parameters
    ----------
    model
        The model.
    initial
        The model without any of the effects found.
    effects
        Ids of the effects to try; None: all.
    found_among_all
        Effects that were the best of all these in their round.
    progress
        Callback for the stage and its progress.
    """

    def __init__(
        self,
        model: ExtendedModel,
        initial: LinearizedFit,
        effects: Sequence[str] | None,
        found_among_all: Collection[AddedEffect],
        progress: SearchProgress,
    ) -> None:
        self._model = model
        self._initial = initial
        self._effects = effects
        self._found_among_all = found_among_all
        self._progress = progress

    def replace_first(self) -> list[str]:
        """Replace the first effect, or else the first two, for which another one is better.

        None explains more where all joints are quiet, but a single one may explain as much as two.

        Returns
        -------
        A sentence on each effect that was replaced; empty if there is none.
        """
        known = self._substitutes_when_found()
        singles: list[_EffectSet] = [(effect,) for effect in self._replaceable if effect not in known]
        attempts: dict[_EffectSet, _Attempt] = {}
        if not are_all_quiet(self._model.current, self._progress):
            attempts = self._attempts(singles)
        sentences = self._replace_first_of(attempts)
        if sentences:
            return sentences

        known = {**known, **_substitutes_found(attempts)}
        pairs = self._replaceable_pairs(known)
        untried = [single for single in singles if single not in attempts]
        if len(pairs) > len(untried):  # it takes less time to screen these first
            known = {**known, **_substitutes_found(self._attempts(untried, max_fits=0))}
            pairs = self._replaceable_pairs(known)
        return self._replace_first_of(self._attempts(pairs))

    @property
    def _replaceable(self) -> list[AddedEffect]:
        """The effects that another one may replace: those that the user did not give."""
        return [effect for effect in self._model.reported if not effect.is_assumed]

    def _substitutes_when_found(self) -> dict[AddedEffect, _Substitutes]:
        """Substitutes of each effect that was found beside the same others as it has now."""
        known = {}
        for effect in self._replaceable:
            substitutes = effect.selection.substitutes
            if substitutes is not None and self._would_be_found_again((effect,)):
                known[effect] = substitutes
        return known

    def _replaceable_pairs(self, known: Mapping[AddedEffect, _Substitutes]) -> list[_EffectSet]:
        """Pairs of effects that a single one may replace, and that a search without them would not find again.

        Parameters
        ----------
        known
            Substitutes of each effect beside all others, as far as they are known.
        """
        pairs: list[_EffectSet] = []
        for pair in combinations(self._replaceable, 2):
            if _may_have_common_substitute(pair, known) and not self._would_be_found_again(pair):
                pairs.append(pair)
        return pairs

    def _would_be_found_again(self, replaced: _EffectSet) -> bool:
        """True if a search without some effects would find one of them again.

        It was the best of all kinds in a round whose model had the same other effects.
        """
        others = [effect.entry for effect in self._model.added if effect not in replaced]
        subjects_of_others = _subjects([*self._model.given, *others])
        for effect in replaced:
            base = effect.selection.base
            was_best_of_all = effect in self._found_among_all
            has_same_rows = base.reversal_margin == self._model.current.reversal_margin
            has_same_effects = _subjects(base.experiment.config.effects) == subjects_of_others
            if was_best_of_all and has_same_rows and has_same_effects:
                return True
        return False

    def _attempts(self, choices: Sequence[_EffectSet], max_fits: int = MAX_FULL_FITS) -> dict[_EffectSet, _Attempt]:
        """Attempts to replace each of several sets of effects; each process ends at the first that is better.

        Parameters
        ----------
        choices
            The sets of effects.
        max_fits
            Number of candidates that are fitted in place of each set at most; 0 if only substitutes are wanted.
        """

        def attempts_of(share: range, progress: Progress) -> dict[int, _Attempt]:
            self._progress.report = progress  # a copy of this process has its own
            attempts: dict[int, _Attempt] = {}
            for i in share:
                attempts[i] = self._attempt(choices[i], max_fits)
                if attempts[i].is_better:
                    break
            return attempts

        by_number: dict[int, _Attempt] = {}
        for attempts in in_processes(attempts_of, interleaved_shares(len(choices)), self._progress.report):
            by_number.update(attempts)
        return {choices[i]: by_number[i] for i in sorted(by_number)}

    def _attempt(self, replaced: _EffectSet, max_fits: int) -> _Attempt:
        """Attempt to replace effects; the model stays as it is."""
        before = self._model.state()
        attempt = self._add_in_place_of(replaced, max_fits)
        self._model.restore(before)
        return attempt

    def _replace_first_of(self, attempts: Mapping[_EffectSet, _Attempt]) -> list[str]:
        """Replace the first effects for which an attempt was better; a sentence on each."""
        better = [replaced for replaced, attempt in attempts.items() if attempt.is_better]
        if not better:
            return []
        before = self._model.state()
        replaced = better[0]
        if not self._add_in_place_of(replaced, MAX_FULL_FITS).is_better:  # again: a copy cannot send its model
            self._model.restore(before)
            return []
        by = self._model.added[-1].chosen
        return [replacement_sentence(effect.chosen, by) for effect in replaced]

    def _add_in_place_of(self, replaced: _EffectSet, max_fits: int) -> _Attempt:
        """Add another effect in place of some; if the model is not better, the caller has to restore it.

        Parameters
        ----------
        replaced
            The effects.
        max_fits
            Number of candidates that are fitted at most.
        """
        before = self._model.current
        self._model.drop(replaced)
        try:
            self._model.refit_coefficients()  # the screening has the nonlinear parameters free, to first order
            without = self._model.current
            original = linearize_fit(before.experiment, self._progress, without)
            selection = find_best_effect(
                without,
                self._initial,
                self._progress,
                self._effects,
                self._model.unexplained_bursts,
                movable=self._model.movable,
                replaced=original,
            )
        except FAILURES:
            return _Attempt(is_better=False, substitutes=None)
        winner = selection.winner
        is_better = (
            winner is not None
            and is_reportable(winner.probe.effect)
            and probe_target(winner.probe) not in [effect.target for effect in replaced]
            and not self._model.try_add(selection, winner)
            and self._is_better(original, without, is_simpler=len(replaced) > 1)
        )
        return _Attempt(is_better, selection.substitutes)

    def _is_better(self, original: LinearizedFit, without: LinearizedFit, is_simpler: bool) -> bool:
        """True if the present model explains significantly more than the original one; if simpler, hardly less.

        Parameters
        ----------
        original
            The model with the effects that were replaced, on the rows and in the units of ``without``.
        without
            The model without the effects in which the two differ.
        is_simpler
            True if the present model has fewer effects.
        """
        try:
            present = linearize_fit(self._model.current.experiment, self._progress, without)
        except FAILURES:
            return False
        gains = block_gains(original, present)
        gain = float(gains.sum())
        significant_gain = _MIN_SIGNIFICANCE * sum_standard_error(gains)
        if not is_simpler:
            return gain > significant_gain
        explained = float(block_gains(without, original).sum())
        return gain > -min(significant_gain, MAX_SIMPLER_LOSS * explained)


def _may_have_common_substitute(pair: _EffectSet, known: Mapping[AddedEffect, _Substitutes]) -> bool:
    """True if a single effect may explain as much as a pair, and so as much as each of the two beside the other.

    Beside an effect that is undefined where it acts, what others explain of its samples is not known.

    Parameters
    ----------
    pair
        The two effects.
    known
        Substitutes of each effect beside all others, as far as they are known.
    """
    if any(effect_types()[effect.entry.effect].is_undefined_where_it_acts for effect in pair):
        return True
    substitutes = [known[effect] for effect in pair if effect in known]
    if not substitutes:
        return True
    subjects = [effect.subject for effect in pair]
    return any(key.subject not in subjects for key in frozenset.intersection(*substitutes))


def _substitutes_found(attempts: Mapping[_EffectSet, _Attempt]) -> dict[AddedEffect, _Substitutes]:
    """Substitutes of single effects, as far as attempts to replace them found them."""
    found = {}
    for (effect,), attempt in attempts.items():
        if attempt.substitutes is not None:
            found[effect] = attempt.substitutes
    return found


def _subjects(entries: Sequence[EffectEntry]) -> list[tuple[str, str]]:
    """Effects and what they act on, in alphabetical order."""
    return sorted((entry.effect, entry.joint or entry.link or "") for entry in entries)
