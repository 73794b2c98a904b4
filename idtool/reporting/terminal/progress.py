"""A bar that tells the stage of what takes more than two seconds, whether or not that says how far it is."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

_DELAY = 1.0  # s of work before the bar appears: loading took about as long


@contextmanager
def progress_bar(console: Console) -> Iterator[Callable[[str, float], None]]:
    """A function to be told the stage and its share done, 0 where that is not known.

    Parameters
    ----------
    console
        Where the bar appears and vanishes again; where no line can be drawn anew, none does.
    """
    bar = _Bar(console)
    timer = threading.Timer(_DELAY, bar.appear)
    timer.daemon = True
    if console.is_interactive and console.file.isatty():
        timer.start()
    try:
        yield bar.update
    finally:
        timer.cancel()
        bar.end()


class _Bar:
    """The stage told last; drawn from when the timer's thread says so."""

    def __init__(self, console: Console) -> None:
        columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
        self._drawn = Progress(*columns, console=console, transient=True)
        self._lock = threading.Lock()
        self._stage, self._share = "working", 0.0
        self._task: TaskID | None = None
        self._ended = False

    def update(self, stage: str, share: float) -> None:
        with self._lock:
            new, self._stage, self._share = stage != self._stage, stage, share
            if self._task is not None:
                self._draw(new)

    def appear(self) -> None:
        with self._lock:
            if not self._ended:
                self._drawn.start()
                self._draw(new=True)

    def end(self) -> None:
        with self._lock:
            self._ended = True
            if self._task is not None:
                self._drawn.stop()

    def _draw(self, new: bool) -> None:
        """The stage; a new one begins a bar of its own, which moves to and fro as long as its share is not known."""
        if new or self._task is None:
            if self._task is not None:
                self._drawn.remove_task(self._task)
            self._task = self._drawn.add_task(self._stage, start=False, total=1.0)
        if self._share > 0:
            self._drawn.start_task(self._task)
        self._drawn.update(self._task, completed=self._share)
