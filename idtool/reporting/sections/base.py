"""`Section` and its `Table`, a plain record; and the text of cells."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic, Literal, TypeVar

from idtool.reporting.diagnosis_text import common_unit
from idtool.reporting.number_text import number, percent, with_error

R_contra = TypeVar("R_contra", contravariant=True)

Kind = Literal["name", "number", "words"]
Emphasis = Literal["good", "note", "bad"]

NO_VALUE = "–"  # a figure that there is not


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    heading
        Text above it.
    unit
        Unit of its figures, where the table's title does not tell it.
    kind
        ``name`` and ``words`` stand flush left, ``number`` flush right; only ``words`` may be broken.
    help
        Explanation of the heading.
    page_only
        Whether the terminal leaves it out.
    attached
        Whether it stays beside the column to its left where the terminal takes a table apart.
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
        The number, with all its digits; None where there is none.
    emphasis
        Assessment, shown as a colour.
    """

    text: str
    value: float | None = None
    emphasis: Emphasis | None = None


@dataclass(frozen=True)
class Table:
    """Rows under headings.

    Attributes
    ----------
    title
        Quantity in the table, with the unit if all have the same.
    columns
        The columns; the first ones tell the rows apart.
    rows
        The cells, one for each column.
    keys
        The number of columns that tell the rows apart.
    most_rows
        The number of rows that the terminal shows at most.
    """

    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]] = field(default=())
    keys: int = 1
    most_rows: int | None = None

    def __post_init__(self) -> None:
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError(f"{self.title}: a row has not as many cells as there are columns")

    def in_terminal(self) -> Table:
        """The table as the terminal shows it: without columns and rows that are only the page's."""
        shown = [i for i, column in enumerate(self.columns) if not column.page_only]
        columns = [self.columns[i] for i in shown]
        rows = [[row[i] for i in shown] for row in self.rows[: self.most_rows]]
        return replace(self, columns=columns, rows=rows)


class Section(ABC, Generic[R_contra]):
    """A part of a report, made from a record of its results.

    Attributes
    ----------
    title
        Its heading on the page.
    template
        The file under ``templates/`` that shows it on the page.
    parts
        Sections that the page shows below it.
    """

    title: str
    template: str = "section.html"
    parts: Sequence[Section[R_contra]] = ()

    @abstractmethod
    def table(self, report: R_contra) -> Table | None:
        """Its table; None where the report has nothing to show."""

    def text(self, report: R_contra) -> str:
        """Text of the page below the table; may be empty."""
        return ""


def name_column(heading: str) -> Column:
    """A column of names, which are never broken."""
    return Column(heading, kind="name")


def number_cell(x: float | None, digits: int = 4, emphasis: Emphasis | None = None) -> Cell:
    """A figure to so many digits; a dash for none."""
    known = x is not None and math.isfinite(x)
    return Cell(number(x, digits), x if known else None, emphasis)


def percent_cell(x: float | None) -> Cell:
    """A share in percent; a dash for none."""
    return Cell(percent(x), x)


def error_cells(x: float | None, error: float | None) -> tuple[Cell, Cell]:
    """A figure and its standard error, to two digits of the error; a dash for what there is not."""
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


def units_text(units: Mapping[str, str]) -> str:
    """The units of a table's title, each once."""
    return " or ".join(dict.fromkeys(units.values()))


def unit_columns(units: Mapping[str, str]) -> list[Column]:
    """The column of the joints' units; none where all have the same, which the title tells."""
    if len(set(units.values())) > 1:
        return [name_column("unit")]
    return []


def unit_cells(units: Mapping[str, str], joint: str) -> list[Cell]:
    """The cell of `unit_columns` for a joint, or for ``overall``."""
    if not unit_columns(units):
        return []
    return [Cell(units.get(joint) or common_unit(units))]
