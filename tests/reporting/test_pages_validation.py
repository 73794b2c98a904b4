"""validation.html, and the curves that pages are drawn from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pages import Page, complete, evaluation_of
from records import partial

from idtool.estimation.evaluation.torque_errors import Evaluation
from idtool.reporting.fit_report import validation_report
from idtool.reporting.pages.validation import validation_page
from idtool.reporting.plots.sampling import merge_stretches, round_curve
from idtool.reporting.results.validation import ValidationReport

Array = NDArray[np.float64]


TORQUE = "Measured and predicted torque"


def validated(evaluation: Evaluation, **extra: Any) -> Page:
    """The page of a validation, its bounds met by the first joint and not by the whole."""
    units = dict.fromkeys(evaluation.torque_std, "N·m")
    contents = validation_report(evaluation, units, 40.0, {next(iter(units)): 0.5, "overall": 0.3})
    return Page(validation_page(evaluation, partial(ValidationReport, contents.to_json() | extra), "idtool validate x"))


@pytest.fixture
def noisy(rng: np.random.Generator) -> dict[str, Array]:
    """Curves of a model and a prior for three joints, with a gap."""
    measured, model, prior = rng.normal(scale=[[30.0], [1.0], [1e-4]], size=(3, 3, 400))
    measured[:, 100:140] = model[:, 100:140] = prior[:, 100:140] = np.nan
    return {"measured": measured, "model": model, "prior": prior}


def test_the_validation_page_is_complete_in_itself(noisy: dict[str, Array]) -> None:
    complete(validated(evaluation_of(noisy)))


@pytest.mark.parametrize("logs", [1, 20])
def test_pages_of_large_robots_stay_small(rng: np.random.Generator, logs: int) -> None:
    curves = {name: rng.normal(scale=30, size=(12, 4000)) for name in ("measured", "model", "prior")}
    page = validated(evaluation_of(curves, logs, 1.6e9))
    assert len(page.html.encode()) < 6e6
    drawn = min(logs, 6)
    assert len(page.figures_of(TORQUE)) == 12 * drawn
    assert (f"{logs - drawn} more logs are not drawn" in page.text) == (logs > 1)


def test_curves_match_the_evaluation(noisy: dict[str, Array]) -> None:
    figures = validated(evaluation_of(noisy)).figures_of(TORQUE)
    wanted = {"measured": noisy["measured"], "predicted": noisy["model"], "prior": noisy["prior"]}
    residual = (noisy["measured"] - noisy["model"]).reshape(3, -1, 2)
    wanted["residual"] = np.sort(residual, axis=-1)
    assert len(figures) == 3
    for j, figure in enumerate(figures):
        assert figure.x == (np.repeat(np.arange(200) + 0.5, 2) * 0.01).round(5).tolist()
        assert figure.names == ["measured", "predicted", "prior", "residual"]
        for name, x in wanted.items():
            drawn = np.sort(np.array(figure.y(name), dtype=float).reshape(-1, 2))
            pairs = np.sort(x.reshape(3, -1, 2)[j])
            np.testing.assert_allclose(drawn, pairs, atol=1e-4 * np.nanmax(np.abs(pairs)))


def test_late_stamps_keep_their_digits(noisy: dict[str, Array]) -> None:
    for figure in validated(evaluation_of(noisy, start=1.6e9)).figures_of(TORQUE):
        assert figure.titles[-1] == "t − 1600000000 [s]"
        np.testing.assert_allclose(np.diff(np.array(figure.x, dtype=float)[::2]), 0.01, atol=2e-5)


def test_merging_loses_no_extreme(rng: np.random.Generator) -> None:
    x = rng.normal(size=(2, 50))
    x[0, :20] = np.nan
    coarse = merge_stretches(x, 4)
    assert coarse.shape == (2, 14)
    assert np.isnan(coarse[0, :4]).all()
    assert not np.isnan(coarse[:, 4:]).any()
    for row, full in zip(coarse, x, strict=True):
        assert (np.nanmin(row), np.nanmax(row)) == (np.nanmin(full), np.nanmax(full))
    assert np.sort(merge_stretches(x[1:], 1).reshape(-1, 2)).tolist() == np.sort(x[1:].reshape(-1, 2)).tolist()


def test_a_smooth_curve_is_drawn_smooth() -> None:
    """In stretches of time in which it falls, the least value comes last: no saw teeth."""
    x = np.sin(np.linspace(0, 20, 4000))[None]
    pairs = np.sort(x.reshape(-1, 2)).reshape(1, -1)  # as they are collected
    drawn = merge_stretches(pairs, 8)
    assert np.abs(np.diff(drawn)).sum() < 1.1 * np.abs(np.diff(x)).sum()


def test_rounding_keeps_five_digits_of_the_largest() -> None:
    assert round_curve(np.array([12.345678, -0.001234, np.nan])) == [12.346, -0.001, None]
    assert round_curve(np.array([np.nan])) == [None]
    assert round_curve(np.array([0.0, 1e-300])) == [0.0, 0.0]
    assert round_curve(np.array([123456789.0])) == [123460000.0]


def test_joints_of_two_kinds_have_two_units(noisy: dict[str, Array]) -> None:
    evaluation = evaluation_of(noisy)
    mixed = validated(evaluation, units={"j0": "N·m", "j1": "N", "j2": "N·m"})
    titles = [figure.titles[0] for figure in mixed.figures_of(TORQUE)]
    assert titles == ["torque [N·m]", "torque [N]", "torque [N·m]"]
    assert "mixed N·m and N" in mixed.text
    assert "mixed N·m and N" not in validated(evaluation).text


def test_bounds_pass_or_fail(noisy: dict[str, Array]) -> None:
    page = validated(evaluation_of(noisy))
    results = {name: (row["bound"], row["result"]) for name, row in page.table("bound").items()}
    assert results == {"j0": ("0.5", "ok"), "j1": ("–", ""), "j2": ("–", ""), "overall": ("0.3", "NOT MET")}
    assert "These bounds are not met: overall." in page.text
    assert page.levels == ["good", "bad"]


def test_a_validation_without_prior_or_bounds(noisy: dict[str, Array]) -> None:
    evaluation = evaluation_of({name: noisy[name] for name in ("measured", "model")})
    units = dict.fromkeys(evaluation.torque_std, "N·m")
    page = Page(validation_page(evaluation, validation_report(evaluation, units, 40.0, {}), "idtool validate x"))
    assert "prior" not in page.text
    assert "bound" not in page.text
    assert page.figures_of(TORQUE)[0].names == ["measured", "predicted", "residual"]
    assert page.levels == ["good"]
