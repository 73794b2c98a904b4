"""Results and progress in a notebook."""

from __future__ import annotations

import html
import re
import sys
from html.parser import HTMLParser
from inspect import isfunction, signature
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from commands import LEG, TRAIN
from commands import idtool as run
from typing_extensions import override

import idtool
from idtool.api import notebook
from idtool.api.notebook import Displayable, shows_progress
from idtool.reporting.results.base import NoticeReport
from idtool.reporting.sections.base import Cell, Column, Table
from idtool.reporting.terminal.notebook import NotebookOutput

HOSTILE = "<script>alert(1)</script>\"'&$x$\x1b[31m\u202e"
STATE_COLOURS = {"#1a8a3a", "#b07500", "#dc3b30"}


class Elements(HTMLParser):
    """The tags and the text of a piece of HTML; every element must be closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: set[str] = set()
        self.text = ""
        self._open: list[str] = []
        self.feed(text)
        assert not self._open

    @override
    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}
        self._open.append(tag)

    @override
    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    @override
    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def result() -> idtool.FitResult:
    return idtool.fit(LEG, TRAIN, quick=True)


def test_every_result_has_html() -> None:
    results = [getattr(idtool, name) for name in idtool.__all__ if name.endswith("Result")]
    assert len(results) > 10
    assert all(issubclass(each, Displayable) for each in results)


def test_a_fit_shows_the_verdict_first_and_what_the_command_prints(result: idtool.FitResult, tmp_path: Path) -> None:
    shown = html.unescape(re.sub("<[^>]*>", " ", result._repr_html_()))
    assert shown.strip().startswith("Verdict: ")
    done = run("fit", LEG, TRAIN, "--quick", "--out", tmp_path)
    printed, _, written = done.out.partition("written:")
    assert written
    assert shown.split() == printed.split()


def test_the_html_needs_nothing_else_and_sets_no_colours_but_those_of_states(result: idtool.FitResult) -> None:
    shown = result._repr_html_()
    elements = Elements(shown)
    assert elements.tags <= {"div", "table", "thead", "tbody", "tr", "th", "td", "details", "summary"}
    assert elements.attributes <= {"style", "class", "title"}
    assert "background" not in shown
    assert set(re.findall(r"#[0-9a-f]{6}", shown)) <= STATE_COLOURS
    assert len(shown) < 20_000


def test_a_name_is_text_and_no_formula() -> None:
    output = NotebookOutput()
    output.say(HOSTILE, "bold yellow")
    output.show(Table(HOSTILE, [Column(HOSTILE, HOSTILE, help=HOSTILE)], [[Cell(HOSTILE, emphasis="bad")]] * 20))
    output.notices([NoticeReport(code="any", severity="warning", subject=HOSTILE, message=HOSTILE, advice=HOSTILE)])
    elements = Elements(output.html())
    assert "script" not in elements.tags
    assert elements.attributes == {"style", "class", "title"}
    assert elements.text.count("<script>alert(1)</script>") == 2 + 3 + 20 + 2
    assert output.html().startswith('<div class="tex2jax_ignore mathjax_ignore">')
    assert not {"\x1b", "\u202e"} & set(output.html())


def test_a_hostile_robot_is_text(tmp_path: Path) -> None:
    name = "<img src=x onerror=alert(2)>"
    urdf = tmp_path / "leg.urdf"
    urdf.write_text(LEG.read_text().replace("shank_link", html.escape(name)))
    elements = Elements(idtool.check(idtool.Model(urdf, {}))._repr_html_())
    assert "img" not in elements.tags
    assert name in elements.text


def test_a_long_table_is_folded() -> None:
    for count, folded in ((12, False), (13, True)):
        output = NotebookOutput()
        output.show(Table("rows", [Column("one")], [[Cell("1")]] * count))
        assert ("<details>" in output.html()) is folded


class Kernel:
    """IPython with a kernel, which keeps what is displayed."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.kernel: object | None = self
        self.shown: list[str] = []
        ipython, display = ModuleType("IPython"), ModuleType("IPython.display")
        ipython.get_ipython = lambda: self  # type: ignore[attr-defined]
        display.display = self.update  # type: ignore[attr-defined]
        patch.setitem(sys.modules, "IPython", ipython)
        patch.setitem(sys.modules, "IPython.display", display)
        patch.setattr(notebook, "_DELAY", 0.0)
        patch.setattr(notebook, "_INTERVAL", 0.0)

    def update(self, content: dict[str, str], **options: Any) -> Kernel:
        assert options.pop("raw")
        self.shown.append(content["text/html"])
        return self


@shows_progress
def work(*, fails: bool = False, progress: Any = None) -> bool:
    """Report two stages."""
    if progress is None:
        return False
    progress("reading <log>", 0.0)
    progress("solving", 0.25)
    if fails:
        raise ValueError("no solution")
    return True


def test_a_notebook_shows_a_bar_and_takes_it_away(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = Kernel(monkeypatch)
    assert work()
    bars = ["reading &lt;log&gt; <progress></progress>", 'solving <progress value="0.250"></progress>', ""]
    assert kernel.shown == bars
    with pytest.raises(ValueError, match="no solution"):
        work(fails=True)
    assert kernel.shown == 2 * bars


def test_short_work_shows_no_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = Kernel(monkeypatch)
    monkeypatch.setattr(notebook, "_DELAY", 60.0)
    assert work()
    assert kernel.shown == []


def test_the_users_callback_is_used_instead(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = Kernel(monkeypatch)
    stages: list[str] = []
    assert work(progress=lambda stage, share: stages.append(stage))
    assert stages == ["reading <log>", "solving"]
    assert kernel.shown == []


def test_there_is_no_bar_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not work()  # no IPython
    kernel = Kernel(monkeypatch)
    kernel.kernel = None  # IPython in a terminal
    assert not work()
    assert kernel.shown == []


def test_every_function_with_progress_shows_it(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = Kernel(monkeypatch)
    idtool.fit(LEG, TRAIN, quick=True)
    assert len(kernel.shown) > 2
    assert kernel.shown[-1] == ""
    functions = [function for name in idtool.__all__ if isfunction(function := getattr(idtool, name))]
    reporting = [function for function in functions if "progress" in signature(function).parameters]
    assert len(reporting) > 7
    assert all(hasattr(function, "__wrapped__") for function in reporting)
