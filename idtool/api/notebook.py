"""Results and progress in a notebook."""

from __future__ import annotations

import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import wraps
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

if TYPE_CHECKING:
    from idtool.reporting.terminal.output import Output

_DELAY = 1.0  # s of work before the bar appears
_INTERVAL = 0.1  # s between two drawings of the bar

P = ParamSpec("P")
R = TypeVar("R")


class Displayable(ABC):
    """A result that a notebook shows as HTML: what the command prints about it."""

    def _repr_html_(self) -> str:
        """The verdict or main finding, tables and notices as HTML."""
        from idtool.reporting.terminal.notebook import NotebookOutput

        output = NotebookOutput()
        self._show(output)
        return output.html()

    @abstractmethod
    def _show(self, output: Output) -> None:
        """Add what the command prints about the result."""


def shows_progress(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator of a function with an option ``progress``: without one, a notebook shows a bar until it returns."""

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        if kwargs.get("progress") is not None or not _in_notebook():
            return function(*args, **kwargs)
        bar = _Bar()
        kwargs["progress"] = bar.update
        try:
            return function(*args, **kwargs)
        finally:
            bar.end()

    return call


def _in_notebook() -> bool:
    """True where IPython runs with a kernel, not in a terminal."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    return getattr(shell, "kernel", None) is not None


class _Bar:
    """A bar below the cell that runs, with the stage told last."""

    def __init__(self) -> None:
        self._next_drawing = time.monotonic() + _DELAY
        self._handle: Any = None  # IPython's; None as long as nothing is shown

    def update(self, stage: str, share: float) -> None:
        now = time.monotonic()
        if now >= self._next_drawing:
            self._next_drawing = now + _INTERVAL
            value = f' value="{share:.3f}"' if share > 0 else ""  # without a value, it moves to and fro
            self._draw(f"{escape(stage)} <progress{value}></progress>", f"{stage}: {share:.0%}")

    def end(self) -> None:
        """Take the bar away."""
        if self._handle is not None:
            self._draw("", "")

    def _draw(self, html: str, text: str) -> None:
        display = import_module("IPython.display")  # not a dependency: where it is missing, there is no bar
        content = {"text/html": html, "text/plain": text}
        if self._handle is None:
            self._handle = display.display(content, raw=True, display_id=True)
        else:
            self._handle.update(content, raw=True)
