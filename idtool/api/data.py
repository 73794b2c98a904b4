"""An experiment from a user's model and logs; and the text of a call, for the pages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from idtool.api.log import Log
from idtool.api.model import Model, Source, as_model
from idtool.api.results import Progress
from idtool.common.exceptions import ConfigError, LogError
from idtool.data.logs import JointLog
from idtool.estimation.dataset.experiment import Experiment, prepare

LogSource = Log | Source
Logs = LogSource | Sequence[LogSource]


def load_experiment(
    model: Model | Source,
    logs: Logs,
    validate: Logs = (),
    holdout: float = 0.3,
    progress: Progress = lambda stage, share: None,
    transform: Callable[[JointLog], JointLog] = lambda log: log,
) -> Experiment:
    """Load logs and put them together with a model.

    Parameters
    ----------
    model
        The model, or its URDF.
    logs, validate, holdout
        As in `idtool.fit`.
    progress
        Called with the stage and the share of it that is done.
    transform
        Applied to every log that is read.

    Raises
    ------
    IdtoolError
        If a log, the configuration or the model cannot be used.
    """
    progress("reading", 0.0)
    model = as_model(model)
    training_logs = [_record(log, model) for log in as_list(logs)]
    validation_logs = [_record(log, model) for log in as_list(validate)]
    try:
        return prepare(model.robot, model.settings, training_logs, validation_logs, holdout, transform)
    except ConfigError as error:
        source = model.settings.source
        if source is None or error.where.startswith("--"):
            raise
        raise ConfigError(f"{source.path}: {error.where}", error.what) from None


def as_list(logs: Logs) -> list[LogSource]:
    """Logs as a list, also of a single one."""
    if isinstance(logs, Sequence) and not isinstance(logs, str | Log):
        return list(logs)
    return [logs]


def _record(log: LogSource, model: Model) -> Path | JointLog:
    """The path of a log that is read with the configuration's options, or the record of one that was read."""
    if not isinstance(log, Log):
        return Path(log)
    options = model.settings.log
    if log.as_logged and (options.columns or any(dict(options.scale).values())):
        what = "columns" if options.columns else "scale"
        raise LogError(log.path, f"was read without the setting log.{what}; read it with Model.read_log")
    return log.record


def call_text(function: str, model: Model | Source, logs: Logs, **options: Any) -> str:
    """A call as a person would type it, for the pages.

    Parameters
    ----------
    function
        Its name.
    model, logs, options
        Its arguments.
    """
    validate = as_list(options.pop("validate", ()))
    model_name = model.name if isinstance(model, Model) else str(model)
    arguments = [repr(model_name), _paths_text(as_list(logs))]
    if validate:
        arguments.append(f"validate={_paths_text(validate)}")
    arguments += [f"{name}={value!r}" for name, value in options.items()]
    return f"idtool.{function}({', '.join(arguments)})"


def changed_options(function: Callable[..., Any], **options: Any) -> dict[str, Any]:
    """The options of a function that are not at their default."""
    defaults = function.__kwdefaults__ or {}
    return {name: value for name, value in options.items() if value != defaults[name]}


def _paths_text(logs: Sequence[LogSource]) -> str:
    return repr([str(log.path if isinstance(log, Log) else log) for log in logs])
