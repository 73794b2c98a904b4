"""The record of a simulation: ``simulation`` of report.json and validation.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.evaluation.replay import HORIZONS, Departure, Replay
from idtool.reporting.results.rollouts import Horizon, MotionErrors, Simulation, WindowCount

POSITION_UNITS = {"N·m": "rad", "N": "m"}  # of a joint, by that of its torque


def simulation_report(replay: Replay | None, model: str, experiment: Experiment) -> Simulation | None:
    """The record of a simulation; None where the model was not or cannot be simulated.

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
    sample_time = sum(run.signals.log.dt for run in experiment.runs) / len(experiment.runs)
    errors = _errors(own, joints)
    return Simulation(
        kind=replay.kind,
        window=replay.window,
        windows=WindowCount(simulated=replay.windows, of=replay.of),
        seconds=own.samples * sample_time,
        units={joint: POSITION_UNITS[unit] for joint, unit in experiment.model.units.items()},
        position=errors.position,
        velocity=errors.velocity,
        baseline=_errors(baseline, joints),
        prior=_errors(prior, joints) if prior else None,
        horizon=_horizons(joints, own, baseline, prior) if replay.kind == "open_loop" else (),
        lost=replay.lost[model],
        prior_lost=replay.lost["prior"] if prior else None,
    )


def _horizons(joints: Sequence[str], own: Departure, baseline: Departure, prior: Departure | None) -> list[Horizon]:
    """Errors at all times since a restart that some rollout reached."""
    horizons = []
    for seconds in HORIZONS:
        reached = own.horizon(joints, seconds)
        if reached:
            horizons.append(
                Horizon(
                    seconds=seconds,
                    position=_finite(reached),
                    baseline=_finite(baseline.horizon(joints, seconds) or {}),
                    prior=_finite(prior.horizon(joints, seconds) or {}) if prior else None,
                )
            )
    return horizons


def _errors(departure: Departure, joints: Sequence[str]) -> MotionErrors:
    return MotionErrors(
        position=_finite(departure.rmse(joints, "position")), velocity=_finite(departure.rmse(joints, "velocity"))
    )


def _finite(errors: Mapping[str, float]) -> dict[str, float | None]:
    """The errors, None for one that is not finite: rollouts that diverged may have no state."""
    return {name: error if math.isfinite(error) else None for name, error in errors.items()}
