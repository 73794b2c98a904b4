"""The section on simulation: what is drawn, tabled and said of it, and nothing where there was none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pages import Page, complete, evaluation_of
from rollouts import experiment_of, rollouts_of

from idtool.estimation.evaluation.rollouts import RolloutError, RolloutEvaluation
from idtool.reporting.fit_report import validation_report
from idtool.reporting.pages.validation import validation_page
from idtool.reporting.simulation_report import simulation_report

Array = NDArray[np.float64]

POSITION = "Measured and simulated position"
UNITS = {"j0": "N·m", "j1": "N"}


@pytest.fixture
def motion(rng: np.random.Generator) -> dict[str, Array]:
    """Positions measured, of a model that runs away for a while, and of a prior that does at once; with a gap."""
    measured = np.sort(rng.normal(size=(2, 200, 2)), axis=-1).reshape(2, 400)
    model, prior = measured + 0.1, measured + 1e4
    model[:, 300:320] = 500.0
    measured[:, 100:140] = model[:, 100:140] = prior[:, 100:140] = np.nan
    return {"measured": measured, "model": model, "prior": prior}


def page_of(rollouts: RolloutEvaluation | None, **changes: Any) -> Page:
    """validation.html of a simulation, and made-up torques."""
    evaluation = evaluation_of({name: np.ones((2, 4)) for name in ("measured", "model", "prior")})
    simulation = simulation_report(rollouts, "model", experiment_of(UNITS))
    if simulation:
        simulation = simulation.model_copy(update=changes)
    report = validation_report(evaluation, UNITS, 40.0, {}, simulation)
    return Page(validation_page(evaluation, report, "idtool validate x", rollouts))


def test_the_page_is_complete_in_itself(motion: dict[str, Array]) -> None:
    complete(page_of(rollouts_of(motion)))
    complete(page_of(rollouts_of(motion, closed=True)))


def test_the_curves_are_those_of_the_simulation(motion: dict[str, Array]) -> None:
    page = page_of(rollouts_of(motion))
    figures = page.figures_of(POSITION)
    assert "more logs" not in page.text
    assert "log 0" in page.text
    assert [figure.titles[0] for figure in figures] == ["angle [rad]", "position [m]"]
    for j, figure in enumerate(figures):
        for name, drawn in (("measured", "measured"), ("model", "simulated"), ("prior", "prior")):
            pairs = np.sort(np.array(figure.y(drawn), dtype=float).reshape(-1, 2))
            wanted = np.sort(motion[name][j].reshape(-1, 2))
            np.testing.assert_allclose(pairs, wanted, atol=1e-4 * np.nanmax(np.abs(wanted)))


def test_what_runs_away_does_not_flatten_what_was_measured(motion: dict[str, Array]) -> None:
    """A curve that leaves the measured range is shown for half of it beyond."""
    figures = page_of(rollouts_of(motion)).figures_of(POSITION)
    for figure, measured in zip(figures, motion["measured"], strict=True):
        low, high = figure.layout["yaxis"]["range"]
        least, greatest = np.nanmin(measured), np.nanmax(measured)
        span = greatest - least
        assert least - 0.1 * span < low < least
        assert greatest + 0.5 * span < high < greatest + 0.6 * span


def test_a_joint_at_rest_has_a_range() -> None:
    still = np.zeros((2, 40))
    figure, _ = page_of(rollouts_of({"measured": still, "model": still})).figures_of(POSITION)
    assert figure.layout["yaxis"]["range"] == [-0.01, 0.01]


def test_tables_hold_the_errors(motion: dict[str, Array]) -> None:
    page = page_of(rollouts_of(motion))
    models = ["model", "prior", "hold"]
    heads = ["joint", "unit", *models, *(f"velocity, {name} [unit/s]" for name in models)]
    start = page.rows.index(heads)
    errors = ["0.100", "0.200", "0.900", "0.200", "0.400", "1.80"]
    assert page.rows[start + 1 :][:2] == [["j0", "rad", *errors], ["j1", "m", *errors]]
    assert page.rows[start + 3][:2] == ["overall", "mixed rad and m"]
    assert page.rows[start + 4] == ["after 10 ms", "mixed rad and m", "0.00100", "0.00200", "0.00900", "", "", ""]
    assert "Simulated position, RMS error, rad or m: open loop, 0.5 s at a time" in page.plain


def test_open_loop_says_how_it_was_run_and_draws_the_error_against_time(motion: dict[str, Array]) -> None:
    page = page_of(rollouts_of(motion))
    assert "in 10 of 12 windows, spread over the logs. Each window is 0.5 s long" in page.plain
    assert "Hold: a baseline that keeps the position" in page.plain
    (figure,) = page.figures_of("Position error against time since the restart")
    assert figure.x == [0.01, 0.05, 0.1, 0.5]
    assert figure.titles == ["RMS error [mixed rad and m]", "time since the restart [s]"]
    assert figure.layout["xaxis"]["type"] == figure.layout["yaxis"]["type"] == "log"
    assert {name: figure.y(name) for name in figure.names} == {
        "model": [0.001, 0.005, 0.01, 0.05],
        "prior": [0.002, 0.01, 0.02, 0.1],
        "hold": [0.009, 0.045, 0.09, 0.45],
    }


def test_closed_loop_says_how_it_was_run(motion: dict[str, Array]) -> None:
    page = page_of(rollouts_of(motion, closed=True))
    assert (
        "in closed loop with the joint controller, its delay and the logged command, over 5.00 s. "
        "The simulation is never restarted" in page.plain
    )
    assert "q = qcmd" in page.plain
    assert page.figures_of("Position error") == []


@pytest.mark.parametrize(
    ("own", "level", "said"),
    [
        (0.1, "good", "0.100 mixed rad and m RMS"),
        (0.3, "note", "that of the prior 0.200"),  # worse than the prior
        (
            1.5,
            "note",
            "so the simulation drifts: 0.0150 mixed rad and m after 0.01 s",
        ),  # worse than what does not move
        (float("nan"), "note", "diverges"),
    ],
)
def test_the_finding(motion: dict[str, Array], own: float, level: str, said: str) -> None:
    rollouts = rollouts_of(motion)
    squares = np.full(2, 1000 * own**2)
    after = {0.01: (np.full(2, 10 * (0.01 * own) ** 2), 10)}
    page = page_of(
        replace(rollouts, errors={**rollouts.errors, "model": RolloutError(squares, squares, 1000, 1000, after)})
    )
    assert page.levels[1] == level
    assert said in page.plain


def test_a_rollout_that_ran_away_is_said(motion: dict[str, Array]) -> None:
    page = page_of(rollouts_of(motion, diverged={"model": 3, "prior": 0}))
    assert "3 of 10 simulations diverged and were stopped." in page.plain
    assert page.levels[1] == "note"


def test_without_a_prior_nothing_is_said_of_one(motion: dict[str, Array]) -> None:
    """Not even where it was simulated on the first log before it failed on the next."""
    rollouts = rollouts_of(motion, failed={"prior": "no inertia"})
    del rollouts.errors["prior"]  # type: ignore[attr-defined]
    page = page_of(rollouts)
    assert [row for row in page.rows if len(row) == 6 and row[0] in UNITS and row[1] in ("rad", "m")]
    boxes = [attrs["data-curve"] for _, attrs in page.tags if "data-curve" in attrs]
    assert boxes == ["prior"]  # of the torques
    assert page.figures_of(POSITION)[0].names == ["measured", "simulated"]
    assert page.figures_of("Position error")[0].names == ["model", "hold"]


@pytest.mark.parametrize("asked", [True, False])
def test_without_a_simulation_there_is_no_section(motion: dict[str, Array], asked: bool) -> None:
    page = page_of(rollouts_of(motion, failed={"model": "no inertia"}) if asked else None)
    assert page.figures_of(POSITION) == []
    assert "Simulation" not in page.text
    complete(page)


def test_many_joints_and_logs_stay_small(rng: np.random.Generator) -> None:
    curves = {name: rng.normal(size=(2, 4000)) for name in ("measured", "model", "prior")}
    page = page_of(rollouts_of(curves, logs=20))
    assert len(page.html.encode()) < 6e6
    figures = page.figures_of(POSITION)
    assert len(figures) == 2 * 6
    assert "14 more logs are not drawn." in page.plain
    assert sum(len(trace["y"]) for figure in figures for trace in figure.data) < 41_000
