"""Evidence for an effect: its size on parts of the data, its share of the residual, and the held-out error."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from disturbed import Array, experiment_of, motion, nothing, silent, torque_on_joint

from idtool.diagnosis import held_out_error
from idtool.diagnosis.confirmation import contradiction, estimate_on_parts
from idtool.diagnosis.diagnose import Options, diagnose
from idtool.diagnosis.doubts import doubt_about
from idtool.diagnosis.held_out_error import lowers_held_out_likelihood
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.records import Diagnosis, PartEstimate
from idtool.diagnosis.selection_round import find_best_effect
from idtool.diagnosis.trial import with_effects, with_fixed_inertia
from idtool.diagnosis.unexplained import residual_structure
from idtool.diagnosis.unproven import _clearest_joint, find_unproven
from idtool.estimation.dataset.experiment import Experiment
from idtool.robot.config import EffectEntry

STIFFNESS, OFFSET = 3.0, 0.5  # N·m/rad, N·m
UNITS = {"stiffness": "N·m/rad", "rest_position": "rad"}
EFFECTS = ("parallel_spring", "torque_offset", "quadratic_drag")
SPRING = EffectEntry(effect="parallel_spring", joint="j1", parameters={"stiffness": 0.0, "rest_position": 0.4})
DRAG = EffectEntry(effect="quadratic_drag", joint="j2", parameters={"drag": 0.0})

spring = torque_on_joint(0, lambda t, q, v, tau: STIFFNESS * (q - 0.4))
stiffer = torque_on_joint(0, lambda t, q, v, tau: 2 * STIFFNESS * (q - 0.4))


def fitted(experiment: Experiment, *entries: EffectEntry) -> LinearizedFit:
    return linearize_fit(with_effects(experiment, entries), silent)


def sizes(experiment: Experiment) -> list[PartEstimate]:
    """Size of a spring on the parts of the data."""
    current = fitted(experiment, SPRING)
    (found,) = estimate_on_parts(current, [current.experiment.config.effects[-1]], silent)
    return found


def test_a_spring_has_its_stiffness_on_both_halves(tmp_path: Path) -> None:
    found = sizes(experiment_of(tmp_path, spring))
    assert [(one.part, one.parameter) for one in found] == [("first half", "stiffness"), ("second half", "stiffness")]
    for one in found:
        assert abs(one.value - STIFFNESS) < 4 * one.standard_error < 0.5
    assert contradiction(found, UNITS) == ""


def test_a_spring_that_is_another_in_another_log_is_contradicted(tmp_path: Path) -> None:
    found = sizes(experiment_of(tmp_path, spring, stiffer))
    assert [one.part for one in found] == ["log0.csv", "log1.csv"]
    assert [one.value for one in found] == pytest.approx([STIFFNESS, 2 * STIFFNESS], rel=0.05)
    clause = contradiction(found, UNITS)
    assert clause.startswith("its stiffness is 3")
    assert re.fullmatch(
        r"its stiffness is 3\.\d+ ± 0\.\d+ N·m/rad in log0\.csv, but [56]\.\d+ ± 0\.\d+ N·m/rad in log1\.csv", clause
    )


def diagnosed(experiment: Experiment) -> Diagnosis:
    return diagnose(experiment, Options(effects=EFFECTS, simulate=False), silent)


def test_what_the_data_contradict_is_doubtful(tmp_path: Path) -> None:
    found = diagnosed(experiment_of(tmp_path, spring))
    (step,) = found.steps
    parts = (PartEstimate("log0.csv", "stiffness", 2.0, 0.1), PartEstimate("log1.csv", "stiffness", 3.0, 0.1))
    doubt = doubt_about(replace(step, parts=parts), UNITS, found.floor, found.after.torque, ())
    assert "is not the same everywhere in the data: its stiffness is 2" in doubt


@pytest.mark.parametrize(
    ("significance", "score", "is_doubtful"), [(2.0, 0.5, True), (2.0, 0.9, False), (5.0, 0.5, False)]
)
def test_what_explains_a_part_and_that_in_a_few_places_is_doubtful(
    tmp_path: Path, significance: float, score: float, is_doubtful: bool
) -> None:
    found = diagnosed(experiment_of(tmp_path, spring))
    (step,) = found.steps
    after = {}
    for name, before in step.before.torque.items():
        above_floor = before**2 - found.floor[name] ** 2
        after[name] = float(np.sqrt(before**2 - score * above_floor))
    changed = replace(
        step,
        significance=significance,
        chosen=replace(step.chosen, score=score),
        after=replace(step.after, train=after, validation=None),
    )
    doubt = doubt_about(changed, UNITS, found.floor, found.after.torque, ())
    assert ("explains 50 % of the mean square residual" in doubt) is is_doubtful
    assert bool(doubt) is is_doubtful


def test_what_holds_everywhere_is_not(tmp_path: Path) -> None:
    (step,) = diagnosed(experiment_of(tmp_path, spring)).steps
    assert (step.chosen.effect, len(step.parts), step.doubt) == ("parallel_spring", 2, "")


@pytest.mark.parametrize(("rest", "unproven"), [(0.0, None), (0.4, 1)])
def test_a_small_effect_must_bring_its_joint_to_the_noise_floor(
    tmp_path: Path, rest: float, unproven: int | None
) -> None:
    """A drag beside a much larger spring: believed alone, not where something else remains on the same joint."""

    def hidden(t: Any, q: Any, v: Any, tau: Any) -> Any:
        second = torque_on_joint(1, lambda t, q, v, tau: 0.012 * v * np.abs(v) + rest * np.sin(9 * t))
        return stiffer(t, q, v, tau) + second(t, q, v, tau)

    experiment = experiment_of(tmp_path, hidden)
    current = fitted(experiment, SPRING, DRAG)
    without = [linearize_fit(with_effects(experiment, [one]), silent, current) for one in (DRAG, SPRING)]
    found = find_unproven(current, [SPRING, DRAG], without, silent)
    assert (found.index if found else None) == unproven


def test_what_a_small_effect_explains_counts_in_units_of_each_joints_noise() -> None:
    """On a joint with much noise, it may explain more torque, and yet next to nothing of what is there."""
    assert _clearest_joint(np.array([0.010, 0.004]), np.array([0.3, 0.001])) == 1


def test_a_joint_that_rests_shows_nothing() -> None:
    assert _clearest_joint(np.array([1e-9, 0.010, 0.004]), np.array([0.0, 0.3, 0.001])) == 2
    assert _clearest_joint(np.array([1e-9, 0.010]), np.array([0.0, 0.0])) == 1


@pytest.mark.parametrize(("rest", "unproven"), [(0.09, None), (0.14, 1)])
def test_the_only_effect_on_a_joint_must_explain_half_of_what_the_joint_has(
    tmp_path: Path, rest: float, unproven: int | None
) -> None:
    """A drag beside a larger spring on another joint, and a vibration that nothing explains on its own."""

    def hidden(t: Any, q: Any, v: Any, tau: Any) -> Any:
        second = torque_on_joint(1, lambda t, q, v, tau: 0.012 * v * np.abs(v) + rest * np.sin(31 * t))
        return 0.5 * spring(t, q, v, tau) + second(t, q, v, tau)

    experiment = with_fixed_inertia(experiment_of(tmp_path, hidden))
    current = fitted(experiment, SPRING, DRAG)
    without = [linearize_fit(with_effects(experiment, [one]), silent, current) for one in (DRAG, SPRING)]
    found = find_unproven(current, [SPRING, DRAG], without, silent)
    assert (found.index if found else None) == unproven


@pytest.mark.parametrize(("rest", "unproven"), [(0.1, False), (0.3, True)])
def test_an_effect_must_explain_a_fifth_of_what_its_joint_has(tmp_path: Path, rest: float, unproven: bool) -> None:
    """A spring that is the same at all times, on a joint with a vibration that no effect explains."""
    hidden = torque_on_joint(0, lambda t, q, v, tau: 1.5 * (q - 0.4) + rest * np.sin(31 * t))
    experiment = experiment_of(tmp_path, hidden)
    current = fitted(experiment, SPRING)
    without = [linearize_fit(with_effects(experiment, []), silent, current)]
    found = find_unproven(current, list(current.experiment.config.effects), without, silent)
    assert (found is not None) == unproven
    if found is not None:
        assert found.reason == "it explains less than a fifth of what its joint's residual has above the noise floor"


@pytest.mark.parametrize(("later", "unproven"), [(1.0, False), (0.3, True)])
def test_an_effect_that_explains_little_must_be_the_same_everywhere(
    tmp_path: Path, later: float, unproven: bool
) -> None:
    """A spring that becomes softer with time, on a joint with a vibration that no effect explains."""

    def hidden(t: Any, q: Any, v: Any, tau: Any) -> Any:
        softening = np.where(t < 0.35 * t[-1], 1.0, later)
        torque = torque_on_joint(0, lambda t, q, v, tau: 3.0 * softening * (q - 0.4) + 0.25 * np.sin(31 * t))
        return torque(t, q, v, tau)

    experiment = experiment_of(tmp_path, hidden)
    current = fitted(experiment, SPRING)
    entries = list(current.experiment.config.effects)
    without = [linearize_fit(with_effects(experiment, []), silent, current)]
    found = find_unproven(current, entries, without, silent)
    assert (found is not None) == unproven
    if found is not None:
        assert found.reason.startswith("it is not the same everywhere in the data (its stiffness is ")


def test_held_out_data_are_less_likely_with_what_is_not_there(tmp_path: Path) -> None:
    """A spring that ends with the training data costs much of the rest; one that lasts gains, none does neither."""

    def ending(t: Any, q: Any, v: Any, tau: Any) -> Any:
        return spring(t, q, v, tau) * (t < 0.69 * t[-1])

    for hidden, worsens in ((ending, True), (spring, False), (nothing, False)):
        experiment = experiment_of(tmp_path, hidden)
        before = fitted(experiment)
        after = linearize_fit(with_effects(experiment, [SPRING]), silent, before)
        assert lowers_held_out_likelihood(before, after) is worsens


@pytest.mark.parametrize(("share_of_torque", "worsens"), [(2e-3, False), (5e-3, True)])
def test_an_increase_that_is_negligible_beside_the_torque_does_not_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, share_of_torque: float, worsens: bool
) -> None:
    """By errors that are given here: that of the second joint is tiny without the effect, and grows manyfold."""
    before = fitted(experiment_of(tmp_path, nothing, rows=slice(4000)))
    after = linearize_fit(before.experiment, silent, before)
    increase = np.square(share_of_torque * before.rms_torque[1])

    def mean_squares(model: LinearizedFit, row_equation: Any) -> Array:
        return np.array([1.0, 1e-3 * increase if model is before else increase])

    monkeypatch.setattr(held_out_error, "held_out_mean_squares", mean_squares)
    assert lowers_held_out_likelihood(before, after) is worsens


@pytest.mark.parametrize(("after_everywhere", "worsens"), [(0.5, False), (0.97, True), (1.2, True), (np.nan, True)])
def test_a_play_may_cost_a_little_elsewhere_if_it_explains_the_data_where_it_acts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after_everywhere: float, worsens: bool
) -> None:
    """Squared errors that a model with a play may have where its torque is defined, and everywhere."""
    experiment = experiment_of(tmp_path, nothing, rows=slice(4000))
    before = fitted(experiment)
    after = linearize_fit(with_effects(experiment, [SPRING]), silent, before)

    def mean_squares(model: LinearizedFit, row_equation: Any) -> Array:
        if model is before:
            return np.array([1.0, np.nan])
        return np.array([1.02 if row_equation is after.experiment.equation else after_everywhere, np.nan])

    monkeypatch.setattr(held_out_error, "held_out_mean_squares", mean_squares)
    assert lowers_held_out_likelihood(before, after) is worsens


@pytest.mark.parametrize(
    ("size", "rest", "is_named"),
    [(2e-3, 0.0, True), (5e-4, 0.0, False), (2e-3, 1e-3, False)],
    ids=["leaves nothing", "negligible", "leaves something"],
)
def test_an_effect_of_a_thousandth_of_the_torque_is_named_if_it_leaves_nothing(
    tmp_path: Path, size: float, rest: float, is_named: bool
) -> None:
    """A stop that is reached now and then, and a rest that no stop explains, as shares of the torque."""
    _, q, _, tau = motion()
    rms_torque = np.sqrt(np.mean(tau[0] ** 2))
    beyond = np.maximum(q[0] - 0.9, 0.0)
    stiffness = size * rms_torque / np.sqrt(np.mean(beyond**2))

    def stop_and_rest(t: Array, q: Array, v: Array, tau: Array) -> Array:
        return stiffness * np.maximum(q - 0.9, 0.0) + rest * rms_torque * np.sign(np.sin(9 * t))

    base = linearize_fit(experiment_of(tmp_path, torque_on_joint(0, stop_and_rest)), silent)
    winner = find_best_effect(base, base, silent, ("end_stop",)).winner
    assert (winner is not None) is is_named
    if winner is not None:
        assert winner.trial.entries[-1].parameters["stiffness"] == pytest.approx(stiffness, rel=0.1)


@pytest.mark.parametrize(("size", "is_reported"), [(4e-3, False), (8e-3, True)])
def test_structure_counts_from_half_a_percent_of_the_torque(tmp_path: Path, size: float, is_reported: bool) -> None:
    """A torque that no effect has, as a share of the joint's torque, far above the noise."""
    _, _, _, tau = motion()
    rms_torque = np.sqrt(np.mean(tau[0] ** 2))

    def wave(t: Array, q: Array, v: Array, tau: Array) -> Array:
        return size * rms_torque * np.sqrt(2) * np.sin(9 * t)

    base = linearize_fit(experiment_of(tmp_path, torque_on_joint(0, wave)), silent)
    structure = residual_structure(base, 1.0, silent)
    assert (structure[0].score > 0) is is_reported
