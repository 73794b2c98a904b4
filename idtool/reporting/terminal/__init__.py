"""What a person sees in the terminal: one file a command."""

from idtool.reporting.terminal.base import Terminal

__all__ = ["Terminal"]
