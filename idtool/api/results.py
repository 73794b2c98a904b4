"""Bases of the results: saving files and recordings, and lines for a Python prompt."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from idtool.common.outputs import write_all

if TYPE_CHECKING:
    from idtool.estimation.evaluation.envelope import Trace
    from idtool.reporting.results.base import NoticeReport
    from idtool.robot.model import Model as RobotModel

    RecordingData = tuple[
        RobotModel, Sequence[Sequence[Trace]], str
    ]  # robot, each log's torque and positions, what is shown

Progress = Callable[[str, float], None]  # stage, share of it that is done

_MAX_LINES = 12  # lines of a table at a prompt


def ignore_progress(stage: str, share: float) -> None:
    """Progress that nobody wants to hear of."""


def table_lines(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table, the first column to the left; of long ones the first lines and the last."""
    hidden = len(rows) - _MAX_LINES
    shown = rows if hidden <= 0 else [*rows[: _MAX_LINES - 1], rows[-1]]
    cells = [list(head), *map(list, shown)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    lines = [
        "  "
        + "  ".join(cell.rjust(w) if i else cell.ljust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True)))
        for row in cells
    ]
    if hidden > 0:
        lines.insert(-1, f"  … {hidden} more")
    return lines


def notice_lines(notices: Sequence[NoticeReport]) -> list[str]:
    """What a user should know, a line each."""
    lines = [f"  {notice.severity}: {notice.sentence}" for notice in notices[:_MAX_LINES]]
    if len(notices) > _MAX_LINES:
        lines.append(f"  … {len(notices) - _MAX_LINES} more notices")
    return lines


class Recordable(ABC):
    """A result that rerun's viewer can show."""

    def rerun(self, file: str | os.PathLike[str]) -> Path:
        """Write a recording for rerun's viewer, as ``--rerun`` does: the robot, its motion, torques and residuals.

        Parameters
        ----------
        file
            Where to, FILE.rrd.

        Raises
        ------
        ConfigError
            If rerun is not installed.
        OutputError
            If the file cannot be written.
        """
        from idtool.api.recording import save_recording

        return save_recording(file, *self._recording_data())

    @abstractmethod
    def _recording_data(self) -> RecordingData:
        """The robot, of each log the torque and the positions, and the model that is shown."""


class SavableResult(ABC):
    """A result that is written as files."""

    _made_by: str

    def save(self, folder: str | os.PathLike[str], made_by: str | None = None) -> tuple[Path, ...]:
        """Write the files that the command writes, all or none.

        Parameters
        ----------
        folder
            Where to; made where it is not there.
        made_by
            What the page says it was made by; None: the call.

        Returns
        -------
        The files.

        Raises
        ------
        OutputError
            If the folder cannot be written to.
        """
        return self._write(folder, made_by)

    def _write(
        self, folder: str | os.PathLike[str], made_by: str | None, without: Sequence[str] = ()
    ) -> tuple[Path, ...]:
        every = self._files(Path(folder), self._made_by if made_by is None else made_by)
        files = {name: content for name, content in every.items() if name not in without}
        write_all(Path(folder), files)
        return tuple(Path(folder, name) for name in files)

    @abstractmethod
    def _files(self, folder: Path, made_by: str) -> dict[str, str | bytes]:
        """The files' contents by name."""
