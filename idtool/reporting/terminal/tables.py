"""Tables that no terminal cuts.

What is too wide is taken apart: headings are broken between their words, columns of words take more lines, and what is
still too wide continues below, beside the same names. A name or a figure is never shortened; one that is wider than
the terminal makes the table so, too.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import cached_property

from rich.cells import cell_len
from rich.text import Text

_GAP = 2  # blanks between columns
_WORDS = 20  # blanks that a column of words is left with, if it has so many

Columns = list["Column"]


class Words(str):
    """The heading of a column of words: flush left, and broken between them where it must be."""

    __slots__ = ()


class Column:
    """A column of a table.

    Parameters
    ----------
    heading
        What stands above it.
    left
        Whether its cells stand flush left, as those of `Words` do.
    """

    def __init__(self, heading: str, left: bool = False) -> None:
        self.heading = Text(heading, "dim")
        self.words = isinstance(heading, Words)
        self.left = left or self.words
        self.cells: list[Text] = []

    @cached_property
    def most(self) -> int:
        """The width of its widest line, if none is broken."""
        return max(cell.cell_len for cell in (self.heading, *self.cells))

    @cached_property
    def least(self) -> int:
        """The width that its longest word needs, or its longest name or figure."""
        whole = max(map(_longest, (self.heading, *self.cells) if self.words else (self.heading,)))
        return max(whole, min(self.most, _WORDS)) if self.words else max(whole, *(c.cell_len for c in self.cells), 0)


class Table:
    """Rows under headings.

    Parameters
    ----------
    title
        What the figures are, with their unit.
    names
        The columns that tell one row from another.
    groups
        The other columns; those of a group stay side by side where there is room.
    """

    def __init__(self, title: str, names: Columns, groups: Sequence[Columns]) -> None:
        self.title = title
        self._names = names
        self._groups = groups

    def add_row(self, *cells: str | Text) -> None:
        """A row, left to right; plain text, which need not be printable."""
        for column, cell in zip(_joined(self._names, *self._groups), cells, strict=True):
            column.cells.append(cell if isinstance(cell, Text) else Text(printable(cell)))

    def lines(self, width: int) -> Iterator[Text]:
        """The table as lines of at most this width [characters], where names and figures allow that."""
        for i, columns in enumerate(self._parts(width)):
            if i:
                yield Text()
            widths = _widths(columns, width)
            yield from _row([column.heading for column in columns], columns, widths, heading=True)
            for k in range(len(columns[0].cells)):
                yield from _row([column.cells[k] for column in columns], columns, widths)

    def _parts(self, width: int) -> list[Columns]:
        """The columns of each part, names included: as few parts as can be, and those about equally wide."""
        every = _joined(self._names, *self._groups)
        if _total(every) <= width:
            return [every]
        groups: list[Columns] = []
        for group in self._groups:
            said = [column for column in group if any(cell.plain for cell in column.cells)]
            fits = _total([*self._names, *said]) <= width
            groups += [said] if fits else [[column] for column in said]
        fewest = len(self._packed(groups, width))
        narrow = next(w for w in range(width + 1) if len(self._packed(groups, w)) <= fewest)
        return self._packed(groups, narrow)

    def _packed(self, groups: Sequence[Columns], width: int) -> list[Columns]:
        """The groups, each in the first part that has room for it."""
        parts = [[*self._names]]
        for group in groups:
            room = (part for part in parts if part == self._names or _total([*part, *group]) <= width)
            if (part := next(room, None)) is None:
                parts.append(part := [*self._names])
            part += group
        return parts


def _joined(*groups: Columns) -> Columns:
    return [column for group in groups for column in group]


def _total(columns: Columns) -> int:
    """The least width of columns side by side."""
    return sum(column.least for column in columns) + _GAP * (len(columns) - 1)


def _widths(columns: Columns, width: int) -> list[int]:
    """The columns' widths: the least, and what is left over first to words, then to headings."""
    widths = [column.least for column in columns]
    for i in sorted(range(len(columns)), key=lambda i: not columns[i].words):
        room = max(width - sum(widths) - _GAP * (len(columns) - 1), 0)
        widths[i] += min(room, columns[i].most - widths[i])
    return widths


def _row(cells: Sequence[Text], columns: Columns, widths: Sequence[int], heading: bool = False) -> Iterator[Text]:
    """The lines of a row; headings end on the same line, cells begin on it."""
    broken = [
        _broken(cell, width) if heading or column.words else [cell]
        for cell, column, width in zip(cells, columns, widths, strict=True)
    ]
    for k in range(height := max(map(len, broken))):
        line = Text()
        for lines, column, width in zip(broken, columns, widths, strict=True):
            at = k - (height - len(lines)) if heading else k
            part = lines[at] if 0 <= at < len(lines) else Text()
            blanks = " " * (width - part.cell_len)
            line.append(" " * _GAP if line else "").append_text(part if column.left else Text(blanks))
            line.append_text(Text(blanks) if column.left else part)
        line.rstrip()
        yield line


def _broken(cell: Text, width: int) -> list[Text]:
    """A text in lines of at most this width, broken after commas and before signs where that is enough."""
    lines: list[str] = []
    for item in re.split(r"(?<=,) | (?=[+−] )", cell.plain):
        for piece in [item] if cell_len(item) <= width else item.split(" "):
            if lines and cell_len(f"{lines[-1]} {piece}") <= width:
                lines[-1] += f" {piece}"
            else:
                lines.append(piece)
    return [Text(line, cell.style) for line in lines]


def _longest(text: Text) -> int:
    return max(map(cell_len, text.plain.split(" ")))


def printable(text: str) -> str:
    """The text, which may hold a stranger's names, without characters that would steer the terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
