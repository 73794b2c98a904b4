"""Rollouts as plain data for JSON, terminal and pages. Keys are the contract's (section 5)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.evaluation.rollouts import HORIZONS, RolloutError, RolloutEvaluation

POSITION_UNITS = {"N·m": "rad", "N": "m"}  # of a joint, by that of its torque


def simulation_report(rollouts: RolloutEvaluation | None, model: str, experiment: Experiment) -> dict[str, Any] | None:
    """``simulation`` of report.json and validation.json; None where the model was not or cannot be simulated.

    Parameters
    ----------
    replay
        The model's simulation and, where there is one, that of ``prior``; None: not asked for.
    model
        The model's name there.
    experiment
        What was simulated.
    """
    if rollouts is None or model in rollouts.failed:
        return None
    joints = experiment.equation.joints
    own = rollouts.errors[model]
    baseline = rollouts.errors["baseline"]
    prior = rollouts.errors.get("prior")
    dt = sum(run.signals.log.dt for run in experiment.runs) / len(experiment.runs)
    return {
        "kind": rollouts.kind,
        "window": rollouts.window,
        "windows": {"simulated": rollouts.windows, "of": rollouts.available},
        "seconds": own.samples * dt,
        "units": {joint: POSITION_UNITS[unit] for joint, unit in experiment.model.units.items()},
        **_rmse(own, joints),
        "baseline": _rmse(baseline, joints),
        "prior": _rmse(prior, joints) if prior else None,
        "horizon": _horizons(own, baseline, prior, joints) if rollouts.kind == "open_loop" else [],
        "lost": rollouts.diverged[model],
        "prior_lost": rollouts.diverged["prior"] if prior else None,
    }


def _horizons(
    own: RolloutError, baseline: RolloutError, prior: RolloutError | None, joints: Sequence[str]
) -> list[dict[str, Any]]:
    """Position errors so long after a start, for every horizon that the rollouts reach."""
    horizons = []
    for seconds in HORIZONS:
        position = own.horizon(joints, seconds)
        if position is None:
            continue
        horizons.append(
            {
                "seconds": seconds,
                "position": _finite(position),
                "baseline": _finite(baseline.horizon(joints, seconds) or {}),
                "prior": _finite(prior.horizon(joints, seconds) or {}) if prior else None,
            }
        )
    return horizons


def _rmse(error: RolloutError, joints: Sequence[str]) -> dict[str, dict[str, float | None]]:
    return {
        "position": _finite(error.rmse(joints, "position")),
        "velocity": _finite(error.rmse(joints, "velocity")),
    }


def _finite(figures: Mapping[str, float]) -> dict[str, float | None]:
    """The figures, None for what is not finite: rollouts that ran away may have no state."""
    return {name: x if math.isfinite(x) else None for name, x in figures.items()}


def simulation_notes(rollouts: RolloutEvaluation | None, model: str) -> list[str]:
    """Warnings about rollouts, a plain sentence each.

    Parameters
    ----------
    replay
        As for `simulation_report`.
    model
        The model's name there.
    """
    if rollouts is None:
        return []
    notes = []
    for name in (model, "prior"):
        which = "the prior" if name == "prior" else "the model"
        if name in rollouts.failed:
            notes.append(f"no simulation of {which}: {rollouts.failed[name]}")
        elif diverged := rollouts.diverged.get(name):
            notes.append(f"{diverged} of {rollouts.windows} simulations of {which} ran away and were stopped")
    return notes
