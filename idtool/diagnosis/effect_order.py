"""Order of the effects found: each step must lower the held-out error; an effect that increases it is removed."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

from idtool.diagnosis.effect_search import EffectSearch
from idtool.diagnosis.error_summary import MAX_ERROR_RATIO, MAX_EXCUSED_RATIO, errors_of_fit, increases_error
from idtool.diagnosis.extended_model import AddedEffect
from idtool.diagnosis.held_out_error import held_out_log_change
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.records import ErrorSummary
from idtool.estimation.fit import Fit, fit

_MIN_LOG_DECREASE = 0.1  # of the squared error where the direction of friction is known, that excuses an increase

Errors = Mapping[str, float]  # rms torque errors by joint, and ``overall`` [N·m or N]


def order_effects(search: EffectSearch, fits: StepFits) -> None:
    """Order the effects so that each lowers the held-out error when it is added to those before it.

    One that increases the error is moved to the end, since a right but small effect may do so as long as a larger one
    is missing, and from there to the first place where no step does. If there is none, it is removed. If moving has no
    end, the effect without which the error is least is removed. Three kinds of effects stay although they increase the
    error at their place: those that lower it only together with others, those that increase it by no more than chance
    explains, and those that increase it by less than 1 %, only near reversals, and lower it elsewhere. Near reversals
    the direction of friction is uncertain, and chance decides whether an effect that shifts the jump of friction
    increases the error.

    Without held-out data, the error on the training data decides.

    Parameters
    ----------
    search
        The search that found them.
    fits
        Fits of the model with some of them.
    """
    has_held_out = search.current.experiment.has_held_out
    reason = "it increases the error on the held-out data" if has_held_out else "it increases the error"
    excused: list[AddedEffect] = []
    moves = 0
    while search.reported:
        harmful = first_harmful(search.reported, fits, excused)
        if harmful is None:
            return
        may_move = moves < len(search.reported) ** 2
        if may_move and harmful is not search.reported[-1]:
            search.move_to_end(harmful)
            moves += 1
            continue
        if not may_move:
            harmful = _most_harmful(search, fits, excused)
            if harmful is None:
                return
        order = _harmless_order(_others(search, harmful), harmful, fits, excused)
        if order is not None:
            search.reorder(order)
            return
        if _is_excused(search, harmful, fits):
            excused.append(harmful)
            continue
        fits.forget()
        search.remove(harmful, reason)
        moves = 0


class StepFits:
    """Fits of the model with some of the effects found, each of which is made once.

    Attributes
    ----------
    first
        Fit of the model without effects.

    Parameters
    ----------
    search
        The search that found the effects.
    first
        Fit of the model without effects.
    """

    def __init__(self, search: EffectSearch, first: Fit) -> None:
        self._search = search
        self.first = first
        self._known: dict[frozenset[AddedEffect], Fit] = {}

    def of(self, effects: Sequence[AddedEffect]) -> Fit:
        """Fit of the model with these effects; raises as `idtool.estimation.fit.fit`."""
        if not effects:
            return self.first
        key = frozenset(effects)
        if key not in self._known:
            self._known[key] = fit(self._search.model.experiment_with(effects), self._search.progress)
        return self._known[key]

    def forget(self) -> None:
        """Forget all fits but the first, where effects are about to change."""
        self._known.clear()

    def errors_of(self, effects: Sequence[AddedEffect]) -> Errors:
        """Torque errors of the model with these effects, held out if anything is."""
        return self.summary_of(effects).torque

    def summary_of(self, effects: Sequence[AddedEffect]) -> ErrorSummary:
        """Errors of the model with these effects."""
        return errors_of_fit(self.of(effects))

    def by_step(self, order: Sequence[AddedEffect]) -> Iterator[tuple[AddedEffect, Errors, Errors]]:
        """Each effect with the errors before and after it is added to those before it."""
        for k, effect in enumerate(order):
            yield effect, self.errors_of(order[:k]), self.errors_of(order[: k + 1])


def first_harmful(
    order: Sequence[AddedEffect], fits: StepFits, excused: Collection[AddedEffect] = ()
) -> AddedEffect | None:
    """First effect that increases the error over all joints when it is added to those before it; None: there is none.

    Parameters
    ----------
    order
        The effects found, in an order.
    fits
        Fits with some of them.
    excused
        Effects that may increase the error.
    """
    for effect, before, after in fits.by_step(order):
        is_harmful = after["overall"] > MAX_ERROR_RATIO * before["overall"]
        if is_harmful and effect not in excused:
            return effect
    return None


def _harmless_order(
    others: Sequence[AddedEffect], harmful: AddedEffect, fits: StepFits, excused: Collection[AddedEffect]
) -> list[AddedEffect] | None:
    """Order with an effect among the others in which no step increases the error; None if there is none."""
    for place in range(len(others)):
        order = [*others[:place], harmful, *others[place:]]
        if first_harmful(order, fits, excused) is None:
            return order
    return None


def _most_harmful(search: EffectSearch, fits: StepFits, excused: Collection[AddedEffect]) -> AddedEffect | None:
    """Effect without which the error is least, all others being present; None if it is least with all."""
    least_error = fits.errors_of(search.reported)["overall"] / MAX_ERROR_RATIO
    most_harmful = None
    for effect in search.reported:
        error = fits.errors_of(_others(search, effect))["overall"]
        if error < least_error and effect not in excused:
            least_error = error
            most_harmful = effect
    return most_harmful


def _is_excused(search: EffectSearch, effect: AddedEffect, fits: StepFits) -> bool:
    """True if chance, or the uncertain friction at reversals, explains that an effect increases the error."""
    without = fits.summary_of(_others(search, effect))
    with_all = fits.summary_of(search.reported)
    if not increases_error(without, with_all):
        return True
    ratio = with_all.torque["overall"] / without.torque["overall"]
    return ratio < MAX_EXCUSED_RATIO and _helps_where_friction_is_known(search, effect)


def _helps_where_friction_is_known(search: EffectSearch, effect: AddedEffect) -> bool:
    """True if an effect lowers the held-out error but for samples at rest and near reversals."""
    without = _fit_with(search, _others(search, effect))
    with_all = _fit_with(search, search.reported)
    return held_out_log_change(without, with_all, with_all.experiment.equation) < -_MIN_LOG_DECREASE


def _others(search: EffectSearch, effect: AddedEffect) -> list[AddedEffect]:
    """All effects but one."""
    return [other for other in search.reported if other is not effect]


def _fit_with(search: EffectSearch, effects: Sequence[AddedEffect]) -> LinearizedFit:
    """Fit of the model with some of the effects."""
    return linearize_fit(search.model.experiment_with(effects), search.progress)
