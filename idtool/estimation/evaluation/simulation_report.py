"""A replay → plain data for JSON, terminal and pages. Keys are the contract's (section 5)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.evaluation.replay import HORIZONS, Departure, Replay

POSITION_UNITS = {"N·m": "rad", "N": "m"}  # of a joint, by that of its torque


def simulation_report(replay: Replay | None, model: str, experiment: Experiment) -> dict[str, Any] | None:
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
    if replay is None or model in replay.failed:
        return None
    joints, departures = experiment.equation.joints, replay.departures
    own, baseline, prior = departures[model], departures["baseline"], departures.get("prior")
    dt = sum(run.signals.log.dt for run in experiment.runs) / len(experiment.runs)
    return {
        "kind": replay.kind,
        "window": replay.window,
        "windows": {"simulated": replay.windows, "of": replay.of},
        "seconds": own.samples * dt,
        "units": {joint: POSITION_UNITS[unit] for joint, unit in experiment.model.units.items()},
        **_rmse(own, joints),
        "baseline": _rmse(baseline, joints),
        "prior": _rmse(prior, joints) if prior else None,
        "horizon": [
            {
                "seconds": seconds,
                "position": _known(reached),
                "baseline": _known(baseline.horizon(joints, seconds) or {}),
                "prior": _known(prior.horizon(joints, seconds) or {}) if prior else None,
            }
            for seconds in HORIZONS
            if replay.kind == "open_loop" and (reached := own.horizon(joints, seconds))
        ],
        "lost": replay.lost[model],
        "prior_lost": replay.lost["prior"] if prior else None,
    }


def _rmse(departure: Departure, joints: Sequence[str]) -> dict[str, dict[str, float | None]]:
    return {
        "position": _known(departure.rmse(joints, "position")),
        "velocity": _known(departure.rmse(joints, "velocity")),
    }


def _known(figures: Mapping[str, float]) -> dict[str, float | None]:
    """The figures, None for what is not finite: rollouts that ran away may have no state."""
    return {name: x if math.isfinite(x) else None for name, x in figures.items()}


def simulation_notes(replay: Replay | None, model: str) -> list[str]:
    """What a user should know of a replay, a plain sentence each.

    Parameters
    ----------
    replay
        As for `simulation_report`.
    model
        The model's name there.
    """
    if replay is None:
        return []
    notes = []
    for name in (model, "prior"):
        which = "the prior" if name == "prior" else "the model"
        if name in replay.failed:
            notes.append(f"no simulation of {which}: {replay.failed[name]}")
        elif lost := replay.lost.get(name):
            notes.append(f"{lost} of {replay.windows} simulations of {which} ran away and were stopped")
    return notes
