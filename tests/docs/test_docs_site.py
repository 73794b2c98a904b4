"""The documentation's site, opened from disk in Chromium: no errors, nothing wider than a phone, dark mode, search."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import DRIVER, Browser, browser
from doc_pages import DOCS, PAGES, pages
from mkdocs.commands.build import build
from mkdocs.config import load_config

pytestmark = pytest.mark.skipif(DRIVER is None, reason="no chromedriver: install Debian's chromium-driver or Chrome's")

SECONDS = 10.0  # that a search or a change of colours may take
BROKEN = "return [...document.images].filter((image) => !image.naturalWidth).map((image) => image.src);"
WIDE = "return document.documentElement.scrollWidth > document.documentElement.clientWidth;"
THEME = "return document.documentElement.dataset.bsTheme;"
BACKGROUND = "return getComputedStyle(document.body).backgroundColor;"
SEARCH = """const field = document.getElementById("mkdocs-search-query");
field.value = arguments[0]; field.dispatchEvent(new Event("input"));"""
RESULTS = "return document.getElementById('mkdocs-search-results').innerText;"
LINKS = """return [...document.querySelectorAll("#mkdocs-search-results a")].map((link) => link.href);"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    build(load_config(str(DOCS / "mkdocs.yml"), site_dir=str(folder)))
    return folder


@pytest.fixture(scope="module")
def opened() -> Iterator[Browser]:
    with browser() as one:
        yield one


def test_every_page_fits_a_phone_and_has_no_errors(site: Path, opened: Browser) -> None:
    for page in pages():
        name = page.relative_to(PAGES)
        found = opened.use(site / name.with_suffix(".html"), 400, dark=True)
        is_wide = found["wide"]
        end = time.monotonic() + SECONDS
        while is_wide and time.monotonic() < end:  # a busy machine may not have the layout yet
            is_wide = opened.run(WIDE)
        assert (found["wrong"], is_wide) == ([], False), name


@pytest.mark.slow
@pytest.mark.parametrize("dark", [False, True])
def test_colours_are_those_of_the_system(site: Path, opened: Browser, dark: bool) -> None:
    opened.use(site / "index.html", 1400, dark)
    wanted = "dark" if dark else "light"
    end = time.monotonic() + SECONDS
    while opened.run(THEME) != wanted and time.monotonic() < end:  # the browser may tell the page later
        pass
    assert opened.run(THEME) == wanted
    red, _, _ = map(int, re.findall(r"\d+", opened.run(BACKGROUND))[:3])
    assert (red < 128) == dark


@pytest.mark.slow
@pytest.mark.parametrize("name", ["index.html", "benchmarks.html"])
def test_pictures_are_there_on_a_desk(site: Path, opened: Browser, name: str) -> None:
    found = opened.use(site / name, 1400, dark=False)
    assert (found["wrong"], found["wide"]) == ([], False)
    assert opened.run(BROKEN) == []


def searched(opened: Browser, words: str) -> list[str]:
    """Addresses of the sections that are found."""
    opened.run(SEARCH, words)
    end = time.monotonic() + SECONDS
    while not opened.run(RESULTS) and time.monotonic() < end:
        pass
    links: list[str] = opened.run(LINKS)
    return links


@pytest.mark.slow
def test_search_works_without_a_server(site: Path, opened: Browser) -> None:
    opened.use(site / "howto" / "report.html", 1400, dark=False)
    assert searched(opened, "stribeck_fr")[0] == f"{(site / 'effects.html').as_uri()}#stribeck_friction"
    assert any("#bounds-of-the-bodies" in link for link in searched(opened, "bounding ellipsoids"))
    assert searched(opened, "no:such^word") == []
