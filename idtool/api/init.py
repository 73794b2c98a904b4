"""`init`: a first configuration."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from idtool.api.model import Source
from idtool.api.notebook import Displayable, shows_progress
from idtool.api.results import Progress, ignore_progress, notice_lines
from idtool.common.names import stem
from idtool.common.outputs import OutputError, check_file, write_all
from idtool.common.safe_yaml import read_yaml
from idtool.common.threads import with_single_threaded_blas
from idtool.common.urls import log_path
from idtool.data.robot_source import read_robot_and_logs
from idtool.reporting.results.base import notice_fields
from idtool.reporting.results.setup import InitReport, StartErrors, TodoReport, TrialReport
from idtool.robot.config.schema import SCHEMA_FILE, config_schema
from idtool.setup import InitialConfig, make_initial_config

if TYPE_CHECKING:
    from idtool.reporting.terminal.output import Output


class InitResult(InitReport, Displayable):
    """A first configuration; its fields are those that `idtool init --json` prints."""

    _text: str

    @property
    def text(self) -> str:
        """The configuration as commented YAML."""
        return self._text

    def save(self, *, force: bool = False) -> Path:
        """Write the configuration to ``file``, and beside it its JSON schema for editors, ``idtool.schema.json``.

        Parameters
        ----------
        force
            Whether to overwrite an existing file.

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
        write_all(file.parent, {file.name: self._text, SCHEMA_FILE: config_schema()})
        return file

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.init import show_initial_config

        show_initial_config(output, self, is_written=False)

    def __repr__(self) -> str:
        lines = [f"InitResult {self.file}"]
        lines += [f"  {finding}" for finding in self.found]
        lines += [f"  to fill in: {item.key}: {item.what}" for item in self.left]
        lines += notice_lines(self.notices)
        return "\n".join(lines)


@shows_progress
@with_single_threaded_blas
def init(
    urdf: Source,
    logs: Source | Sequence[Source] = (),
    *,
    config: Source | None = None,
    file: Source | None = None,
    progress: Progress | None = None,
) -> InitResult:
    """Create a first configuration from a URDF and logs, like `idtool init`. Only `save` writes the file.

    Parameters
    ----------
    urdf
        The URDF, or a ROS bag that contains it as ``/robot_description``.
    logs
        The logs.
    config
        A configuration with known values, such as controller gains. Its keys are kept unchanged.
    file
        File for `save`; None: ``<urdf stem>.yaml`` beside the URDF, where the other functions look for it.
    progress
        Function that is called with the name of a stage and the fraction of it that is done; None: no reports.

    Raises
    ------
    IdtoolError
        If a log or the configuration cannot be used, or no joint can be identified.
    """
    log_list = [logs] if isinstance(logs, str | os.PathLike) else logs
    paths = [log_path(path) for path in log_list]
    config_path = None if config is None else Path(config)
    default_path = default_configuration(Path(urdf))
    path = default_path if file is None else Path(file)
    robot, all_logs = read_robot_and_logs(Path(urdf), paths)
    known_config = (read_yaml(config_path) if config_path else None) or {}
    draft = make_initial_config(robot, all_logs, known_config, config_path, progress or ignore_progress)
    is_default_path = path.resolve() == default_path.resolve()
    result = InitResult(
        file=str(path),
        urdf=str(urdf),
        logs=[str(log) for log in paths],
        band_hz=draft.band_hz,
        config=dict(draft.data),
        rms=None if draft.rms is None else StartErrors(**draft.rms),
        trials=[TrialReport(**asdict(trial)) for trial in draft.trials],
        found=draft.findings,
        left=[TodoReport(**asdict(item)) for item in draft.todo],
        needed=[item.key for item in draft.needed],
        **notice_fields(draft.notices),
        next=_next_command(draft, path, [Path(urdf), *paths], is_default_path),
    )
    result._text = draft.text
    return result


def default_configuration(urdf: Path) -> Path:
    """The file beside a URDF that its configuration is read from."""
    return urdf.with_name(f"{stem(urdf)}.yaml")


def check_configuration(file: Path, inputs: Sequence[Path], force: bool) -> None:
    """Check, before anything is read, that the file may and can be written.

    Raises
    ------
    OutputError
        If not.
    """
    check_file(file, inputs)
    if file.exists() and not force:
        raise OutputError(file, "already exists; use --force to overwrite it, or choose another --out")


def _next_command(draft: InitialConfig, file: Path, inputs: Sequence[Path], is_default_path: bool) -> str:
    """The next command: the fit, or `init` again if values that the fit needs have to be filled in."""
    arguments = [str(path) for path in inputs]
    if draft.needed:
        words = ["idtool", "init", *arguments, "--config", str(file)]
        if not is_default_path:
            words += ["--out", str(file)]
        words.append("--force")
    else:
        words = ["idtool", "fit", *arguments]
        if not is_default_path:
            words += ["--config", str(file)]
    return shlex.join(words)
