"""An experiment from a user's model and logs; and the text of a call, for the pages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from idtool.api.log import Log
from idtool.api.model import Model, Source, as_model
from idtool.api.results import Progress
from idtool.common.exceptions import ConfigError, LogError
from idtool.common.input_files import REDUCTION_SUFFIX
from idtool.data.logs import JointLog
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.reduced_experiment import prepare_reduced
from idtool.estimation.saved_reduction import SavedReduction, read_reduction

LogSource = Log | Source
Logs = LogSource | Sequence[LogSource]

DEFAULT_HOLDOUT = 0.3  # share at the end of every log


def load_experiment(
    model: Model | Source,
    logs: Logs,
    validate: Logs = (),
    holdout: float = DEFAULT_HOLDOUT,
    progress: Progress = lambda stage, share: None,
    transform: Callable[[JointLog], JointLog] = lambda log: log,
    takes_reductions: bool = False,
) -> Experiment:
    """Load logs, or reduced logs, and put them together with a model.

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
    takes_reductions
        If true, the logs may be files of `idtool reduce`.

    Raises
    ------
    IdtoolError
        If a log, the configuration or the model cannot be used.
    """
    progress("reading", 0.0)
    model = as_model(model)
    has_reductions = any(_reduction_path(log) for log in (*as_list(logs), *as_list(validate)))
    training_logs = [_record(log, model) for log in as_list(logs)]
    validation_logs = [_record(log, model) for log in as_list(validate)]
    try:
        if has_reductions and takes_reductions:
            return _with_reductions(model, as_list(logs), as_list(validate), holdout)
        return prepare(model.robot, model.settings, training_logs, validation_logs, holdout, transform)
    except ConfigError as error:
        source = model.settings.source
        if source is None or error.where.startswith("--"):
            raise
        raise ConfigError(f"{source.path}: {error.where}", error.what) from None


def _reduction_path(log: LogSource) -> Path | None:
    """The path of a file of `idtool reduce`, which is known by its name; None for others."""
    if isinstance(log, Log) or Path(log).suffix.lower() != REDUCTION_SUFFIX:
        return None
    return Path(log)


def _with_reductions(
    model: Model, logs: Sequence[LogSource], validate: Sequence[LogSource], holdout: float
) -> Experiment:
    """A model with reduced logs."""
    training = [_read_reduction(log) for log in logs]
    validation = [_read_reduction(log) for log in validate]
    for path, reduction in training:
        if not validate and holdout not in (reduction.holdout, DEFAULT_HOLDOUT):
            what = f"{path} was made with --holdout {reduction.holdout:g}"
            raise ConfigError("--holdout", f"{what}; make it again with idtool reduce for another one")
    return prepare_reduced(model.robot, model.settings, training, validation)


def _read_reduction(log: LogSource) -> tuple[Path, SavedReduction]:
    """A file of `idtool reduce`, and what is in it; LogError for a log."""
    path = _reduction_path(log)
    if path is None:
        log_path = log.path if isinstance(log, Log) else Path(log)
        raise LogError(log_path, "is a log among reductions; make a reduction of it with idtool reduce")
    return path, read_reduction(path)


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
