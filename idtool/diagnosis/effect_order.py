"""Order of the effects found: each step must lower the held-out error; an effect that increases it is removed."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from idtool.diagnosis.effect_search import EffectSearch
from idtool.diagnosis.error_summary import evaluate_errors
from idtool.diagnosis.extended_model import AddedEffect
from idtool.diagnosis.held_out_error import held_out_log_change
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.trial import with_effects
from idtool.robot.config import EffectEntry

MAX_ERROR_RATIO = 1.0005  # of the errors with an effect and without it, over all joints
_MIN_EXCUSE = 0.1  # decrease of the logarithm of a joint's squared error where the direction of friction is known


def order_effects(search: EffectSearch, initial_error: float) -> None:
    """Order the effects so that each lowers the held-out error when it is added to those before it.

    One that increases the error is moved to the end, since a right but small effect may do so as long as a larger one
    is missing; if it increases the error there too, it is removed. If no such order is found, the effect without which
    the error is least is removed. Two kinds of effects stay although they increase the error at their place: those that
    lower it only together with others, and those that increase it only near reversals and lower it elsewhere. Near
    reversals the direction of friction is uncertain, and chance decides whether an effect that shifts the jump of
    friction increases the error.

    Without held-out data, the error on the training data decides.

    Parameters
    ----------
    search
        The search that found them.
    initial_error
        Torque error of the model without effects, over all joints [N·m].
    """
    has_held_out = search.current.experiment.has_held_out
    reason = "it increases the error on the held-out data" if has_held_out else "it increases the error"
    excused: list[AddedEffect] = []
    moves = 0
    while search.reported:
        harmful = first_harmful(search, initial_error, excused)
        if harmful is None:
            return
        may_move = moves < len(search.reported) ** 2
        if may_move and harmful is not search.reported[-1]:
            search.move_to_end(harmful)
            moves += 1
            continue
        if not may_move:
            harmful = _most_harmful(search, excused)
            if harmful is None:
                return
        if _helps_where_friction_is_known(search, harmful):
            excused.append(harmful)
            continue
        search.remove(harmful, reason)
        moves = 0


def first_harmful(
    search: EffectSearch, initial_error: float, excused: Collection[AddedEffect] = ()
) -> AddedEffect | None:
    """First effect that increases the error when it is added to those before it; None if there is none.

    Parameters
    ----------
    search, initial_error
        As in `order_effects`.
    excused
        Effects that may increase it.
    """
    error_before = initial_error
    for k, effect in enumerate(search.reported):
        error = _error_with(search, search.model.entries(k + 1))
        if error > MAX_ERROR_RATIO * error_before and effect not in excused:
            return effect
        error_before = error
    return None


def _most_harmful(search: EffectSearch, excused: Collection[AddedEffect]) -> AddedEffect | None:
    """Effect without which the error is least, all others being present; None if it is least with all."""
    least_error = _error_with(search, _all_entries(search)) / MAX_ERROR_RATIO
    most_harmful = None
    for effect in search.reported:
        error = _error_with(search, _entries_without(search, effect))
        if error < least_error and effect not in excused:
            least_error = error
            most_harmful = effect
    return most_harmful


def _helps_where_friction_is_known(search: EffectSearch, effect: AddedEffect) -> bool:
    """True if an effect lowers the held-out error but for samples at rest and near reversals."""
    without = _fit_with(search, _entries_without(search, effect))
    with_all = _fit_with(search, _all_entries(search))
    return held_out_log_change(without, with_all) < -_MIN_EXCUSE


def _all_entries(search: EffectSearch) -> list[EffectEntry]:
    """Entries of the model with all effects."""
    return search.model.entries(len(search.reported))


def _entries_without(search: EffectSearch, effect: AddedEffect) -> list[EffectEntry]:
    """Entries of the model with all effects but one."""
    entries = _all_entries(search)
    first = len(entries) - len(search.reported)
    del entries[first + search.reported.index(effect)]
    return entries


def _error_with(search: EffectSearch, entries: Sequence[EffectEntry]) -> float:
    """Rms torque error of the model with some of the effects, held out if anything is, over all joints [N·m]."""
    fitted = _fit_with(search, entries)
    errors = evaluate_errors(fitted.experiment, fitted.estimate.theta, False, search.progress)
    return errors.torque["overall"]


def _fit_with(search: EffectSearch, entries: Sequence[EffectEntry]) -> LinearizedFit:
    """Fit of the model with some of the effects."""
    experiment = with_effects(search.current.experiment, entries, search.current.theta)
    return linearize_fit(experiment, search.progress)
