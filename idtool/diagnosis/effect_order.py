"""Order of the effects found, so that each of them lowers the held-out error, and removal of those that never do."""

from __future__ import annotations

from collections.abc import Sequence

from idtool.diagnosis.effect_search import EffectSearch
from idtool.diagnosis.error_summary import evaluate_errors
from idtool.diagnosis.extended_model import AddedEffect
from idtool.diagnosis.linearized_fit import linearize_fit
from idtool.diagnosis.trial import with_effects
from idtool.robot.config import EffectEntry

_MAX_INCREASE = 1.0005  # ratio of the held-out errors of all joints together, with an effect and without it


def remove_harmful(search: EffectSearch, initial_error: float) -> None:
    """Order the effects so that each lowers the held-out error, and remove those that do so nowhere in the order.

    A right but small effect may increase the error as long as the largest one is missing. Effects that lower it only
    together stay, in any order.

    Parameters
    ----------
    search
        The search that found them.
    initial_error
        Held-out torque error of the model without effects, over all joints [N·m].
    """
    moves = 0
    while search.reported:
        harmful = first_harmful(search, initial_error)
        if harmful is None:
            return
        all_orders_fail = moves >= len(search.reported) ** 2
        if not all_orders_fail and harmful is not search.reported[-1]:
            search.move_to_end(harmful)
            moves += 1
            continue
        if all_orders_fail:
            harmful = _most_harmful(search)
            if harmful is None:
                return
        search.remove(harmful, "it increases the error on the held-out data")
        moves = 0


def first_harmful(search: EffectSearch, initial_error: float) -> AddedEffect | None:
    """First effect that increases the held-out error when it is added to those before it; None if there is none.

    Parameters
    ----------
    search, initial_error
        As in `remove_harmful`.
    """
    error_before = initial_error
    for k, effect in enumerate(search.reported):
        error = _overall_error(search, search.model.entries(k + 1))
        if error > _MAX_INCREASE * error_before:
            return effect
        error_before = error
    return None


def _most_harmful(search: EffectSearch) -> AddedEffect | None:
    """Effect without which the held-out error is least, all others being present; None if it is least with all."""
    entries = search.model.entries(len(search.reported))
    least_error = _overall_error(search, entries)
    most_harmful = None
    first = len(entries) - len(search.reported)
    for i, effect in enumerate(search.reported, first):
        error = _overall_error(search, [*entries[:i], *entries[i + 1 :]])
        if error < least_error:
            least_error = error
            most_harmful = effect
    return most_harmful


def _overall_error(search: EffectSearch, entries: Sequence[EffectEntry]) -> float:
    """Rms torque error of the model with some effects on the held-out data, over all joints [N·m]."""
    experiment = with_effects(search.current.experiment, entries, search.current.theta)
    fitted = linearize_fit(experiment, search.progress)
    errors = evaluate_errors(fitted.experiment, fitted.estimate.theta, False, search.progress)
    return errors.torque["overall"]
