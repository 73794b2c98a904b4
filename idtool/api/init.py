"""`init`: a first configuration."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from idtool.api.model import Source
from idtool.api.records import Progress, notice_lines, silent
from idtool.common.names import stem
from idtool.common.outputs import OutputError, write_all
from idtool.common.safe_yaml import read_yaml
from idtool.data.description import robot_and_logs
from idtool.reporting.results.base import notice_fields
from idtool.reporting.results.setup import InitReport, StartErrors, TodoReport, TrialReport
from idtool.setup import InitialConfig, make_initial_config


class InitResult(InitReport):
    """A first configuration; its fields are those that `idtool init --json` prints."""

    _text: str

    @property
    def text(self) -> str:
        """The configuration as commented YAML."""
        return self._text

    def save(self, *, force: bool = False) -> Path:
        """Write the configuration to ``file``.

        Parameters
        ----------
        force
            Whether to overwrite a file that is there.

        Returns
        -------
        The file.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        file = Path(self.file)
        check_configuration(file, [], force)
        write_all(file.parent, {file.name: self._text})
        return file

    def __repr__(self) -> str:
        todo = [f"  to fill in: {item.key}: {item.what}" for item in self.left]
        found = [f"  {line}" for line in self.found]
        return "\n".join([f"InitResult {self.file}", *found, *todo, *notice_lines(self.notices)])


def init(
    urdf: Source,
    logs: Source | Sequence[Source] = (),
    *,
    config: Source | None = None,
    file: Source | None = None,
    progress: Progress | None = None,
) -> InitResult:
    """Draft a configuration from a URDF and logs; `idtool init` as a function, which writes nothing before `save`.

    Parameters
    ----------
    urdf
        The URDF, or a bag of ROS that holds it as ``/robot_description``.
    logs
        The logs.
    config
        A configuration with what is known already, such as controller gains: its keys are kept as they are.
    file
        Where it is to be written; None: ``<urdf stem>.yaml`` beside the URDF, where the other functions look for it.
    progress
        Told the stage and the share of it that is done; None: silence.

    Raises
    ------
    IdtoolError
        If a log or the configuration cannot be used, or no joint can be identified.
    """
    given = [Path(path) for path in ([logs] if isinstance(logs, str | os.PathLike) else logs)]
    known = None if config is None else Path(config)
    beside = default_configuration(Path(urdf))
    place = beside if file is None else Path(file)
    robot, all_logs = robot_and_logs(Path(urdf), given)
    given_config = (read_yaml(known) if known else None) or {}
    draft = make_initial_config(robot, all_logs, given_config, known, progress or silent)
    result = InitResult(
        file=str(place),
        urdf=str(urdf),
        logs=[str(path) for path in given],
        band_hz=draft.band_hz,
        config=dict(draft.data),
        rms=None if draft.rms is None else StartErrors(**draft.rms),
        trials=[TrialReport(**asdict(trial)) for trial in draft.trials],
        found=draft.findings,
        left=[TodoReport(**asdict(item)) for item in draft.todo],
        needed=[item.key for item in draft.needed],
        **notice_fields(draft.notices),
        next=_next_command(draft, place, [Path(urdf), *given], place.resolve() == beside.resolve()),
    )
    result._text = draft.text
    return result


def default_configuration(urdf: Path) -> Path:
    """The file beside a URDF that its configuration is read from."""
    return urdf.with_name(f"{stem(urdf)}.yaml")


def check_configuration(file: Path, inputs: Sequence[Path], force: bool) -> None:
    """Before anything is read: whether the file may and can be written.

    Raises
    ------
    OutputError
        If not.
    """
    if any(file.resolve() == path.resolve() for path in inputs):
        raise OutputError(file, "is an input file; give another --out")
    if file.is_dir():
        raise OutputError(file, "is a folder; give a file as --out")
    if file.exists() and not force:
        raise OutputError(file, "already exists; use --force to overwrite it, or choose another --out")
    folder = next(folder for folder in file.absolute().parents if folder.exists())
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(folder, "cannot be written to; give another --out")


def _next_command(draft: InitialConfig, file: Path, given: Sequence[Path], beside: bool) -> str:
    """The next command: the fit, or `init` again if values that the fit needs have to be filled in."""
    arguments = list(map(str, given))
    if draft.needed:
        out = [] if beside else ["--out", str(file)]
        return shlex.join(["idtool", "init", *arguments, "--config", str(file), *out, "--force"])
    return shlex.join(["idtool", "fit", *arguments, *([] if beside else ["--config", str(file)])])
