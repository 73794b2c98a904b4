"""Logs reduced one by one by the processes of a cluster, so that a fit from them is that from all logs together.

Workers read the logs, from a file system that all of them see or from URLs. What they return is written to a folder by
this process; workers on this machine write it themselves, so that it need not be sent. A log whose reduction
is there, made from the same file with the same settings, is not read again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from glob import escape
from pathlib import Path
from typing import Any, Self

from idtool.common.cluster import Cluster
from idtool.common.exceptions import ConfigError, IdtoolError, LogError, TransferError
from idtool.common.input_files import REDUCTION_SUFFIX
from idtool.common.names import count_text, join_names
from idtool.common.notice import Notice
from idtool.common.outputs import OutputError, write_all
from idtool.common.processes import limit_processes, no_progress
from idtool.common.threads import with_single_threaded_blas
from idtool.common.urls import version_of
from idtool.common.version import VERSION
from idtool.estimation.dataset.blocks import rounded_count
from idtool.estimation.dataset.experiment import Progress, check_holdout, left_out_notice, prepare
from idtool.estimation.reduced_experiment import save_reduction
from idtool.estimation.saved_reduction import (
    SavedReduction,
    parse_reduction,
    read_reduction,
    reduction_bytes,
    unfinished_files,
    write_reduction,
)
from idtool.robot.config import Config
from idtool.robot.urdf.reading import Robot

_WITHOUT_BOUNDS: dict[str, Any] = {"bounding_ellipsoids": {}, "bounding_shapes": {}}  # which may need meshes
_WITHOUT_EFFECT_ON_ROWS = {  # keys of the configuration that a reduction does not depend on
    *_WITHOUT_BOUNDS,
    *(
        "known_com",
        "constraints",
        "regularization",
        "known",
        "mirror",
        "solver",
        "simulation",
        "limits",
        "pool",
        "seed",
    ),
}
_MAX_KEPT = 3  # reductions of a log, of different settings
_LONGEST_NAME = 80  # characters of a log's name in that of its reduction
_MAX_NAMED = 3  # logs in a message


@dataclass(frozen=True)
class LogTask:
    """A log to reduce.

    Attributes
    ----------
    robot
        From the URDF.
    config
        Its configuration.
    path
        The log.
    holdout
        Share at its end that is kept for validation; 1: all of it.
    log_count
        Number of logs that are used together, rounded up to a power of two.
    file
        File that the worker writes; None: it returns the content.
    """

    robot: Robot
    config: Config
    path: Path
    holdout: float
    log_count: int
    file: Path | None = None

    @property
    def file_name(self) -> str | None:
        """Name of the file with its reduction, which differs for other settings; None if the log's version is unknown.

        It begins with that of all reductions of the log.
        """
        version = version_of(self.path)
        if version is None:
            return None
        settings = {
            "idtool": VERSION,
            "urdf": hashlib.sha256(self.robot.text).hexdigest(),
            "config": self.config.model_dump(mode="json", exclude=_WITHOUT_EFFECT_ON_ROWS),
            "version": version,
            "holdout": self.holdout,
            "logs": self.log_count,
        }
        return f"{self.log_name}.{_digest(json.dumps(settings))}{REDUCTION_SUFFIX}"

    @property
    def log_name(self) -> str:
        """Name of the log in that of the file, different for logs of the same name in different folders."""
        return f"{self.path.stem[:_LONGEST_NAME]}.{_digest(str(self.path))}"


@dataclass(frozen=True)
class ReducedLogs:
    """Logs that were reduced one by one.

    Attributes
    ----------
    training, validation
        Logs for the fit and for validation, with their reductions.
    notices
        Logs that were left out.
    """

    training: tuple[tuple[Path, SavedReduction], ...]
    validation: tuple[tuple[Path, SavedReduction], ...]
    notices: tuple[Notice, ...]


@with_single_threaded_blas
def reduce_log(task: LogTask) -> bytes | IdtoolError | None:
    """Reduce a log, on a worker.

    Returns
    -------
    The content of the file with its reduction, None if the worker has written the file, or the error of a log that
    cannot be used.

    Raises
    ------
    TransferError
        If the log is behind a URL and cannot be read; Dask then tries again.
    """
    limit_processes(1)  # each process of a cluster has its own core
    try:
        reduction = _reduced(task)
        if task.file is None:
            return reduction_bytes(reduction)
        write_reduction(task.file, reduction)
    except TransferError:
        raise
    except IdtoolError as error:
        return error
    return None


def _reduced(task: LogTask) -> SavedReduction:
    """Read and reduce a log; ConfigError if a delay of its controller would have to be fitted."""
    is_validated = task.holdout == 1
    logs, validate = ([], [task.path]) if is_validated else ([task.path], [])
    experiment = prepare(task.robot, task.config, logs, validate, 0.0 if is_validated else task.holdout)
    controller = task.config.controller
    if experiment.has_commands and controller is not None and controller.known_delay is None:
        what = "is not fitted on a cluster, since it is that of all logs together"
        raise ConfigError("controller.delay", f"{what}; fit one log without --cluster, and give its delay in s")
    return save_reduction(experiment, task.holdout, no_progress, task.log_count, keeps_excerpts=True)


def reduce_on_cluster(
    cluster: Cluster,
    robot: Robot,
    config: Config,
    logs: Sequence[Path],
    validate: Sequence[Path],
    holdout: float,
    folder: Path,
    skip_bad: bool,
    needs_training: bool,
    needs_validation: bool,
    progress: Progress,
    with_excerpts: bool = False,
) -> ReducedLogs:
    """Reduce logs on a cluster.

    Parameters
    ----------
    cluster
        The cluster.
    robot
        From the URDF.
    config
        Its configuration.
    logs, validate, holdout
        As in `prepare`.
    folder
        Where reductions are written.
    skip_bad
        If true, logs that cannot be used are left out; a notice names them.
    needs_training, needs_validation
        True if one of the logs for the fit, or for validation, must be left.
    progress
        Callback for the stage and its progress, from 0 to 1.
    with_excerpts
        True to return the excerpts of the logs too.

    Raises
    ------
    IdtoolError
        If a log, the configuration or the model cannot be used, or a file cannot be written.
    """
    check_holdout(holdout)
    config = config.model_copy(update=_WITHOUT_BOUNDS)
    holdouts = [0.0 if validate else holdout] * len(logs) + [1.0] * len(validate)
    log_count = rounded_count(len(holdouts))
    tasks = []
    for path, own_holdout in zip((*logs, *validate), holdouts, strict=True):
        tasks.append(LogTask(robot, config, path, own_holdout, log_count))
    reductions, failures = _reductions(cluster, dict(enumerate(tasks)), folder, progress, with_excerpts)

    def usable_logs() -> list[int]:
        """Numbers of the logs that can be used; raises if a bad one is not to be skipped, or if too few are left."""
        usable = sorted(reductions.keys() - failures.keys())
        lacking = None
        if needs_training and not any(i < len(logs) for i in usable):
            lacking = "no other log can be used for the fit"
        elif needs_validation and not any(i >= len(logs) for i in usable):
            lacking = "no other log can be used for validation"
        _check_failures(failures, skip_bad, lacking)
        return usable

    differing = {}
    usable = usable_logs()
    if usable:
        common = _CommonSignals.of([reductions[i] for i in usable])
        common_config = config.model_copy(update=common.changes(config))
        differing = {i: replace(tasks[i], config=common_config) for i in usable if not common.are_in(reductions[i])}
    second_reductions, second_failures = _reductions(cluster, differing, folder, progress, with_excerpts)
    reductions |= second_reductions
    failures |= second_failures
    used = usable_logs()
    return ReducedLogs(
        training=tuple((tasks[i].path, reductions[i]) for i in used if i < len(logs)),
        validation=tuple((tasks[i].path, reductions[i]) for i in used if i >= len(logs)),
        notices=tuple(left_out_notice(failures[i]) for i in sorted(failures)),
    )


def remove_reductions(folder: Path) -> None:
    """Remove the reductions of single logs, and their folder if there is nothing else in it."""
    for file in folder.glob(f"*.*.*{REDUCTION_SUFFIX}"):
        file.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


@dataclass(frozen=True)
class _CommonSignals:
    """Joints and cut-off that all logs share."""

    joints: tuple[str, ...]
    band_hz: float

    @classmethod
    def of(cls, reductions: Sequence[SavedReduction]) -> Self:
        """The joints that all logs have, in the order of the first, and the lowest of their cut-offs."""
        first, *others = [reduction.settings["joints"] for reduction in reductions]
        joints = [name for name in first if all(name in joints for joints in others)]
        return cls(tuple(joints), min(reduction.band_hz for reduction in reductions))

    def are_in(self, reduction: SavedReduction) -> bool:
        """True if a log was reduced with just these joints and this cut-off."""
        return tuple(reduction.settings["joints"]) == self.joints and reduction.band_hz == self.band_hz

    def changes(self, config: Config) -> dict[str, Any]:
        """The keys of a configuration that select them."""
        low_pass = config.filter.model_copy(update={"cutoff_hz": self.band_hz})
        return {"joints": self.joints, "filter": low_pass}


def _reductions(
    cluster: Cluster, tasks: Mapping[int, LogTask], folder: Path, progress: Progress, with_excerpts: bool
) -> tuple[dict[int, SavedReduction], dict[int, LogError]]:
    """Reductions of logs, and the errors of those that have none, by their numbers."""
    reductions: dict[int, SavedReduction] = {}
    failures: dict[int, Exception] = {}
    missing = []
    files: dict[int, Path] = {}
    for i, task in tasks.items():
        name = task.file_name
        files[i] = folder / (name or f"{task.log_name}.unversioned{REDUCTION_SUFFIX}")
        reduction = _written_reduction(files[i], with_excerpts) if name else None
        if reduction is None:
            missing.append(i)
        else:
            reductions[i] = reduction
    missing_tasks = [replace(tasks[i], file=files[i] if cluster.is_local else None) for i in missing]
    for k, outcome in cluster.evaluate(reduce_log, missing_tasks):
        i = missing[k]
        if isinstance(outcome, OutputError):
            raise outcome
        if isinstance(outcome, Exception):
            failures[i] = outcome
            _raise_common_error(failures.values(), len(reductions), min(len(tasks), cluster.threads + 1))
        else:
            reductions[i] = _new_reduction(files[i], outcome, with_excerpts)
        _remove_outdated(files[i], tasks[i].log_name)
        progress(_stage(cluster, len(tasks), len(failures)), (len(reductions) + len(failures)) / len(tasks))
    return reductions, {i: _log_error(tasks[i].path, error) for i, error in failures.items()}


def _stage(cluster: Cluster, logs: int, failed: int) -> str:
    """What is done, and how many logs have failed."""
    processes = "1 process" if cluster.threads == 1 else f"{cluster.threads} processes"
    stage = f"reducing {count_text(logs, 'log')} on {processes}"
    return f"{stage}, {failed} failed" if failed else stage


def _new_reduction(file: Path, content: bytes | None, with_excerpts: bool) -> SavedReduction:
    """The reduction that a worker made: from its content, which is written to the file, or from the file it wrote."""
    if content is None:
        return read_reduction(file, with_excerpts)
    write_all(file.parent, {file.name: content})
    return parse_reduction(file, content, with_excerpts)


def _written_reduction(file: Path, with_excerpts: bool) -> SavedReduction | None:
    """The reduction in a file; None if there is none that can be used."""
    try:
        return read_reduction(file, with_excerpts) if file.is_file() else None
    except LogError:  # it is made again
        return None


def _remove_outdated(file: Path, log_name: str) -> None:
    """Remove the oldest other reductions of a log, and unfinished files of this one from workers that were killed."""
    for unfinished in unfinished_files(file):
        unfinished.unlink(missing_ok=True)
    of_log = [other for other in file.parent.glob(f"{escape(log_name)}.*{REDUCTION_SUFFIX}") if other != file]
    of_log.sort(key=lambda other: other.stat().st_mtime, reverse=True)
    for other in of_log[_MAX_KEPT - 1 :]:
        other.unlink(missing_ok=True)


def _raise_common_error(failures: Collection[Exception], successes: int, enough: int) -> None:
    """Raise the first error if no log succeeded, enough failed, and no error is about a log but all about settings."""
    if successes or len(failures) < enough:
        return
    errors = [error for error in failures if isinstance(error, IdtoolError) and not isinstance(error, LogError)]
    if len(errors) == len(failures):
        raise errors[0]


def _log_error(path: Path, error: Exception) -> LogError:
    """Error about a log."""
    if isinstance(error, LogError):
        return error
    reason = str(error) or type(error).__name__
    if isinstance(error, IdtoolError):
        return LogError(path, f"does not fit the configuration: {reason}")
    return LogError(path, f"cannot be reduced: {reason}")


def _check_failures(failures: Mapping[int, LogError], skip_bad: bool, lacking: str | None) -> None:
    """Raise an error about the first log that cannot be used, unless such logs are left out and nothing is lacking."""
    if not failures or (skip_bad and lacking is None):
        return
    first, *others = [failures[i] for i in sorted(failures)]
    advice = lacking or "--skip-bad leaves such logs out"
    if others:
        names = [Path(error.where).name for error in others[:_MAX_NAMED]]
        if len(others) > _MAX_NAMED:
            names.append(f"{len(others) - _MAX_NAMED} more")
        advice = f"{join_names(names)} cannot be used either; {advice}"
    raise LogError(first.where, f"{first.what}; {advice}")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:12]
