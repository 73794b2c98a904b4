"""Excerpts of logs in reductions: what a diagnosis has of logs that it does not read."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from idtool.common.exceptions import LogError
from idtool.common.notice import Notice
from idtool.data.excerpt import duration_of
from idtool.data.logs import JointLog
from idtool.estimation.dataset.row_settings import first_difference
from idtool.estimation.saved_reduction import SavedReduction
from idtool.robot.config import Config

_MAX_SECONDS = 180.0  # of the excerpts of all logs together, that are used
_WHOLE = 0.95  # share of the logs from which on excerpts are as good as all of them


def excerpts_of(reductions: Sequence[tuple[Path, SavedReduction]], config: Config) -> dict[Path, tuple[JointLog, ...]]:
    """Excerpts in reductions by the path of each; of many logs, some, evenly chosen.

    Parameters
    ----------
    reductions
        Reductions with their files, or with the logs that they are of.
    config
        The configuration, which must not read logs in another way.

    Raises
    ------
    LogError
        If one has no excerpts, or was made with other settings for reading logs.
    """
    found: list[tuple[Path, JointLog]] = []
    for path, reduction in dict(reductions).items():  # one that is given twice is used once
        _check_reading(path, reduction, config)
        for log in reduction.logs:
            if log.excerpt is None:
                raise LogError(path, f"has no samples of {log.name}; make it again with idtool reduce")
            found.append((path, log.excerpt))
    seconds = sum(duration_of(excerpt) for _, excerpt in found)
    step = max(math.ceil(seconds / _MAX_SECONDS), 1)
    chosen: dict[Path, tuple[JointLog, ...]] = {path: () for path, _ in reductions}
    for path, excerpt in found[::step]:
        chosen[path] += (excerpt,)
    return chosen


def excerpt_notices(
    reductions: Sequence[tuple[Path, SavedReduction]], used: Sequence[Mapping[Path, Sequence[JointLog]]]
) -> Iterator[Notice]:
    """Notice about how little of the logs is used, if it is not as good as all.

    Parameters
    ----------
    reductions
        The reductions.
    used
        The excerpts of them that are used, for the fit and for validation.
    """
    excerpts = [excerpt for of_kind in used for of_path in of_kind.values() for excerpt in of_path]
    seconds = sum(map(duration_of, excerpts))
    logs = [log for _, reduction in reductions for log in reduction.logs]
    total = sum(part.samples * log.excerpt.dt for log in logs if log.excerpt for part in (*log.train, *log.held_out))
    if seconds < _WHOLE * total:
        message = f"samples of {seconds:.0f} s are used, of the {total:.0f} s that were reduced"
        advice = "an effect that shows only at times may be missed; give the log in which you expect it"
        yield Notice("excerpts_used", "note", None, message, advice)


def _check_reading(path: Path, reduction: SavedReduction, config: Config) -> None:
    """Refuse a reduction of logs that were read with other settings."""
    settings = config.model_dump(mode="json", include={"log"})
    difference = first_difference({"log": reduction.settings.get("log")}, settings)
    if difference is not None:
        key, _, _ = difference
        raise LogError(path, f"was made with another {key}; make it again with idtool reduce")
