"""diagnosis.json, its words, and `idtool diagnose` in the terminal; what is found is made up."""

from __future__ import annotations

import io
import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from commands import JOINTS, LEG, files, idtool, strict_json
from diagnoses import BEHIND, STRIBECK, candidate, diagnosis_of, faulty, fits, level, step_of, unknown_of
from rich.console import Console

from idtool.common.notice import Notice
from idtool.diagnosis.diagnose import _verdict
from idtool.diagnosis.records import Candidate, Diagnosis, DiagnosisStep, ErrorSummary
from idtool.diagnosis.words import distinguishing_experiment, fitted_along_sentence, step_sentence, with_doubts
from idtool.dynamics.effects import effect_name, effect_types
from idtool.estimation.fit import Fit
from idtool.reporting.diagnosis_report import diagnosis_report, gap_closed
from idtool.reporting.diagnosis_text import step_title
from idtool.reporting.results.diagnosis import DiagnosisReport
from idtool.reporting.sections.diagnosis import score_text
from idtool.reporting.terminal import Terminal
from idtool.reporting.terminal.diagnosis import show_diagnosis
from idtool.robot.config import EffectEntry

STEP = (
    *("effect", "joint", "link", "parameters", "standard_error", "where", "evidence"),
    *("validation_rms_before", "validation_rms_after", "alternatives"),
)


@pytest.fixture(scope="module")
def leg(tmp_path_factory: pytest.TempPathFactory) -> tuple[Fit, Fit]:
    return fits(tmp_path_factory.mktemp("leg"))


@pytest.fixture
def found(leg: tuple[Fit, Fit]) -> Diagnosis:
    """Stribeck friction on the hip."""
    return diagnosis_of(*leg, step_of())


def report_of(diagnosis: Diagnosis, inertia: str = "refit") -> dict[str, Any]:
    """The content of diagnosis.json, as a reader gets it."""
    report = diagnosis_report(diagnosis, inertia)
    read = strict_json(json.dumps(report.to_json(), allow_nan=False))
    assert DiagnosisReport.model_validate(read).to_json() == read  # it comes back as it was
    return dict(read)


def said(diagnosis: Diagnosis, explain: bool = False, color: bool = False) -> str:
    """What the terminal shows."""
    terminal, out = Terminal(quiet=False, as_json=False), io.StringIO()
    terminal.console = Console(
        file=out, width=250, highlight=False, force_terminal=color, color_system="standard" if color else None
    )
    show_diagnosis(
        terminal, diagnosis_report(diagnosis, "refit"), Path("out"), ("diagnosis.json", "diagnosis.html"), explain
    )
    return out.getvalue()


def test_the_report_has_the_documented_keys(found: Diagnosis) -> None:
    report = report_of(found)
    assert list(report)[:2] == ["idtool", "schema"]
    assert report["verdict"] == "explained"
    for part in ("before", "after"):
        assert set(report[part]) == {"train", "validation", "simulation"}
        assert all(set(rms) == {*JOINTS, "overall"} for rms in report[part].values())
    assert report["before"]["validation"]["hip"] == pytest.approx(1.43)
    assert report["after"]["simulation"]["hip"] == 0.012
    assert report["noise_floor"]["hip"] == 0.5
    assert report["data_faults"] == []
    (step,) = report["steps"]
    assert set(STEP) < set(step)
    assert (step["effect"], step["joint"], step["link"]) == ("stribeck_friction", "hip", None)
    assert step["parameters"] == {"stribeck": 1.9123, "velocity": 0.15}
    assert step["standard_error"] == {"stribeck": 0.2, "velocity": None}
    assert step["where"] == {"joints": ["hip"], "windows": [[1.25, 2.5], [4.0, 4.5]], "region": "below 0.15 rad/s"}
    assert (step["validation_rms_before"]["hip"], step["validation_rms_after"]["hip"]) == pytest.approx((1.43, 0.66))
    (rival,) = step["alternatives"]
    assert {"effect": "load_dependent_friction", "joint": "hip", "link": None, "score": 0.6}.items() <= rival.items()
    assert [one["reason"] for one in step["rejected"]] == ["within two standard errors of zero"]
    evidence = step["evidence"]
    assert (evidence["score"], evidence["standard_error"], evidence["significance"]) == (0.64, 0.03, 21.0)
    assert (evidence["simulation_before"]["hip"], evidence["simulation_after"]["hip"]) == (0.03, 0.012)
    assert evidence["sentence"] == step_of().sentence


def test_faults_and_what_is_unknown_are_there(found: Diagnosis) -> None:
    report = report_of(faulty(found))
    assert report["data_faults"] == [
        {"fault": "velocity_lag", "joint": "hip", "detail": f"{BEHIND}; {BEHIND}", "undone": False}
    ]
    last = report["steps"][-1]
    assert (last["effect"], last["joint"], last["parameters"]) == ("unknown", "knee", {})
    assert report["removed"] == [BEHIND]
    assert BEHIND in report["warnings"]
    assert len(set(report["warnings"])) == len(report["warnings"])


def test_arrays_and_what_is_not_finite_become_plain(found: Diagnosis) -> None:
    step = step_of(
        chosen=Candidate("payload", None, "shank_link", np.float64(0.5), np.float64(np.inf), 10),
        parameters={"mass": np.float64(0.4), "com": np.array([0.0, 0.1, 0.2]), "inertia": (1e-3, 0, 1e-3, 0, 0, 1e-3)},
        standard_error={"mass": 0.01, "com": np.array([0.1, np.nan, 0.2]), "inertia": None},
        significance=np.inf,
    )
    (written,) = report_of(replace(found, steps=(step,)))["steps"]
    assert written["parameters"]["com"] == [0.0, 0.1, 0.2]
    assert written["standard_error"] == {"mass": 0.01, "com": [0.1, None, 0.2], "inertia": None}
    assert written["evidence"]["standard_error"] is None
    assert written["evidence"]["significance"] is None
    assert written["units"] == {"mass": "kg", "com": "m", "inertia": "kg·m²"}


@pytest.mark.parametrize(
    ("effect", "joint", "parameters", "units"),
    [
        ("stribeck_friction", "hip", ("stribeck", "velocity"), ("N·m", "rad/s")),
        ("stribeck_friction", "knee", ("stribeck", "velocity"), ("N", "m/s")),
        ("encoder_offset", "hip", ("offset",), ("rad",)),
        ("torque_offset", "hip", ("offset",), ("N·m",)),
        ("torque_offset", "knee", ("offset",), ("N",)),
        ("rotor_inertia", "knee", ("inertia",), ("kg",)),
        ("torque_gain", "hip", ("gain",), (None,)),
        ("presliding_hysteresis", "hip", ("amplitude", "displacement", "damping"), ("N·m", "rad", "s")),
        ("torque_ripple", "hip", ("amplitude", "periods", "phase"), ("N·m", "per turn", "rad")),
        ("time_delay", None, ("delay",), ("s",)),
    ],
)
def test_units_are_those_of_the_joint(
    found: Diagnosis, effect: str, joint: str | None, parameters: tuple[str, ...], units: tuple[str | None, ...]
) -> None:
    report = report_of(sliding(found, effect, joint, dict.fromkeys(parameters, 0.5)))
    assert report["units"]["knee"] == "N"
    assert tuple(report["steps"][0]["units"].values()) == units
    assert "mixed N·m and N" in report["summary"]


def sliding(found: Diagnosis, effect: str, joint: str | None, parameters: dict[str, Any]) -> Diagnosis:
    """An effect on a leg whose knee slides."""
    step = step_of(chosen=candidate(effect, joint), parameters=parameters, standard_error={})
    model = found.last.experiment.model
    *others, knee = model.joints
    model = replace(model, joints=(*others, replace(knee, kind="prismatic")))
    last = replace(found.last, experiment=replace(found.last.experiment, model=model))
    return replace(found, last=last, steps=(step,))


@pytest.mark.parametrize(
    ("joint", "source", "unit"), [("hip", "knee", "m"), ("knee", "hip", "1/m"), ("hip", "abad", None)]
)
def test_a_coupling_of_unlike_joints_has_a_unit(found: Diagnosis, joint: str, source: str, unit: str | None) -> None:
    parameters = {"source": source, "coefficient": 0.1}
    (step,) = report_of(sliding(found, "transmission_coupling", joint, parameters))["steps"]
    assert step["parameters"] == parameters
    assert step["units"] == {"source": None, "coefficient": unit}


def test_the_share_of_the_gap_that_is_closed() -> None:
    before, floor = (
        {"a": 1.0, "b": 1.0, "c": 1.02, "d": 2.0, "e": 0.9},
        dict.fromkeys("abcde", 1.0) | {"a": 0.5, "b": 0.5},
    )
    after = {"a": 0.6, "b": 0.4, "c": 1.0, "d": 2.5, "e": 0.8}
    closed = gap_closed(before, after, floor)
    assert closed["a"] == pytest.approx(0.8)  # (1 − 0.6) / (1 − 0.5)
    assert closed["b"] == 1.0  # below the floor: all of it
    assert closed["c"] is None  # no gap to speak of
    assert closed["d"] == pytest.approx(-0.5)  # it has grown
    assert closed["e"] is None


def test_there_is_no_gap_where_model_and_data_do_not_disagree(leg: tuple[Fit, Fit]) -> None:
    report = report_of(diagnosis_of(*leg))
    assert set(report["gap_closed"].values()) == {None}
    assert "Model and data agree" in report["summary"]
    assert "nothing was added" in report["summary"]
    assert report["steps"] == []
    assert [text[:21] for text in report["next"]] == ["Check the final model"]
    assert report["verdict_reasons"][0]["level"] == "good"


@pytest.mark.parametrize(
    ("torque", "before", "after", "worse"),
    [
        (0.6, 0.03, 0.04, [*JOINTS, "overall"]),
        (0.6, 0.03, 0.0303, []),  # by one part in a hundred: no news
        (1.3, 0.03, 0.04, []),  # the torque is no better either
        (0.6, 0.03, np.inf, [*JOINTS, "overall"]),  # they ran away
        (0.6, np.nan, 0.04, []),  # they ran away before
        (0.6, None, None, []),
    ],
)
def test_rollouts_that_got_worse_while_torque_got_better(
    found: Diagnosis, torque: float, before: float | None, after: float | None, worse: list[str]
) -> None:
    levels = (level(0.2, 1.3, 0.4, simulated=before), level(0.2, torque, 0.4, simulated=after))
    step = step_of(before=levels[0], after=levels[1])
    diagnosis = replace(found, steps=(step,), before=levels[0], after=levels[1])
    report = report_of(diagnosis)
    assert report["steps"][0]["evidence"]["rollout_worse"] == report["rollout_worse"] == worse
    red = "\x1b[1;31m   the simulated motion gets worse at this step: hip 0.0300 → "
    assert (red in said(diagnosis, color=True)) == bool(worse)
    assert ("(worse)" in next(line for line in said(diagnosis).splitlines() if line.startswith("1 "))) == bool(worse)
    wanted = "The simulated motion gets worse with Stribeck friction on hip, and that of the final model is worse than"
    assert (wanted in report["summary"]) == bool(worse)
    motion = [reason["text"] for reason in report["verdict_reasons"] if reason["about"] == "motion"]
    assert motion[0].startswith("Do not simulate the model") == bool(worse)
    assert (wanted in motion[-1]) == bool(worse)
    assert ("it diverges" in motion[0]) == (bool(worse) and after == np.inf)
    levels = {reason["level"] for reason in report["verdict_reasons"] if reason["about"] == "motion"}
    assert not worse or levels == {"torque_only"}


def motion(**errors: float) -> ErrorSummary:
    """Errors of a model, with those of its simulated motion by name."""
    return replace(level(0.2, 0.6, 0.4), simulation={**dict.fromkeys((*JOINTS, "overall"), 0.03), **errors})


def test_a_step_with_worse_motion_is_told_apart_from_the_final_model(found: Diagnosis) -> None:
    """The motion of the joint that the effect acts on, or of all, counts; not that of another joint."""
    before = replace(motion(), validation=level(0.2, 1.3, 0.4).validation)
    worse = replace(motion(hip=0.05, overall=0.04), validation=level(0.2, 1.0, 0.4).validation)
    steps = (step_of(before=before, after=worse), step_of(before=worse, after=motion(overall=0.02)))
    diagnosis = replace(found, before=before, after=motion(overall=0.02), steps=steps)
    sentence = "the simulated motion gets worse at this step: hip 0.0300 → 0.0500 rad (final model: 0.0300 rad), "
    assert f"{sentence}all joints 0.0300 → 0.0400 rad (final model: 0.0200 rad)" in said(diagnosis)
    assert report_of(diagnosis)["summary"].endswith(
        "The simulated motion gets worse with Stribeck friction on hip, but that of the final model is better than "
        "that of the original one."
    )
    elsewhere = replace(
        found, before=before, after=motion(knee=0.05), steps=(step_of(before=before, after=motion(knee=0.05)),)
    )
    assert report_of(elsewhere)["steps"][0]["evidence"]["rollout_worse"] == ["knee"]
    assert "motion gets worse" not in said(elsewhere)


def test_a_step_has_its_picture_in_bins(found: Diagnosis) -> None:
    step, unknown = report_of(faulty(found))["steps"]
    assert unknown["profile"] is None
    profile = step["profile"]
    assert {"joint": "hip", "cause": "velocity", "cause_joint": "hip", "period": None}.items() <= profile.items()
    assert profile["values"] == [-1.0, -0.1, 0.1, 1.0]
    assert profile["before"] == {"mean": [0.1, -0.9, 0.9, -0.1], "deviation": [0.1, 0.3, 0.3, 0.1]}
    assert profile["effect_torque"] == [0.0, -1.2, 1.2, 0.0]


def test_without_held_out_data_the_training_error_stands_in(found: Diagnosis) -> None:
    def trained(of: ErrorSummary) -> ErrorSummary:
        return replace(of, validation=None)

    step = step_of(before=trained(found.before), after=trained(found.after))
    report = report_of(replace(found, before=step.before, after=step.after, steps=(step,)))
    assert report["before"]["validation"] is None
    assert report["steps"][0]["validation_rms_before"] == report["before"]["train"]
    assert report["gap_closed"]["hip"] == pytest.approx((1.3 - 0.6) / (1.3 - 0.5))
    assert "training torque error" in report["summary"]


def test_the_verdict_in_words(found: Diagnosis) -> None:
    text = report_of(found)["summary"]
    assert text.startswith(
        "The original model lacks Stribeck friction on hip (or load-dependent friction on hip): with this effect, "
    )
    assert "from 0.873 to 0.475 N·m RMS, which closes 82 % of the gap to the noise floor, 0.387 N·m." in text
    partly = report_of(faulty(found))["summary"]
    assert partly.endswith("No known effect explains the remaining residual on knee.")
    alone = replace(faulty(found), steps=faulty(found).steps[-1:], after=found.before, verdict="unexplained")
    text = report_of(alone)["summary"]
    assert text == (
        "Model and data disagree, and no known effect explains the difference on knee: the held-out torque error is "
        "0.873 N·m RMS, and the noise floor is 0.387 N·m."
    )


def test_nobody_is_told_of_a_difference_between_equal_figures(found: Diagnosis) -> None:
    floor = dict(found.before.torque)
    alone = replace(faulty(found), steps=faulty(found).steps[-1:], after=found.before, floor=floor)
    assert report_of(replace(alone, verdict="unexplained"))["summary"] == (
        "The held-out torque error, 0.873 N·m RMS, is at the noise floor, but no known effect explains the structure "
        "of the residual on knee."
    )


def test_the_verdict_is_the_worst_of_its_reasons(found: Diagnosis) -> None:
    report = report_of(found)
    effects, *others = report["verdict_reasons"]
    assert (effects["about"], effects["level"], effects["text"]) == ("effects", "good", report["summary"])
    assert effects["figure"] == report["gap_closed"]["overall"]
    assert [reason["about"] for reason in others] == ["torque", "motion", "bodies"]
    lines = said(found).splitlines()
    assert lines[0].startswith("Verdict: ")
    assert lines[1] == f"✓ effects: {report['summary']}"
    partly = report_of(replace(faulty(found), verdict="partly_explained"))
    about = [(reason["about"], reason["level"]) for reason in partly["verdict_reasons"]]
    assert about[:3] == [("data", "do_not_use"), *[("effects", "torque_only")] * 2]
    assert partly["model_verdict"] != "good"


def test_a_problem_of_the_data_is_said_once(found: Diagnosis) -> None:
    wrong = Notice("wrong_sign", "problem", "hip", "v has the wrong sign", "set its scale to -1")
    diagnosis = replace(found, faults=(wrong,))
    assert report_of(diagnosis)["model_verdict"] == "do_not_use"
    assert said(diagnosis).count("v has the wrong sign") == 1
    assert "\n✗ data: hip: v has the wrong sign; set its scale to -1.\n" in said(diagnosis)


def test_a_doubt_is_said_and_told_apart(found: Diagnosis) -> None:
    """Payloads that together outweigh what moves, about 2.3 kg; lighter ones are in no doubt."""
    model = found.last.experiment.model
    moving = sum(body.pi[0] for body in model.bodies)

    def loaded(share: float) -> list[DiagnosisStep]:
        links = ("thigh_link", "shank_link")
        loads = [replace(candidate("payload", None), link=link) for link in links]
        parameters = {"mass": share * moving / 2, "com": [0.0] * 3, "inertia": [0.0] * 6}
        return [step_of(chosen=load, parameters=parameters) for load in loads]

    assert with_doubts(loaded(0.99), model) == loaded(0.99)
    assert _verdict(loaded(0.99), is_floor_known=True, is_complete=True) == "explained"
    steps = with_doubts([*loaded(1.01), step_of()], model)
    assert [bool(step.doubt) for step in steps] == [True, True, False]
    masses = f"{1.01 * moving:.3g} kg, is heavier than all bodies of the model, {moving:.2f} kg"
    assert f"the payload on thigh_link and shank_link, {masses}" in steps[0].doubt
    assert _verdict(steps, is_floor_known=True, is_complete=True) == "partly_explained"
    report = report_of(replace(found, steps=tuple(steps[:1]), verdict="partly_explained"))
    assert report["steps"][0]["evidence"]["doubt"] == steps[0].doubt
    assert report["summary"].startswith("The original model may lack a payload on thigh_link")
    certain_too = report_of(replace(found, steps=(steps[0], steps[2]), verdict="partly_explained"))
    assert certain_too["summary"].startswith("The original model lacks a payload on thigh_link")
    assert report["summary"].endswith(" N·m. Doubtful: a payload on thigh_link; the notices give the reasons.")


def test_nobody_is_told_to_correct_what_only_a_new_log_can(found: Diagnosis) -> None:
    jitter = Notice("time_jitter", "warning", None, "the time stamps are uneven")
    stale = Notice("stale", "warning", None, "samples repeat the previous one in every joint")
    step = step_of(pair=False, alternatives=())
    (text,) = report_of(replace(found, faults=(jitter, stale), steps=(step,)))["next"]
    assert not text.startswith("First correct")
    frozen = replace(stale, subject="hip")
    assert report_of(replace(found, faults=(frozen,), steps=(step,)))["next"][0].startswith("First correct")


def test_what_to_do_next(found: Diagnosis) -> None:
    first, second, third = report_of(faulty(found))["next"]
    assert first.startswith("First correct the data")
    wanted = "To distinguish Stribeck friction on hip from load-dependent friction on hip: slow strokes of the hip"
    assert second.startswith(wanted)
    assert third == "To find out what remains on knee, see the residual maps in diagnosis.html."
    (text,) = report_of(replace(found, steps=(step_of(pair=False, alternatives=()),)))["next"]
    model = "`idtool validate OUT/identified.urdf LOG --config OUT/model.yaml`."
    assert text == f"Check the final model on a log that was not used here: {model}"


def test_the_terminal_gives_the_verdict_then_a_line_a_step(found: Diagnosis) -> None:
    lines = said(found).splitlines()
    assert lines[1].startswith("✓ effects: The original model lacks Stribeck friction on hip")
    (row,) = [line for line in lines if line.startswith("1 ")]
    for cell in ("Stribeck friction", "hip", "stribeck 1.91 ± 0.20 N·m, velocity 0.150 rad/s", "0.873 → 0.475"):
        assert cell in row
    for cell in ("0.0300 → 0.0120", "64.0 ± 3.0 %", "21", "load-dependent friction on hip"):
        assert cell in row
    assert "1. Stribeck friction on hip. Friction rises below 0.15 rad/s" in lines
    (hip,) = [line.split() for line in lines if line.startswith("hip ")]
    assert hip == ["hip", "1.43", "0.660", "0.500", "83", "%", "0.0300", "0.0120"]
    assert "reason" not in said(found)
    assert "within two standard errors of zero" in said(found, explain=True)
    assert lines[-1] == "written: out/diagnosis.json, diagnosis.html"


def test_the_terminal_says_faults_before_the_steps_and_shows_names_as_they_are(found: Diagnosis) -> None:
    step = step_of(chosen=candidate("stribeck_friction", "[bold]hip[/bold]"), entry=STRIBECK)
    text = said(faulty(replace(found, steps=(step,))))
    assert text.index(BEHIND) < text.index("effects: The original model lacks") < text.index("Effects that the model")
    assert "[bold]hip[/bold]" in next(line for line in text.splitlines() if line.startswith("1 "))
    assert f"\n{BEHIND}\n" in text
    assert f"warning: {BEHIND}" in text
    assert "3. " not in text


@dataclass(frozen=True)
class Asked:
    """What `idtool diagnose` asked for."""

    inertia: str
    effects: tuple[str, ...] | None
    most: int
    assumed: tuple[tuple[str, str | None], ...]
    simulated: bool
    budget: float | None


@pytest.fixture
def asked(found: Diagnosis, monkeypatch: pytest.MonkeyPatch) -> list[Asked]:
    """The command with a made-up diagnosis in place of a real one."""
    options: list[Asked] = []

    def diagnose(experiment: Any, given: Asked, progress: Any) -> Diagnosis:
        options.append(given)
        return found

    monkeypatch.setitem(sys.modules, "idtool.diagnosis.diagnose", SimpleNamespace(Options=Asked, diagnose=diagnose))
    return options


def test_the_command_that_distinguishes_two_effects_has_the_real_paths(found: Diagnosis) -> None:
    experiment = found.last.experiment
    pair = (candidate("stribeck_friction"), candidate("load_dependent_friction", joint="knee joint"))
    (log,) = [str(run.signals.log.path) for run in experiment.runs if run.train]
    assert distinguishing_experiment(*pair, experiment).endswith(
        f"; or design the motion: `idtool excite {LEG} --config {LEG.with_suffix('.yaml')} --log {log} "
        "--decide stribeck_friction:hip 'load_dependent_friction:knee joint'`"
    )


def test_one_motion_that_distinguishes_two_effects_is_named_once(found: Diagnosis) -> None:
    pair = (replace(candidate("payload", joint=None), link=link) for link in ("thigh", "shank"))
    text = distinguishing_experiment(*pair, found.last.experiment)
    assert text.startswith("log quick and slow motion in many postures (payload); or")


@pytest.mark.parametrize("report_only", [False, True])
def test_the_next_command_has_the_folder_that_the_model_was_written_to(
    tmp_path: Path, asked: list[Asked], found: Diagnosis, monkeypatch: pytest.MonkeyPatch, report_only: bool
) -> None:
    done = replace(found, steps=(step_of(pair=False, alternatives=()),))
    instead = SimpleNamespace(Options=Asked, diagnose=lambda *_: done)
    monkeypatch.setitem(sys.modules, "idtool.diagnosis.diagnose", instead)
    options = ["--report-only"] if report_only else []
    run = idtool("diagnose", LEG, LOG, "--out", "my out", "--json", *options, folder=tmp_path)
    model = "'my out/identified.urdf' LOG --config 'my out/model.yaml'"
    if report_only:
        model = "OUT/identified.urdf LOG --config OUT/model.yaml"
    (text,) = run.json["next"]
    assert text.endswith(f": `idtool validate {model}`.")
    assert f"next: {text}" in run.err
    assert json.loads((tmp_path / "my out" / "diagnosis.json").read_text())["next"] == [text]


LOG = LEG.with_name("leg_train.mcap")
EFFECTS = ", ".join(id for id, kind in effect_types().items() if kind.reportable)


def test_the_command_writes_its_files_and_its_report_alone_to_standard_output(
    tmp_path: Path, asked: list[Asked]
) -> None:
    done = idtool("diagnose", LEG, LOG, "--out", tmp_path / "out", "--json")
    assert done.code == 0
    assert set(files(tmp_path / "out")) == {"diagnosis.json", "diagnosis.html", "model.yaml", "identified.urdf"}
    assert strict_json((tmp_path / "out" / "diagnosis.json").read_text()) == done.json
    assert "The original model lacks Stribeck friction on hip" in done.err
    assert asked == [Asked("refit", None, 12, (), True, None)]
    entry, late = yaml.safe_load((tmp_path / "out" / "model.yaml").read_text())["effects"]
    assert (entry["effect"], entry["joint"]) == ("stribeck_friction", "hip")
    assert set(entry["parameters"]["stribeck"]) == {"value", "standard_error"}
    assert late == {"effect": "time_delay", "parameters": {"delay": 0.005}}
    again = idtool(
        "validate", tmp_path / "out" / "identified.urdf", LOG, "--out", tmp_path, "--no-simulation", "--json"
    )
    assert again.code == 0  # the model is one that the other commands read


def test_the_commands_options(tmp_path: Path, asked: list[Asked]) -> None:
    options = ["--inertia", "fixed", "--effects", "torque_ripple, end_stop", "--max-effects", "2", "--no-simulation"]
    options += ["--assume", "time_delay", "--assume", "end_stop:knee", "--assume", "payload:shank_link"]
    options += ["--budget", "90"]
    done = idtool("diagnose", LEG, LOG, *options, "--report-only", "--quiet", "--explain", "--out", tmp_path)
    assert (done.code, done.out, done.err) == (0, "", "")
    assert set(files(tmp_path)) == {"diagnosis.json", "diagnosis.html"}
    assumed = (("time_delay", None), ("end_stop", "knee"), ("payload", "shank_link"))
    assert asked == [Asked("fixed", ("torque_ripple", "end_stop"), 2, assumed, False, 90.0)]


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (
            ["--effects", "torque_ripple,stribek"],
            "--effects: stribek is not an effect; did you mean stribeck_friction?",
        ),
        (["--effects", ""], "--effects: an empty name is not an effect; available: "),
        (["--effects", "unknown"], "--effects: unknown is not an effect; "),
        (["--assume", "endstop:knee"], "--assume: endstop is not an effect; did you mean end_stop?"),
        (["--assume", "end_stop:kne"], "--assume: kne is not a joint of the model; did you mean knee?"),
        (["--assume", "end_stop"], "--assume: end_stop acts on a joint; give end_stop:JOINT"),
        (["--assume", "payload:knee"], "--assume: knee is not a link of the model; "),
        (["--max-effects", "0"], "command: invalid value for '--max-effects'"),
        (["--inertia", "free"], "command: invalid value for '--inertia'"),
    ],
)
def test_options_that_cannot_be(tmp_path: Path, asked: list[Asked], options: list[str], error: str) -> None:
    done = idtool("diagnose", LEG, LOG, *options, folder=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith(f"error: {error}")
    assert done.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == asked == []


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--effects", "noise"], f"--effects: noise is not an effect; available: {EFFECTS}\n"),
        (
            ["--effects", "end_stop backlash"],
            "give effects alone, separated by commas, as in --effects end_stop,backlash;",
        ),
        (["--effects", "end_stop:knee"], "--assume takes an effect on a joint; did you mean end_stop? available: back"),
        (["--assume", "endstop:knee"], f"did you mean end_stop? available: {EFFECTS}\n"),
        (["--assume", "knee:end_stop"], "--assume: knee is not an effect; give end_stop:knee; "),
        (["--assume", "end_stop=knee"], "--assume: end_stop=knee is not an effect; give end_stop:knee; "),
        (["--assume", "end_stop:kne"], "did you mean knee? available: abad, hip, knee\n"),
        (["--assume", "end_stop"], "end_stop acts on a joint; give end_stop:JOINT; available: abad, hip, knee\n"),
        (["--assume", "gravity_tilt:hip"], "--assume: gravity_tilt acts on the whole robot; give gravity_tilt without"),
        (["--assume", "time_delay:kne"], "--assume: kne is not a joint of the model; did you mean knee? available: "),
        (["--effects", "rounded_friction"], "--effects: rounded_friction is always included in the fit"),
    ],
)
def test_names_that_are_possible_are_listed(tmp_path: Path, asked: list[Asked], options: list[str], told: str) -> None:
    done = idtool("diagnose", LEG, LOG, *options, folder=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert told in done.err
    assert done.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == asked == []


def test_nothing_is_written_where_a_file_cannot_be(tmp_path: Path, asked: list[Asked]) -> None:
    (tmp_path / "model.yaml").mkdir()
    (tmp_path / "diagnosis.json").write_text("the former one")
    done = idtool("diagnose", LEG, LOG, "--out", tmp_path)
    assert done.code == 2
    assert files(tmp_path) == {"diagnosis.json": b"the former one"}


@pytest.mark.parametrize(("effect", "owner"), [("gravity_tilt", "the base"), ("time_delay", "all joints")])
def test_a_title_names_what_an_effect_on_the_whole_robot_acts_on(found: Diagnosis, effect: str, owner: str) -> None:
    step = replace(step_of(), chosen=candidate(effect, joint=None))
    (report,) = diagnosis_report(replace(found, steps=(step,)), "refit").steps
    assert step_title(report) == f"{effect_name(effect).capitalize()} on {owner}"


def test_a_sentence_has_units_and_no_ids(found: Diagnosis) -> None:
    errors = {"stribeck": 0.0032, "velocity": 0.0012}
    step = step_of(parameters={"stribeck": 0.19531, "velocity": 0.11742}, standard_error=errors)
    sentence = step_sentence(step, found.last.experiment.model)
    assert sentence.startswith(
        "Friction increases towards low speed (stribeck 0.195 ± 0.003 N·m, velocity 0.117 ± 0.001 rad/s). "
        "The residual was concentrated below 0.15 rad/s. The held-out torque error of hip changes from "
        "1.43 to 0.660 N·m RMS"
    )
    spring = EffectEntry(effect="parallel_spring", joint="hip", parameters={"stiffness": 0.0, "rest_position": -0.29})
    assert fitted_along_sentence(spring, found.last.experiment.model).startswith(
        "a spring acts across the joint (stiffness 0 N·m/rad, rest position -0.290 rad); "
    )
    for candidates in ((step.chosen, candidate("presliding_hysteresis")),):
        motion = distinguishing_experiment(*candidates, found.last.experiment).partition("; or")[0]
        assert "(Stribeck friction)" in motion
        assert "(presliding hysteresis)" in motion


def test_the_only_effect_searched_for_is_named(found: Diagnosis) -> None:
    left = replace(found, steps=(unknown_of(found.before),), searched=("quadratic_drag",), verdict="unexplained")
    report = diagnosis_report(left, "refit")
    clause = "the only effect searched for, quadratic drag, does not explain the "
    assert f"and {clause}difference on knee: " in report.summary


@pytest.mark.parametrize(
    ("score", "error", "text"),
    [
        (0.64, 0.03, "64.0 ± 3.0 %"),
        (1.0, 0.21, "100 ± 21 %"),
        (-0.0002, 0.0003, "0 %"),
        (-0.0002, 0.02, "0.0 ± 2.0 %"),
        (-0.0001, None, "0 %"),
    ],
)
def test_a_score_is_never_minus_zero(score: float, error: float | None, text: str) -> None:
    assert score_text(score, error) == text
