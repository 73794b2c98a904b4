"""One round of the search: all candidates are screened to first order, and the best are fitted with the whole model.

`model_selection` chooses among them. For *gain* and *inflation*, see `model_selection`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from idtool.common.arrays import Array
from idtool.common.processes import in_processes, process_count
from idtool.diagnosis.candidate_fit import (
    MIN_REPLACING_GAIN_RATIO,
    fit_and_judge,
    fit_candidate,
)
from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.diagnosis.model_selection import (
    MIN_SHARE,
    MIN_SIGNIFICANCE,
    FittedCandidate,
    FullFits,
    ProbeKey,
    Screening,
    SelectionStep,
    best_by_key,
    block_gains,
    probe_key,
    screened_record,
    select_best,
)
from idtool.diagnosis.noise_gain import noise_gain_with_probe
from idtool.diagnosis.quiet_joints import quiet_joints
from idtool.diagnosis.records import Candidate
from idtool.diagnosis.screen import ScreenedProbe, screen_probes
from idtool.diagnosis.summarize_data import summarize_data
from idtool.diagnosis.trial import FAILURES, has_fixed_inertia, not_fitted_reason, with_nonlinear_parameters_free
from idtool.diagnosis.trial_transfer import trial_from_bytes, trial_to_bytes
from idtool.dynamics.effects import effect_types
from idtool.dynamics.effects.data_summary import Burst, DataSummary
from idtool.dynamics.effects.fixed_effect import FixedEffect
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.dynamics.effects.link_effect import LinkEffect
from idtool.dynamics.effects.probe import Probe
from idtool.estimation.dataset.experiment import Progress

Bursts = tuple[Burst, ...]

_MAX_REFINED = 7  # candidates that are screened again on a finer grid
_STARTS_ON_GRID = 3  # probes about which the grid is refined, of a candidate whose residual jumps with its parameters
_REFINEMENTS = 2  # passes, since the best value of a parameter depends on that of another
_REFINEMENT_POINTS = 7  # values that are screened again between the neighbours of a value in the grid
_POINTS_IF_COMBINED = 5  # of each parameter, where several are changed together
MAX_FULL_FITS = 5  # candidates that are fitted with the whole model, including those that are then rejected
_MIN_GAIN_RATIO = 0.4  # to the gain of the best accepted candidate, for a candidate to be fitted
_MIN_FIRST_ORDER_GAIN_RATIO = 0.2  # likewise, where a fit may explain much more than the screening


def _no_bursts() -> Bursts:
    """No time intervals."""
    return ()


def find_best_effect(
    base: LinearizedFit,
    initial: LinearizedFit,
    progress: Progress,
    effects: Sequence[str] | None,
    find_bursts: Callable[[], Bursts] = _no_bursts,
    min_share: float = MIN_SHARE,
    skipped: Collection[ProbeKey] = (),
    movable: Sequence[int] = (),
    replaced: LinearizedFit | None = None,
    max_fits: int = MAX_FULL_FITS,
) -> SelectionStep:
    """One round of the search: the effect that explains most of a model's residual.

    If all joints are quiet, no effect is tried.

    Parameters
    ----------
    base
        Model that lacks the effect.
    initial
        The model without any of the effects found.
    progress
        Callback for the stage and its progress, from 0 to 1.
    effects
        Ids of the effects to try; None: all.
    find_bursts
        Finds the time intervals in which the residual is unusually large. It is called only if effects are tried, since
        it takes long.
    min_share
        Share of a joint's squared residual that an effect must explain.
    skipped
        Keys of candidates that are not tried.
    movable
        Indices of the model's effects whose nonlinear parameters may be moved.
    replaced
        Model with other effects that it is to replace, on the rows of ``base``; None: it is to replace none. Candidates
        that promise to explain much less than these are not fitted.
    max_fits
        Number of candidates that are fitted with the whole model at most, including those that are then rejected.
    """
    quiet = quiet_joints(base, progress)
    if quiet.issuperset(base.experiment.equation.joints):
        return SelectionStep(
            base,
            winner=None,
            indistinguishable=(),
            runners_up=(),
            rejected=(),
            inflation=_white_noise_inflation(base),
            has_tried=False,
        )
    summary = summarize_data(base, find_bursts(), has_fixed_inertia(base.experiment))
    reference = with_nonlinear_parameters_free(base, movable, progress)
    replaced_gain = 0.0
    explained_joints: frozenset[str] = frozenset()
    if replaced is not None:
        replaced_gain = float(block_gains(reference, replaced).sum())
        explained_joints = _joints_as_well_explained(base, replaced)
    screening = _screen_all(reference, summary, effects, quiet.union(explained_joints), skipped, progress)
    needed = [one for one in screening.screened if not _acts_on_one_of(one.probe, explained_joints)]
    refined = _refine(reference, needed, progress)
    candidates = [candidate for candidate in refined if _may_replace(candidate, replaced_gain)]
    fits = _fit_best_candidates(
        base, initial, candidates, summary, screening.inflation, movable, replaced_gain, max_fits, progress
    )
    selection = select_best(base, screening, fits, movable, progress, min_share)
    gain = replaced_gain
    if replaced is None and selection.winner is not None:
        gain = selection.winner.gain
    explains_nothing = gain <= 0 or explained_joints.issuperset(base.experiment.equation.joints)
    if explains_nothing:
        return selection
    substitutes = _substitutes(refined, fits.gains, gain)
    return replace(selection, substitutes=substitutes.union(skipped))


def _joints_as_well_explained(without: LinearizedFit, other: LinearizedFit) -> frozenset[str]:
    """Joints whose squared residual is hardly larger than that of another model on the same rows."""
    is_alike = without.mean_squared_residual < other.mean_squared_residual / (1 - MIN_SHARE)
    return frozenset(without.experiment.equation.joints[j] for j in np.flatnonzero(is_alike))


def _acts_on_one_of(probe: Probe, joints: Container[str]) -> bool:
    """True if a probe's effect changes the torque of a single joint, which is one of some."""
    return _acts_on_own_joint_alone(probe) and probe.joint in joints


def _acts_on_own_joint_alone(probe: Probe) -> bool:
    """True if a probe's effect changes the torque of no other joint than its own."""
    return not issubclass(effect_types()[probe.effect], FixedEffect)


def _screen_all(
    reference: LinearizedFit,
    summary: DataSummary,
    effects: Sequence[str] | None,
    coarse_joints: Container[str],
    skipped: Container[ProbeKey],
    progress: Progress,
) -> Screening:
    """All candidates but the skipped ones, screened on the effects' own grids of nonlinear values.

    On ``coarse_joints``, one probe is tried instead of the whole grid.
    """
    all_probes, not_built = _candidate_probes(summary, effects)
    grids: dict[ProbeKey, list[Probe]] = {}
    for probe in all_probes:
        if probe_key(probe) not in skipped:
            grids.setdefault(probe_key(probe), []).append(probe)
    probes = []
    weights = []
    for grid in grids.values():
        tried = [grid[len(grid) // 2]] if grid[0].joint in coarse_joints else grid
        probes += tried
        weights += [len(grid) / len(tried)] * len(tried)
    screened = screen_probes(reference, probes, progress)
    failed = [*not_built, *_screening_failures(reference, screened)]
    return Screening(reference, screened, failed, _row_inflation(reference, screened, weights))


def _refine(reference: LinearizedFit, screened: Sequence[ScreenedProbe], progress: Progress) -> list[ScreenedProbe]:
    """Best probe of each promising candidate, the largest gain first; the best candidates on a finer grid."""
    promising = _promising(screened)
    refined: list[ScreenedProbe] = []
    for _ in range(_REFINEMENTS):
        starts = [start for start in _refinement_starts(promising) if start not in refined]
        finer_probes = list(_refined_probes(starts, screened))
        promising += _promising(screen_probes(reference, finer_probes, progress, "fitting candidates"))
        refined += starts
    return _by_gain(best_by_key(promising).values())


def _refinement_starts(promising: Sequence[ScreenedProbe]) -> list[ScreenedProbe]:
    """Probes about which the grid is refined: the best of each of the best candidates.

    Of a candidate whose residual jumps with its parameters, there are several, since a coarse grid may miss the best.
    """
    starts = []
    for best in _by_gain(best_by_key(promising).values())[:_MAX_REFINED]:
        key = probe_key(best.probe)
        of_candidate = _by_gain(one for one in promising if probe_key(one.probe) == key)
        count = _STARTS_ON_GRID if _is_searched_on_grid(best.probe.effect) else 1
        starts += of_candidate[:count]
    return starts


def _is_searched_on_grid(effect: str) -> bool:
    """True if the residual jumps with parameters of an effect, so that they are searched for on a grid."""
    kind = effect_types()[effect]
    return issubclass(kind, JointEffect) and bool(kind.grid_parameters())


def _fit_best_candidates(
    base: LinearizedFit,
    initial: LinearizedFit,
    candidates: Sequence[ScreenedProbe],
    summary: DataSummary,
    inflation: float,
    movable: Sequence[int],
    replaced_gain: float,
    max_fits: int,
    progress: Progress,
) -> FullFits:
    """Candidates fitted with the whole model, until their gain is due to chance or far below that of an accepted one.

    Parameters
    ----------
    base, initial
        The model, and the model without any of the effects found.
    candidates
        The candidates, the largest gain first.
    summary
        The robot and its data.
    inflation
        Number of rows that are worth one independent row.
    movable
        Indices of the model's effects whose nonlinear parameters may be moved.
    replaced_gain
        Gain of the effects that one of them is to replace.
    max_fits
        Number of candidates that are fitted at most.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    finalists: list[FittedCandidate] = []
    failed: list[Candidate] = []
    significant, rejected = _significant_candidates(candidates, base, MIN_SIGNIFICANCE**2 * inflation)

    def fit_and_judge_one(candidate: ScreenedProbe, progress: Progress) -> _Judged | Exception:
        try:
            fitted, rejection_reason = fit_and_judge(
                candidate, base, initial, summary, movable, replaced_gain, progress
            )
        except FAILURES as failure:
            return failure
        return _Judged(trial_to_bytes(fitted.trial), fitted.gains, rejection_reason)

    gains: dict[ProbeKey, float] = {}
    best_gain = 0.0
    waiting = _by_gain(significant)[:max_fits]
    while waiting:
        # Those after the first may turn out not to be needed; a core that has nothing else to do fits them anyway.
        together = waiting[: process_count()]
        waiting = waiting[len(together) :]
        for candidate, judged in zip(together, in_processes(fit_and_judge_one, together, progress), strict=True):
            if candidate.gain < _min_gain_ratio(candidate) * best_gain:
                continue
            if isinstance(judged, Exception):
                failed.append(screened_record(candidate, base, not_fitted_reason(judged)))
                continue
            gains[probe_key(candidate.probe)] = float(judged.gains.sum())
            if judged.rejection_reason:
                rejected.append(screened_record(candidate, base, judged.rejection_reason))
            else:
                trial = trial_from_bytes(judged.trial, base)
                finalists.append(FittedCandidate(candidate, trial, judged.gains))
                best_gain = max(best_gain, candidate.gain)
        waiting = [candidate for candidate in waiting if candidate.gain >= _min_gain_ratio(candidate) * best_gain]
    finalists.sort(key=lambda finalist: -finalist.gain)
    return FullFits(finalists, rejected, failed, gains)


def _significant_candidates(
    candidates: Sequence[ScreenedProbe], base: LinearizedFit, min_gain: float
) -> tuple[list[ScreenedProbe], list[Candidate]]:
    """Candidates that gain enough even without torque noise that they cancel; records of those that only cancel noise.

    Parameters
    ----------
    candidates
        The candidates, the largest gain first.
    base
        The model.
    min_gain
        Gain that is enough.
    """
    significant: list[ScreenedProbe] = []
    rejected: list[Candidate] = []
    for candidate in candidates:
        if candidate.gain < min_gain:
            break
        without_noise = _without_cancelled_noise(candidate, base)
        if without_noise.gain < min_gain:
            rejected.append(screened_record(candidate, base, "explains only noise of the measured torque"))
        else:
            significant.append(without_noise)
    return significant, rejected


class _Judged(NamedTuple):
    """A fitted and judged candidate in a form that a copy of this process can send.

    Attributes
    ----------
    trial
        Bytes of the fit.
    gains
        Gain in each block by the fit, shape (F,).
    rejection_reason
        Reason why it is rejected, as a clause; empty if it is accepted.
    """

    trial: bytes
    gains: Array
    rejection_reason: str


def _min_gain_ratio(candidate: ScreenedProbe) -> float:
    """Least ratio of a candidate's gain to that of the best accepted one, for it to be fitted."""
    is_first_order = effect_types()[candidate.probe.effect].is_screened_to_first_order
    return _MIN_FIRST_ORDER_GAIN_RATIO if is_first_order else _MIN_GAIN_RATIO


def _may_replace(candidate: ScreenedProbe, replaced_gain: float) -> bool:
    """True if the fit of a candidate may explain as much as effects with a given gain."""
    kind = effect_types()[candidate.probe.effect]
    is_gain_reliable = _acts_on_own_joint_alone(candidate.probe) or issubclass(kind, LinkEffect)
    min_ratio = MIN_REPLACING_GAIN_RATIO if is_gain_reliable else _min_gain_ratio(candidate)
    return candidate.gain > min_ratio * replaced_gain


def _substitutes(
    candidates: Iterable[ScreenedProbe], fitted_gains: Mapping[ProbeKey, float], gain: float
) -> frozenset[ProbeKey]:
    """Keys of the candidates that may explain as much as effects with a given gain.

    Parameters
    ----------
    candidates
        The candidates.
    fitted_gains
        Gains of those that were fitted.
    gain
        Gain of the effects.
    """
    substitutes = set()
    for candidate in candidates:
        key = probe_key(candidate.probe)
        if key in fitted_gains:
            may_replace = max(fitted_gains[key], candidate.gain) > MIN_REPLACING_GAIN_RATIO * gain
        else:
            may_replace = _may_replace(candidate, gain)
        if may_replace:
            substitutes.add(key)
    return frozenset(substitutes)


def _without_cancelled_noise(candidate: ScreenedProbe, base: LinearizedFit) -> ScreenedProbe:
    """Candidate without the gains that come from cancelled noise of the measured torque: the most that can remain.

    An effect that uses the measured torque, such as joint elasticity, predicts a torque that contains that torque's
    noise. In the residual, the two partly cancel, which explains nothing. All that the candidate leaves is taken as
    noise: without the cancellation, its square would be 1 / noise gain² times as large. The increase is no gain.
    """
    if not effect_types()[candidate.probe.effect].uses_measured_torque:
        return candidate
    noise_gain = noise_gain_with_probe(base.experiment, base.theta, base.noise, candidate.probe, candidate.c)
    # a block's gain is not known by joint: if each had all of it, the least would be left
    least_sse = np.maximum(base.sse - np.maximum(candidate.gains, 0)[:, None], 0)
    loss = least_sse @ (1 / np.square(noise_gain) - 1)
    return replace(candidate, gains=candidate.gains - loss)


def fit_assumed_effect(
    base: LinearizedFit, progress: Progress, effect: str, target: str | None, bursts: Bursts = ()
) -> SelectionStep:
    """Fit one given effect at the joint or link where it explains most, without requiring that it explain anything.

    Its nonlinear values are not screened on a finer grid, which serves the comparison of candidates: the fit moves them
    from the best values of the grid.

    Parameters
    ----------
    base
        The model.
    progress
        Callback for the stage and its progress, from 0 to 1.
    effect
        Id of the effect.
    target
        The joint or link; None: any.
    bursts
        Time intervals in which the residual is unusually large.
    """
    summary = summarize_data(base, bursts, has_fixed_inertia(base.experiment))
    candidates, _ = _candidate_probes(summary, (effect,))
    probes = [probe for probe in candidates if probe.effect == effect]  # unreported ones are among the candidates
    if target is not None:
        probes = [probe for probe in probes if probe.subject[1] == target]
    screened = screen_probes(base, probes, progress)
    winner = None
    for candidate in sorted(screened, key=lambda one: (not one.is_possible, -one.gain)):
        try:
            winner = fit_candidate(base, candidate, progress)
            break
        except FAILURES:
            continue
    return SelectionStep(base, winner, (), (), (), _row_inflation(base, screened, [1.0] * len(screened)))


def _candidate_probes(summary: DataSummary, effects: Sequence[str] | None) -> tuple[list[Probe], list[Candidate]]:
    """Probes of all effects that may be missing, and records of the effects whose probes cannot be built.

    Effects that are fitted without being reported are always among them.

    Parameters
    ----------
    summary
        The robot and its data.
    effects
        Ids of the effects to try; None: all.
    """
    searched = {}
    for effect_id, effect_type in effect_types().items():
        if effects is None or effect_id in effects or not effect_type.reportable:
            searched[effect_id] = effect_type
    probes: list[Probe] = []
    failed = []
    for effect_type in searched.values():
        # an effect outside the search would never be added: waiting for it would exclude the one that requires it
        required = [effect for effect in effect_type.requires if effect in searched]
        try:
            effect_probes = list(effect_type.probes(summary))
        except FAILURES as failure:
            failed.append(Candidate(effect_type.id, None, None, 0.0, 0.0, 0, not_fitted_reason(failure)))
            continue
        for probe in effect_probes:
            _, owner = probe.subject
            if not required or any(summary.has_effect(effect, owner) for effect in required):
                probes.append(probe)
    return probes, failed


def _screening_failures(base: LinearizedFit, screened: Sequence[ScreenedProbe]) -> list[Candidate]:
    """Effects of which no probe could be evaluated, with the reason of the first."""
    evaluated = {probe_key(one.probe) for one in screened if not one.failure}
    failures: dict[ProbeKey, Candidate] = {}
    for one in screened:
        key = probe_key(one.probe)
        if one.failure and key not in evaluated and key not in failures:
            failures[key] = screened_record(one, base, not_fitted_reason(one.failure))
    return list(failures.values())


def _row_inflation(base: LinearizedFit, screened: Sequence[ScreenedProbe], weights: Sequence[float]) -> float:
    """Number of rows that are worth one independent row: the median over all probes, by their weights.

    It is at least that of white noise after the filter.
    """
    least = _white_noise_inflation(base)
    inflations = np.array([probe.inflation for probe in screened])
    is_known = np.isfinite(inflations) & (inflations > 0)
    if not is_known.any():
        return least
    known_weights = np.array(weights)[is_known]
    median = np.quantile(inflations[is_known], 0.5, weights=known_weights, method="inverted_cdf")
    return max(float(median), least)


def _white_noise_inflation(base: LinearizedFit) -> float:
    """Number of rows that are worth one independent row, if the noise is white before the filter."""
    return base.experiment.runs[0].signals.low_pass.redundancy


def _promising(screened: Iterable[ScreenedProbe]) -> list[ScreenedProbe]:
    """Probes that explain something and that physics allows."""
    return [candidate for candidate in screened if candidate.gain > 0 and candidate.is_possible]


def _by_gain(screened: Iterable[ScreenedProbe]) -> list[ScreenedProbe]:
    """Probes in the order of their gains, the largest first."""
    return sorted(screened, key=lambda candidate: -candidate.gain)


def _refined_probes(candidates: Sequence[ScreenedProbe], screened: Sequence[ScreenedProbe]) -> Iterator[Probe]:
    """Probes of the candidates on a finer grid: of each, with one nonlinear value changed at a time.

    Of a candidate whose residual jumps with its parameters, all values are changed together: the best value of one
    depends on those of the others. A parameter that is not continuous, one of which a single value was screened, and
    one whose value is not of the grid any more, is not changed.

    Parameters
    ----------
    candidates
        The candidates.
    screened
        All probes that were screened: their values are the grid.
    """
    for candidate in candidates:
        probe = candidate.probe
        alike = [other.probe for other in screened if probe_key(other.probe) == probe_key(probe)]
        for changed_values in _refined_choices(probe, alike):
            yield probe.at({**probe.nonlinear_values, **changed_values})


def _refined_choices(probe: Probe, alike: Sequence[Probe]) -> Iterator[dict[str, float]]:
    """Finer values to try of some nonlinear parameters of a probe; ``alike`` are the probes of its coarse grid."""
    parameters = effect_types()[probe.effect].nonlinear_parameters
    discrete = [parameter.name for parameter in parameters if not parameter.is_continuous]
    are_changed_together = _is_searched_on_grid(probe.effect)
    points = _POINTS_IF_COMBINED if are_changed_together else _REFINEMENT_POINTS
    finer: dict[str, list[float]] = {}
    for name, value in probe.nonlinear_values.items():
        grid = sorted({other.nonlinear_values[name] for other in alike})
        if name not in discrete and len(grid) > 1 and value in grid:
            finer[name] = _refined_values(value, grid, points)
    if are_changed_together and finer:
        for values in product(*finer.values()):
            yield dict(zip(finer, values, strict=True))
        return
    for name, values_of_one in finer.items():
        for value in values_of_one:
            yield {name: value}


def _refined_values(value: float, grid: Sequence[float], points: int) -> list[float]:
    """Values between the neighbours of a value in an ascending grid; at an end of the grid, it is its own neighbour."""
    position = grid.index(value)
    low = grid[max(position - 1, 0)]
    high = grid[min(position + 1, len(grid) - 1)]
    spaced = np.geomspace if low > 0 else np.linspace
    inner = spaced(low, high, points + 2)[1:-1]
    return [float(x) for x in inner]
