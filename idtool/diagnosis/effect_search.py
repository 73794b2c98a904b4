"""Search for missing effects, in rounds: the best one is added, all are refitted, and superseded ones are removed.

`EffectSearch` decides which effects are added and removed again, `EffectReplacement` which ones give way to others;
`ExtendedModel` is the model that has them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from idtool.common.exceptions import ConfigError
from idtool.diagnosis.candidate_fit import (
    implausibility,
    imprecise_parameter,
    without_insignificant_parameters,
    without_optional_parameters,
)
from idtool.diagnosis.effect_group import EffectGroup, find_groups
from idtool.diagnosis.effect_replacement import EffectReplacement
from idtool.diagnosis.error_summary import evaluate_errors
from idtool.diagnosis.extended_model import AddedEffect, ExtendedModel
from idtool.diagnosis.held_out_error import lowers_held_out_likelihood
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.model_selection import (
    MIN_SHARE,
    FittedCandidate,
    ProbeKey,
    SelectionStep,
    block_gains,
    fitted_record,
    is_reportable,
    is_worthwhile,
    probe_key,
    probe_target,
)
from idtool.diagnosis.reversal_rows import REVERSAL_MARGIN, joints_clearer_away_from_reversals
from idtool.diagnosis.search_progress import SearchProgress, TimeLimitError
from idtool.diagnosis.selection_round import find_best_effect, fit_assumed_effect
from idtool.diagnosis.summarize_data import summarize_data
from idtool.diagnosis.trial import FAILURES, failure_reason, has_fixed_inertia, not_fitted_reason, with_effects
from idtool.diagnosis.unproven import find_unproven
from idtool.diagnosis.words import removal_sentence, removal_with_reason, unproven_sentence
from idtool.dynamics.effects import effect_types
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.robot.config import EffectEntry

_REVERSAL_SHARE = 0.5  # least share of the squared residual that an effect at reversals must explain
_MAX_REPLACEMENTS = 3
_MIN_GROUP_SIZE = 2  # of effects that are added together
_MIN_REPLACEMENT_GAIN = 2.0  # standard errors by which a model must be better to replace another


class EffectSearch:
    """Adds effects, and removes those that later ones have superseded.

    Attributes
    ----------
    model
        The model so far.
    initial
        The model before any effect was added, with the background effect.
    removed
        Effects that were removed again, a plain sentence each.
    last_round
        The latest round in which effects were tried; None before the first.
    reversal_joints
        The joints whose friction does not follow its law near reversals. The values are their rms residual with the
        rows near reversals, and without these rows [N·m or N]. If there are such joints, the rows are excluded.
    failed
        Reason why an effect could not be fitted or was refused, by effect and target.
    stopped
        Reason why the search ended before it was complete; empty if it was.
    advice
        What the user can do about ``stopped``, as a clause; empty if the search was complete.
    is_interrupted
        True if Ctrl-C ended it.

    Parameters
    ----------
    experiment
        Model and data.
    effects
        Ids of the effects to try; None: all.
    max_effects
        Number of effects that are added at most.
    progress
        Callback for the stage and its progress, from 0 to 1.
    budget
        Time after which the search stops with what it has found [s]; None: no limit.
    """

    def __init__(
        self,
        experiment: Experiment,
        effects: Sequence[str] | None,
        max_effects: int,
        progress: Progress,
        budget: float | None = None,
    ) -> None:
        self._effects = effects
        self._max_effects = max_effects
        self.progress = SearchProgress(progress)
        self._budget = budget
        self.stopped = ""
        self.advice = ""
        self.is_interrupted = False
        self.removed: list[str] = []
        self.last_round: SelectionStep | None = None
        self.reversal_joints: dict[str, tuple[float, float]] = {}
        self.failed: dict[tuple[str, str], str] = {}
        self._refused: set[ProbeKey] = set()  # candidates that could not be added beside the present effects
        self._discarded: set[ProbeKey] = set()  # removed effects, which are not tried again
        self._found_among_all: list[AddedEffect] = []  # effects that were the best of all kinds
        self.model = ExtendedModel(experiment, self.progress)
        self.initial = self.current
        self._keep_as_complete()

    @property
    def current(self) -> LinearizedFit:
        """Fit of the model so far."""
        return self.model.current

    @property
    def added(self) -> list[AddedEffect]:
        """The effects found, in their order."""
        return self.model.added

    @property
    def reported(self) -> list[AddedEffect]:
        """The effects found that a diagnosis names, in their order."""
        return self.model.reported

    def assume(self, effect: str, target: str | None) -> None:
        """Add an effect however little it explains.

        Raises
        ------
        ConfigError
            If the model cannot have it.
        """
        bursts = self.model.unexplained_bursts() if effect_types()[effect].acts_in_bursts else ()
        selection = fit_assumed_effect(self.current, self.progress, effect, target, bursts)
        reason = "cannot be fitted to these data"
        if selection.winner is not None:
            reason = self.model.try_add(selection, selection.winner, is_assumed=True)
        if reason:
            what = f"{effect}:{target or 'any joint'} {reason}"
            raise ConfigError("--assume", f"{what}; leave it out, or name another joint")
        self._keep_as_complete()

    def run(self) -> None:
        """Add effects until none is worthwhile, the time is over, or Ctrl-C; what was found by then remains."""
        self.progress.limit(self._budget)
        try:
            self._run()
        except KeyboardInterrupt:
            self.is_interrupted = True
            self._stop("the search was interrupted", "let it run to its end, or limit its time with --budget")
        except TimeLimitError:
            self._stop("the search reached its time limit", "allow it more time with a larger --budget")
        except FAILURES as failure:
            advice = (
                "correct the faults of the data, or search for fewer effects: a second run would end in the same way"
            )
            self._stop(f"the search ended early: {failure_reason(failure)}", advice)
        self.progress.limit(None)

    def note_limit(self) -> None:
        """Say that the search ended at the largest number of effects, if it did, although more are missing."""
        if len(self.reported) >= self._max_effects and not self.stopped:
            self.stopped = f"the search ended at --max-effects {self._max_effects}"
            self.advice = "allow more effects"

    def _stop(self, reason: str, advice: str) -> None:
        """Return to the last model that was complete."""
        self.progress.limit(None)  # what remains to be done is short
        self.stopped = reason
        self.advice = advice
        state, removed = self._last_complete
        self.model.restore(state)
        self.removed = list(removed)
        try:
            self.model.settle()
        except FAILURES:  # keep it as it was fitted during the search
            self.model.restore(state)

    def _keep_as_complete(self) -> None:
        """Keep the present model as the one to return to if the search is stopped."""
        self._last_complete = self.model.state(), tuple(self.removed)

    def _run(self) -> None:
        """Add effects until none is worthwhile, replace and remove those that turn out wrong, and fit the rest.

        A large residual near reversals must not hide smaller effects, see `reversal_rows`. Where there is one, effects
        that act there, such as Stribeck friction, are searched first, and must explain most of it. If that is not
        enough, the others are searched away from reversals, and those that act there once more. If that is not enough
        either, the rows near reversals are excluded for the rest of the search.
        """
        if joints_clearer_away_from_reversals(self.current, self.progress):
            self._add_reversal_effects()
        if joints_clearer_away_from_reversals(self.current, self.progress):
            self.model.set_reversal_margin(REVERSAL_MARGIN)
            self._add_effects()
            self.model.set_reversal_margin(0.0)
            self._add_reversal_effects()
        else:
            self._add_effects()
        self.reversal_joints = joints_clearer_away_from_reversals(self.current, self.progress)
        if self.reversal_joints:
            self.model.set_reversal_margin(REVERSAL_MARGIN)
            self._add_effects()
        self._replace_effects()
        self._drop_insignificant_parameters()  # beside one of them, others may seem undetermined
        if self._remove_doubtful():
            self._add_effects()  # what they stood for
            self._remove_doubtful()
        self._drop_insignificant_parameters()
        self._drop_harmful_parameters()
        self.model.settle()

    def remove(self, effect: AddedEffect, reason: str) -> None:
        """Remove an effect for a reason, a clause of a sentence."""
        before = self.model.state()
        try:
            self.model.remove([effect])
        except KeyboardInterrupt:
            self.model.restore(before)
            raise
        self.removed.append(removal_with_reason(effect.chosen, reason))

    def move_to_end(self, effect: AddedEffect) -> None:
        """Report an effect after all others."""
        self.reorder([effect])

    def reorder(self, effects: Sequence[AddedEffect]) -> None:
        """Report effects in this order, after all others."""
        self.model.drop(effects)
        self.model.added += effects

    def remove_failed(self, effect: AddedEffect, failure: Exception) -> None:
        """Remove an effect with which the whole model cannot be fitted."""
        self.failed[effect.chosen.effect, effect.chosen.target] = not_fitted_reason(failure)
        self.model.remove([effect])

    def _add_effects(self) -> None:
        """Add effects of all kinds, one by one, and where none is left, several at a time."""
        self._add_in_rounds(self._effects, MIN_SHARE)
        for _ in range(self._max_effects):
            if not self._add_group():
                break
            self._add_in_rounds(self._effects, MIN_SHARE)

    def _add_reversal_effects(self) -> None:
        """Add effects that act at reversals and explain most of the residual."""
        self._add_in_rounds(self._reversal_effects(), _REVERSAL_SHARE)

    def _add_in_rounds(self, effects: Sequence[str] | None, min_share: float) -> None:
        """Add effects in rounds, until no candidate is worthwhile or a set of effects recurs.

        Parameters
        ----------
        effects
            Ids of the effects to try; None: all.
        min_share
            Share of a joint's squared residual that an effect must explain.
        """
        self._refused.clear()  # on other rows, or beside other effects, they may be better
        earlier: set[tuple[tuple[str, str], ...]] = set()
        while len(self.reported) < self._max_effects:
            skipped = self._refused | self._discarded
            selection = find_best_effect(
                self.current,
                self.initial,
                self.progress,
                effects,
                self.model.unexplained_bursts,
                min_share=min_share,
                skipped=skipped,
                movable=self.model.movable,
            )
            if selection.has_tried or self.last_round is None:
                self.last_round = selection
            for candidate in selection.failed:
                self.failed[candidate.effect, candidate.target] = candidate.reason
            if selection.winner is None:
                break
            reason = self.model.try_add(selection, selection.winner)
            if reason:
                self._refuse(selection.winner, reason)
                continue
            if effects is self._effects:
                self._found_among_all.append(self.added[-1])
            self._refused.clear()  # beside this effect, another one may be better
            self._prune()
            self._keep_as_complete()
            present = tuple(sorted(effect.target for effect in self.added))
            if present in earlier:
                break
            earlier.add(present)

    def _add_group(self) -> bool:
        """Add effects that the last round rejected and that are worthwhile together; False if there are none."""
        selection = self.last_round
        room = self._max_effects - len(self.reported)
        if selection is None or selection.screening is None or room < _MIN_GROUP_SIZE:
            return False
        if selection.base is not self.current:  # the model has changed since that round
            return False
        for group in find_groups(selection, selection.screening, self.initial, self.model.movable, self.progress):
            if len(group.effects) <= room and self._try_add_group(selection, group):
                self._prune()
                self._keep_as_complete()
                return True
        return False

    def _try_add_group(self, selection: SelectionStep, group: EffectGroup) -> bool:
        """Add effects; False if the model cannot be fitted with them or is worse on the held-out data."""
        before = self.model.state()
        targets = {probe_target(effect.probe) for effect in group.effects}
        rejected = tuple(one for one in selection.rejected if (one.effect, one.target) not in targets)
        runners_up = tuple(one for one in selection.runners_up if probe_target(one.probe) not in targets)
        entries = group.trial.entries[-len(group.effects) :]
        for effect, entry in zip(group.effects, entries, strict=True):
            own_selection = replace(selection, winner=effect, rejected=rejected, runners_up=runners_up, screening=None)
            self.added.append(AddedEffect(entry, own_selection, fitted_record(effect, before.current)))
        if self.model.try_refit() or lowers_held_out_likelihood(before.current, self.current):
            self.model.restore(before)
            return False
        return True

    def _reversal_effects(self) -> tuple[str, ...]:
        """Ids of the effects to try that act at reversals."""
        ids = []
        for effect_id, kind in effect_types().items():
            is_tried = self._effects is None or effect_id in self._effects
            if is_tried and (kind.is_friction or kind.acts_at_reversals):
                ids.append(effect_id)
        return tuple(ids)

    def _refuse(self, candidate: FittedCandidate, reason: str) -> None:
        """Do not try a candidate again beside the present effects."""
        self._refused.add(probe_key(candidate.probe))
        record = fitted_record(candidate, self.current)
        self.failed[record.effect, record.target] = reason

    def _replace_effects(self) -> None:
        """Replace effects by others that are better beside those found later."""
        replacement = EffectReplacement(self.model, self.initial, self._effects, self._found_among_all, self.progress)
        for _ in range(_MAX_REPLACEMENTS):
            sentences = replacement.replace_first()
            if not sentences:
                return
            self.removed += sentences
            self._keep_as_complete()

    def _remove_doubtful(self) -> bool:
        """Remove effects that are not determined or for which the evidence is not enough; False if there are none."""
        before = list(self.added)
        self._remove_unfounded()
        self._remove_unproven()
        removed = [effect for effect in before if effect not in self.added]
        for effect in removed:
            self._discard(effect)
        return bool(removed)

    def _discard(self, effect: AddedEffect) -> None:
        """Do not try a removed effect again."""
        if effect.selection.winner is not None:
            self._discarded.add(probe_key(effect.selection.winner.probe))

    def _remove_unfounded(self) -> None:
        """Remove effects that no robot has, or that are not determined, with the parameters of the present model."""
        for effect in self.reported:
            reason = self._unfounded_reason(effect)
            if effect.is_assumed or not reason:
                continue
            failure = self.model.try_drop([effect])
            if failure:
                continue
            self.removed.append(removal_with_reason(effect.chosen, reason))
            self._keep_as_complete()

    def _unfounded_reason(self, effect: AddedEffect) -> str:
        """Reason why an effect's parameters in the present model are no explanation, as a clause; empty if they are."""
        robot = summarize_data(self.initial, fixed_inertia=has_fixed_inertia(self.initial.experiment))
        reason = implausibility(self.current, effect.entry, robot)
        if reason:
            return reason
        parameter = imprecise_parameter(effect.entry, effect.errors, self.initial)
        return f"its {parameter.replace('_', ' ')} is not determined by the data" if parameter else ""

    def _remove_unproven(self) -> None:
        """Remove effects for which the evidence is not enough, one after the other."""
        while self.reported:
            entries = [effect.entry for effect in self.reported]
            try:
                without = self.model.without_each()
            except FAILURES:  # no evidence against any of them
                return
            assumed = [i for i, effect in enumerate(self.reported) if effect.is_assumed]
            unproven = find_unproven(self.current, entries, without, self.progress, assumed)
            if unproven is None:
                return
            effect = self.reported[unproven.index]
            if self.model.try_drop([effect]):
                return
            self.removed.append(unproven_sentence(effect.chosen, unproven.reason))
            self._keep_as_complete()

    def _prune(self) -> None:
        """Remove effects that are no longer worthwhile, except the newest and those that the user gave."""
        newest = self.added[-1]
        for effect in self.added[:-1]:
            if effect.is_assumed:
                continue
            others = [other.entry for other in self.added if other is not effect]
            is_needed = self._is_needed(effect, [*self.model.given, *others])
            if is_needed or self.model.try_drop([effect]):
                continue
            self._discard(effect)
            if is_reportable(effect.chosen.effect):
                self.removed.append(removal_sentence(effect.chosen, newest.chosen))

    def _is_needed(self, effect: AddedEffect, others: Sequence[EffectEntry]) -> bool:
        """True if an effect is still worthwhile beside the others.

        Parameters
        ----------
        effect
            The effect.
        others
            All effects of the model without it.
        """
        current = self.current
        margin = effect.selection.base.reversal_margin
        try:
            if current.reversal_margin != margin:  # judge it on the rows that it was selected on
                current = linearize_fit(current.experiment, self.progress, reversal_margin=margin)
            reduced = with_effects(current.experiment, others, self.current.theta)
            kind = effect_types()[effect.chosen.effect]
            without = linearize_fit(reduced, self.progress, current, own_rows=kind.is_undefined_where_it_acts)
            with_effect = linearize_fit(current.experiment, self.progress, without)
        except FAILURES:  # no evidence against it
            return True
        gain = float(block_gains(without, with_effect).sum())
        on_joint = effect.chosen.joint is not None
        return is_worthwhile(gain, without, effect.selection.inflation, on_joint, effect.chosen.parameters)

    def _drop_insignificant_parameters(self) -> None:
        """Leave out optional parameters that the data do not determine."""
        entries = [without_insignificant_parameters(effect.entry, effect.errors) for effect in self.added]
        is_same = [entry is effect.entry for entry, effect in zip(entries, self.added, strict=True)]
        if all(is_same):
            return
        before = self.model.state()
        for effect, entry in zip(self.added, entries, strict=True):
            effect.entry = entry
        if self.model.try_refit():
            self.model.restore(before)

    def _drop_harmful_parameters(self) -> None:
        """Leave out optional parameters of an effect unless the error at its joint is larger without them."""
        for effect in self.added:
            simpler = without_optional_parameters(effect.entry)
            if simpler is effect.entry:
                continue
            before = self.model.state()
            error_with = self._error_on_joint(effect)
            effect.entry = simpler
            failure = self.model.try_refit()
            if failure or self._error_on_joint(effect) > error_with:
                self.model.restore(before)

    def _error_on_joint(self, effect: AddedEffect) -> float:
        """Error of the present model, on the held-out data if there are any, at the joint of an effect."""
        errors = evaluate_errors(self.current.experiment, self.current.estimate.theta, False, self.progress)
        return errors.torque[effect.entry.joint or "overall"]
