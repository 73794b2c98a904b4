"""Candidates that fail: a diagnosis goes on without them, names them, and keeps what else was found."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import LEG, csv_text, idtool, sample_table
from diagnosis_stages import STAGES, completed_search, copy_of_search
from disturbed import experiment_of, silent, torque_on_joint
from numpy.typing import NDArray
from sentences import sentences

from idtool.common.exceptions import ConfigError, SolverError
from idtool.common.notice import Notice
from idtool.data.signals import Motion
from idtool.diagnosis import diagnose as module
from idtool.diagnosis import effect_order, effect_replacement, effect_search, extended_model, reversal_rows
from idtool.diagnosis.diagnose import Options, diagnose
from idtool.diagnosis.effect_order import StepFits
from idtool.diagnosis.effect_search import EffectSearch
from idtool.diagnosis.extended_model import AddedEffect, ExtendedModel
from idtool.diagnosis.records import Diagnosis
from idtool.dynamics.effects.parallel_spring import ParallelSpring
from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.fit import Fit
from idtool.reporting.diagnosis_report import diagnosis_report
from idtool.reporting.diagnosis_text import summary
from idtool.robot.config import EffectEntry

EFFECTS = ("parallel_spring", "torque_offset")
SPRING, OFFSET = ("parallel_spring", "j1"), ("torque_offset", "j2")
REASON = "was not solved, as this test wants it"
NOTE = "parallel spring on j1 cannot be fitted together with the rest of the model: "


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    """An arm with a spring on its first joint and an offset on its second."""

    def hidden(t: Any, q: Any, v: Any, tau: Any) -> Any:
        spring, offset = (
            torque_on_joint(0, lambda t, q, v, tau: 3.0 * (q - 0.4)),
            torque_on_joint(1, lambda t, q, v, tau: 0.5 + 0 * t),
        )
        return spring(t, q, v, tau) + offset(t, q, v, tau)

    return experiment_of(tmp_path_factory.mktemp("arm"), hidden, rows=slice(8000))


def diagnosed(experiment: Experiment) -> Diagnosis:
    return diagnose(experiment, Options(effects=EFFECTS, simulate=False), silent)


def named(found: Diagnosis) -> set[tuple[str, str]]:
    return {(step.chosen.effect, step.chosen.target) for step in found.steps if step.entry is not None}


def refuse_springs(entries: Iterable[EffectEntry]) -> None:
    if any(entry.effect == ParallelSpring.id for entry in entries):
        raise SolverError("solver", REASON)


def test_both_are_found_where_nothing_fails(arm: Experiment) -> None:
    found = diagnosed(arm)
    assert named(found) == {SPRING, OFFSET}
    assert found.verdict == "explained"
    assert not any("cannot be fitted" in warning for warning in sentences(found.notices))


def without_spring(found: Diagnosis, reason: str) -> None:
    """The offset was found, the spring's failure is named, and what it leaves is unknown."""
    assert OFFSET in named(found)
    assert SPRING not in named(found)
    assert any(warning.startswith(NOTE + reason) for warning in sentences(found.notices))
    assert found.verdict == "partly_explained"
    assert found.after.validation is not None
    assert found.before.validation is not None
    assert found.after.validation["j2"] < 0.5 * found.before.validation["j2"]


def test_an_effect_that_the_motion_does_not_tell_is_skipped(arm: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    def invalid_mask(self: ParallelSpring, motion: Motion) -> dict[int, NDArray[np.bool_]]:
        return {int(self.joint): np.ones(len(motion.t), dtype=bool)}

    monkeypatch.setattr(ParallelSpring, "invalid_mask", invalid_mask)
    without_spring(diagnosed(arm), "at joint j1, all effects are defined in only 0 of ")


def test_an_effect_that_fails_once_it_was_chosen_is_skipped(arm: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    inner = extended_model.fit_trial

    def fit_trial(base: Any, entries: Any, *others: Any) -> Any:
        refuse_springs(entries)
        return inner(base, entries, *others)

    monkeypatch.setattr(extended_model, "fit_trial", fit_trial)
    without_spring(diagnosed(arm), REASON)
    search = EffectSearch(arm, EFFECTS, 3, silent)
    with pytest.raises(ConfigError, match="parallel_spring:j1 cannot be fitted together"):
        search.assume(*SPRING)
    search.assume(*OFFSET)
    assert [one.chosen.effect for one in search.added] == ["torque_offset"]


def test_an_effect_that_only_the_last_fit_cannot_have_is_left_out(
    arm: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    inner = effect_order.fit

    def fit(experiment: Experiment, *others: Any) -> Any:
        refuse_springs(experiment.config.effects)
        return inner(experiment, *others)

    monkeypatch.setattr(effect_order, "fit", fit)
    found = diagnosed(arm)
    assert SPRING not in named(found)
    assert any(warning.startswith(NOTE + REASON) for warning in sentences(found.notices))


def test_a_step_whose_own_model_cannot_be_fitted_has_the_errors_of_the_whole(
    arm: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    inner = StepFits.of

    def of(fits: StepFits, effects: Sequence[AddedEffect]) -> Fit:
        if len(effects) == 1:
            raise np.linalg.LinAlgError("Singular matrix")
        return inner(fits, effects)

    monkeypatch.setattr(StepFits, "of", of)
    found = diagnosed(arm)
    assert named(found) == {SPRING, OFFSET}
    for step in found.steps:
        assert step.after.validation == pytest.approx(found.after.validation)


def test_an_effect_without_which_the_rest_cannot_be_fitted_stays(
    arm: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The spring pays no more, but taking it out fails."""
    search = EffectSearch(arm, EFFECTS, 3, silent)
    for effect, joint in (SPRING, OFFSET):
        search.assume(effect, joint)
    inner, before = effect_search.linearize_fit, search.current

    def linearize_fit(experiment: Experiment, *others: Any, **options: Any) -> Any:
        if not any(entry.effect == ParallelSpring.id for entry in experiment.config.effects):
            raise ConfigError("effects", REASON)
        return inner(experiment, *others, **options)

    for part in (effect_search, extended_model):
        monkeypatch.setattr(part, "linearize_fit", linearize_fit)
    search._prune()
    assert search.current is before
    monkeypatch.setattr(EffectSearch, "_is_needed", lambda self, one, others: False)
    search._prune()
    assert [one.chosen.effect for one in search.added] == ["parallel_spring", "torque_offset"]
    assert search.current is before
    assert not search.removed


def test_bodies_that_cannot_be_are_fixed_as_they_stand(tmp_path: Path) -> None:
    """Whose inertia is zero, say: no prior has a say where the URDF's parameters are taken as known."""
    nothing = '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
    urdf = tmp_path / "leg.urdf"
    urdf.write_text(re.sub(r"<inertia [^>]*/>", nothing, LEG.read_text()))
    shutil.copy(LEG.with_suffix(".yaml"), tmp_path)
    log = tmp_path / "log.csv"
    log.write_text(csv_text(sample_table(3000)))
    options = ("--inertia", "fixed", "--effects", "torque_offset", "--no-simulation", "--quiet")
    assert idtool("diagnose", urdf, log, *options, "--out", tmp_path / "out").code == 0


@pytest.fixture(scope="module")
def search(arm: Experiment) -> EffectSearch:
    """A search that ended with both effects."""
    return completed_search(lambda: diagnosed(arm))


STAGE_FAILURES: list[tuple[str, BaseException]] = [
    *((stage, ValueError("as this test wants it")) for stage in STAGES),
    *((stage, KeyboardInterrupt()) for stage in STAGES),
    ("residual_structure", np.linalg.LinAlgError()),
]


@pytest.mark.parametrize(("stage", "failure"), STAGE_FAILURES)
def test_a_stage_that_fails_is_skipped_and_named(
    arm: Experiment, search: EffectSearch, monkeypatch: pytest.MonkeyPatch, stage: str, failure: BaseException
) -> None:
    def fail(*arguments: Any, **options: Any) -> Any:
        monkeypatch.undo()  # Ctrl-C comes once
        raise failure

    monkeypatch.setattr(module, "EffectSearch", lambda *arguments: copy_of_search(search))
    monkeypatch.setattr(module, stage, fail)
    found = diagnosed(arm)
    assert named(found) == {SPRING, OFFSET}
    assert not found.stopped
    is_floor_known = stage not in ("residual_structure", "structured_noise_floor")
    if isinstance(failure, ValueError):
        assert found.is_floor_known == is_floor_known
    if not is_floor_known:  # nothing is known of what remains
        assert found.verdict == "partly_explained"
    skipped = [notice.message for notice in found.notices if notice.code == "stage_skipped"]
    if stage != "localize_unexplained":  # nothing remains to be located
        assert skipped
        reason = "the diagnosis was interrupted" if isinstance(failure, KeyboardInterrupt) else "its "
        assert re.search(f" (was|were) skipped: {reason}", skipped[0])


@pytest.mark.parametrize("failure", [ValueError("as this test wants it"), KeyboardInterrupt()])
@pytest.mark.parametrize("effects", [0, 2])
def test_effects_stay_where_the_simulation_fails(
    arm: Experiment, search: EffectSearch, monkeypatch: pytest.MonkeyPatch, effects: int, failure: BaseException
) -> None:
    """That of the model without effects, or that of the last one."""
    inner = module.simulate_fit

    def simulate_fit(fitted: Any, progress: Any) -> Any:
        if len(fitted.experiment.config.effects) == effects:
            raise failure
        return inner(fitted, progress)

    monkeypatch.setattr(module, "EffectSearch", lambda *arguments: copy_of_search(search))
    monkeypatch.setattr(module, "simulate_fit", simulate_fit)
    found = diagnose(arm, Options(effects=EFFECTS), silent)
    assert named(found) == {SPRING, OFFSET}
    assert found.last.simulation is None
    assert re.search("the simulation.* skipped: ", " ".join(sentences(found.notices)))


def test_a_search_whose_last_fit_fails_keeps_what_it_found(arm: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every time, so that it cannot be made up for."""

    def fail(model: ExtendedModel) -> None:
        model.current = search.initial
        raise SolverError("solver", REASON)

    monkeypatch.setattr(ExtendedModel, "settle", fail)
    search = EffectSearch(arm, EFFECTS, 3, silent)
    search.run()
    assert {(one.chosen.effect, one.chosen.target) for one in search.added} == {SPRING, OFFSET}
    assert REASON in search.stopped
    assert len(search.current.experiment.config.effects) >= 2


def test_a_removal_that_ctrl_c_interrupts_did_not_happen(arm: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    search = EffectSearch(arm, EFFECTS, 3, silent)
    search.assume(*OFFSET)
    before = search.current

    def interrupted(model: ExtendedModel) -> None:
        model.current = search.initial
        raise KeyboardInterrupt

    monkeypatch.setattr(ExtendedModel, "_refit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        search.remove(search.added[0], REASON)
    assert search.current is before
    assert [one.chosen.effect for one in search.added] == ["torque_offset"]
    assert not search.removed


@pytest.mark.parametrize("calls", [1, 3, 6, 10])
def test_what_was_found_before_ctrl_c_is_reported(arm: Experiment, monkeypatch: pytest.MonkeyPatch, calls: int) -> None:
    """At the n-th fit of the search; the model that is reported is complete."""
    inner, count = effect_search.linearize_fit, [0]

    def linearize_fit(*arguments: Any, **options: Any) -> Any:
        count[0] += 1
        if count[0] == calls + 2:  # the first two are the model without effects
            raise KeyboardInterrupt
        return inner(*arguments, **options)

    for part in (effect_search, effect_replacement, extended_model, reversal_rows):
        monkeypatch.setattr(part, "linearize_fit", linearize_fit)
    found = diagnosed(arm)
    assert named(found) <= {SPRING, OFFSET}
    assert found.after.validation is not None
    interrupted = [notice for notice in found.notices if notice.code == "search_interrupted"]
    assert len(interrupted) == (count[0] >= calls + 2)


def test_ctrl_c_at_the_time_limit_ends_the_search_once(arm: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    search = EffectSearch(arm, EFFECTS, 3, silent, budget=0.0)

    def interrupt(self: EffectSearch) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(EffectSearch, "_run", interrupt)
    monkeypatch.setattr(ExtendedModel, "settle", lambda model: search.progress("fitting", 0.0))
    search.run()
    assert search.is_interrupted
    assert search.stopped == "the search was interrupted"


def test_a_budget_ends_the_search(arm: Experiment) -> None:
    found = diagnose(arm, Options(effects=EFFECTS, simulate=False, budget=0.0), silent)
    assert named(found) == set()
    (notice,) = [notice for notice in found.notices if notice.code == "search_interrupted"]
    assert notice.message == "the search reached its time limit; no effect had been found by then"
    assert notice.advice == "allow it more time with a larger --budget"
    assert found.stopped == "the search reached its time limit"
    words = summary(diagnosis_report(found, "refit"))
    assert words.startswith("No effect was found: ")
    assert "The diagnosis is incomplete: the search reached its time limit" in words
    assert diagnose(arm, Options(effects=EFFECTS, simulate=False, budget=1e6), silent).verdict == "explained"


def test_a_limited_number_of_effects_is_not_all_that_is_known(arm: Experiment) -> None:
    found = diagnose(arm, Options(effects=EFFECTS, simulate=False, max_effects=1), silent)
    assert len(named(found)) == 1
    assert found.verdict == "partly_explained"
    assert found.stopped == "the search ended at --max-effects 1"
    (notice,) = [notice for notice in found.notices if notice.code == "search_interrupted"]
    assert notice.advice == "allow more effects"
    assert "The diagnosis is incomplete: the search ended at --max-effects 1" in summary(
        diagnosis_report(found, "refit")
    )
    everything = diagnose(arm, Options(effects=EFFECTS, simulate=False, max_effects=2), silent)
    assert (everything.verdict, everything.stopped) == ("explained", "")


def test_after_ctrl_c_no_other_reason_is_given(arm: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(search: EffectSearch) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(EffectSearch, "_run", interrupt)
    found = diagnosed(arm)
    codes = [notice.code for notice in found.notices]
    assert codes.count("stage_skipped") == 1
    assert "noise_floor_unknown" not in codes


@pytest.mark.parametrize("assumed", [(), (SPRING,), (SPRING, OFFSET)])
def test_a_search_that_failed_is_not_to_be_run_again(
    arm: Experiment, monkeypatch: pytest.MonkeyPatch, assumed: tuple[tuple[str, str], ...]
) -> None:
    def fail(search: EffectSearch) -> None:
        raise SolverError("solver", "gave up")

    monkeypatch.setattr(EffectSearch, "_run", fail)
    found = diagnose(arm, Options(effects=EFFECTS, simulate=False, assumed=assumed), silent)
    (notice,) = [notice for notice in found.notices if notice.code == "search_interrupted"]
    reported = (
        "no effect had been found by then",
        "the effect found by then is reported",
        "the effects found by then are",
    )
    assert notice.message.startswith(f"the search ended early: gave up; {reported[len(assumed)]}")
    assert notice.advice.startswith("correct the faults of the data, or search for fewer effects")


def test_a_search_for_some_effects_says_nothing_of_others(arm: Experiment) -> None:
    found = diagnose(arm, Options(effects=("payload",), simulate=False), silent)
    assert found.verdict == "unexplained"
    report = diagnosis_report(found, "refit")
    assert "the only effect searched for, payload, does not explain the difference on j1 and j2" in report.summary
    assert report.next[0].startswith("To find out what remains on j1 and j2, see ")
    two = replace(found, searched=("payload", "end_stop"))
    assert "none of the effects searched for explains" in diagnosis_report(two, "refit").summary


def test_effects_beside_a_fault_of_the_data_are_doubtful(arm: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    fault = Notice("wrong_sign", "problem", "j1", "as this test wants it")
    monkeypatch.setattr(module, "find_data_faults", lambda *arguments: (fault,))
    found = diagnosed(arm)
    assert named(found) == {SPRING, OFFSET}
    assert found.verdict == "partly_explained"
    for step in found.steps:
        assert step.doubt.endswith("may imitate a fault of the data: wrong sign on j1")


def test_a_probe_that_fails_is_named_and_hides_no_other(arm: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    inner = ParallelSpring.probe

    def probe(summary: Any, joint: int, nonlinear_values: Any) -> Any:
        def columns(motion: Motion, linearized: Any) -> Any:
            raise ValueError(REASON)

        return replace(inner(summary, joint, nonlinear_values), columns=columns, column_key=None)

    monkeypatch.setattr(ParallelSpring, "probe", probe)
    without_spring(diagnosed(arm), "its evaluation failed (ValueError)")


def test_an_effect_whose_hypotheses_fail_is_named(arm: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    def probes(summary: Any) -> Any:
        raise RuntimeError(REASON)

    monkeypatch.setattr(ParallelSpring, "probes", probes)
    found = diagnosed(arm)
    assert OFFSET in named(found)
    assert any("parallel spring" in warning and "RuntimeError" in warning for warning in sentences(found.notices))
