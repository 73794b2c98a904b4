"""The pages in Chromium: every plot is drawn, nothing goes wrong, on a desk and on a phone, light and dark."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import DRIVER, LOOK, MOVE, ROBOT, Browser, browser
from commands import LEG, TRAIN, VALIDATE, csv_text, idtool, sample_table

pytestmark = pytest.mark.skipif(DRIVER is None, reason="no chromedriver: install Debian's chromium-driver or Chrome's")

PAGES = ("report.html", "validation.html", "diagnosis.html", "study.html")


@pytest.fixture(scope="module")
def opened() -> Iterator[Browser]:
    with browser() as one:
        yield one


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pages of the sample leg, by the commands."""
    out = tmp_path_factory.mktemp("pages")
    short = out / "short.csv"
    short.write_text(csv_text(sample_table(3000)))
    for command in (
        ("fit", LEG, TRAIN, "--validate", VALIDATE),
        ("validate", LEG, VALIDATE),
        ("diagnose", LEG, TRAIN, "--validate", VALIDATE, "--no-simulation", "--report-only"),
        ("study", LEG, short, "--draws", "5"),
    ):
        assert idtool(*command, "--out", out, "--quiet").code == 0
    return out


@pytest.mark.parametrize("name", PAGES)
def test_every_plot_is_drawn(pages: Path, opened: Browser, name: str) -> None:
    for width in (1400, 400):
        for dark in (False, True):
            found = opened.use(pages / name, width, dark)
            assert found["plots"] > 2
            assert (found["blank"], found["wrong"], found["wide"]) == ([], [], False)
            assert found["dark"] == dark


def at_rest(opened: Browser) -> dict[str, Any]:
    """The robot's plot, which turns on for a while when the mouse lets go."""
    before, now = None, opened.run(ROBOT)
    while before is None or now["eye"] != pytest.approx(before["eye"]):
        before, now = now, opened.run(ROBOT)
    return dict(now)


@pytest.mark.parametrize("name", ["report.html", "validation.html", "diagnosis.html"])
def test_the_robot_moves_and_turns(pages: Path, opened: Browser, name: str) -> None:
    """The slider moves it, the mouse turns it, and it stays turned when it is moved again."""
    opened.use(pages / name, 1400, False)
    opened.run(LOOK)
    first = opened.run(ROBOT)
    opened.run(MOVE, 30)
    moved = opened.run(ROBOT)
    assert moved["places"] != first["places"]
    assert moved["eye"] == pytest.approx(first["eye"])
    opened.drag(moved["x"], moved["y"], 200)
    turned = at_rest(opened)
    assert np.linalg.norm(np.subtract(*([one["eye"][k] for k in "xyz"] for one in (turned, moved)))) > 0.2
    opened.run(MOVE, 0)
    again = opened.run(ROBOT)
    assert again["places"] == first["places"]
    assert again["eye"] == pytest.approx(turned["eye"])
