"""Bases of the results: saving files and recordings, and lines for a Python prompt."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from idtool.common.outputs import write_all

if TYPE_CHECKING:
    from idtool.estimation.dataset.envelope import Trace
    from idtool.reporting.results.base import NoticeReport
    from idtool.robot.model import RobotModel

    #: The robot, the traces of each log, and the name of the model's curve in them.
    RecordingData = tuple[RobotModel, Sequence[Sequence[Trace]], str]

Progress = Callable[[str, float], None]  # stage, share of it that is done

_MAX_LINES = 12  # lines of a table at a prompt


def ignore_progress(stage: str, share: float) -> None:
    """Progress callback that does nothing."""


def table_lines(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table, the first column flush left; long ones keep the first lines and the last."""
    omitted = max(len(rows) - _MAX_LINES, 0)
    if omitted:
        rows = [*rows[: _MAX_LINES - 1], rows[-1]]
    table = [head, *rows]
    columns = zip(*table, strict=True)
    widths = [max(map(len, column)) for column in columns]
    lines = []
    for first, *others in table:
        cells = [first.ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        lines.append("  " + "  ".join(cells))
    if omitted:
        lines.insert(-1, f"  … {omitted} more")
    return lines


def notice_lines(notices: Sequence[NoticeReport]) -> list[str]:
    """Lines of the notices; of many, the first ones."""
    lines = [f"  {notice.severity}: {notice.sentence}" for notice in notices[:_MAX_LINES]]
    if len(notices) > _MAX_LINES:
        lines.append(f"  … {len(notices) - _MAX_LINES} more notices")
    return lines


class Recordable(ABC):
    """A result that can be recorded for the rerun viewer."""

    def rerun(self, file: str | os.PathLike[str]) -> Path:
        """Write a recording for the rerun viewer, like ``--rerun``: the robot, its motion, torques and residuals.

        Parameters
        ----------
        file
            File to write, with the extension .rrd.

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
        """The robot, the traces of each log, and the name of the model's curve in them."""


class SavableResult(ABC):
    """A result that is written as files."""

    _made_by: str

    def save(self, folder: str | os.PathLike[str], made_by: str | None = None) -> tuple[Path, ...]:
        """Write the same files as the command. If an error occurs, no file is written.

        Parameters
        ----------
        folder
            Output folder; it is created if it does not exist.
        made_by
            Command that the HTML report shows; None: the Python call.

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
        self, folder: str | os.PathLike[str], made_by: str | None, omitted: Sequence[str] = ()
    ) -> tuple[Path, ...]:
        all_files = self._files(Path(folder), self._made_by if made_by is None else made_by)
        files = {name: content for name, content in all_files.items() if name not in omitted}
        write_all(Path(folder), files)
        return tuple(Path(folder, name) for name in files)

    @abstractmethod
    def _files(self, folder: Path, made_by: str) -> dict[str, str | bytes]:
        """Contents of the files, by name."""
