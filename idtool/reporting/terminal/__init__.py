"""Terminal output: one file for each command."""

from idtool.reporting.terminal.base import Terminal

__all__ = ["Terminal"]
