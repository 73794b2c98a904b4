"""The picture in README.md is that of its script."""

from __future__ import annotations

import runpy
from pathlib import Path
from xml.etree import ElementTree

import pytest
from doc_pages import DOCS, README

COMMITTED = DOCS / "pages" / "images" / "report.svg"
SVG = "{http://www.w3.org/2000/svg}"


def texts(file: Path) -> list[str]:
    return [element.text or "" for element in ElementTree.parse(file).iter(f"{SVG}text")]


def test_the_picture_is_that_of_its_script(tmp_path: Path) -> None:
    script = runpy.run_path(str(DOCS / "picture.py"))
    drawn = tmp_path / "report.svg"
    script["main"](drawn)
    assert texts(drawn) == texts(COMMITTED)
    assert (
        len(list(ElementTree.parse(drawn).iter(f"{SVG}polyline"))) == 12
    )  # three torques and a residual of each joint


@pytest.mark.parametrize("page", [README, DOCS / "pages" / "index.md"], ids=["README.md", "index.md"])
def test_the_picture_is_small_and_shown(page: Path) -> None:
    assert COMMITTED.stat().st_size < 200_000
    assert str(COMMITTED.relative_to(page.parent)) in page.read_text()
