"""`Stages`: parts of a diagnosis without which there still is a result, each skipped where it fails."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.diagnosis.trial import FAILURES, failure_reason

T = TypeVar("T")


class Stages:
    """Runs the stages, and notes those that were skipped.

    After Ctrl-C, the present stage and all others are skipped, so that what was found is written at once. The second
    Ctrl-C ends the program.

    Parameters
    ----------
    interrupted
        True if the user has asked for the result already.

    Attributes
    ----------
    is_interrupted
        True if the user has asked for the result.
    """

    def __init__(self, interrupted: bool) -> None:
        self.is_interrupted = interrupted
        self._skipped: dict[str, list[str]] = {}  # names of the stages by the reason

    @property
    def notices(self) -> list[Notice]:
        """Stages that were skipped, a notice for each reason."""
        notices = []
        for reason, names in self._skipped.items():
            were = "was" if len(names) == 1 else "were"
            message = f"{join_names(names, most=len(names))} {were} skipped: {reason}"
            notices.append(Notice("stage_skipped", "warning", None, message))
        return notices

    def has_skipped(self, name: str) -> bool:
        """True if a stage of this name was skipped."""
        return any(name in names for names in self._skipped.values())

    def run(self, name: str, stage: Callable[[], T], otherwise: T, is_short: bool = False) -> T:
        """Result of a stage, or the one that stands for it.

        Parameters
        ----------
        name
            Name of the stage, as in "... was skipped".
        stage
            The stage.
        otherwise
            Its result if it fails.
        is_short
            True if it is to run even after Ctrl-C.
        """
        if self.is_interrupted and not is_short:
            self._note(name, "the diagnosis was interrupted")
            return otherwise
        try:
            return stage()
        except KeyboardInterrupt:
            if self.is_interrupted:
                raise
            self.is_interrupted = True
            self._note(name, "the diagnosis was interrupted")
        except FAILURES as failure:
            self._note(name, failure_reason(failure))
        return otherwise

    def _note(self, name: str, reason: str) -> None:
        names = self._skipped.setdefault(reason, [])
        if name not in names:
            names.append(name)
