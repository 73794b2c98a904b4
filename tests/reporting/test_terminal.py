"""What the terminal shows beside tables: colours, warnings and what to do about them, remarks, and progress."""

from __future__ import annotations

import contextlib
import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from commands import Result, csv_text, idtool, sample_table
from diagnoses import diagnosis_of, fits, step_of
from pages import Page
from records import partial
from rich.console import Console

from idtool.common.notice import Notice, Severity
from idtool.diagnosis.records import Diagnosis
from idtool.reporting.diagnosis_report import diagnosis_report
from idtool.reporting.pages.diagnosis import diagnosis_page
from idtool.reporting.results.base import NoticeReport
from idtool.reporting.results.export import ExportReport
from idtool.reporting.results.rollouts import Simulation
from idtool.reporting.terminal import Terminal
from idtool.reporting.terminal.diagnosis import show_diagnosis
from idtool.reporting.terminal.export import show_export
from idtool.reporting.terminal.simulation import show_simulation

CODE = re.compile(r"\x1b\[([\d;?]*)([a-zA-Z])")
COLOURS = {str(code) for code in (*range(30, 50), *range(90, 108))}


class Screen(io.StringIO):
    """A terminal that keeps what was written to it."""

    def isatty(self) -> bool:
        return True

    def terminal(self, quiet: bool = False, errors: io.StringIO | None = None) -> Terminal:
        """What a command prints with; standard error may go elsewhere."""
        with contextlib.redirect_stdout(self), contextlib.redirect_stderr(errors or self):
            return Terminal(quiet, as_json=False)

    @property
    def colours(self) -> set[str]:
        found = (set(codes.split(";")) for codes, kind in CODE.findall(self.getvalue()) if kind == "m")
        return set().union(*found) & COLOURS


def notice(severity: Severity, subject: str | None, message: str, advice: str) -> NoticeReport:
    return NoticeReport(code="any", severity=severity, subject=subject, message=message, advice=advice)


SOMETHING = notice("warning", None, "something", "")


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Screen:
    """A terminal in colour, if nothing else is asked for."""
    for name in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE", "COLUMNS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm-256color")
    return Screen()


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log with a finding."""
    path = tmp_path_factory.mktemp("logs") / "log.csv"
    path.write_text(csv_text(sample_table(1500)))
    return path


def said(show: Callable[[Terminal], object]) -> str:
    """What is shown on a wide terminal without colours."""
    terminal, out = Terminal(quiet=False, as_json=False), io.StringIO()
    terminal.console = Console(file=out, width=1000, highlight=False)
    show(terminal)
    return out.getvalue()


def inspected(log: Path, *options: str) -> Result:
    done = idtool("inspect", log, *options)
    assert done.code == 0
    return done


def test_in_a_pipe_text_is_plain(log: Path) -> None:
    done = inspected(log)
    assert done.out.startswith(f"{log}: 1500 samples")
    assert "\x1b" not in done.out
    assert done.err == ""


def test_json_is_alone_on_standard_output(log: Path) -> None:
    done = inspected(log, "--json")
    assert done.json["samples"] == 1500
    assert done.err == inspected(log).out


def test_quiet_prints_nothing(log: Path) -> None:
    done = inspected(log, "--quiet")
    assert (done.out, done.err) == ("", "")
    done = inspected(log, "--quiet", "--json")
    assert (json.loads(done.out)["samples"], done.err) == (1500, "")


def test_no_color_leaves_no_colours(screen: Screen, monkeypatch: pytest.MonkeyPatch) -> None:
    screen.terminal().notices([SOMETHING])
    assert screen.colours
    monkeypatch.setenv("NO_COLOR", "1")
    plain = Screen()
    plain.terminal().notices([SOMETHING])
    assert "warning: something" in plain.getvalue()
    assert plain.colours == set()


def test_a_dumb_terminal_gets_no_codes(screen: Screen, monkeypatch: pytest.MonkeyPatch, at_once: None) -> None:
    monkeypatch.setenv("TERM", "dumb")
    terminal = screen.terminal()
    work(terminal, ("reading", 0.5))
    terminal.notices([SOMETHING])
    assert screen.getvalue() == "warning: something\n"


@pytest.mark.parametrize(
    ("encoding", "shown"), [("ascii", "1 N?m ? 2"), ("cp1252", "1 N·m ? 2"), ("utf-8", "1 N·m → 2")]
)
def test_what_an_encoding_has_not_is_replaced(encoding: str, shown: str) -> None:
    written = io.BytesIO()
    out = io.TextIOWrapper(written, encoding, write_through=True)
    with contextlib.redirect_stdout(out):
        Terminal(quiet=False, as_json=False).say("1 N·m → 2")
    assert written.getvalue().decode(encoding) == f"{shown}\n"


def test_what_would_steer_the_terminal_is_shown_as_text() -> None:
    assert said(lambda terminal: terminal.say("\x1b[2Jhip\x9b1m, N·m")) == "\\x1b[2Jhip\\x9b1m, N·m\n"
    assert said(lambda terminal: terminal.say("[bold]hip[/bold]")) == "[bold]hip[/bold]\n"


def test_notices_are_followed_by_their_advice_once_for_those_alike() -> None:
    lacking = notice("warning", "panda_link3", "no bounding ellipsoid", "add one to the configuration")
    still = [notice("note", name, "held still at 0", "if it stood elsewhere, say where") for name in ("neck", "jaw")]
    gap = notice("problem", None, "mind the gap", "")
    assert said(lambda terminal: terminal.notices([lacking, *still, gap])).splitlines() == [
        "warning: panda_link3: no bounding ellipsoid",
        "    add one to the configuration",
        "note: neck, jaw: held still at 0",
        "    if it stood elsewhere, say where",
        "problem: mind the gap",
    ]


def test_export_names_every_part_in_full() -> None:
    names = [f"{'FL_hip_rotor' * 6}_{i}" for i in range(9)]
    carried = [{"what": "rotor", "of": name, "detail": "as it is"} for name in names]
    lost = [
        {"what": "friction", "of": name, "detail": "there is none", "value": 0.1 * i, "unit": "N·m"}
        for i, name in enumerate(names)
    ]
    report = partial(ExportReport, {"file": "m.xml", "carried": carried, "not_carried": lost})
    text = said(lambda terminal: show_export(terminal, report))
    assert text.splitlines() == [
        f"exported: rotor of {', '.join(names)}",
        f"not exported: friction of {', '.join(names)}: there is none, up to 0.8 N·m",
        "written: m.xml",
    ]


def simulated(position: float | None, at: dict[float, float | None], kind: str = "open_loop") -> str:
    """The terminal on a model with these errors where the baseline's is 1."""
    found = {
        "kind": kind,
        "window": 1.0,
        "seconds": 20.0,
        "units": {"hip": "rad"},
        "position": {"hip": position, "overall": position},
        "prior": None,
        "baseline": {"position": {"hip": 1.0, "overall": 1.0}},
        "horizon": [
            {"seconds": seconds, "position": {"overall": x}, "baseline": {"overall": 1.0}, "prior": None}
            for seconds, x in at.items()
        ],
    }
    return said(lambda terminal: show_simulation(terminal, partial(Simulation, found)))


def test_a_model_worse_than_none_is_said_to_be() -> None:
    worse = "Simulated for 1 s at a time, the model has a larger error than "
    stays = "a robot that keeps its position"
    assert "larger error" not in simulated(0.9, {0.01: 0.1, 0.1: 1.1})
    assert f"{worse}{stays}." in simulated(1.5, {0.01: 1.1, 0.05: 0.2})
    assert f"{worse}a robot that follows its command exactly." in simulated(1.5, {}, "closed_loop")
    assert f"{worse}{stays}." in simulated(None, {0.01: 0.1, 0.05: None})


@pytest.fixture(scope="module")
def undone(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    """A diagnosis of a log with a fault that is undone, and one that is not."""
    diagnosis = diagnosis_of(*fits(tmp_path_factory.mktemp("leg")), step_of())
    faults = (
        Notice("velocity_lag", "note", "hip", "v lags", "idtool corrects it"),
        Notice("stale", "warning", "knee", "values repeat", "check the bus"),
        Notice("time_jitter", "note", None, "stamps jitter"),
    )
    return replace(diagnosis, faults=faults)


def test_a_fault_that_is_undone_is_a_note(undone: Diagnosis) -> None:
    report = diagnosis_report(undone, "refit")
    lines = said(lambda terminal: show_diagnosis(terminal, report, Path("out"), (), explain=False)).splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("data fault"))
    assert lines[first - 1] == ""
    assert lines[first : first + 3] == [
        "data fault (knee): values repeat; check the bus",
        "note on the data (hip): v lags; idtool corrects it",
        "note on the data: stamps jitter",
    ]
    page = Page(diagnosis_page(undone, report, "idtool diagnose"))
    assert page.levels[:2] == ["bad", "note"]
    assert "Data fault, knee. stale" in page.plain
    assert "Note on the data, hip. velocity lag" in page.plain


class Clock:
    """A timer for which no time passes, until it is told that all of it has."""

    passed = False

    def __init__(self, seconds: float, then: Callable[[], None]) -> None:
        self.seconds, self.then = seconds, then
        self.daemon = False

    def start(self) -> None:
        assert self.daemon  # it must not outlive a command that was stopped
        assert self.seconds <= 2.0
        if self.passed:
            self.then()

    def cancel(self) -> None:
        pass


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """All work is done in no time."""
    monkeypatch.setattr("threading.Timer", Clock)


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Work has taken more than two seconds as soon as it has begun."""
    monkeypatch.setattr("threading.Timer", type("Late", (Clock,), {"passed": True}))


def work(terminal: Terminal, *stages: tuple[str, float]) -> None:
    with terminal.progress() as tell:
        for stage, share in stages:
            tell(stage, share)


def test_long_work_shows_its_stages_even_those_whose_share_is_not_known(screen: Screen, at_once: None) -> None:
    work(screen.terminal(), ("reading [1].csv", 0.0), ("solving", 0.25), ("solving", 0.75))
    text = CODE.sub("", screen.getvalue())
    assert text.index("working") < text.index("reading [1].csv") < text.index("solving")
    assert CODE.findall(screen.getvalue())[-1] == ("2", "K")  # and leaves nothing behind


def test_work_that_tells_its_stage_and_nothing_more_shows_it_once_it_is_long(
    screen: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    clocks: list[Clock] = []
    monkeypatch.setattr("threading.Timer", lambda *how: clocks.append(Clock(*how)) or clocks[0])
    with screen.terminal().progress() as tell:
        tell("inspecting", 0.0)
        assert screen.getvalue() == ""
        clocks[0].then()
        assert "inspecting" in screen.getvalue()


def test_short_work_shows_nothing(screen: Screen, short: None) -> None:
    work(screen.terminal(), ("reading", 0.0), ("solving", 0.5))
    assert screen.getvalue() == ""


def test_quiet_work_and_work_in_a_pipe_show_nothing(
    screen: Screen, at_once: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    work(screen.terminal(quiet=True), ("reading", 0.5))
    assert screen.getvalue() == ""
    monkeypatch.setenv("FORCE_COLOR", "1")
    pipe = io.StringIO()
    work(screen.terminal(errors=pipe), ("reading", 0.5))
    assert (screen.getvalue(), pipe.getvalue()) == ("", "")


def test_work_that_is_stopped_takes_its_bar_away(screen: Screen, at_once: None) -> None:
    def stopped() -> None:
        with screen.terminal().progress() as tell:
            tell("solving", 0.5)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    codes = CODE.findall(screen.getvalue())
    assert codes[-1] == ("2", "K")
    assert ("?25", "h") in codes  # the cursor is there again
