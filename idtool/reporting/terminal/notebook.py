"""`NotebookOutput`: the result of a command as HTML in a notebook."""

from __future__ import annotations

from collections.abc import Iterable

from markupsafe import Markup
from typing_extensions import override

from idtool.reporting.sections.base import Cell, Column, Table
from idtool.reporting.terminal.output import EMPHASIS_STYLE, Output, without_control_characters

_MAX_OPEN_ROWS = 12  # of a table; longer ones are folded
_CSS = {  # the colours are legible on white and on black; all else is the theme's
    "bold": "font-weight:bold",
    "dim": "opacity:0.7",
    "green": "color:#1a8a3a",
    "yellow": "color:#b07500",
    "red": "color:#dc3b30",
}
_TEXT = Markup('<div style="white-space:pre-wrap;{}">{}</div>\n')
_OPEN = Markup('<div style="margin-top:0.6em;font-weight:bold">{}</div>\n{}')
_FOLDED = Markup('<details><summary style="font-weight:bold">{} ({} rows)</summary>\n{}</details>\n')
_TABLE = Markup('<table style="width:auto;margin:0.3em 0"><thead>{}</thead><tbody>\n{}</tbody></table>\n')
_ROW = Markup("<tr>{}</tr>\n")
_HEADING = Markup('<th style="{}" title="{}">{}</th>')
_CELL = Markup('<td style="{}">{}</td>')
# Names come from strangers' files: without these classes, a notebook takes what stands between dollar signs for TeX.
_WHOLE = Markup('<div class="tex2jax_ignore mathjax_ignore">\n{}</div>')


class NotebookOutput(Output):
    """HTML that needs no other file and follows the theme of the notebook. All text is escaped."""

    def __init__(self) -> None:
        self._parts: list[Markup] = []

    @override
    def say(self, text: str, style: str | None = None) -> None:
        lines = [without_control_characters(line) for line in text.split("\n") if line]
        if lines:
            self._parts.append(_TEXT.format(_css(style or ""), "\n".join(lines)))

    @override
    def show(self, table: Table) -> None:
        shown = table.in_terminal()
        headings = _joined(_heading(column) for column in shown.columns)
        rows = _joined(_row(shown.columns, cells) for cells in shown.rows)
        html = _TABLE.format(_ROW.format(headings), rows)
        title = without_control_characters(shown.title)
        if len(shown.rows) > _MAX_OPEN_ROWS:
            self._parts.append(_FOLDED.format(title, len(shown.rows), html))
        else:
            self._parts.append(_OPEN.format(title, html))

    def html(self) -> str:
        """All that was added."""
        return str(_WHOLE.format(_joined(self._parts)))


def _css(style: str) -> str:
    """CSS of a style of the terminal."""
    return ";".join(_CSS[word] for word in style.split())


def _alignment(column: Column) -> str:
    return "text-align:right" if column.kind == "number" else "text-align:left"


def _heading(column: Column) -> Markup:
    text = f"{column.heading} {column.unit}".rstrip()
    return _HEADING.format(
        _alignment(column), without_control_characters(column.help), without_control_characters(text)
    )


def _row(columns: Iterable[Column], cells: Iterable[Cell]) -> Markup:
    html = []
    for column, cell in zip(columns, cells, strict=True):
        css = ";".join(filter(None, [_alignment(column), _css(EMPHASIS_STYLE[cell.emphasis])]))
        html.append(_CELL.format(css, without_control_characters(cell.text)))
    return _ROW.format(_joined(html))


def _joined(parts: Iterable[Markup]) -> Markup:
    return Markup("").join(parts)
