"""Sample of the training data of long logs, for what a part of them tells as well as all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from idtool.estimation.dataset.experiment import Experiment, Run

_WINDOW = 3.0  # s: many times as long as the low-pass's response, at whose ends samples are lost


def training_sample(experiment: Experiment, duration: float) -> Experiment:
    """The experiment with windows of its training data, spread evenly over all logs.

    Parameters
    ----------
    experiment
        Model and data.
    duration
        About how long the windows are together [s]; with shorter logs, the experiment is as it is.
    """
    total = sum(_duration(run) for run in experiment.runs)
    if total <= duration:
        return experiment
    runs = []
    for run in experiment.runs:
        windows = tuple(window for part in run.train for window in _windows(part, run, duration / total))
        runs.append(replace(run, train=windows))
    return replace(experiment, runs=tuple(runs))


def _duration(run: Run) -> float:
    """Duration of the parts of a log for fitting [s]."""
    samples = sum(part.stop - part.start for part in run.train)
    return float(samples * run.signals.log.dt)


def _windows(part: slice, run: Run, share: float) -> Iterator[slice]:
    """Windows with about a share of a part's samples; all of a part that is not longer than a window."""
    samples = part.stop - part.start
    window = round(_WINDOW / run.signals.log.dt)
    if samples <= window:
        yield part
        return
    count = max(round(share * samples / window), 1)
    spacing = samples / count
    for i in range(count):
        start = part.start + int((i + 0.5) * spacing - window / 2)
        yield slice(start, start + window)
