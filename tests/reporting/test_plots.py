"""Figures for pages and notebooks: valid for plotly, in colours that a page has, equal arrays stored once."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnoses import residual
from pages import SCRIPT, Page, complete, evaluation_of, study_of
from records import partial

import idtool
from idtool.reporting.pages.base import render
from idtool.reporting.plots.comparison import advantage_figure, learning_figure, online_figure
from idtool.reporting.plots.figure import Figure, Panel, curve, figure, stack_figures, styled_curve
from idtool.reporting.plots.gap import gap_figure
from idtool.reporting.plots.residuals import residual_figures
from idtool.reporting.plots.simulation import motion_figures
from idtool.reporting.plots.torques import torque_figures
from idtool.reporting.results.study import StudyReport

STYLE = Path(idtool.__file__).parent / "reporting" / "templates" / "style.css"
T = np.linspace(0, 1, 200)


def torques() -> list[Figure]:
    """Of two joints, with a prior and the position."""
    measured = np.stack([np.sin(T), np.cos(T)])
    curves = {"measured": measured, "model": 0.9 * measured, "prior": 0.5 * measured, "q": 0.3 * measured}
    evaluation = evaluation_of(curves)
    (group,) = torque_figures(evaluation, "model", dict.fromkeys(evaluation.torque_std, "N·m"), position=True).groups
    return group.figures


@pytest.fixture(scope="module")
def drawn() -> list[Figure]:
    """One of every kind that a notebook may show, and of those with bands and levels."""
    study = partial(StudyReport, study_of(["hip", "knee"], ["thigh", "shank"]))
    motion = {"measured": np.stack([T, T]), "simulated": np.stack([T, 2 * T])}
    maps = {"hip": residual(1.0)}
    return [
        *torques(),
        stack_figures(torques(), "a log"),
        *motion_figures(T, motion, {"hip": "rad", "lift": "m"}).figures,
        gap_figure("hip", ["the model given", "1: drift"], ([2.0, 1.0], "N·m"), ([0.2, 0.1], "rad"), 0.5, 340),
        *residual_figures(maps, maps, {"hip": "N·m"}, ("prior", "identified"), "both").groups[0].figures,
        learning_figure(study),
        advantage_figure(study),
        online_figure(study),
    ]


def colors(part: Any) -> Iterator[str]:
    """All colours of a part of a figure."""
    if isinstance(part, dict):
        for key, value in part.items():
            if key.endswith("color"):
                yield value
            else:
                yield from colors(value)
    elif isinstance(part, list) and part and isinstance(part[0], dict):
        for inner in part:
            yield from colors(inner)


def test_plotly_takes_every_figure_with_all_its_curves(drawn: list[Figure]) -> None:
    for own in drawn:
        shown = own.to_plotly()
        assert own.description
        assert len(shown.data) == len(own.data)
        for trace, given in zip(shown.data, own.data, strict=True):
            assert (list(trace.x), list(trace.y)) == (list(given["x"]), list(given["y"]))


def test_their_colours_are_those_of_the_pages_light_and_dark(drawn: list[Figure]) -> None:
    light, _, dark = STYLE.read_text().partition("@media screen")
    for own in drawn:
        used = {name.partition(" ")[0] for name in colors([*own.data, own.layout])}
        assert used
        for color in used:
            assert re.search(rf"--{color}: #[0-9a-f]{{6}};", light)
            assert re.search(rf"--{color}: #[0-9a-f]{{6}};", dark)


def test_a_band_lets_what_is_below_shine_through() -> None:
    study = partial(StudyReport, study_of(["hip", "knee"], ["thigh", "shank"]))
    shown = learning_figure(study).to_plotly()
    fills = [trace.fillcolor for trace in shown.data if trace.fillcolor]
    assert fills[0] == "rgba(92, 103, 115, 0.18)"  # --c0
    assert [trace.fill for trace in shown.data[:3]] == [None, "tonexty", None]


def test_a_logarithmic_axis_leaves_out_what_it_cannot_show() -> None:
    panel = Panel("y", [styled_curve("a", [1, 2, 3], [1.0, 0.0, -1.0], 0)], log=True)
    assert figure("c", "x", [panel]).data[0]["y"] == [1.0, None, None]


def test_panels_share_the_height_and_the_lowest_has_the_x_axis() -> None:
    panels = [Panel(name, [curve(name, [1, 2], [3, 4], "c0")]) for name in ("a", "b", "c")]
    layout = figure("c", "x", panels).layout
    domains = [layout[axis]["domain"] for axis in ("yaxis", "yaxis2", "yaxis3")]
    assert domains[0][1] == 1
    assert domains[2][0] == pytest.approx(0)
    assert all(upper[0] > lower[1] for upper, lower in itertools.pairwise(domains))
    assert layout["xaxis"]["anchor"] == "y3"


def test_figures_stacked_for_a_notebook_keep_their_curves_and_have_one_legend() -> None:
    own = torques()
    shown = stack_figures(own, "leg.mcap").to_plotly()
    assert shown.layout.title.text == "leg.mcap"
    names = [trace["name"] for one in own for trace in one.data]
    assert [trace.name for trace in shown.data] == names
    assert [trace.showlegend for trace in shown.data] == [True] * 5 + [False] * 5
    assert all(trace.visible for trace in shown.data)
    titles = [axis.title.text for axis in shown.select_yaxes()]
    assert titles[::3] == ["j0: torque [N·m]", "j1: torque [N·m]"]
    ends = sorted(axis.domain for axis in shown.select_yaxes())
    assert all(lower[1] < upper[0] for lower, upper in itertools.pairwise(ends))
    assert [trace.yaxis for trace in shown.data[5:]] == ["y4", "y4", "y4", "y5", "y6"]
    assert [axis.matches for axis in shown.select_xaxes()] == [None, "x"]  # zoomed together


def test_a_section_may_be_figures_and_nothing_else() -> None:
    drawn = torques()
    drawn.append(figure(SCRIPT, "x", [Panel("y", [styled_curve(SCRIPT, [1, 2], [3, 4], 0)])]))
    page = Page(render("t", [("Power", drawn)], [], {}))
    complete(page)
    assert [one.label for one in page.figures] == [one.description for one in drawn]
    assert [one.data for one in page.figures] == [
        [{key: list(value) if key in ("x", "y") else value for key, value in trace.items()} for trace in one.data]
        for one in drawn
    ]
    assert "<" not in page.scripts[1]
    assert page.text.count(SCRIPT) == 2  # caption and legend


def test_equal_arrays_are_stored_once() -> None:
    page = Page(render("t", [("Power", torques())], [], {}))
    assert len(page.data["arrays"]) == 1 + 2 * 5  # the times once, and the curves of two joints
