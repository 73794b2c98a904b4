"""Models and logs as users give them → an experiment; and a call as text, for the pages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from idtool.api.log import Log
from idtool.api.model import Model, Source, as_model
from idtool.api.records import Progress
from idtool.common.exceptions import ConfigError, LogError
from idtool.data.logs import Log as Record
from idtool.estimation.dataset.experiment import Experiment, prepare

LogSource = Log | Source
Logs = LogSource | Sequence[LogSource]


def experiment_of(
    model: Model | Source,
    logs: Logs,
    validate: Logs = (),
    holdout: float = 0.3,
    progress: Progress = lambda stage, share: None,
    transform: Callable[[Record], Record] = lambda log: log,
) -> Experiment:
    """Model and logs put together.

    Parameters
    ----------
    model
        The model, or its URDF.
    logs, validate, holdout
        As in `idtool.fit`.
    progress
        Told the stage and how far it has come.
    transform
        Applied to every log that is read.

    Raises
    ------
    IdtoolError
        If a log, the configuration or the model cannot be used.
    """
    progress("reading", 0.0)
    model = as_model(model)
    fitted, kept = ([_record(log, model) for log in listed(given)] for given in (logs, validate))
    try:
        return prepare(model.robot, model.settings, fitted, kept, holdout, transform)
    except ConfigError as error:
        source = model.settings.source
        if source is None or error.where.startswith("--"):
            raise
        raise ConfigError(f"{source.path}: {error.where}", error.what) from None


def listed(logs: Logs) -> list[LogSource]:
    """Logs as a list; a single one need not be in one."""
    return list(logs) if isinstance(logs, Sequence) and not isinstance(logs, str | Log) else [logs]


def _record(log: LogSource, model: Model) -> Path | Record:
    """A file that is to be read as the configuration says, or what was read."""
    if not isinstance(log, Log):
        return Path(log)
    options = model.settings.log
    if log.as_logged and (options.columns or any(dict(options.scale).values())):
        what = "columns" if options.columns else "scale"
        raise LogError(log.path, f"was read without the setting log.{what}; read it with Model.read_log")
    return log.record


def call(function: str, model: Model | Source, logs: Logs, **options: Any) -> str:
    """A call as a person would type it, for the pages.

    Parameters
    ----------
    function
        Its name.
    model, logs, options
        What it was given.
    """
    validate = listed(options.pop("validate", ()))
    given = [repr(model.name if isinstance(model, Model) else str(model)), _text(listed(logs))]
    given += [f"validate={_text(validate)}"] if validate else []
    return f"idtool.{function}({', '.join([*given, *(f'{name}={value!r}' for name, value in options.items())])})"


def changed(function: Callable[..., Any], **options: Any) -> dict[str, Any]:
    """The options of a function that are not at their default."""
    defaults = function.__kwdefaults__ or {}
    return {name: value for name, value in options.items() if value != defaults[name]}


def _text(logs: Sequence[LogSource]) -> str:
    return repr([str(log.path if isinstance(log, Log) else log) for log in logs])
