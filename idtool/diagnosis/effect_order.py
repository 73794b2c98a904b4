"""Order of the effects found, so that each of them lowers the held-out error, and removal of those that never do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from idtool.diagnosis.effect_search import EffectSearch
from idtool.diagnosis.error_summary import evaluate_errors
from idtool.diagnosis.extended_model import AddedEffect
from idtool.diagnosis.held_out_error import held_out_mean_squares
from idtool.diagnosis.linearized_fit import linearize_fit
from idtool.diagnosis.trial import with_effects
from idtool.robot.config import EffectEntry

MAX_INCREASE = 1.0005  # ratio of the held-out errors of all joints together, with an effect and without it


@dataclass(frozen=True)
class _HeldOutError:
    """Rms torque error of a model on the held-out data, over all joints [N·m].

    Attributes
    ----------
    at_all_samples
        At all samples. At a reversal nothing is known of the direction of friction, so that chance decides whether an
        effect that shifts its jump increases this error.
    where_defined
        At samples at which the columns of the model with all effects are defined; NaN without held-out data.
    """

    at_all_samples: float
    where_defined: float

    def exceeds(self, before: _HeldOutError) -> bool:
        """True if it is larger than the error without an effect, whichever samples count."""
        is_larger = self.at_all_samples > MAX_INCREASE * before.at_all_samples
        is_smaller_where_defined = self.where_defined <= MAX_INCREASE * before.where_defined
        return is_larger and not is_smaller_where_defined


def remove_harmful(search: EffectSearch, initial_error: float) -> None:
    """Order the effects so that each lowers the held-out error, and remove those that do so nowhere in the order.

    A right but small effect may increase the error as long as the largest one is missing. Effects that lower it only
    together stay, in any order.

    Parameters
    ----------
    search
        The search that found them.
    initial_error
        Held-out torque error of the model without effects, at all samples and over all joints [N·m].
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
    without_any = _held_out_error(search, search.model.entries(0))
    error_before = replace(without_any, at_all_samples=initial_error)
    for k, effect in enumerate(search.reported):
        error = _held_out_error(search, search.model.entries(k + 1))
        if error.exceeds(error_before):
            return effect
        error_before = error
    return None


def _most_harmful(search: EffectSearch) -> AddedEffect | None:
    """Effect without which the held-out error is least, all others being present; None if it is least with all."""
    entries = search.model.entries(len(search.reported))
    least = _held_out_error(search, entries)
    most_harmful = None
    first = len(entries) - len(search.reported)
    for i, effect in enumerate(search.reported, first):
        error = _held_out_error(search, [*entries[:i], *entries[i + 1 :]])
        if least.exceeds(error):
            least = error
            most_harmful = effect
    return most_harmful


def _held_out_error(search: EffectSearch, entries: Sequence[EffectEntry]) -> _HeldOutError:
    """Held-out error of the model with some of the effects."""
    experiment = with_effects(search.current.experiment, entries, search.current.theta)
    fitted = linearize_fit(experiment, search.progress)
    errors = evaluate_errors(fitted.experiment, fitted.estimate.theta, False, search.progress)
    mean_squares = held_out_mean_squares(fitted, search.current.experiment.equation)
    return _HeldOutError(errors.torque["overall"], float(np.sqrt(mean_squares.mean())))
