"""Tables that no terminal cuts: which columns stand side by side; `rich` lays them out.

Where a table is too wide, headings are broken between their words, columns of words take more lines, and what is still
too wide continues below, beside the same names. A name or a figure is never shortened; one that is wider than the
terminal makes the table so, too.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from functools import cached_property

import rich.table
from rich.cells import cell_len
from rich.console import Console, JustifyMethod
from rich.text import Text

from idtool.common.dataclass import dataclass
from idtool.reporting.sections.base import Cell, Column, Table
from idtool.reporting.terminal.output import EMPHASIS_STYLE, without_control_characters

_GAP = 2  # blanks between columns
_MIN_TEXT_WIDTH = 20  # blanks that a column of words is left with, if it has so many


@dataclass(frozen=True)
class _Strip:
    """A column with its cells.

    Attributes
    ----------
    column
        The column.
    heading, cells
        Its texts.
    """

    column: Column
    heading: Text
    cells: list[Text]

    @cached_property
    def natural_width(self) -> int:
        """The width of its widest text, if none is broken."""
        return max(text.cell_len for text in (self.heading, *self.cells))

    @cached_property
    def min_width(self) -> int:
        """The width that its longest word needs, or its longest name or figure."""
        if self.column.kind == "words":
            longest = max(_longest_word(text) for text in (self.heading, *self.cells))
            return max(longest, min(self.natural_width, _MIN_TEXT_WIDTH))
        return max(_longest_word(self.heading), *(cell.cell_len for cell in self.cells), 0)


def table_lines(table: Table, width: int) -> Iterator[Text]:
    """A table as lines of at most this width [characters], where names and figures allow that."""
    strips = [_strip(table, i) for i in range(len(table.columns))]
    for i, part in enumerate(_parts(strips, table.key_columns, width)):
        if i:
            yield Text()
        yield from _lines(part, width)


def _strip(table: Table, index: int) -> _Strip:
    column = table.columns[index]
    heading = f"{column.heading} {column.unit}".rstrip()
    cells = [_text(row[index], column) for row in table.rows]
    return _Strip(column, Text(without_control_characters(heading), "dim"), cells)


def _text(cell: Cell, column: Column) -> Text:
    is_whole = column.kind != "words"
    return Text(without_control_characters(cell.text), EMPHASIS_STYLE[cell.emphasis], no_wrap=is_whole, overflow="fold")


def _longest_word(text: Text) -> int:
    return max(map(cell_len, text.plain.split(" ")))


def _total_width(strips: Sequence[_Strip]) -> int:
    """The least width of columns side by side."""
    return sum(strip.min_width for strip in strips) + _GAP * (len(strips) - 1)


def _parts(strips: list[_Strip], keys: int, width: int) -> list[list[_Strip]]:
    """The columns of each part, names included: as few parts as can be, and those about equally wide."""
    if _total_width(strips) <= width:
        return [strips]
    names = strips[:keys]
    groups: list[list[_Strip]] = []
    for group in _groups(strips[keys:]):
        filled = [strip for strip in group if any(cell.plain for cell in strip.cells)]
        fits = _total_width([*names, *filled]) <= width
        groups += [filled] if fits else [[strip] for strip in filled]
    fewest = len(_pack(names, groups, width))
    narrow = next(w for w in range(width + 1) if len(_pack(names, groups, w)) <= fewest)
    return _pack(names, groups, narrow)


def _groups(strips: Sequence[_Strip]) -> list[list[_Strip]]:
    """The columns that stay side by side."""
    groups: list[list[_Strip]] = []
    for strip in strips:
        if strip.column.attached and groups:
            groups[-1].append(strip)
        else:
            groups.append([strip])
    return groups


def _pack(names: list[_Strip], groups: Sequence[list[_Strip]], width: int) -> list[list[_Strip]]:
    """The groups, each in the first part that has room for it."""
    parts = [list(names)]
    for group in groups:
        for part in parts:
            if part == names or _total_width([*part, *group]) <= width:
                part += group
                break
        else:
            parts.append([*names, *group])
    return parts


def _widths(strips: Sequence[_Strip], width: int) -> list[int]:
    """The columns' widths: the least, and what is left over first to words, then to headings."""
    widths = [strip.min_width for strip in strips]
    room = max(width - _total_width(strips), 0)
    for i in sorted(range(len(strips)), key=lambda i: strips[i].column.kind != "words"):
        more = min(room, strips[i].natural_width - widths[i])
        widths[i] += more
        room -= more
    return widths


def _lines(strips: Sequence[_Strip], width: int) -> Iterator[Text]:
    """The lines of columns side by side."""
    widths = _widths(strips, width)
    grid = rich.table.Table(box=None, padding=(0, _GAP, 0, 0), pad_edge=False)
    for strip, column_width in zip(strips, widths, strict=True):
        justify: JustifyMethod = "right" if strip.column.kind == "number" else "left"
        grid.add_column(strip.heading, width=column_width, justify=justify, overflow="fold")
    for row in zip(*(strip.cells for strip in strips), strict=True):
        grid.add_row(*row)
    total = sum(widths) + _GAP * (len(strips) - 1)
    console = Console(file=io.StringIO(), width=total, legacy_windows=False)
    for segments in console.render_lines(grid, console.options.update(width=total), pad=False):
        line = Text.assemble(*((segment.text, segment.style or "") for segment in segments))
        line.rstrip()
        yield line
