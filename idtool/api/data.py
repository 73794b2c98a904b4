"""An experiment from a user's model and logs; and the text of a call, for the pages."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from inspect import unwrap
from pathlib import Path
from typing import Any

from idtool.api.distribution import Distribution
from idtool.api.log import Log
from idtool.api.model import Model, Source, as_model
from idtool.api.results import Progress
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, LogError, TransferError
from idtool.common.input_files import REDUCTION_SUFFIX
from idtool.common.names import without_secrets
from idtool.common.notice import Notice, unique
from idtool.common.provenance import InputFile
from idtool.common.urls import local_copy, log_path
from idtool.data.logs import JointLog
from idtool.estimation.dataset.experiment import Experiment, is_about, left_out_notice, prepare
from idtool.estimation.dataset.robots_of_logs import robots_of_logs
from idtool.estimation.distributed_reduction import reduce_on_cluster
from idtool.estimation.fleet import check_fleet
from idtool.estimation.reduced_experiment import ReducedExperiment, prepare_reduced, save_reduction
from idtool.estimation.reduction_excerpts import choose_excerpts
from idtool.estimation.saved_reduction import SavedReduction, read_reduction
from idtool.robot.config.pool import Pool

LogSource = Log | Source
Logs = LogSource | Sequence[LogSource]
FileAndReduction = tuple[Path, SavedReduction]

DEFAULT_HOLDOUT = 0.3  # share at the end of every log


def load_experiment(
    model: Model | Source,
    logs: Logs,
    validate: Logs = (),
    holdout: float = DEFAULT_HOLDOUT,
    progress: Progress = lambda stage, share: None,
    transform: Callable[[JointLog], JointLog] = lambda log: log,
    takes_reductions: bool = False,
    distribution: Distribution | None = None,
    skip_bad: bool = False,
    pool: Pool | None = None,
    with_excerpts: bool = False,
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
        If true, some or all of the logs may be files of `idtool reduce`.
    distribution
        A cluster that reduces the logs; None: they are read here.
    skip_bad
        If true, logs that cannot be used are left out; a notice names them.
    pool
        The fleet that the logs are of, which are reduced then; None: they are of one robot.
    with_excerpts
        If true, reductions are read with the excerpts of their logs.

    Raises
    ------
    IdtoolError
        If a log, the configuration or the model cannot be used.
    """
    progress("reading", 0.0)
    model = as_model(model)
    given, damaged = _given_logs(logs, validate, holdout, skip_bad)
    with _in_configuration(model):
        if distribution is not None:
            model.settings.require_only_joints("--cluster")
        if pool is not None:
            model.settings.require_only_joints("pool")
        if pool is not None and not given.has_reductions:
            robots_of_logs(pool, [path_of(log) for log in (*given.logs, *given.validate)])
        experiment: Experiment
        if distribution is not None:
            experiment = _reduced_by_cluster(model, given, distribution, skip_bad, progress, with_excerpts)
        elif pool is not None or (takes_reductions and given.has_reductions):
            experiment = _with_reductions(model, given, skip_bad, progress, with_excerpts)
        else:
            experiment = _prepare(model, given.logs, given.validate, holdout, skip_bad, transform)
        if pool is not None and isinstance(experiment, ReducedExperiment):
            check_fleet(pool, experiment)
        return replace(experiment, loading_notices=(*damaged, *experiment.loading_notices))


def load_for_diagnosis(
    model: Model | Source,
    logs: Logs,
    validate: Logs = (),
    holdout: float = DEFAULT_HOLDOUT,
    progress: Progress = lambda stage, share: None,
    distribution: Distribution | None = None,
    skip_bad: bool = False,
) -> Experiment:
    """Load logs, of reductions the excerpts of their logs, and put them together with a model.

    Parameters
    ----------
    model, logs, validate, holdout, progress, distribution, skip_bad
        As in `load_experiment`; with a cluster, excerpts of all logs are used.

    Raises
    ------
    IdtoolError
        If a log, the configuration or the model cannot be used, or a reduction has no excerpts.
    """
    progress("reading", 0.0)
    model = as_model(model)
    given, damaged = _given_logs(logs, validate, holdout, skip_bad)
    with _in_configuration(model):
        training, validation = given.reductions(with_excerpts=True)
        left_out: tuple[Notice, ...] = ()
        if distribution is not None:
            model.settings.require_only_joints("--cluster")
            training, validation, left_out = _with_cluster_reductions(
                training, validation, model, given, distribution, skip_bad, progress, with_excerpts=True
            )
        excerpts = choose_excerpts(training, validation, model.settings)
        if distribution is None:
            training_logs = _with_excerpts_in_place(given.logs, excerpts.training)
            validation_logs = _with_excerpts_in_place(given.validate, excerpts.validation)
        else:
            training_logs = _as_logs(excerpts.training)
            validation_logs = _as_logs(excerpts.validation)
        experiment = _prepare(model, training_logs, validation_logs, holdout, skip_bad)
    notices = (*damaged, *left_out, *experiment.loading_notices, *excerpts.notices)
    return replace(experiment, loading_notices=notices)


@contextmanager
def _in_configuration(model: Model) -> Iterator[None]:
    """Name the file of a model's configuration in errors about a key of it."""
    try:
        yield
    except ConfigError as error:
        source = model.settings.source
        if source is None or error.where.startswith("--"):
            raise
        raise ConfigError(f"{source.path}: {error.where}", error.what) from None


@dataclass(frozen=True)
class _GivenLogs:
    """Logs and reductions as they were given."""

    logs: Sequence[LogSource]
    validate: Sequence[LogSource]
    holdout: float

    @property
    def has_reductions(self) -> bool:
        """True if some are files of `idtool reduce`."""
        return any(reduction_path(log) for log in (*self.logs, *self.validate))

    def without_reductions(self) -> _GivenLogs:
        """The logs alone. Nothing of them is held out if others, maybe reductions, are for validation."""
        logs = [log for log in self.logs if reduction_path(log) is None]
        validate = [log for log in self.validate if reduction_path(log) is None]
        return _GivenLogs(logs, validate, 0.0 if self.validate else self.holdout)

    def reductions(self, with_excerpts: bool) -> tuple[list[FileAndReduction], list[FileAndReduction]]:
        """The files of `idtool reduce` for the fit and for validation."""
        return _read_reductions(self.logs, with_excerpts), _read_reductions(self.validate, with_excerpts)

    def check_holdout(self, training: Sequence[FileAndReduction]) -> None:
        """Refuse reductions for a fit in which another part of the logs is held out; ConfigError."""
        for path, reduction in training:
            if not self.validate and self.holdout not in (reduction.holdout, DEFAULT_HOLDOUT):
                what = f"{path} was made with --holdout {reduction.holdout:g}"
                raise ConfigError("--holdout", f"{what}; make it again with idtool reduce for another one")


def _given_logs(logs: Logs, validate: Logs, holdout: float, skip_bad: bool) -> tuple[_GivenLogs, tuple[Notice, ...]]:
    """Logs and holdout as given; with ``skip_bad``, damaged reductions are left out, with a notice for each."""
    given = _GivenLogs(as_list(logs), as_list(validate), holdout)
    if not (skip_bad and given.has_reductions):
        return given, ()
    usable_logs, errors = _without_damaged_reductions(given.logs)
    usable_validate, errors_of_validate = _without_damaged_reductions(given.validate)
    usable = replace(given, logs=usable_logs, validate=usable_validate)
    return usable, unique(map(left_out_notice, (*errors, *errors_of_validate)))


def _without_damaged_reductions(logs: Sequence[LogSource]) -> tuple[list[LogSource], list[LogError]]:
    """Logs, which are not read here, and readable files of `idtool reduce`, and the errors of the other files.

    Raises
    ------
    LogError
        If nothing is left of them, or a file behind a URL cannot be reached.
    """
    usable, errors = [], []
    for log in logs:
        try:
            _read_reductions([log], with_excerpts=False)
        except TransferError:  # of the connection: the file may be good
            raise
        except LogError as error:
            errors.append(error)
        else:
            usable.append(log)
    if errors and not usable:
        raise LogError(errors[0].where, f"{errors[0].what}; no other log can be used")
    return usable, errors


def _prepare(
    model: Model,
    logs: Sequence[LogSource],
    validate: Sequence[LogSource],
    holdout: float,
    skip_bad: bool,
    transform: Callable[[JointLog], JointLog] = lambda log: log,
) -> Experiment:
    """Model and logs, which are read here; with ``skip_bad``, those that can be used."""
    if not skip_bad or not (logs or validate):
        training = [_record(log, model) for log in logs]
        validation = [_record(log, model) for log in validate]
        return prepare(model.robot, model.settings, training, validation, holdout, transform)
    experiment, failures = _prepare_usable(model, logs, validate, holdout, bool(logs), bool(validate), transform)
    if experiment is None:
        raise LogError(failures[0].where, f"{failures[0].what}; no other log can be used")
    return experiment


def _prepare_usable(
    model: Model,
    logs: Sequence[LogSource],
    validate: Sequence[LogSource],
    holdout: float,
    needs_training: bool,
    needs_validation: bool,
    transform: Callable[[JointLog], JointLog] = lambda log: log,
) -> tuple[Experiment | None, list[LogError]]:
    """Model and those of the logs that can be used, and the errors of the others; None if too few are left.

    Parameters
    ----------
    model, logs, validate, holdout, transform
        As in `load_experiment`.
    needs_training, needs_validation
        True if one of the logs for the fit, or for validation, must be left.
    """
    failures: list[LogError] = []
    training = [record for log in logs if (record := _readable(log, model, failures))]
    validation = [record for log in validate if (record := _readable(log, model, failures))]
    while True:
        lacks_training = needs_training and not training
        lacks_validation = needs_validation and not validation
        if lacks_training or lacks_validation or not (training or validation):
            return None, failures
        try:
            experiment = prepare(model.robot, model.settings, training, validation, holdout, transform)
        except LogError as error:  # a log that can be read, but not used
            count = len(training) + len(validation)
            training = [log for log in training if not is_about(error, log.path)]
            validation = [log for log in validation if not is_about(error, log.path)]
            if len(training) + len(validation) == count:
                raise
            failures.append(error)
        else:
            return replace(experiment, loading_notices=tuple(map(left_out_notice, failures))), failures


def _readable(log: LogSource, model: Model, failures: list[LogError]) -> JointLog | None:
    """A log that is read; None if it cannot be, and its error is then one more of the failures."""
    try:
        record = _record(log, model)
        return record if isinstance(record, JointLog) else model.read_log(record).record
    except LogError as error:
        failures.append(error)
        return None


def _with_reductions(
    model: Model, given: _GivenLogs, skip_bad: bool, progress: Progress, with_excerpts: bool
) -> Experiment:
    """A model with reduced logs; logs among them are reduced here."""
    training, validation = given.reductions(with_excerpts)
    given.check_holdout(training)
    unreduced = given.without_reductions()
    experiment: Experiment | None = None
    failures: list[LogError] = []
    needs_training = bool(given.logs) and not training
    needs_validation = bool(given.validate) and not validation
    if skip_bad:
        experiment, failures = _prepare_usable(
            model, unreduced.logs, unreduced.validate, unreduced.holdout, needs_training, needs_validation
        )
        if experiment is None and (needs_training or needs_validation):
            raise LogError(failures[0].where, f"{failures[0].what}; no other log can be used")
    elif unreduced.logs or unreduced.validate:
        experiment = _prepare(model, unreduced.logs, unreduced.validate, unreduced.holdout, skip_bad)
    notices: tuple[Notice, ...] = ()
    if experiment is not None:
        reduction = save_reduction(experiment, unreduced.holdout, progress, keeps_excerpts=with_excerpts)
        notices = reduction.notices  # which name the logs
        of_training: list[FileAndReduction] = []
        of_validation: list[FileAndReduction] = []
        for log, run in zip(reduction.logs, experiment.runs, strict=True):
            files = run.signals.log.sources or (InputFile("log", str(log.path), None),)
            of_log = (log.path, replace(reduction, logs=(log,), files=files, notices=()))
            (of_training if run.train else of_validation).append(of_log)
        training = _in_order(given.logs, training, of_training)
        validation = _in_order(given.validate, validation, of_validation)
    reduced = prepare_reduced(model.robot, model.settings, training, validation)
    left_out = tuple(map(left_out_notice, failures))
    return replace(reduced, loading_notices=left_out, log_notices=unique((*notices, *reduced.log_notices)))


def _reduced_by_cluster(
    model: Model,
    given: _GivenLogs,
    distribution: Distribution,
    skip_bad: bool,
    progress: Progress,
    with_excerpts: bool,
) -> Experiment:
    """A model with logs that a cluster reduces, and with reductions."""
    training, validation = given.reductions(with_excerpts)
    given.check_holdout(training)
    training, validation, left_out = _with_cluster_reductions(
        training, validation, model, given, distribution, skip_bad, progress, with_excerpts
    )
    return replace(prepare_reduced(model.robot, model.settings, training, validation), loading_notices=left_out)


def _with_cluster_reductions(
    training: list[FileAndReduction],
    validation: list[FileAndReduction],
    model: Model,
    given: _GivenLogs,
    distribution: Distribution,
    skip_bad: bool,
    progress: Progress,
    with_excerpts: bool,
) -> tuple[list[FileAndReduction], list[FileAndReduction], tuple[Notice, ...]]:
    """Reductions for the fit and for validation with those of the given logs, which a cluster makes, in their order.

    The third part of the result are notices about logs that are left out.
    """
    unreduced = given.without_reductions()
    if not (unreduced.logs or unreduced.validate):
        return training, validation, ()
    reduced = reduce_on_cluster(
        distribution.cluster,
        model.robot,
        model.settings,
        [_log_file(log) for log in unreduced.logs],
        [_log_file(log) for log in unreduced.validate],
        unreduced.holdout,
        distribution.folder,
        skip_bad,
        bool(given.logs) and not training,
        bool(given.validate) and not validation,
        progress,
        with_excerpts,
    )
    training = _in_order(given.logs, training, reduced.training)
    validation = _in_order(given.validate, validation, reduced.validation)
    return training, validation, reduced.notices


def _in_order(
    given: Sequence[LogSource], from_files: Sequence[FileAndReduction], of_logs: Sequence[FileAndReduction]
) -> list[FileAndReduction]:
    """Reductions from files and those of logs, without logs that were left out, in the order in which they are given.

    The order of the logs is that of their blocks in cross-validation.
    """
    remaining_files, remaining_logs = list(from_files), list(of_logs)
    ordered = []
    for log in given:
        if reduction_path(log) is not None:
            ordered.append(remaining_files.pop(0))
        elif remaining_logs and remaining_logs[0][0] == path_of(log):
            ordered.append(remaining_logs.pop(0))
    return [*ordered, *remaining_logs]


def path_of(log: LogSource) -> Path:
    """Path of a log."""
    return log.path if isinstance(log, Log) else log_path(log)


def _log_file(log: LogSource) -> Path:
    """Path of a log, which a cluster's processes read."""
    if isinstance(log, Log):
        raise LogError(log.path, "was read already, and a cluster reads files; give its path")
    return log_path(log)


def reduction_path(log: LogSource) -> Path | None:
    """The path of a file of `idtool reduce`, which is known by its name; None for a log."""
    if isinstance(log, Log) or not str(log).lower().endswith(REDUCTION_SUFFIX):
        return None
    return log_path(log)


def _with_excerpts_in_place(logs: Sequence[LogSource], excerpts: Sequence[Sequence[JointLog]]) -> list[LogSource]:
    """Logs with the excerpts of a reduction in place of its file, in the order of the reductions."""
    replaced: list[LogSource] = []
    remaining = iter(excerpts)
    for log in logs:
        if reduction_path(log) is None:
            replaced.append(log)
        else:
            replaced += map(Log.from_record, next(remaining))
    return replaced


def _as_logs(excerpts: Sequence[Sequence[JointLog]]) -> list[LogSource]:
    """Excerpts of several reductions as logs."""
    return [Log.from_record(excerpt) for of_reduction in excerpts for excerpt in of_reduction]


def _read_reductions(logs: Sequence[LogSource], with_excerpts: bool) -> list[FileAndReduction]:
    """The files of `idtool reduce` among logs, and what is in them."""
    reductions = []
    for log in logs:
        path = reduction_path(log)
        if path is not None:
            with local_copy(path) as file:
                reductions.append((path, read_reduction(file, with_excerpts)))
    return reductions


def as_list(logs: Logs) -> list[LogSource]:
    """Logs as a list, also of a single one."""
    if isinstance(logs, Sequence) and not isinstance(logs, str | Log):
        return list(logs)
    return [logs]


def _record(log: LogSource, model: Model) -> Path | JointLog:
    """The path of a log that is read with the configuration's options, or the record of one that was read."""
    if not isinstance(log, Log):
        return log_path(log)
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
    defaults = unwrap(function).__kwdefaults__ or {}
    return {name: value for name, value in options.items() if value != defaults[name]}


def _paths_text(logs: Sequence[LogSource]) -> str:
    return repr([without_secrets(str(log.path if isinstance(log, Log) else log)) for log in logs])
