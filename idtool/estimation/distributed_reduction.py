"""Logs reduced one by one by the processes of a cluster: a fit from their reductions is that from all logs together.

A reduction holds what a fit needs of a log: R-factors of its rows and statistics. Workers read the logs, from a file
system that all of them see or from URLs. This process writes the reductions to a folder; workers on this machine write
them themselves, so that they need not be sent. A log whose reduction is in the folder, made from the same file with the
same settings, is not read again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from glob import escape
from pathlib import Path
from typing import Any, Self

from idtool.common.cluster import Cluster
from idtool.common.dataclass import dataclass
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
_KEYS_NOT_IN_ROWS = {  # keys of the configuration that a reduction does not depend on
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
_MAX_REDUCTIONS_PER_LOG = 3  # of different settings, the newest included
_MAX_STEM_LENGTH = 80  # characters of a log's name in that of its reduction
_MAX_OTHERS_NAMED = 3  # logs in a message, beside the first


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
        Number of logs that are used together, rounded up to a power of two so that one more changes nothing.
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
    def is_for_validation(self) -> bool:
        """True if all of the log is kept for validation."""
        return self.holdout == 1

    def name_of_reduction(self) -> str | None:
        """Name of the file with its reduction: `file_prefix` and a digest of all that it depends on.

        None if the version of the log is unknown; a server is asked for it.
        """
        log_version = version_of(self.path)
        if log_version is None:
            return None
        dependencies = {
            "idtool": VERSION,
            "urdf": hashlib.sha256(self.robot.text).hexdigest(),
            "config": self.config.model_dump(mode="json", exclude=_KEYS_NOT_IN_ROWS),
            "version": log_version,
            "holdout": self.holdout,
            "logs": self.log_count,
        }
        return f"{self.file_prefix}.{_digest(json.dumps(dependencies))}{REDUCTION_SUFFIX}"

    @property
    def file_prefix(self) -> str:
        """Beginning of the names of all its reductions; it tells logs of one name in different folders apart."""
        return f"{self.path.stem[:_MAX_STEM_LENGTH]}.{_digest(str(self.path))}"


@dataclass(frozen=True)
class ReducedLogs:
    """Logs that were reduced one by one.

    Attributes
    ----------
    training, validation
        Logs for the fit and for validation, with their reductions.
    notices
        One for each log that was left out.
    """

    training: tuple[tuple[Path, SavedReduction], ...]
    validation: tuple[tuple[Path, SavedReduction], ...]
    notices: tuple[Notice, ...]


@with_single_threaded_blas
def reduce_log(task: LogTask) -> bytes | IdtoolError | None:
    """Reduce a log, on a worker.

    Returns
    -------
    The content of the file with its reduction; None if the worker has written the file; or the error that prevented it.

    Raises
    ------
    TransferError
        If the log is behind a URL and cannot be read; Dask then tries again.
    """
    limit_processes(1)  # each process of a cluster has its own core
    try:
        reduction = _read_and_reduce(task)
        if task.file is None:
            return reduction_bytes(reduction)
        write_reduction(task.file, reduction)
    except TransferError:  # Dask tries again what raises
        raise
    except IdtoolError as error:
        return error
    return None


def _read_and_reduce(task: LogTask) -> SavedReduction:
    """The reduction of a log; ConfigError if the delay of the controller would have to be fitted."""
    if task.is_for_validation:
        experiment = prepare(task.robot, task.config, [], [task.path], holdout=0.0)
    else:
        experiment = prepare(task.robot, task.config, [task.path], [], task.holdout)
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

    Those with other joints, or a higher cut-off, than all logs share are then reduced again, with what all share.

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
        True if it is an error that no log for the fit, or for validation, can be used.
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
    training_holdout = 0.0 if validate else holdout
    holdouts = [training_holdout] * len(logs) + [1.0] * len(validate)
    log_count = rounded_count(len(holdouts))
    tasks = {}
    for i, (path, own_holdout) in enumerate(zip((*logs, *validate), holdouts, strict=True)):
        tasks[i] = LogTask(robot, config, path, own_holdout, log_count)
    reductions, failures = _read_or_reduce(cluster, tasks, folder, progress, with_excerpts)

    def usable_logs() -> list[int]:
        """Numbers of the logs that can be used; raises if a bad one is not to be skipped, or if too few are left."""
        usable = sorted(reductions.keys() - failures.keys())  # what fails the second time has its first reduction
        lacking = None
        if needs_training and all(tasks[i].is_for_validation for i in usable):
            lacking = "no other log can be used for the fit"
        elif needs_validation and not any(tasks[i].is_for_validation for i in usable):
            lacking = "no other log can be used for validation"
        _check_failures(failures, skip_bad, lacking)
        return usable

    to_reduce_again = {}
    usable = usable_logs()
    if usable:
        shared = _SharedSelection.of([reductions[i] for i in usable])
        shared_config = config.model_copy(update=shared.config_update(config))
        differing = [i for i in usable if not shared.matches(reductions[i])]
        to_reduce_again = {i: replace(tasks[i], config=shared_config) for i in differing}
    second_reductions, second_failures = _read_or_reduce(cluster, to_reduce_again, folder, progress, with_excerpts)
    reductions |= second_reductions
    failures |= second_failures
    usable = usable_logs()
    return ReducedLogs(
        training=tuple((tasks[i].path, reductions[i]) for i in usable if not tasks[i].is_for_validation),
        validation=tuple((tasks[i].path, reductions[i]) for i in usable if tasks[i].is_for_validation),
        notices=tuple(left_out_notice(failures[i]) for i in sorted(failures)),
    )


def remove_reductions(folder: Path) -> None:
    """Remove the reductions of single logs, and their folder if there is nothing else in it."""
    for file in folder.glob(f"*.*.*{REDUCTION_SUFFIX}"):
        file.unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


@dataclass(frozen=True)
class _SharedSelection:
    """Joints and cut-off that all logs share."""

    joints: tuple[str, ...]
    band_hz: float

    @classmethod
    def of(cls, reductions: Sequence[SavedReduction]) -> Self:
        """The joints that all logs have, in the order of the first, and the lowest of their cut-offs."""
        first, *others = [reduction.settings["joints"] for reduction in reductions]
        joints = [name for name in first if all(name in other for other in others)]
        return cls(tuple(joints), min(reduction.band_hz for reduction in reductions))

    def matches(self, reduction: SavedReduction) -> bool:
        """True if a log was reduced with just these joints and this cut-off."""
        return tuple(reduction.settings["joints"]) == self.joints and reduction.band_hz == self.band_hz

    def config_update(self, config: Config) -> dict[str, Any]:
        """Keys for a configuration that select these joints and this cut-off."""
        low_pass = config.filter.model_copy(update={"cutoff_hz": self.band_hz})
        return {"joints": self.joints, "filter": low_pass}


def _read_or_reduce(
    cluster: Cluster, tasks: Mapping[int, LogTask], folder: Path, progress: Progress, with_excerpts: bool
) -> tuple[dict[int, SavedReduction], dict[int, LogError]]:
    """Reductions of logs, by their numbers, and the errors of those that have none.

    They are read from the folder or, where they are not there, made on the cluster and written to it.
    """
    reductions: dict[int, SavedReduction] = {}
    failures: dict[int, Exception] = {}
    missing = []
    files: dict[int, Path] = {}
    for i, task in tasks.items():
        name = task.name_of_reduction()
        files[i] = folder / (name or f"{task.file_prefix}.unversioned{REDUCTION_SUFFIX}")
        reduction = _reduction_in(files[i], with_excerpts) if name else None
        if reduction is None:
            missing.append(i)
        else:
            reductions[i] = reduction
    missing_tasks = [replace(tasks[i], file=files[i] if cluster.is_local else None) for i in missing]
    for k, outcome in cluster.evaluate(reduce_log, missing_tasks):
        i = missing[k]
        if isinstance(outcome, OutputError):  # of no log, such as a full disk
            raise outcome
        if isinstance(outcome, Exception):
            failures[i] = outcome
            enough = min(len(tasks), cluster.threads + 1)  # each process, and one of them twice
            _raise_if_settings_are_wrong(failures.values(), len(reductions), enough)
        else:
            reductions[i] = _received_reduction(files[i], outcome, with_excerpts)
        _remove_surplus(files[i], tasks[i].file_prefix)
        progress(_stage(cluster, len(tasks), len(failures)), (len(reductions) + len(failures)) / len(tasks))
    return reductions, {i: _log_error(tasks[i].path, error) for i, error in failures.items()}


def _stage(cluster: Cluster, log_count: int, failure_count: int) -> str:
    """Text for the progress bar: what is being done, and how many logs have failed."""
    processes = "1 process" if cluster.threads == 1 else f"{cluster.threads} processes"
    stage = f"reducing {count_text(log_count, 'log')} on {processes}"
    return f"{stage}, {failure_count} failed" if failure_count else stage


def _received_reduction(file: Path, content: bytes | None, with_excerpts: bool) -> SavedReduction:
    """The reduction that a worker made: from its content, which is written to the file, or from the file it wrote."""
    if content is None:
        return read_reduction(file, with_excerpts)
    write_all(file.parent, {file.name: content})
    return parse_reduction(file, content, with_excerpts)


def _reduction_in(file: Path, with_excerpts: bool) -> SavedReduction | None:
    """The reduction in a file; None if there is none that can be used."""
    try:
        return read_reduction(file, with_excerpts) if file.is_file() else None
    except LogError:  # damaged: it is made again
        return None


def _remove_surplus(file: Path, file_prefix: str) -> None:
    """Remove the oldest other reductions of a log, and unfinished files of this one from workers that were killed."""
    for unfinished in unfinished_files(file):
        unfinished.unlink(missing_ok=True)
    of_log = [other for other in file.parent.glob(f"{escape(file_prefix)}.*{REDUCTION_SUFFIX}") if other != file]
    of_log.sort(key=lambda other: other.stat().st_mtime, reverse=True)
    for other in of_log[_MAX_REDUCTIONS_PER_LOG - 1 :]:
        other.unlink(missing_ok=True)


def _raise_if_settings_are_wrong(failures: Collection[Exception], successes: int, enough: int) -> None:
    """Raise the first error if no log succeeded, enough failed, and no error is about a log: it is the settings'."""
    if successes or len(failures) < enough:
        return
    of_settings = [error for error in failures if isinstance(error, IdtoolError) and not isinstance(error, LogError)]
    if len(of_settings) == len(failures):
        raise of_settings[0]


def _log_error(path: Path, error: Exception) -> LogError:
    """The error itself if it is about a log, else one that names the log."""
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
    ending = lacking or "--skip-bad leaves such logs out"
    if others:
        names = [Path(error.where).name for error in others[:_MAX_OTHERS_NAMED]]
        if len(others) > _MAX_OTHERS_NAMED:
            names.append(f"{len(others) - _MAX_OTHERS_NAMED} more")
        ending = f"{join_names(names)} cannot be used either; {ending}"
    raise LogError(first.where, f"{first.what}; {ending}")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:12]
