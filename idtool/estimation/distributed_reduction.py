"""Logs reduced one by one by the processes of a cluster, so that a fit from them is that from all logs together.

Workers read the logs, from a file system that all of them see or from URLs. What they return is written to a folder by
this process. A log whose reduction is there, made from the same file with the same settings, is not read again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from idtool.common.cluster import Cluster
from idtool.common.exceptions import ConfigError, IdtoolError, LogError
from idtool.common.input_files import REDUCTION_SUFFIX
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.outputs import write_all
from idtool.common.processes import limit_processes
from idtool.common.urls import version_of
from idtool.common.version import VERSION
from idtool.estimation.dataset.experiment import Progress, left_out_notice, prepare
from idtool.estimation.dataset.reduced_logs import LogPlaces
from idtool.estimation.reduced_experiment import save_reduction
from idtool.estimation.saved_reduction import SavedReduction, read_reduction, reduction_bytes
from idtool.robot.config import Config
from idtool.robot.urdf.reading import Robot

_WITHOUT_EFFECT: dict[str, Any] = {"bounding_ellipsoids": {}, "bounding_shapes": {}}  # on rows; they may need meshes
_LONGEST_NAME = 80  # characters of a log's name in that of its reduction
_MOST_NAMED = 3  # logs in a message


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
    places
        Its place among all logs.
    """

    robot: Robot
    config: Config
    path: Path
    holdout: float
    places: LogPlaces

    @property
    def file_name(self) -> str:
        """Name of the file with its reduction, which is another one for another log or other settings."""
        settings = {
            "idtool": VERSION,
            "urdf": hashlib.sha256(self.robot.text).hexdigest(),
            "config": self.config.model_dump(mode="json"),
            "version": version_of(self.path),
            "holdout": self.holdout,
            "places": [self.places.first, self.places.total],
        }
        return f"{self.path.stem[:_LONGEST_NAME]}.{_digest(str(self.path))}.{_digest(json.dumps(settings))}"


@dataclass(frozen=True)
class ReducedFleet:
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


def reduce_log(task: LogTask) -> bytes:
    """Reduce a log, on a worker; the content of the file with its reduction.

    Raises
    ------
    IdtoolError
        If the log cannot be read, or what its rows are depends on all logs together.
    """
    limit_processes(1)  # each process of a cluster has its own core
    is_validated = task.holdout == 1
    logs, validate = ([], [task.path]) if is_validated else ([task.path], [])
    experiment = prepare(task.robot, task.config, logs, validate, 0.0 if is_validated else task.holdout)
    controller = task.config.controller
    if experiment.has_commands and controller is not None and controller.known_delay is None:
        what = "is not fitted on a cluster, since it is that of all logs together"
        raise ConfigError("controller.delay", f"{what}; fit one log without --cluster, and give its delay in s")
    return reduction_bytes(save_reduction(experiment, task.holdout, lambda stage, share: None, task.places))


def reduce_on_cluster(
    cluster: Cluster,
    robot: Robot,
    config: Config,
    logs: Sequence[Path],
    validate: Sequence[Path],
    holdout: float,
    folder: Path,
    skip_bad: bool,
    progress: Progress,
) -> ReducedFleet:
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
    progress
        Callback for the stage and its progress, from 0 to 1.

    Raises
    ------
    IdtoolError
        If a log, the configuration or the model cannot be used, or a file cannot be written.
    """
    config = config.model_copy(update=_WITHOUT_EFFECT)
    total = len(logs) + len(validate)
    shares = [0.0 if validate else holdout] * len(logs) + [1.0] * len(validate)
    tasks = []
    for i, (path, share) in enumerate(zip((*logs, *validate), shares, strict=True)):
        tasks.append(LogTask(robot, config, path, share, LogPlaces(i, total)))
    reductions, failures = _reductions(cluster, dict(enumerate(tasks)), folder, progress)
    _check_failures(failures, skip_bad and bool(reductions))
    common = _common_settings(reductions)
    others = {}
    for i, reduction in reductions.items():
        if not _has_settings(reduction, common):
            others[i] = replace(tasks[i], config=config.model_copy(update=common.changes(config)))
    again, more_failures = _reductions(cluster, others, folder, progress)
    _check_failures(more_failures, skip_bad and len(more_failures) < len(reductions))
    reductions |= again
    failures |= more_failures
    used = [i for i in range(total) if i in reductions and i not in failures]
    return ReducedFleet(
        training=tuple((tasks[i].path, reductions[i]) for i in used if i < len(logs)),
        validation=tuple((tasks[i].path, reductions[i]) for i in used if i >= len(logs)),
        notices=tuple(left_out_notice(failures[i]) for i in sorted(failures)),
    )


@dataclass(frozen=True)
class _CommonSettings:
    """What logs must agree in that is taken from them where the configuration leaves it open."""

    joints: tuple[str, ...]
    band_hz: float

    def changes(self, config: Config) -> dict[str, Any]:
        """The keys of a configuration that make it so."""
        low_pass = config.filter.model_copy(update={"cutoff_hz": self.band_hz})
        return {"joints": self.joints, "filter": low_pass}


def _common_settings(reductions: Mapping[int, SavedReduction]) -> _CommonSettings:
    """The joints that all logs have, and the lowest of their cut-offs."""
    first, *others = [reduction.settings["joints"] for reduction in reductions.values()]
    joints = [name for name in first if all(name in joints for joints in others)]
    return _CommonSettings(tuple(joints), min(reduction.band_hz for reduction in reductions.values()))


def _has_settings(reduction: SavedReduction, common: _CommonSettings) -> bool:
    return tuple(reduction.settings["joints"]) == common.joints and reduction.band_hz == common.band_hz


def _reductions(
    cluster: Cluster, tasks: Mapping[int, LogTask], folder: Path, progress: Progress
) -> tuple[dict[int, SavedReduction], dict[int, LogError]]:
    """Reductions of logs, and the errors of those that have none, by their numbers."""
    reductions: dict[int, SavedReduction] = {}
    failures: dict[int, Exception] = {}
    missing = []
    names = {i: task.file_name for i, task in tasks.items()}
    for i in tasks:
        reduction = _written_reduction(folder / f"{names[i]}{REDUCTION_SUFFIX}")
        if reduction is None:
            missing.append(i)
        else:
            reductions[i] = reduction
    stage = f"reducing {len(tasks)} logs on {cluster.threads} processes"
    for k, outcome in cluster.evaluate(reduce_log, [tasks[i] for i in missing]):
        i = missing[k]
        if isinstance(outcome, bytes):
            file = folder / f"{names[i]}{REDUCTION_SUFFIX}"
            _write(file, outcome)
            reductions[i] = read_reduction(file)
        else:
            failures[i] = outcome
            _check_not_in_general(failures.values(), len(reductions), min(len(tasks), cluster.threads + 1))
        progress(stage, (len(reductions) + len(failures)) / len(tasks))
    return reductions, {i: _log_error(tasks[i].path, error) for i, error in failures.items()}


def _written_reduction(file: Path) -> SavedReduction | None:
    """The reduction in a file; None if there is none that can be used."""
    try:
        return read_reduction(file) if file.is_file() else None
    except LogError:  # it is made again
        return None


def _write(file: Path, content: bytes) -> None:
    """Write a log's reduction, and remove older ones of the same log."""
    write_all(file.parent, {file.name: content})
    of_log = file.name.rsplit(".", 2)[0]
    for other in file.parent.glob(f"{of_log}.*{REDUCTION_SUFFIX}"):
        if other != file:
            other.unlink(missing_ok=True)


def _check_not_in_general(failures: Collection[Exception], successes: int, enough: int) -> None:
    """Raise the first of some errors if all logs have one that is not about the log."""
    if successes or len(failures) < enough:
        return
    errors = [error for error in failures if isinstance(error, IdtoolError) and not isinstance(error, LogError)]
    if len(errors) == len(failures):
        raise errors[0]


def _log_error(path: Path, error: Exception) -> LogError:
    """Error about a log."""
    return (
        error if isinstance(error, LogError) else LogError(path, f"cannot be reduced: {error or type(error).__name__}")
    )


def _check_failures(failures: Mapping[int, LogError], skip_bad: bool) -> None:
    """Raise an error about the first log that cannot be used, which names others, unless they are left out."""
    if not failures or skip_bad:
        return
    first, *others = failures.values()
    advice = "--skip-bad leaves such logs out"
    if others:
        names = [Path(error.where).name for error in others[:_MOST_NAMED]]
        if len(others) > _MOST_NAMED:
            names.append(f"{len(others) - _MOST_NAMED} more")
        advice = f"{join_names(names)} cannot be used either; {advice}"
    raise LogError(first.where, f"{first.what}; {advice}")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:12]
