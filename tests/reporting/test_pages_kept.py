"""Templates that an earlier process compiled: the page is the same, and what is damaged or outdated is not used."""

from __future__ import annotations

import marshal
import os
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = "from idtool.reporting.pages.base import render; print(render('T & t', [], [], {'x': 1}))"


def page(folder: Path) -> str:
    """A page, by a process of its own that keeps compiled files in a folder."""
    command = [sys.executable, "-X", f"pycache_prefix={folder}", "-c", PAGE]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("kept")
    return folder, page(folder)


def templates(folder: Path) -> list[Path]:
    found = sorted(folder.rglob("template-*"))
    assert found
    return found


def test_a_page_of_kept_templates_is_the_same(first: tuple[Path, str]) -> None:
    folder, html = first
    before = {path: path.stat().st_mtime_ns for path in templates(folder)}
    assert "T &amp; t" in html
    assert page(folder) == html
    assert {path: path.stat().st_mtime_ns for path in templates(folder)} == before


@pytest.mark.parametrize(
    "content", [b"", b"damaged", marshal.dumps(("of another compiler", compile("raise SystemExit", "x", "exec")))]
)
def test_a_damaged_or_outdated_template_is_compiled_anew(first: tuple[Path, str], content: bytes) -> None:
    folder, html = first
    good = {path: path.read_bytes() for path in templates(folder)}
    for path in good:
        path.write_bytes(content)
    assert page(folder) == html
    assert {path: path.read_bytes() for path in templates(folder)} == good
