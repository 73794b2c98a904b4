"""Sample of the training data of long logs, for what a part of them tells as well as all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from idtool.data.excerpt import spread_windows
from idtool.estimation.dataset.experiment import Experiment, Run

_WINDOW = 3.0  # s
_WINDOW_IN_EDGES = 8  # of the low-pass, of which a window loses one at each end


def training_sample(experiment: Experiment, duration: float) -> Experiment:
    """The experiment with windows of its training data, spread evenly over all logs.

    Parameters
    ----------
    experiment
        Model and data.
    duration
        About how long the windows are together [s]; with shorter logs, the experiment is as it is.
    """
    total = sum(_duration(run, run.train) for run in experiment.runs)
    if total <= duration:
        return experiment
    windows = [(i, window) for i, run in enumerate(experiment.runs) for window in _windows(run, duration / total)]
    in_windows = sum(_duration(experiment.runs[i], (window,)) for i, window in windows)
    step = max(round(in_windows / duration), 1)  # of many short parts, only some are taken
    chosen = windows[::step]
    runs = []
    for i, run in enumerate(experiment.runs):
        runs.append(replace(run, train=tuple(window for k, window in chosen if k == i)))
    return replace(experiment, runs=tuple(runs))


def _duration(run: Run, parts: tuple[slice, ...]) -> float:
    """Duration of parts of a log [s]."""
    samples = sum(part.stop - part.start for part in parts)
    return float(samples * run.signals.log.dt)


def _windows(run: Run, share: float) -> Iterator[slice]:
    """Windows with about a share of a log's training data, at least one of each part; all of one that is as short."""
    signals = run.signals
    length = max(round(_WINDOW / signals.log.dt), _WINDOW_IN_EDGES * signals.full_rate_low_pass.edge)
    return spread_windows(run.train, share, length)
