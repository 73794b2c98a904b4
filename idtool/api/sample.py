"""`sample`: robots and logs to try the commands with."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from idtool.api.notebook import Displayable
from idtool.common.outputs import OutputError, check_folder, write_all
from idtool.common.samples import FOLDER, SampleName, find_sample
from idtool.reporting.results.sample import SampleReport

if TYPE_CHECKING:
    from idtool.reporting.terminal.output import Output


class SampleResult(SampleReport, Displayable):
    """Robots, configurations and logs that were written."""

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.sample import show_sample

        show_sample(output, self)

    def __repr__(self) -> str:
        return "\n".join([f"SampleResult {self.sample}", *(f"  {file}" for file in self.files)])


def sample(name: SampleName, out: str | os.PathLike[str] = FOLDER, *, force: bool = False) -> SampleResult:
    """Write a sample robot with its logs into a folder, like `idtool sample`.

    Parameters
    ----------
    name
        ``leg`` and ``belt_arm`` are robots, each with a configuration, logs to fit and logs to validate. ``quadruped``
        has an IMU, and stands, walks and hangs. ``hidden`` is a leg with a spring or a payload that its model lacks.
        ``pair`` is an arm and its simulator.
    out
        The folder, which may contain other files.
    force
        Whether to overwrite files that differ from the sample's.

    Raises
    ------
    IdtoolError
        If there is no such sample, a file differs from the sample's, or the folder cannot be written to.
    """
    folder = Path(out)
    chosen = find_sample(name)
    files = chosen.files()
    check_folder(folder)
    missing = {path: content for path, content in files.items() if not _is_equal(folder / path, content)}
    other = next((folder / path for path in missing if os.path.lexists(folder / path)), None)
    if other and not force:
        raise OutputError(other, "is another file than the sample's; overwrite it with --force, or give another --out")
    if missing:
        write_all(folder, missing)
    return SampleResult(
        sample=name,
        files=[str(folder / path) for path in files],
        written=[str(folder / path) for path in missing],
        next=chosen.command(folder),
    )


def _is_equal(path: Path, content: bytes) -> bool:
    """True if a file can be read and has this content."""
    try:
        return path.is_file() and path.stat().st_size == len(content) and path.read_bytes() == content
    except OSError:
        return False
