"""Order of the effects found: each step must lower the held-out error; an effect that never does is removed."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from idtool.diagnosis.effect_search import EffectSearch
from idtool.diagnosis.error_summary import evaluate_errors
from idtool.diagnosis.extended_model import AddedEffect
from idtool.diagnosis.held_out_error import lowers_held_out_likelihood
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.trial import with_effects
from idtool.robot.config import EffectEntry

MAX_INCREASE = 1.0005  # ratio of the held-out errors of all joints together, with an effect and without it


def remove_harmful(search: EffectSearch, initial_error: float) -> None:
    """Order the effects so that each lowers the held-out error; remove those that increase it in every order.

    A right but small effect may increase the error as long as a larger one is missing, so a harmful effect is first
    moved to the end. Two kinds of effects stay although they increase the error at their place: those that lower it
    only together with others, and those that increase it only near reversals. There the direction of friction is
    uncertain, and chance decides whether an effect that shifts the jump of friction increases the error.

    Parameters
    ----------
    search
        The search that found them.
    initial_error
        Held-out torque error of the model without effects, over all joints [N·m].
    """
    excused: list[AddedEffect] = []
    moves = 0
    while search.reported:
        harmful = first_harmful(search, initial_error, excused)
        if harmful is None:
            return
        all_orders_fail = moves >= len(search.reported) ** 2
        if not all_orders_fail and harmful is not search.reported[-1]:
            search.move_to_end(harmful)
            moves += 1
            continue
        if all_orders_fail:
            harmful = _most_harmful(search, excused)
            if harmful is None:
                return
        if _is_harmful_only_at_reversals(search, harmful):
            excused.append(harmful)
            continue
        search.remove(harmful, "it increases the error on the held-out data")
        moves = 0


def first_harmful(
    search: EffectSearch, initial_error: float, excused: Collection[AddedEffect] = ()
) -> AddedEffect | None:
    """First effect that increases the held-out error when it is added to those before it; None if there is none.

    Parameters
    ----------
    search, initial_error
        As in `remove_harmful`.
    excused
        Effects that may increase it.
    """
    error_before = initial_error
    for k, effect in enumerate(search.reported):
        error = _overall_error(_fit_with(search, search.model.entries(k + 1)), search)
        if error > MAX_INCREASE * error_before and effect not in excused:
            return effect
        error_before = error
    return None


def _most_harmful(search: EffectSearch, excused: Collection[AddedEffect]) -> AddedEffect | None:
    """Effect without which the held-out error is least, all others being present; None if it is least with all."""
    least_error = _overall_error(_fit_with(search, search.model.entries(len(search.reported))), search)
    most_harmful = None
    for effect in search.reported:
        error = _overall_error(_fit_with(search, _entries_without(search, effect)), search)
        if error < least_error and effect not in excused:
            least_error = error
            most_harmful = effect
    return most_harmful


def _is_harmful_only_at_reversals(search: EffectSearch, effect: AddedEffect) -> bool:
    """True if an effect makes the held-out data more likely at the samples at which all columns are defined."""
    if not search.current.experiment.has_held_out:
        return False
    without = _fit_with(search, _entries_without(search, effect))
    with_all = _fit_with(search, search.model.entries(len(search.reported)))
    return not lowers_held_out_likelihood(without, with_all)


def _entries_without(search: EffectSearch, effect: AddedEffect) -> list[EffectEntry]:
    """Entries of the model with all effects but one."""
    entries = search.model.entries(len(search.reported))
    first = len(entries) - len(search.reported)
    del entries[first + search.reported.index(effect)]
    return entries


def _fit_with(search: EffectSearch, entries: Sequence[EffectEntry]) -> LinearizedFit:
    """Fit of the model with some of the effects."""
    experiment = with_effects(search.current.experiment, entries, search.current.theta)
    return linearize_fit(experiment, search.progress)


def _overall_error(fitted: LinearizedFit, search: EffectSearch) -> float:
    """Rms torque error of a model on the held-out data, over all joints [N·m]."""
    errors = evaluate_errors(fitted.experiment, fitted.estimate.theta, False, search.progress)
    return errors.torque["overall"]
