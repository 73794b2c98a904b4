"""`ExtendedModel`: the configuration's model with the effects that a search has added, fitted to the data.

A controller holds its torque during a sample, so that the torque acts half a sample later, on average, than it is
logged. Every log has a delay of about that size. It is the background: an effect that is fitted with the others but not
reported, as long as it is shorter than one sample. A model without it would explain it as joint elasticity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import field
from typing import Any

import numpy as np

from idtool.common.dataclass import dataclass
from idtool.diagnosis.bursts import find_bursts
from idtool.diagnosis.held_out_error import lowers_held_out_likelihood
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.model_selection import FittedCandidate, SelectionStep, fitted_record, is_reportable
from idtool.diagnosis.records import Candidate
from idtool.diagnosis.trial import FAILURES, ParameterKey, fit_trial, not_fitted_reason, with_effects
from idtool.dynamics.effects import effect_types
from idtool.dynamics.effects.data_summary import Burst
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.robot.config import EffectEntry

_REFITS = 2  # where columns depend on the values of the coefficients
_MAX_GAUSS_NEWTON_STEPS = 6  # of the fit of all nonlinear parameters after an effect was added


@dataclass(eq=False)
class AddedEffect:
    """An effect in the model, with the evidence for it.

    Attributes
    ----------
    entry
        Its configuration entry.
    selection
        The round of the search that selected it.
    chosen
        The candidate as reported, with its score.
    errors
        Standard errors of its nonlinear parameters, by name.
    is_assumed
        True if the user gave it.
    """

    entry: EffectEntry
    selection: SelectionStep
    chosen: Candidate
    errors: dict[str, float] = field(default_factory=dict)
    is_assumed: bool = False

    @property
    def subject(self) -> tuple[str, str]:
        """The effect and the joint or link that it acts on, as of a `Probe`."""
        return self.entry.effect, self.entry.joint or self.entry.link or ""

    @property
    def target(self) -> tuple[str, str]:
        """The effect and what it acts on, as in a `Candidate`."""
        return self.chosen.effect, self.chosen.target


@dataclass(frozen=True)
class ModelState:
    """A state of an `ExtendedModel`, to which it can return.

    Attributes
    ----------
    current, background, added
        As in `ExtendedModel`; the entries of the background.
    fitted
        Entry and standard errors of each added effect.
    """

    current: LinearizedFit
    background: tuple[EffectEntry, ...]
    added: tuple[AddedEffect, ...]
    fitted: tuple[tuple[EffectEntry, dict[str, float]], ...]


class ExtendedModel:
    """Model with added effects, all fitted together, and with a background effect if the data have one.

    Attributes
    ----------
    current
        Fit of the model.
    added
        The effects that were added, in their order.

    Parameters
    ----------
    experiment
        Model and data.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """

    def __init__(self, experiment: Experiment, progress: Progress) -> None:
        self._progress = progress
        self._configured = experiment.config.effects
        self._dt = max(run.signals.log.dt for run in experiment.runs)
        self._background: tuple[EffectEntry, ...] = ()
        self.added: list[AddedEffect] = []
        self.current = linearize_fit(experiment, progress)
        self.try_refit()

    @property
    def reported(self) -> list[AddedEffect]:
        """The added effects that a diagnosis names, in their order."""
        return [effect for effect in self.added if is_reportable(effect.entry.effect)]

    @property
    def given(self) -> tuple[EffectEntry, ...]:
        """Effects that were not added: those of the configuration and the background."""
        return (*self._configured, *self._background)

    @property
    def movable(self) -> list[int]:
        """Indices, among the present model's effects, of the added ones whose nonlinear parameters are fitted."""
        return self._movable_from(len(self.given))

    def _movable_from(self, first: int) -> list[int]:
        """Indices of the added effects that are fitted, if the first of them has a given index."""
        margin = self.current.reversal_margin
        movable = []
        for i, effect in enumerate(self.added, first):
            if effect.selection.base.reversal_margin >= margin:  # else the rows that determine it are excluded
                movable.append(i)
        return movable

    def drop(self, effects: Sequence[AddedEffect]) -> None:
        """Leave out added effects; the fit remains as it is until `try_refit`."""
        self.added = [effect for effect in self.added if effect not in effects]

    def try_drop(self, effects: Sequence[AddedEffect]) -> Exception | None:
        """Leave out added effects and refit; if that fails, restore everything and return the failure."""
        before = self.state()
        self.drop(effects)
        failure = self.try_refit()
        if failure:
            self.restore(before)
        return failure

    def remove(self, effects: Sequence[AddedEffect]) -> None:
        """Leave out added effects and refit; where that fails, the others keep their nonlinear parameters."""
        self.drop(effects)
        if self.try_refit():
            with suppress(*FAILURES):
                self.refit_coefficients()

    def refit_coefficients(self) -> None:
        """Fit the coefficients alone; the nonlinear parameters of all effects stay as they are.

        Raises
        ------
        IdtoolError, LinAlgError
            If the model cannot be fitted; see `FAILURES`.
        """
        entries = [*self.given, *(effect.entry for effect in self.added)]
        experiment = with_effects(self.current.experiment, entries, self.current.theta)
        self.current = linearize_fit(experiment, self._progress, reversal_margin=self.current.reversal_margin)

    def try_add(self, selection: SelectionStep, winner: FittedCandidate, is_assumed: bool = False) -> str:
        """Add the winner of a round, unless the model cannot be fitted with it or is worse on the held-out data.

        Parameters
        ----------
        selection, winner
            The round, and its winner.
        is_assumed
            True if the user gave the effect, so that the model may be worse with it.

        Returns
        -------
        Reason why it was not added, as a clause; empty if it was.
        """
        before = self.state()
        entry = winner.trial.entries[-1]
        record = fitted_record(winner, self.current)
        self.added.append(AddedEffect(entry, selection, record, is_assumed=is_assumed))
        failure = self.try_refit()
        if failure:
            self.restore(before)
            return not_fitted_reason(failure)
        needs_check = is_reportable(winner.probe.effect) and not is_assumed
        if needs_check and lowers_held_out_likelihood(before.current, self.current):
            self.restore(before)
            return "increases the error on the held-out data when all effects are fitted together"
        return ""

    def unexplained_bursts(self) -> tuple[Burst, ...]:
        """Time intervals with an unusually large residual, in logs in which no effect explains them yet."""
        explained_logs = set()
        for effect in self.added:
            if effect_types()[effect.chosen.effect].acts_in_bursts:
                explained_logs.add(effect.entry.parameters.get("log", ""))
        if "" in explained_logs:  # an effect without a log acts in all of them
            return ()
        bursts = find_bursts(self.current.experiment, self.current.estimate.theta, self._progress)
        return tuple(burst for burst in bursts if burst.log not in explained_logs)

    def entries(self, effects: Sequence[AddedEffect]) -> list[EffectEntry]:
        """The configuration's effects and some of those added, with errors of nonlinear parameters."""
        return [*self._configured, *(_with_errors(effect) for effect in effects)]

    def experiment_with(self, effects: Sequence[AddedEffect]) -> Experiment:
        """The experiment with some of the effects found, as it is reported: without the background."""
        return with_effects(self.current.experiment, self.entries(effects), self.current.estimate.theta)

    def set_reversal_margin(self, margin: float) -> None:
        """Use only rows at least ``margin`` [s] away from reversals."""
        self.current = linearize_fit(self.current.experiment, self._progress, reversal_margin=margin)
        self.try_refit()

    def settle(self) -> None:
        """Fit the present model on all rows, with columns that depend on its coefficients at their final values."""
        refits = 0
        if self.current.reversal_margin > 0:
            refits = 1
        if self.current.experiment.equation.depends_on_parameters:
            refits = _REFITS
        for _ in range(refits):
            entries = self.current.experiment.config.effects
            experiment = with_effects(self.current.experiment, entries, self.current.theta)
            self.current = linearize_fit(experiment, self._progress)

    def state(self) -> ModelState:
        """The present state, for `restore`."""
        fitted = tuple((effect.entry, effect.errors) for effect in self.added)
        return ModelState(self.current, self._background, tuple(self.added), fitted)

    def restore(self, state: ModelState) -> None:
        """Restore an earlier state."""
        self.current = state.current
        self._background = state.background
        self.added = list(state.added)
        for effect, (entry, errors) in zip(self.added, state.fitted, strict=True):
            effect.entry = entry
            effect.errors = errors

    def try_refit(self) -> Exception | None:
        """Refit with the added effects; if that fails, restore everything and return the failure."""
        before = self.state()
        try:
            self._refit()
        except FAILURES as failure:
            self.restore(before)
            return failure
        return None

    def _refit(self) -> None:
        """Refit all effects, their nonlinear parameters together, with new weights of the joints."""
        entries = [effect.entry for effect in self.added]
        background = _missing_background([*self._configured, *entries])
        if background and self._background:  # begin at its fitted values
            background = self._background
        errors = self._fit_with_background(background, entries)
        is_background = [effect_types()[entry.effect].is_background(entry, self._dt) for entry in self._background]
        if not all(is_background):
            errors = self._fit_with_background((), entries)  # larger than in any log: the search must name it
        first = len(self.given)
        fitted_entries = self.current.experiment.config.effects[first:]
        for i, (effect, entry) in enumerate(zip(self.added, fitted_entries, strict=True), first):
            effect.entry = entry
            own_errors = {name: error for (k, name), error in errors.items() if k == i}
            if own_errors:  # else its parameters were not moved
                effect.errors = own_errors

    def _fit_with_background(
        self, background: Sequence[EffectEntry], entries: Sequence[EffectEntry]
    ) -> Mapping[ParameterKey, float]:
        """Fit with background effects, which become `_background` with their fitted values, and the added effects.

        Parameters
        ----------
        background, entries
            Entries of the background effects and of the added ones.

        Returns
        -------
        Standard errors of the nonlinear parameters that were moved.
        """
        all_entries = [*self._configured, *background, *entries]
        experiment = with_effects(self.current.experiment, all_entries, self.current.theta)
        margin = self.current.reversal_margin
        self.current = linearize_fit(experiment, self._progress, reversal_margin=margin)
        first = len(self._configured)
        first_added = first + len(background)
        optimized = [*range(first, first_added), *self._movable_from(first_added)]
        errors: Mapping[ParameterKey, float] = {}
        if background or entries:
            trial = fit_trial(self.current, all_entries, optimized, self._progress, _MAX_GAUSS_NEWTON_STEPS)
            self.current = trial.linearized
            errors = trial.standard_errors
        self._background = self.current.experiment.config.effects[first:first_added]
        return errors

    def without_each(self) -> list[LinearizedFit]:
        """Models without each of the reported effects, on the rows and in the units of the present one.

        Without an effect that is undefined where it acts, the model has its own rows.
        """
        models = []
        for effect in self.reported:
            others = [other.entry for other in self.added if other is not effect]
            reduced = with_effects(self.current.experiment, [*self.given, *others], self.current.theta)
            own_rows = effect_types()[effect.entry.effect].is_undefined_where_it_acts
            models.append(linearize_fit(reduced, self._progress, self.current, own_rows))
        return models


def _missing_background(entries: Sequence[EffectEntry]) -> tuple[EffectEntry, ...]:
    """Background effects, which every log has a little of, that the entries do not contain."""
    present = {(entry.effect, entry.joint, entry.link) for entry in entries}
    missing = []
    for kind in effect_types().values():
        entry = kind.background_entry()
        if entry is not None and (entry.effect, entry.joint, entry.link) not in present:
            missing.append(entry)
    return tuple(missing)


def _with_errors(effect: AddedEffect) -> EffectEntry:
    """Entry of an effect, its nonlinear parameters with their standard errors."""
    given = {name: _with_error(effect, name, value) for name, value in effect.entry.parameters.items()}
    return effect.entry.model_copy(update={"parameters": given})


def _with_error(effect: AddedEffect, name: str, value: Any) -> Any:
    """A nonlinear parameter, or a list of them, with standard errors if they are known."""
    if isinstance(value, list):
        return [_with_error(effect, f"{name}.{k}", x) for k, x in enumerate(value)]
    error = effect.errors.get(name, 0.0)
    is_known = isinstance(value, float) and np.isfinite(error) and error > 0
    return {"value": value, "standard_error": error} if is_known else value
