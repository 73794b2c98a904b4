"""A simulation as JSON, as notes, and in the terminal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from commands import LEG, column_set, config_with, csv_text, fitted, idtool, sample_table, validated
from rollouts import experiment_of, rollouts_of
from sentences import sentences

from idtool.common.number_text import number
from idtool.estimation.evaluation.rollouts import RolloutError, RolloutEvaluation, simulation_notices
from idtool.reporting.simulation_report import simulation_report

UNITS = {"j0": "N·m", "j1": "N"}
FLAT = {name: np.zeros((2, 40)) for name in ("measured", "model", "prior")}


def reported(rollouts: RolloutEvaluation | None, model: str = "model") -> dict[str, Any] | None:
    """As JSON has it."""
    report = simulation_report(rollouts, model, experiment_of(UNITS))
    return None if report is None else report.model_dump(mode="json")


def of_all(value: float) -> Any:
    return pytest.approx({"j0": value, "j1": value, "overall": value})


def test_open_loop() -> None:
    assert reported(rollouts_of(FLAT, diverged={"model": 1, "prior": 4})) == {
        "kind": "open_loop",
        "window": 0.5,
        "windows": {"simulated": 10, "of": 12},
        "seconds": 5.0,
        "units": {"j0": "rad", "j1": "m"},
        "position": of_all(0.1),
        "velocity": of_all(0.2),
        "baseline": {"position": of_all(0.9), "velocity": of_all(1.8)},
        "prior": {"position": of_all(0.2), "velocity": of_all(0.4)},
        "horizon": [
            {"seconds": t, "position": of_all(0.1 * t), "baseline": of_all(0.9 * t), "prior": of_all(0.2 * t)}
            for t in (0.01, 0.05, 0.1, 0.5)
        ],
        "lost": 1,
        "prior_lost": 4,
    }


def test_closed_loop_has_no_horizon_even_where_the_replay_has() -> None:
    horizons = rollouts_of(FLAT).errors
    report = reported(rollouts_of(FLAT, closed=True, errors=horizons))
    assert report is not None
    assert (report["kind"], report["window"], report["horizon"]) == ("closed_loop", None, [])


def test_a_horizon_that_no_window_reaches_is_left_out() -> None:
    departures = dict(rollouts_of(FLAT).errors)
    for departure in departures.values():
        del departure.after[0.5]
    report = reported(rollouts_of(FLAT, errors=departures))
    assert report is not None
    assert [at["seconds"] for at in report["horizon"]] == [0.01, 0.05, 0.1]


def test_what_is_not_finite_is_null() -> None:
    lost = RolloutError(np.array([1.0, np.inf]), np.array([np.nan, 1.0]), 10, 10, {0.01: (np.array([np.nan, 1.0]), 10)})
    report = reported(rollouts_of(FLAT, errors={**rollouts_of(FLAT).errors, "model": lost}))
    assert report is not None
    assert report["position"] == {"j0": pytest.approx(0.1**0.5), "j1": None, "overall": None}
    assert report["velocity"]["j0"] is None
    assert report["horizon"][0]["position"] == {"j0": None, "j1": pytest.approx(0.1**0.5), "overall": None}


def test_a_model_that_cannot_be_simulated_has_no_report_but_a_note() -> None:
    rollouts = rollouts_of(FLAT, failed={"model": "leg.urdf: cannot be simulated"})
    assert reported(rollouts) is None
    assert sentences(simulation_notices(rollouts, "model")) == (
        "the model was not simulated: leg.urdf: cannot be simulated",
    )


def test_a_prior_that_cannot_be_simulated_is_null_and_a_note() -> None:
    departures = {name: d for name, d in rollouts_of(FLAT).errors.items() if name != "prior"}
    rollouts = rollouts_of(FLAT, errors=departures, failed={"prior": "why"}, diverged={"model": 2, "prior": 0})
    report = reported(rollouts)
    assert report is not None
    assert report["prior"] is report["prior_lost"] is report["horizon"][0]["prior"] is None
    assert sentences(simulation_notices(rollouts, "model")) == (
        "2 of 10 simulations of the model diverged and were stopped",
        "the prior was not simulated: why",
    )


def test_nothing_asked_for_nothing_said() -> None:
    assert reported(None) is None
    assert simulation_notices(None, "model") == []
    assert simulation_notices(rollouts_of(FLAT), "model") == []


def row(text: str, name: str, after: str) -> list[str]:
    """The cells of a row of the table under a title."""
    lines = text.partition(after)[2].splitlines()
    return next(line for line in lines if line.startswith(name + " ")).removeprefix(name).split()


def test_the_terminal_has_the_reports_figures(tmp_path: Any) -> None:
    (tmp_path / "log.csv").write_text(csv_text(sample_table(2500)))
    arguments = [LEG, tmp_path / "log.csv", "--prior", LEG, "--out", tmp_path]
    report = validated(tmp_path, LEG, tmp_path / "log.csv", "--prior", LEG, simulated=True)["simulation"]
    text = idtool("validate", *arguments).out
    title = "Simulated position, RMS error, rad: open loop, 1 s at a time"
    for name in ("abad", "hip", "knee", "overall"):
        figures = (x["position"][name] for x in (report, report["prior"], report["baseline"]))
        assert row(text, name, title) == [number(x) for x in figures]
    after = report["horizon"][1]
    wanted = [number(after[key]["overall"]) for key in ("position", "prior", "baseline")]
    assert row(text, "after 50 ms", title) == wanted
    assert "Simulated" not in idtool("validate", *arguments, "--no-simulation").out


@pytest.fixture
def commanded(tmp_path: Any) -> Callable[..., list[object]]:
    """A leg without torque, under a controller."""

    def build(**changes: Any) -> list[object]:
        table = sample_table(1500)
        for joint in ("abad", "hip", "knee"):
            place = table[0].index(f"tau_{joint}")
            values = [float(row[place]) / 80 + float(row[table[0].index(f"q_{joint}")]) for row in table[1:]]
            table = column_set(table, f"tau_{joint}", values.__getitem__)
        table[0] = [name.replace("tau_", "qcmd_") for name in table[0]]
        (tmp_path / "log.csv").write_text(csv_text(table))
        controller = {"kp": dict.fromkeys(("abad", "hip", "knee"), 80.0)}
        config = config_with(tmp_path / "c.yaml", LEG.with_suffix(".yaml"), controller=controller, **changes)
        return [LEG, tmp_path / "log.csv", "--config", config, "--out", tmp_path / "out"]

    return build


def test_closed_loop_in_the_terminal(commanded: Callable[..., list[object]]) -> None:
    text = idtool("validate", *commanded()).out
    assert "Simulated position, RMS error, rad: closed loop under the controller, 1.5 s, never restarted" in text
    assert "q = qcmd" in text
    assert "after 10 ms" not in text


def test_a_fit_that_cannot_be_simulated_is_written_all_the_same(tmp_path: Any) -> None:
    """Half a second of a leg, without constraints or prior: bodies that accelerate against their forces."""
    (tmp_path / "log.csv").write_text(csv_text(sample_table(500)))
    free = {"constraints": "none", "regularization": {"kind": "none"}}
    config = config_with(tmp_path / "c.yaml", LEG.with_suffix(".yaml"), **free)
    arguments = [LEG, tmp_path / "log.csv", "--validate", tmp_path / "log.csv", "--config", config]
    report = fitted(tmp_path, *arguments, simulated=True)
    assert report["simulation"] is None
    assert [w for w in report["warnings"] if w.startswith("the model was not simulated: ")]
    assert (tmp_path / "report.html").is_file()


def test_a_fit_simulates_what_was_held_out_else_what_it_was_fitted_to(tmp_path: Any) -> None:
    (tmp_path / "log.csv").write_text(csv_text(sample_table(2500)))
    for arguments, seconds in ((["--holdout", "0.2"], 0.5), (["--holdout", "0"], 2.5)):
        report = fitted(tmp_path, LEG, tmp_path / "log.csv", *arguments, simulated=True)
        assert report["simulation"]["seconds"] == pytest.approx(seconds, abs=0.05)
        assert report["seconds"]["simulate"] > 0
