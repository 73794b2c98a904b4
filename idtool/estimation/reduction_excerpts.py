"""Choice of the excerpts in reductions that a diagnosis searches in place of the logs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError
from idtool.common.notice import Notice
from idtool.data.excerpt import duration_of
from idtool.data.logs import JointLog
from idtool.estimation.dataset.reduced_logs import ReducedLog
from idtool.estimation.dataset.row_settings import first_difference
from idtool.estimation.saved_reduction import SavedReduction
from idtool.robot.config import Config

_MAX_SECONDS = 180.0  # that are searched, of the excerpts of all logs together
_MIN_SHARE = 0.95  # of the reduced time, that excerpts must have to be as good as all of the logs


@dataclass(frozen=True)
class Excerpts:
    """Excerpts of the logs in some reductions, for the fit and for validation.

    Attributes
    ----------
    training, validation
        Excerpts of each reduction, in the order of the reductions. If there are many logs, those of some are left out.
    notices
        A notice about how little of the logs they are, if all of the logs would tell more.
    """

    training: tuple[tuple[JointLog, ...], ...]
    validation: tuple[tuple[JointLog, ...], ...]
    notices: tuple[Notice, ...]


def choose_excerpts(
    training: Sequence[tuple[Path, SavedReduction]],
    validation: Sequence[tuple[Path, SavedReduction]],
    config: Config,
) -> Excerpts:
    """Choose the excerpts that are searched: all, or if there are many logs, those of every n-th.

    Parameters
    ----------
    training, validation
        Reductions for the fit and for validation, each with its file, or with its log if a cluster made it.
    config
        The configuration; its options for reading logs must be those of the reductions.

    Raises
    ------
    LogError
        If one has no excerpts, or was made with other settings for reading logs.
    """
    every = (*training, *validation)
    for path, reduction in every:
        _check_log_settings(path, reduction, config)
    training_excerpts = [_excerpts_in(path, reduction) for path, reduction in training]
    validation_excerpts = [_excerpts_in(path, reduction) for path, reduction in validation]
    available_seconds = _total_duration([*training_excerpts, *validation_excerpts])
    step = max(math.ceil(available_seconds / _MAX_SECONDS), 1)
    chosen_training = _every_nth(training_excerpts, step)
    chosen_validation = _every_nth(validation_excerpts, step)
    used_seconds = _total_duration([*chosen_training, *chosen_validation])
    reduced_seconds = sum(_reduced_seconds(log) for _, reduction in every for log in reduction.logs)
    notices: tuple[Notice, ...] = ()
    if used_seconds < _MIN_SHARE * reduced_seconds:
        notices = (_shortness_notice(used_seconds, reduced_seconds),)
    return Excerpts(chosen_training, chosen_validation, notices)


def _excerpts_in(path: Path, reduction: SavedReduction) -> list[JointLog]:
    """Excerpt of each log of a reduction; LogError if it lacks one."""
    excerpts = []
    for log in reduction.logs:
        if log.excerpt is None:
            raise LogError(path, f"has no excerpt of {log.name}; make it again with idtool reduce")
        excerpts.append(log.excerpt)
    return excerpts


def _total_duration(by_reduction: Sequence[Sequence[JointLog]]) -> float:
    """Duration of all excerpts together [s]."""
    return sum(duration_of(excerpt) for excerpts in by_reduction for excerpt in excerpts)


def _every_nth(by_reduction: Sequence[Sequence[JointLog]], step: int) -> tuple[tuple[JointLog, ...], ...]:
    """The first excerpt of all, and every n-th after it, by reduction."""
    chosen = []
    count_before = 0
    for excerpts in by_reduction:
        first = -count_before % step
        chosen.append(tuple(excerpts[first::step]))
        count_before += len(excerpts)
    return tuple(chosen)


def _reduced_seconds(log: ReducedLog) -> float:
    """Time of a log that was reduced, of which its excerpt is a part [s]."""
    if log.excerpt is None:
        return 0.0
    samples = sum(part.samples for part in (*log.train, *log.held_out))
    return samples * log.excerpt.dt


def _shortness_notice(used_seconds: float, reduced_seconds: float) -> Notice:
    """Notice about how little of the logs is searched."""
    message = f"only {used_seconds:.0f} s of the {reduced_seconds:.0f} s in the reductions are searched"
    advice = "a brief effect may be missed; run this on the log where you expect it"
    return Notice("excerpts_used", "note", None, message, advice)


def _check_log_settings(path: Path, reduction: SavedReduction, config: Config) -> None:
    """Refuse a reduction of logs that were read with other settings."""
    settings = config.model_dump(mode="json", include={"log"})
    difference = first_difference({"log": reduction.settings.get("log")}, settings)
    if difference is not None:
        key, _, _ = difference
        raise LogError(path, f"was made with another {key} in the configuration; make it again with idtool reduce")
