"""Tables at every width: each name and figure in full, beside its own row's name, under its own heading."""

from __future__ import annotations

import contextlib
import io
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from commands import LEG, csv_text, idtool, sample_table
from diagnoses import candidate, diagnosis_of, faulty, fits, step_of
from records import partial

from idtool.reporting.diagnosis_report import diagnosis_report
from idtool.reporting.results.diagnosis import DiagnosisReport
from idtool.reporting.results.setup import InitReport
from idtool.reporting.results.study import StudyReport
from idtool.reporting.results.validation import RegressionReport
from idtool.reporting.sections import Cell, Column, Table
from idtool.reporting.terminal import Terminal
from idtool.reporting.terminal.diagnosis import show_diagnosis
from idtool.reporting.terminal.init import show_initial_config
from idtool.reporting.terminal.layout import table_lines
from idtool.reporting.terminal.study import show_study
from idtool.reporting.terminal.validation import show_regression

NAMES = {"abad": "left_shoulder_pitch_joint", "hip": "panda_joint3", "knee": "FL_calf_joint"}
WIDTHS = (60, 80, 200)


def renamed(text: str) -> str:
    """The leg's words with the names of larger robots."""
    return re.sub("|".join(NAMES), lambda found: NAMES[found[0]], text)


def lines_of(table: Table, width: int) -> list[str]:
    """What the terminal shows of a table."""
    return [line.plain for line in table_lines(table.in_terminal(), width)]


def rows_of(table: Table) -> list[list[str]]:
    """The texts of the cells that the terminal has to show."""
    return [[cell.text for cell in row] for row in table.in_terminal().rows]


def table_of(columns: list[Column], *rows: tuple[str, ...]) -> Table:
    return Table("Title", columns, [[Cell(text) for text in row] for row in rows])


def name(heading: str = "joint") -> Column:
    return Column(heading, kind="name")


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Table]]:
    """The tables of each command, of a leg with long names."""
    folder = tmp_path_factory.mktemp("long")
    for name in ("leg.urdf", "leg.yaml"):
        (folder / name).write_text(renamed(LEG.with_name(name).read_text()))
    samples = sample_table(3600)
    for name, rows in (("one.csv", samples[1:1800]), ("two.csv", samples[1800:])):
        (folder / name).write_text(renamed(csv_text([samples[0], *rows])))
    with pytest.MonkeyPatch.context() as patch:
        return {name: noted(patch, show) for name, show in shows(folder).items()}


def noted(patch: pytest.MonkeyPatch, show: Callable[[], object]) -> list[Table]:
    """The tables that are shown on the way."""
    tables: list[Table] = []
    with patch.context() as noting:
        noting.setattr(Terminal, "show", lambda _, table: tables.append(table))
        show()
    return tables


def shows(folder: Path) -> dict[str, Callable[[], object]]:
    """What shows each command's tables."""

    def command(*words: object) -> Callable[[], object]:
        def run() -> None:
            done = idtool(*words, folder=folder)
            assert done.code == 0, done.err

        return run

    terminal = Terminal(quiet=True, as_json=False)
    outcome = {"case": "leg on the other leg's log", "rms": 0.123456, "bound": 0.5, "prior": 1234.5, "ok": True}
    cases = partial(RegressionReport, {"cases": [{**outcome, "joint": name} for name in NAMES.values()]})
    logs = ("leg.urdf", "one.csv", "two.csv")
    tried = {"friction": dict.fromkeys(NAMES.values(), 1.234567), "found": dict.fromkeys(NAMES.values(), 0.1)}
    said: dict[str, list[str]] = {key: [] for key in ("warnings", "found", "left", "needed")}
    start = {"rms": tried, "band_hz": 10.0, "file": "leg.yaml", "next": "idtool fit", **said}
    quick = ("--iterations", "1", "--duration", "3")
    return {
        "inspect": command("inspect", "one.csv"),
        "init": lambda: show_initial_config(terminal, partial(InitReport, start)),
        "fit": command("fit", *logs, "--out", "fit"),
        "validate": command("validate", *logs, "--prior", "leg.urdf", "--max-rms", "100"),
        "regression": lambda: show_regression(terminal, cases),
        "diagnose": lambda: show_diagnosis(terminal, diagnosed(folder), folder, (), explain=True),
        "adapt": command("adapt", *logs[:2]),
        "study": lambda: show_study(terminal, partial(StudyReport, studied()), folder),
        "excite": command("excite", "leg.urdf", "--log", "one.csv", *quick, "--out", "e.csv"),
        "check": command("ellipsoids", "leg.urdf", "--check", "--repair", "repaired.urdf"),
    }


def studied() -> dict[str, Any]:
    """A report of study, whose names are idtool's own."""
    sets = ("none", "semi", "full", "com_ellipsoid", "ellipsoid", "points")
    rms = {part: {"overall": 0.123456} for part in ("train", "validation")}
    solved = {"rms": rms, "seconds": 12.3456, "duality_gap": 1e-9, "note": "", "violations": 7}
    return {
        "units": {"knee": "N·m", "slide": "N"},
        "band_hz": 10.0,
        "sets": {name: {**solved, "lmi": "119 linear, 4×4"} for name in sets},
        "estimators": {name: {**solved, "iterations": 6000} for name in ("euclidean", "log_cholesky")},
        "learning": {
            "draws": 40,
            "counts": [1, 543],
            "curves": {name: {"median": [0.123456, 0.00123456]} for name in sets},
            "violation": {name: [0.00123456, 10.72] for name in sets},
        },
        "adaptation": {"time_to_10_percent": {"none": None, "full": 1.2345}},
        "warnings": [],
        "seconds": 64.0,
    }


def diagnosed(folder: Path) -> DiagnosisReport:
    """A report of diagnose with all that can be in it."""
    first, last = fits(folder)
    rival = candidate("load_dependent_friction", "knee", score=0.6, reason="explains less of what was held out")
    diagnosis = faulty(diagnosis_of(first, last, step_of(alternatives=(rival,))))
    worse = replace(diagnosis.after, simulation=dict.fromkeys(("abad", "hip", "knee", "overall"), 0.123))
    report = diagnosis_report(replace(diagnosis, after=worse), "refit")
    return DiagnosisReport.model_validate(json.loads(renamed(json.dumps(report.to_json()))))


COMMANDS = ("inspect", "init", "fit", "validate", "regression", "diagnose", "adapt", "study", "excite", "check")


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("command", COMMANDS)
def test_nothing_in_a_commands_tables_is_cut(shown: dict[str, list[Table]], command: str, width: int) -> None:
    assert shown[command]
    for one in shown[command]:
        lines = lines_of(one, width)
        assert not Counter(word for row in rows_of(one) for cell in row for word in cell.split()) - Counter(
            word for line in lines for word in line.split()
        )
        assert max(map(len, lines)) <= width, lines
        assert all(line == line.rstrip() for line in lines)


@pytest.mark.parametrize("command", COMMANDS)
def test_in_a_pipe_a_row_is_a_line(shown: dict[str, list[Table]], command: str) -> None:
    for one in shown[command]:
        _, *lines = lines_of(one, 100_000)
        assert [line.split() for line in lines] == [" ".join(row).split() for row in rows_of(one)]


def test_in_a_pipe_a_table_is_as_wide_as_it_needs() -> None:
    columns = [name(), *(Column(f"column {i}") for i in range(100))]
    table = table_of(columns, ("left_shoulder_pitch_joint", *(f"{i}.123" for i in range(100))))
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        Terminal(quiet=False, as_json=False).show(table)
    assert [len(line.split("  ")) > 100 for line in out.getvalue().splitlines()] == [False, True, True, False]


def values(lines: list[str]) -> Iterator[tuple[str, str, str]]:
    """The heading, name and text of every cell of tables whose cells are one word each and whose headings are, too."""
    heads: list[str] = []
    for line in lines:
        if not line:
            heads = []
        elif not heads:
            heads = line.split()
        else:
            name, *cells = line.split()
            yield from ((head, name, cell) for head, cell in zip(heads[1:], cells, strict=True))


@pytest.mark.parametrize("width", range(12, 90, 3))
def test_parts_of_a_table_hold_each_cell_once_beside_its_name(width: int) -> None:
    heads = ["a", "second", "c", "the_fourth", "e", "f"]
    columns = [name(), *(Column(head, attached=head in ("the_fourth", "e")) for head in heads)]
    rows = []
    wanted = []
    for i, joint in enumerate(("hip", "knee", "neck")):
        cells = [f"{(i + 1) * 10.0 ** (-k):.{k}f}" for k in range(len(heads))]
        rows.append((joint, *cells))
        wanted += [(head, joint, cell) for head, cell in zip(heads, cells, strict=True)]
    lines = lines_of(table_of(columns, *rows), width)
    assert sorted(values(lines)) == sorted(wanted)
    assert max(map(len, lines)) <= max(width, len("joint  the_fourth"))


def test_what_stays_side_by_side_does() -> None:
    error = Column("± se", attached=True)
    columns = [name(), Column("a"), Column("viscous"), error, Column("Coulomb"), error]
    table = table_of(columns, ("hip", "1", "22.22", "3.333", "44.44", "5.555"))
    assert lines_of(table, 24) == [
        "joint  a  viscous   ± se",
        "hip    1    22.22  3.333",
        "",
        "joint  Coulomb   ± se",
        "hip      44.44  5.555",
    ]


def test_headings_are_broken_before_a_table_is_taken_apart_and_so_are_words() -> None:
    columns = [name(), Column("noise floor"), Column("why not", kind="words")]
    table = table_of(columns, ("hip", "0.1", "it explains no more, it seems, than chance would"))
    assert lines_of(table, 38) == [
        "       noise",
        "joint  floor  why not",
        "hip      0.1  it explains no more, it",
        "              seems, than chance would",
    ]
    sums = [Column("base parameter", kind="words"), Column("prior")]
    assert lines_of(table_of(sums, ("link1 I_zz + 0.25 link2 mass − 0.5 link3 mass", "1.5")), 31)[1:] == [
        "link1 I_zz + 0.25 link2     1.5",
        "mass − 0.5 link3 mass",
    ]


def test_columns_without_content_give_way() -> None:
    table = table_of([name(), Column("rms"), Column("bound")], ("left_shoulder_pitch_joint", "0.1234", ""))
    assert "bound" in lines_of(table, 200)[0]
    assert lines_of(table, 33) == [
        "joint                         rms",
        "left_shoulder_pitch_joint  0.1234",
    ]


def test_columns_of_the_page_and_rows_beyond_the_most_are_left_out() -> None:
    columns = [name(), Column("mass", "kg"), Column("margin", "kg", page_only=True)]
    table = replace(table_of(columns, ("hip", "1", "2"), ("knee", "3", "4")), max_terminal_rows=1)
    assert lines_of(table, 80) == ["joint  mass kg", "hip          1"]


def test_a_row_has_a_cell_for_each_column() -> None:
    with pytest.raises(ValueError, match="Title"):
        table_of([name(), Column("rms")], ("hip",))


def test_a_name_wider_than_the_terminal_stays_whole() -> None:
    joint = "a" * 70
    table = table_of([name(), Column("rms"), Column("bound")], (joint, "0.1234", "0.5"))
    parts = [["joint", "rms"], [joint, "0.1234"], ["joint", "bound"], [joint, "0.5"]]
    assert [line.split() for line in lines_of(table, 60) if line] == parts


def test_names_cannot_steer_the_terminal_and_wide_letters_count_twice() -> None:
    rows = [[Cell("[b]\x1b[2J\n"), Cell("1")], [Cell("関節"), Cell("2", emphasis="bad")]]
    lines = list(table_lines(Table("Title", [name(), Column("rms")], rows), 80))
    assert [line.plain.split() for line in lines[1:]] == [["[b]\\x1b[2J\\n", "1"], ["関節", "2"]]
    assert lines[1].cell_len == lines[2].cell_len
    assert [str(span.style) for span in lines[2].spans] == ["bold red"]


def test_an_empty_table_has_its_headings() -> None:
    assert lines_of(table_of([name(), Column("rms")]), 80) == ["joint  rms"]
