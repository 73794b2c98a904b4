"""`Section`: one part of a report. It makes its table from the report once, for the page and for the terminal.

A table is a plain record; the terminal lays it out, and a template of the page shows it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace
from typing import Generic, Literal, TypeVar

from idtool.common.dataclass import dataclass
from idtool.common.number_text import number, with_error
from idtool.common.units import common_unit
from idtool.reporting.number_text import percent

R_contra = TypeVar("R_contra", contravariant=True)

Kind = Literal["name", "number", "words"]
Emphasis = Literal["good", "note", "bad"]

_MAX_PHONE_COLUMNS = 4  # that fit side by side
_MAX_STACKED_ROWS = 30  # longer tables are for looking a row up
NO_VALUE = "–"  # shown instead of a number that does not exist


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    heading
        Text above it.
    unit
        Unit of its numbers, if it is not in the table's title.
    kind
        ``name`` and ``words`` are aligned left, ``number`` right; only ``words`` may be wrapped.
    help
        Explanation of the heading.
    page_only
        True for a column that the terminal leaves out.
    attached
        True for a column that stays with the one to its left if the terminal splits a wide table.
    """

    heading: str
    unit: str = ""
    kind: Kind = "number"
    help: str = ""
    page_only: bool = False
    attached: bool = False


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Attributes
    ----------
    text
        Text that is shown.
    value
        The number with all its digits; None if there is none.
    emphasis
        Assessment, shown as a colour.
    lines
        The parts of a text that the page shows one below the other; empty: the text is one part.
    """

    text: str
    value: float | None = None
    emphasis: Emphasis | None = None
    lines: Sequence[str] = ()

    @classmethod
    def of_lines(cls, lines: Sequence[str]) -> Cell:
        """A cell with several texts, which are separated by commas in the terminal."""
        return cls(", ".join(lines), lines=lines)


@dataclass(frozen=True)
class Table:
    """Rows under headings.

    Attributes
    ----------
    title
        Quantity in the table, with the unit if all have the same.
    columns
        The columns.
    rows
        The cells, one for each column.
    key_columns
        Number of columns at the left that identify a row; the terminal repeats them if it splits the table.
    max_terminal_rows
        Largest number of rows in the terminal; None: all.
    """

    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]] = field(default=())
    key_columns: int = 1
    max_terminal_rows: int | None = None

    def __post_init__(self) -> None:
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError(f"{self.title}: the number of cells in a row differs from the number of columns")

    @property
    def is_stacked_on_phones(self) -> bool:
        """True if a narrow screen shows each row as a list of headings and values; a long table is scrolled there."""
        return len(self.columns) > _MAX_PHONE_COLUMNS and len(self.rows) <= _MAX_STACKED_ROWS

    def text_width(self, index: int) -> int:
        """Length of the longest text in a column, without its heading [characters]."""
        texts = [text for row in self.rows for text in (row[index].lines or (row[index].text,))]
        return max(map(len, texts), default=0)

    def in_terminal(self) -> Table:
        """The table without the columns and rows that only the page shows."""
        shown = [i for i, column in enumerate(self.columns) if not column.page_only]
        columns = [self.columns[i] for i in shown]
        rows = [[row[i] for i in shown] for row in self.rows[: self.max_terminal_rows]]
        return replace(self, columns=columns, rows=rows)


class Section(ABC, Generic[R_contra]):
    """A part of a report with a table.

    Attributes
    ----------
    title
        Heading on the page.
    template
        The file under ``templates/`` that shows the section on the page, table and text included.
    parts
        Subsections, which the page shows below the table.
    """

    title: str
    template: str = "section.html"
    parts: Sequence[Section[R_contra]] = ()

    @abstractmethod
    def table(self, report: R_contra) -> Table | None:
        """Table made from the report; None if the report has nothing to show."""

    def text(self, report: R_contra) -> str:
        """Text of the page below the table; may be empty."""
        return ""


def name_column(heading: str) -> Column:
    """A column of names, which are never wrapped."""
    return Column(heading, kind="name")


def number_cell(x: float | None, digits: int = 3, emphasis: Emphasis | None = None) -> Cell:
    """A number to ``digits`` significant digits; a dash for None."""
    known = x is not None and math.isfinite(x)
    return Cell(number(x, digits), x if known else None, emphasis)


def percent_cell(x: float | None) -> Cell:
    """A fraction in percent; a dash for None."""
    return Cell(percent(x), x)


def error_cells(x: float | None, error: float | None) -> tuple[Cell, Cell]:
    """A figure and its standard error, to two digits of the error; a dash for what is None."""
    known = error is not None and math.isfinite(error)
    value, deviation = with_error(x, error)
    if x is None or not known:
        return Cell(value, x), Cell(NO_VALUE)
    return Cell(value, x), Cell(deviation, error)


def realizable_cell(realizable: bool) -> Cell:
    """The cell of a body's realizability."""
    return Cell("yes") if realizable else Cell("NO", emphasis="bad")


def error_column(page_only: bool = False) -> Column:
    """The column of the standard errors of the figures to its left."""
    return Column("± se", help="Standard error", attached=True, page_only=page_only)


def unit_columns(units: Mapping[str, str]) -> list[Column]:
    """The column of the joints' units; none where all have the same, which the title tells."""
    if len(set(units.values())) > 1:
        return [name_column("unit")]
    return []


def kind_label(kind: str) -> str:
    """A kind of rows, a key of ``rms_by_kind``, in words: ``base force``."""
    for part in ("force", "moment"):
        if kind.endswith(f"_{part}"):
            return f"{kind.removesuffix(f'_{part}')} {part}"
    return kind


def kind_units(kinds: Iterable[str], units: Mapping[str, str]) -> dict[str, str]:
    """Unit of each kind of rows, a key of ``rms_by_kind``, from the units by row.

    The rows of each force and moment are named after it; all others are joints.
    """
    of_joints = dict(units)
    by_kind = {}
    for kind in kinds:
        if kind != "joints":
            by_kind[kind] = common_unit({axis: of_joints.pop(f"{kind}_{axis}") for axis in "xyz"})
    return {"joints": common_unit(of_joints), **by_kind}


def unit_cells(units: Mapping[str, str], joint: str) -> list[Cell]:
    """The cell of `unit_columns` for a joint, or for ``overall``."""
    if not unit_columns(units):
        return []
    return [Cell(units.get(joint) or common_unit(units))]
