"""The sections of all reports: each makes its table once, for the page and for the terminal."""

from idtool.reporting.sections.base import Cell, Column, Section, Table

__all__ = ["Cell", "Column", "Section", "Table"]
