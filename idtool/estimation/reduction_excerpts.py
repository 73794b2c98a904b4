"""Excerpts of logs in reductions: what a diagnosis has of logs that it does not read."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from idtool.common.exceptions import LogError
from idtool.common.notice import Notice
from idtool.data.excerpt import duration_of
from idtool.data.logs import JointLog
from idtool.estimation.dataset.reduced_logs import ReducedLog
from idtool.estimation.dataset.row_settings import first_difference
from idtool.estimation.saved_reduction import SavedReduction
from idtool.robot.config import Config

_MAX_SECONDS = 180.0  # of the excerpts of all logs together, that are used
_WHOLE = 0.95  # share of the logs from which on excerpts are as good as all of them


@dataclass(frozen=True)
class Excerpts:
    """Excerpts of the logs in some reductions, for the fit and for validation.

    Attributes
    ----------
    training, validation
        Excerpts of each reduction, in the order of the reductions; of many logs, only some have one.
    notices
        A notice about how little of the logs they are, if all of the logs would tell more.
    """

    training: tuple[tuple[JointLog, ...], ...]
    validation: tuple[tuple[JointLog, ...], ...]
    notices: tuple[Notice, ...]


def read_excerpts(
    training: Sequence[tuple[Path, SavedReduction]],
    validation: Sequence[tuple[Path, SavedReduction]],
    config: Config,
) -> Excerpts:
    """Excerpts in reductions; of many logs, some, evenly chosen.

    Parameters
    ----------
    training, validation
        Reductions for the fit and for validation, with their files or with the logs that they are of.
    config
        The configuration, which must not read logs in another way.

    Raises
    ------
    LogError
        If one has no excerpts, or was made with other settings for reading logs.
    """
    for path, reduction in (*training, *validation):
        _check_reading(path, reduction, config)
        _check_excerpts(path, reduction)
    logs = [log for _, reduction in (*training, *validation) for log in reduction.logs]
    seconds = sum(duration_of(log.excerpt) for log in logs if log.excerpt)
    step = max(math.ceil(seconds / _MAX_SECONDS), 1)
    chosen_training = _every_nth_excerpt([reduction for _, reduction in training], step)
    chosen_validation = _every_nth_excerpt([reduction for _, reduction in validation], step)
    chosen = [excerpt for of_reduction in (*chosen_training, *chosen_validation) for excerpt in of_reduction]
    used_seconds = sum(map(duration_of, chosen))
    return Excerpts(chosen_training, chosen_validation, tuple(_notices(used_seconds, _reduced_seconds(logs))))


def _every_nth_excerpt(reductions: Sequence[SavedReduction], step: int) -> tuple[tuple[JointLog, ...], ...]:
    """The excerpt of every so many-th log, the first included, by reduction."""
    number = itertools.count()
    chosen = []
    for reduction in reductions:
        own = [log.excerpt for log in reduction.logs if next(number) % step == 0]
        chosen.append(tuple(excerpt for excerpt in own if excerpt is not None))
    return tuple(chosen)


def _reduced_seconds(logs: Sequence[ReducedLog]) -> float:
    """Time of the logs that were reduced [s]."""
    seconds = 0.0
    for log in logs:
        samples = sum(part.samples for part in (*log.train, *log.held_out))
        seconds += samples * (log.excerpt.dt if log.excerpt else 0.0)
    return seconds


def _notices(used_seconds: float, reduced_seconds: float) -> Iterator[Notice]:
    """Notice about how little of the logs is used."""
    if used_seconds < _WHOLE * reduced_seconds:
        message = f"samples of {used_seconds:.0f} s are used, of the {reduced_seconds:.0f} s that were reduced"
        advice = "an effect that shows only at times may be missed; give the log in which you expect it"
        yield Notice("excerpts_used", "note", None, message, advice)


def _check_excerpts(path: Path, reduction: SavedReduction) -> None:
    """Refuse a reduction that lacks the excerpt of a log."""
    for log in reduction.logs:
        if log.excerpt is None:
            raise LogError(path, f"has no samples of {log.name}; make it again with idtool reduce")


def _check_reading(path: Path, reduction: SavedReduction, config: Config) -> None:
    """Refuse a reduction of logs that were read with other settings."""
    settings = config.model_dump(mode="json", include={"log"})
    difference = first_difference({"log": reduction.settings.get("log")}, settings)
    if difference is not None:
        key, _, _ = difference
        raise LogError(path, f"was made with another {key}; make it again with idtool reduce")
