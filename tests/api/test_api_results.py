"""The functions beside the commands: the same results and files, read-only, printed and drawn for people."""

from __future__ import annotations

import pickle
import shlex
from collections.abc import Mapping
from dataclasses import FrozenInstanceError
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import (
    FIT_FILES,
    JOINTS,
    LEG,
    TRAIN,
    VALIDATE,
    VALIDATION_FILES,
    config_with,
    csv_text,
    files,
    sample_table,
)
from commands import idtool as run
from descriptions import described
from diagnoses import diagnosis_of, fits, step_of, unknown_of
from pages import Page
from pydantic import ValidationError
from recordings import State, ros2, write_mcap

import idtool
from idtool.api.model import Model
from idtool.common.number_text import number, short_number
from idtool.diagnosis.records import Diagnosis
from idtool.robot.config import read_config

CONTROLLER = {"kp": dict.fromkeys(JOINTS, 50.0), "kd": dict.fromkeys(JOINTS, 2.0)}


def timeless(report: Mapping[str, Any]) -> dict[str, Any]:
    """A report without the times that its making took."""
    kept = {key: value for key, value in report.items() if key not in ("seconds", "wall_seconds")}
    return {**kept, **({"solver": {**kept["solver"], "seconds": None}} if "solver" in kept else {})}


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the command has written, and a log of three seconds."""
    folder = tmp_path_factory.mktemp("api")
    (folder / "log.csv").write_text(csv_text(sample_table(3000)))
    return folder


@pytest.fixture(scope="module")
def command(out: Path) -> list[object]:
    """A fit on the command line."""
    return ["fit", LEG, TRAIN, "--validate", VALIDATE, "--quick", "--json", "--quiet", "--out", out / "fit"]


@pytest.fixture(scope="module")
def printed(command: list[object]) -> dict[str, Any]:
    """What that command prints."""
    return run(*command).json


@pytest.fixture(scope="module")
def result() -> idtool.FitResult:
    """The same as a function, the log given both ways."""
    return idtool.fit(idtool.Model(LEG), [idtool.Log(TRAIN)], validate=[VALIDATE], quick=True)


def test_fit_returns_what_the_command_prints(result: idtool.FitResult, printed: dict[str, Any]) -> None:
    assert timeless(result.to_json()) == timeless(printed)
    result.to_json()["rms"].clear()  # a copy
    assert list(result.to_json()) == list(printed)


def test_fit_writes_what_the_command_writes(
    result: idtool.FitResult, command: list[object], printed: dict[str, Any], out: Path, tmp_path: Path
) -> None:
    made_by = shlex.join(["idtool", *map(str, command)])
    assert {path.name for path in result.save(tmp_path / "new", made_by)} == FIT_FILES
    own, theirs = files(tmp_path / "new"), files(out / "fit")
    assert set(own) == set(theirs) == FIT_FILES
    for name in ("identified.urdf", "model.yaml"):
        assert own[name] == theirs[name]
    assert made_by.replace("'", "&#39;").encode() in own["report.html"]
    assert len(own["report.html"]) == pytest.approx(len(theirs["report.html"]), abs=20)  # times are in it
    page = next(path for path in result.save(tmp_path) if path.suffix == ".html").read_text()
    assert f"idtool.fit(&#39;{LEG}&#39;, [&#39;{TRAIN}&#39;], validate=[&#39;{VALIDATE}&#39;], quick=True)" in page


def test_a_fits_figures_are_the_reports(result: idtool.FitResult, printed: dict[str, Any]) -> None:
    assert result.joints == JOINTS
    for part in ("train", "validation", "prior_validation"):
        assert getattr(result.rms, part) == printed["rms"][part]
        assert getattr(result.rms_raw, part) == printed["rms_raw"][part]
    assert list(result.bodies) == list(printed["bodies"])
    for name, body in printed["bodies"].items():
        own = result.bodies[name]
        assert (own.mass, own.realizable, own.constraints) == (body["mass"], True, body["constraints"])
        for key in ("com", "inertia_com", "pi", "standard_error"):
            expected = [np.nan if x is None else x for x in body[key]]
            np.testing.assert_array_equal(getattr(own, key), expected)
        np.testing.assert_array_equal(own.inertia, own.inertia.T)
        np.testing.assert_array_equal(np.diag(own.inertia), own.inertia_com[[0, 2, 5]])
    for joint, friction in printed["friction"].items():
        assert result.friction[joint].model_dump() == friction
    assert result.warnings == tuple(printed["warnings"])
    assert result.simulation is None


def test_results_cannot_be_changed(result: idtool.FitResult) -> None:
    with pytest.raises(ValidationError, match="frozen"):
        result.joints = ()  # type: ignore[misc]
    with pytest.raises(ValidationError, match="frozen"):
        result.bodies["shank_link"].mass = 0.0  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        result.bodies["shank_link"].pi[0] = 0.0


def test_a_result_may_be_sent_to_another_process(result: idtool.FitResult) -> None:
    assert repr(pickle.loads(pickle.dumps(result))) == repr(result)  # noqa: S301


def test_a_fit_at_the_prompt(result: idtool.FitResult) -> None:
    lines = repr(result).splitlines()
    assert lines[0] == "FitResult leg.urdf: RMS torque error [N·m] below 40 Hz, on held-out data"
    assert lines[1].split() == ["joint", "identified", "prior", "viscous", "coulomb"]
    hip = result.friction["hip"]
    shown = (result.rms.validation or {})["hip"], (result.rms.prior_validation or {})["hip"], hip.viscous, hip.coulomb
    assert lines[3].split() == ["hip", *map(number, shown)]
    assert f"shank_link {short_number(result.bodies['shank_link'].mass)}" in lines[6]
    assert len(lines) < 10
    assert repr(result.bodies["shank_link"]).startswith(
        f"Link: {short_number(result.bodies['shank_link'].mass)} kg at ("
    )


def test_without_held_out_data_the_fits_own_error_is_shown(out: Path) -> None:
    result = idtool.fit(LEG, out / "log.csv", holdout=0.0, quick=True)
    assert result.rms.validation is result.rms.prior_validation is None
    assert "on the fitted data" in repr(result)
    assert "warning: no data were held out" in repr(result)
    assert len(result.plot().data) == 4 * len(JOINTS)


def test_the_identified_model_is_the_one_in_the_files(
    result: idtool.FitResult, printed: dict[str, Any], out: Path
) -> None:
    assert printed
    folder = out / "fit"
    assert result.model.urdf == (folder / "identified.urdf").read_text()
    assert result.model.settings.model_dump() == read_config(folder / "model.yaml").model_dump()
    assert repr(result.model).startswith("Model leg.urdf with the identified parameters\n  joints: abad, hip, knee\n")
    by_files = ["validate", folder / "identified.urdf", out / "log.csv", "--prior", LEG, "--max-rms", "hip=0.1"]
    done = run(*by_files, "--json", "--quiet", "--out", out / "validation")
    assert done.code == 1
    found = idtool.validate(result.model, [out / "log.csv"], prior=idtool.Model(LEG), max_rms={"hip": 0.1})
    by_hand, by_command = timeless(found.to_json()), timeless(done.json)
    assert by_hand["inputs"][0] == {**by_command["inputs"][0], "path": f"{LEG}, identified"}
    assert {**by_hand, "inputs": None} == {**by_command, "inputs": None}
    assert (dict(found.ok), found.rms.model, found.rms.prior) == ({"hip": False}, *done.json["rms"].values())
    assert found.simulation is not None
    assert found.simulation.model_dump(mode="json") == done.json["simulation"]
    assert "0.100 (not met)" in repr(found)
    assert {path.name for path in found.save(out / "api")} == VALIDATION_FILES
    assert f"idtool.validate(&#39;{LEG}, identified&#39;" in (out / "api" / "validation.html").read_text()


@pytest.mark.parametrize("prior", ["bare", "configured"])
def test_a_prior_takes_the_models_configuration_where_it_has_none(out: Path, prior: str) -> None:
    urdf = out / prior / "other.urdf"
    urdf.parent.mkdir()
    urdf.write_bytes(LEG.read_bytes())
    if prior == "configured":
        config_with(urdf.with_suffix(".yaml"), LEG.with_suffix(".yaml"), friction={"viscous": {"value": 3.0}})
    arguments = [LEG, out / "log.csv", "--prior", urdf, "--no-simulation", "--json", "--quiet", "--out", out / "prior"]
    printed = run("validate", *arguments).json
    for other in (urdf, Model(urdf)):
        found = idtool.validate(LEG, out / "log.csv", prior=other, simulation=False)
        assert found.to_json() == printed
    friction = {"bare": 1.0, "configured": 0.0}[prior]
    assert (found.rms.prior == found.rms.model) == bool(friction)


def test_simulate_returns_and_writes_what_the_command_does(result: idtool.FitResult, out: Path, tmp_path: Path) -> None:
    result.save(out / "model")
    arguments = [out / "model" / "identified.urdf", out / "log.csv", "--window", "0.5", "--json", "--quiet"]
    printed = run("simulate", *arguments, "--out", out / "motion.csv").json
    found = idtool.simulate(result.model, out / "log.csv", window=0.5)
    (file,) = found.save(tmp_path / "motion.csv")
    assert file.read_bytes() == (out / "motion.csv").read_bytes()
    own = {**found.to_json(out / "motion.csv"), "urdf": printed["urdf"]}  # in memory, it is still the one it came from
    assert timeless(own) == timeless(printed)
    assert found.rmse.position == printed["rmse"]["position"]
    assert found.rmse.velocity == printed["rmse"]["velocity"]
    assert found.save(tmp_path / "folder") == (tmp_path / "folder" / "simulated.mcap",)
    np.testing.assert_array_equal(idtool.Log(tmp_path / "folder" / "simulated.mcap").q, found.log.q)
    assert repr(found).startswith("SimulationResult: 3 s open loop, 0.5 s at a time\n")
    with pytest.raises(idtool.IdtoolError, match="is an input file"):
        found.save(out / "log.csv")
    with pytest.raises(FrozenInstanceError):
        found.log = idtool.Log(out / "log.csv")  # type: ignore[misc]


def test_a_trajectory_is_tracked(out: Path) -> None:
    model = idtool.Model(LEG, {**idtool.Model(LEG).config, "controller": CONTROLLER})
    t = np.arange(500) / 500
    log = idtool.Log.from_arrays("sway", t, JOINTS, q=0.1 * np.sin(2 * np.pi * t)[:, None] * np.ones(3))
    found = idtool.simulate(model, log, track=True)
    assert (found.kind, found.window, found.log.signals) == ("closed_loop", None, ("q", "v", "tau", "qcmd", "vcmd"))
    np.testing.assert_allclose([trace.y[0] for trace in found.plot().data[::2]], 0.0, atol=1e-3)
    with pytest.raises(idtool.ConfigError, match="controller: is missing"):
        idtool.simulate(LEG, log, track=True)


@pytest.fixture(scope="module")
def diagnosis(out: Path) -> Diagnosis:
    """A made-up one, with an effect and an unknown."""
    first, last = fits(out)
    step = step_of()
    return diagnosis_of(first, last, step, unknown_of(step.after), verdict="partly_explained")


def test_diagnose_returns_and_writes_what_the_command_does(
    out: Path, tmp_path: Path, diagnosis: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def diagnose(experiment: Any, options: Any, progress: Any) -> Diagnosis:
        asked.append((experiment.samples(False), options))
        return diagnosis

    monkeypatch.setattr("idtool.diagnosis.diagnose.diagnose", diagnose)
    arguments = ["diagnose", LEG, out / "log.csv", "--inertia", "fixed", "--effects", "time_delay, payload"]
    arguments += ["--assume", "end_stop:knee", "--max-effects", "3", "--no-simulation", "--holdout", "0.2"]
    arguments += ["--json", "--quiet", "--out", out / "diagnosis"]
    printed = run(*arguments).json
    found = idtool.diagnose(
        *(LEG, out / "log.csv"),
        **{"holdout": 0.2, "inertia": "fixed", "effects": ["time_delay", "payload"], "most": 3},
        assume=[("end_stop", "knee")],
        simulation=False,
    )
    assert asked[0] == asked[1]
    assert found.to_json() == printed
    found.save(tmp_path, made_by=shlex.join(["idtool", *map(str, arguments)]))
    assert files(tmp_path) == files(out / "diagnosis")  # byte for byte
    assert len(found.save(tmp_path / "report", report_only=True)) == 2
    assert [step.effect for step in found.steps] == ["stribeck_friction", "unknown"]
    assert found.steps[0].parameters == printed["steps"][0]["parameters"]
    assert found.model.effects["stribeck_friction"] == ("hip",)
    assert "\n  1. Stribeck friction on hip\n  2. Unknown effect on knee\n" in repr(found)


def test_a_bag_may_stand_in_the_urdfs_place(out: Path) -> None:
    log = idtool.Log(out / "log.csv")
    assert log.v is not None
    assert log.tau is not None
    items = [
        State(round(1e9 * t), JOINTS, *(x[i].tolist() for x in (log.q, log.v, log.tau)), "", round(1e9 * t))
        for i, t in enumerate(log.t)
    ]
    path = write_mcap(out / "bag.mcap", ros2(items), described(LEG.read_text()))
    config_with(out / "bag.yaml", LEG.with_suffix(".yaml"))
    model = idtool.Model(path)
    assert (model.joints, model.path) == (JOINTS, path / "robot_description")
    expected = idtool.fit(model, path, quick=True)
    options = ["--json", "--quiet", "--out", out / "from_bag"]
    for arguments in ([path], [path, "--config", out / "bag.yaml"]):
        printed = run("fit", *arguments, "--quick", *options).json
        assert timeless(printed) == timeless(expected.to_json())
    assert run("validate", path, "--no-simulation", *options).json["samples"] > 2000
    for given in ((), (out / "log.csv",)):
        printed = run("simulate", path, *given, *options[:2], "--out", out / "bag_motion.csv").json
        assert printed["log"] == str(given[0] if given else path)
    assert run("simulate", LEG).err == "error: command: missing argument 'LOG'; try idtool simulate --help\n"


def test_every_mistake_is_an_error_of_idtools(out: Path) -> None:
    log = out / "log.csv"
    for call, error in (
        (lambda: idtool.fit(LEG, []), "logs: no log given"),
        (lambda: idtool.fit(LEG, "none.mcap"), "none.mcap: there is no such file"),
        (lambda: idtool.fit(LEG, log, holdout=2), "--holdout: 2 is not a fraction"),
        (lambda: idtool.validate(LEG, log, max_rms={"hpi": 1.0}), "--max-rms: hpi is not a joint; did you mean hip?"),
        (lambda: idtool.validate(LEG, log, max_rms=-1.0), "--max-rms: -1.0 is not a bound; give a number above 0"),
        (lambda: idtool.simulate(LEG, log, window=-1.0), "--window: -1 is not a valid time"),
        (lambda: idtool.diagnose(LEG, log, effects=["stribek"]), "--effects: stribek is not an effect; did you mean"),
        (lambda: idtool.diagnose(LEG, log, assume=["end_stop"]), "--assume: end_stop acts on a joint"),
        (lambda: idtool.diagnose(LEG, log, most=0), "--max-effects: 0 is too few"),
    ):
        with pytest.raises(idtool.IdtoolError) as caught:
            call()
        assert str(caught.value).startswith(error)


def test_progress_is_told_and_silent_by_default(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told: list[tuple[str, float]] = []
    idtool.fit(LEG, out / "log.csv", quick=True, progress=lambda stage, share: told.append((stage, share)))
    assert told[0] == ("reading", 0.0)
    assert {"solving", "reading log.csv"} <= {stage for stage, _ in told}
    assert all(0 <= share <= 1 for _, share in told)
    idtool.fit(LEG, out / "log.csv", quick=True)
    assert capsys.readouterr() == ("", "")


def test_figures_show_the_pages_curves(result: idtool.FitResult, tmp_path: Path) -> None:
    page = Page(result._files(tmp_path, "")["report.html"])  # type: ignore[arg-type]
    figure = result.plot()
    drawn = page.figures_of("Measured and predicted torque")
    assert figure.layout.title.text == "leg_validate.mcap"
    assert [trace.name for trace in figure.data] == ["measured", "predicted", "prior", "residual"] * 3
    for j, own in enumerate(drawn):
        for trace in figure.data[4 * j : 4 * j + 4]:
            assert list(trace.y) == own.y(trace.name)
            assert list(trace.x) == own.x
    titles = [axis.title.text for axis in figure.select_yaxes()]
    assert titles[:3] == ["abad: torque [N·m]", "residual", "hip: torque [N·m]"]
    assert figure.data[1].line.color == "#005ea8"  # --predicted of style.css
    with pytest.raises(IndexError):
        result.plot(log=1)


def test_the_figure_of_a_diagnosis_shows_the_gap_closing(
    diagnosis: Diagnosis, monkeypatch: pytest.MonkeyPatch, out: Path
) -> None:
    monkeypatch.setattr("idtool.diagnosis.diagnose.diagnose", lambda *_: diagnosis)
    figure = idtool.diagnose(LEG, out / "log.csv").plot()
    assert [trace.name for trace in figure.data] == ["torque", "noise floor", "simulation"] * (1 + len(JOINTS))
    hip = figure.data[3 * 2]
    assert list(hip.y) == pytest.approx([1.1 * 1.3, 1.1 * 0.6])
    assert list(hip.text) == ["original model", "1: Stribeck friction on hip"]
