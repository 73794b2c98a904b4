"""The pages in Chromium: every plot is drawn, nothing goes wrong, on a desk and on a phone, light and dark."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import DRIVER, LOOK, MOVE, ROBOT, Browser, browser
from commands import LEG, TRAIN, VALIDATE, csv_text, idtool, sample_table
from diagnoses import diagnosis_of, fits, level, step_of

from idtool.reporting.diagnosis_report import diagnosis_report
from idtool.reporting.pages.diagnosis import diagnosis_page

pytestmark = pytest.mark.skipif(DRIVER is None, reason="no chromedriver: install Debian's chromium-driver or Chrome's")

EFFECTS = ("--effects", "parallel_spring")  # for the same page as with all others, since nothing is found
# Pages whose plots are made as those of the report.
AS_THE_REPORT = [pytest.param(name, marks=pytest.mark.slow) for name in ("validation.html", "study.html")]


@pytest.fixture(scope="module")
def opened() -> Iterator[Browser]:
    with browser() as one:
        yield one


COMMANDS = {
    "report.html": ("fit", LEG, TRAIN, "--validate", VALIDATE),
    "validation.html": ("validate", LEG, VALIDATE),
    "diagnosis.html": ("diagnose", LEG, TRAIN, "--validate", VALIDATE, "--no-simulation", "--report-only", *EFFECTS),
    "study.html": ("study", LEG, "short.csv", "--draws", "5"),
}


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A page of the sample leg by its name, as the command writes it."""
    out = tmp_path_factory.mktemp("pages")

    @cache
    def written(name: str) -> Path:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(out)
            patch.setattr("idtool.estimation.study.study.LOCAL", {})  # local solvers, which take long
            Path("short.csv").write_text(csv_text(sample_table(3000)))
            assert idtool(*COMMANDS[name], "--out", out, "--quiet").code == 0
        return out / name

    return written


@pytest.mark.parametrize(
    "name", ["report.html", pytest.param("diagnosis.html", marks=pytest.mark.slow), *AS_THE_REPORT]
)
@pytest.mark.parametrize(("width", "dark"), [(400, True), pytest.param(1400, False, marks=pytest.mark.slow)])
def test_every_plot_is_drawn(page: Callable[[str], Path], opened: Browser, name: str, width: int, dark: bool) -> None:
    """Colours have no part in the width: each of both is seen once."""
    found = opened.use(page(name), width, dark)
    assert found["plots"] > 2
    assert (found["blank"], found["wrong"], found["wide"]) == ([], [], False)
    assert found["dark"] == dark


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A diagnosis whose table of steps is as wide as can be: a pair, and a simulation that gets worse."""
    folder = tmp_path_factory.mktemp("pair")
    first, last = fits(folder)
    worse = level(0.2, 0.6, 0.4, simulated=0.04)
    diagnosis = diagnosis_of(first, last, step_of(after=worse), after=worse)
    page = folder / "diagnosis.html"
    page.write_text(diagnosis_page(diagnosis, diagnosis_report(diagnosis, "refit"), "idtool diagnose"))
    return page


# Tables that are wider than their place, and cells of stacked tables without a heading.
TABLES = """const tables = [...document.querySelectorAll("table")];
return {
  wide: tables.filter((table) => table.scrollWidth > table.parentElement.clientWidth).map((table) => table.innerText),
  stacked: tables.filter((table) => getComputedStyle(table).display === "block").length,
  bare: document.querySelectorAll(".stacked tbody :is(th, td):not([data-label])").length,
};"""
# Plots with a toolbar that reaches into the curves.
COVERED = """return [...document.querySelectorAll("[data-figure]")].filter((plot) => {
  const bar = plot.querySelector(".modebar"), area = plot.querySelector(".nsewdrag");
  return bar && bar.getBoundingClientRect().bottom > area.getBoundingClientRect().top;
}).map((plot) => plot.getAttribute("aria-label"));"""


@pytest.mark.slow
def test_tables_of_a_diagnosis_fit_and_no_toolbar_covers_a_curve(pair: Path, opened: Browser) -> None:
    opened.use(pair, 1400, False)
    assert opened.run(TABLES) == {"wide": [], "stacked": 0, "bare": 0}
    assert opened.run(COVERED) == []
    opened.use(pair, 400, False)
    found = opened.run(TABLES)
    assert found["stacked"] >= 4
    assert (found["wide"], found["bare"]) == ([], 0)
    assert opened.run(COVERED) == []


def at_rest(opened: Browser) -> dict[str, Any]:
    """The robot's plot, which turns on for a while when the mouse lets go."""
    before, now = None, opened.run(ROBOT)
    while before is None or now["eye"] != pytest.approx(before["eye"]):
        before, now = now, opened.run(ROBOT)
    return dict(now)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["report.html", "diagnosis.html", "validation.html"])
def test_the_robot_moves_and_turns(page: Callable[[str], Path], opened: Browser, name: str) -> None:
    """The slider moves it, the mouse turns it, the prior beside it too, and it stays turned when it is moved again."""
    opened.use(page(name), 1400, False, "[data-robot]")
    opened.run(LOOK)
    first = opened.run(ROBOT)
    opened.run(MOVE, 30)
    moved = opened.run(ROBOT)
    assert moved["places"] != first["places"]
    assert moved["eye"] == pytest.approx(first["eye"])
    opened.drag(moved["x"], moved["y"], 200)
    turned = at_rest(opened)
    assert np.linalg.norm(np.subtract(*([one["eye"][k] for k in "xyz"] for one in (turned, moved)))) > 0.2
    assert all(eye == pytest.approx(turned["eye"], abs=1e-3) for eye in turned["eyes"])
    opened.run(MOVE, 0)
    again = opened.run(ROBOT)
    assert again["places"] == first["places"]
    assert again["eye"] == pytest.approx(turned["eye"])


SHOWN = """return [...document.querySelectorAll(".log[open] [data-figure]")].map((plot) => ({
  about: plot.getAttribute("aria-label"), range: plot._fullLayout.xaxis.range,
  curves: plot.data.filter((trace) => trace.visible).map((trace) => trace.name),
}));"""
TORQUE = '[aria-label^="Measured and predicted torque"]'
TICK = f"""const box = document.querySelector('{TORQUE}').closest("section").querySelector("[data-curve]");
box.checked = arguments[0]; box.dispatchEvent(new Event("change"));"""
ZOOM = f"""const [range] = arguments; // as the mouse does
const change = range ? {{ "xaxis.range[0]": range[0], "xaxis.range[1]": range[1] }} : {{ "xaxis.autorange": true }};
return Plotly.relayout(document.querySelector('{TORQUE}'), change).then(() => null);"""


@pytest.mark.slow
def test_the_prior_is_drawn_where_asked_and_a_log_is_zoomed_as_one(
    page: Callable[[str], Path], opened: Browser
) -> None:
    opened.use(page("report.html"), 1400, False, ".log[open] [data-figure]")
    whole = opened.run(SHOWN)
    torques = [one["about"].startswith("Measured and predicted torque") for one in whole]
    assert (sum(torques), torques.count(False)) == (3, 3)  # and the positions
    assert not any("prior" in one["curves"] for one in whole)
    opened.run(TICK, True)
    assert [("prior" in one["curves"]) for one in opened.run(SHOWN)] == torques
    opened.run(ZOOM, [12.0, 13.0])
    zoomed = opened.run(SHOWN)
    for one, before, torque in zip(zoomed, whole, torques, strict=True):
        assert one["range"] == pytest.approx([12.0, 13.0] if torque else before["range"])
    opened.run(TICK, False)
    again = opened.run(SHOWN)
    assert [one["curves"] for one in again] == [one["curves"] for one in whole]
    assert [one["range"] for one in again] == [one["range"] for one in zoomed]
    opened.run(ZOOM, None)
    assert [one["range"] for one in opened.run(SHOWN)] == [pytest.approx(one["range"]) for one in whole]
