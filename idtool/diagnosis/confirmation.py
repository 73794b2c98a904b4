"""Confirmation of effects on parts of the data: on every log by itself, or with one log only, on its two halves.

An effect that is truly there has the same size everywhere. One that stands for something else has the size that the
motion of each part gives it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.number_text import with_error
from idtool.common.processes import shared_among_processes
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.records import PartEstimate
from idtool.diagnosis.trial import FAILURES, TrialFit, fit_trial, parameter_value
from idtool.estimation.dataset.experiment import Experiment, Progress, split_ranges
from idtool.robot.config import EffectEntry

_MAX_PARTS = 6  # logs that are fitted by themselves, the first ones
_MAX_DIFFERENCE = 4.0  # standard errors by which two estimates of one size may differ
_SAME_SIZE = 0.2  # relative difference, up to which sizes agree whatever their standard errors


def estimate_on_parts(
    current: LinearizedFit, entries: Sequence[EffectEntry], progress: Progress
) -> list[list[PartEstimate]]:
    """Size of each effect on each part of the training data.

    Parameters
    ----------
    current
        The model.
    entries
        Entries of the effects that are to be confirmed, as in the model.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    For each entry, the parts on which its size could be estimated.
    """
    all_entries = current.experiment.config.effects
    indices = [all_entries.index(entry) for entry in entries]

    def estimate_on_part(named_part: tuple[str, Experiment], progress: Progress) -> list[PartEstimate | None]:
        name, part = named_part
        try:
            alone = linearize_fit(part, progress, reversal_margin=current.reversal_margin)
            trial = fit_trial(alone, all_entries, indices, progress)
        except FAILURES:  # too short by itself
            return [None for _ in entries]
        return [_size(trial, index, name) for index in indices]

    by_part = shared_among_processes(estimate_on_part, _parts(current.experiment), progress)
    by_entry = zip(*by_part, strict=True)
    return [[estimate for estimate in estimates if estimate is not None] for estimates in by_entry]


def contradiction(estimates: Sequence[PartEstimate], units: Mapping[str, str]) -> str:
    """Clause on two parts of the data that contradict each other about an effect's size; empty if all agree.

    Parameters
    ----------
    estimates
        Size of the effect on each part.
    units
        Unit of each parameter.
    """
    for i, first in enumerate(estimates):
        for second in estimates[:i]:
            if not _agree(first, second):
                unit = units.get(first.parameter, "1")
                name = first.parameter.replace("_", " ")
                return f"its {name} is {_text(second, unit)}, but {_text(first, unit)}"
    return ""


def _text(estimate: PartEstimate, unit: str) -> str:
    """Size with its standard error and unit, and where it was estimated."""
    is_half = estimate.part.endswith("half")
    place = f"on the {estimate.part} of the log" if is_half else f"in {estimate.part}"
    size = " ± ".join(with_error(estimate.value, estimate.standard_error))
    return f"{size} {place}" if unit == "1" else f"{size} {unit} {place}"


def _agree(a: PartEstimate, b: PartEstimate) -> bool:
    """True if two estimates of a size differ by no more than chance, or by little."""
    difference = abs(a.value - b.value)
    chance = _MAX_DIFFERENCE * float(np.hypot(a.standard_error, b.standard_error))
    return difference <= max(chance, _SAME_SIZE * max(abs(a.value), abs(b.value)))


def _parts(experiment: Experiment) -> list[tuple[str, Experiment]]:
    """The training data of each log, or the two halves of the only one, without held-out data."""
    runs = [run for run in experiment.runs if run.train]
    if len(runs) > 1:
        logs = [(run.signals.log.path.name, replace(run, held_out=())) for run in runs[:_MAX_PARTS]]
    else:
        samples = sum(part.stop - part.start for part in runs[0].train)
        halves = split_ranges(runs[0].train, samples // 2)
        logs = []
        for name, half in zip(("first half", "second half"), halves, strict=True):
            logs.append((name, replace(runs[0], train=half, held_out=())))
    return [(name, replace(experiment, runs=(run,))) for name, run in logs]


def _size(trial: TrialFit, index: int, part: str) -> PartEstimate | None:
    """Size of an effect on a part of the data: its first parameter with a known standard error.

    Returns
    -------
    None if no parameter has one, as where the effect does not act in the data.
    """
    entry = trial.entries[index]
    for name, (value, error) in _linear_parameters(trial.linearized, entry).items():
        if error is not None and 0 < error < np.inf:
            return PartEstimate(part, name, value, error)
    for (moved, name), error in trial.standard_errors.items():
        number = parameter_value(entry, name)
        if moved == index and isinstance(number, float) and 0 < error < np.inf:
            return PartEstimate(part, name, number, error)
    return None


def _linear_parameters(linearized: LinearizedFit, entry: EffectEntry) -> dict[str, tuple[float, float | None]]:
    """Values and standard errors of an effect's linear parameters, by name."""
    effect_and_slice = linearized.find_effect(entry)
    if effect_and_slice is None:
        return {}
    effect, part = effect_and_slice
    return effect.parameters(linearized.estimate.theta[part], linearized.jackknife_covariance(part))
