"""`SearchProgress`: the progress of a search that ends when its time is over."""

from __future__ import annotations

import time

from idtool.estimation.dataset.experiment import Progress


class TimeLimitError(Exception):
    """The search's time is over."""


class SearchProgress:
    """Callback for the stage of a search and its progress, from 0 to 1, that can end the search.

    Attributes
    ----------
    report
        Callback that it passes all on to. A copy of the process has another one.
    """

    def __init__(self, report: Progress) -> None:
        self.report = report
        self._deadline: float | None = None

    def __call__(self, stage: str, share: float) -> None:
        """Report progress; raises `TimeLimitError` once the search's time is over."""
        self.report(stage, share)
        if self._deadline is not None and time.monotonic() > self._deadline:
            self._deadline = None
            raise TimeLimitError

    def limit(self, seconds: float | None) -> None:
        """Let the time be over after some seconds from now; None: never."""
        self._deadline = None if seconds is None else time.monotonic() + seconds
