"""The pictures of the report are small and on their pages; the drawn one agrees with the script that draws it."""

from __future__ import annotations

import re
import runpy
import tomllib
from pathlib import Path

import pytest
import yaml
from doc_pages import DOCS, README
from lxml import etree
from paths import CHECKOUT

COMMITTED = DOCS / "pages" / "images" / "report.svg"


def test_the_picture_is_up_to_date(tmp_path: Path) -> None:
    drawn = tmp_path / "report.svg"
    runpy.run_path(str(DOCS / "picture.py"))["main"](drawn)
    new, committed = drawn.read_text(), COMMITTED.read_text()
    etree.fromstring(new)  # it is well-formed
    labels = [re.findall(r">([^<]+)</text>", text) for text in (new, committed)]
    assert labels[0] == labels[1], "run python docs/picture.py"
    curves_per_joint = 4  # measured, prior, predicted, residual
    assert new.count("<polyline") == 3 * curves_per_joint


@pytest.mark.parametrize(
    ("page", "picture"),
    [(README, COMMITTED.with_suffix(".png")), (DOCS / "pages" / "index.md", COMMITTED)],
    ids=["README.md", "index.md"],
)
def test_the_picture_is_small_and_on_the_page(page: Path, picture: Path) -> None:
    assert picture.stat().st_size < 200_000
    assert str(picture.relative_to(page.parent)) in page.read_text()


def test_the_citation_has_the_version_and_the_license_of_the_package() -> None:
    citation = yaml.safe_load((DOCS / "CITATION.cff").read_text())
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())["project"]
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])
