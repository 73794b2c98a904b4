"""The record of a simulation: ``simulation`` of report.json and validation.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from idtool.common.units import position_units
from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.evaluation.rollouts import HORIZONS, RolloutError, RolloutEvaluation
from idtool.reporting.results.rollouts import Horizon, MotionErrors, Simulation, WindowCount


def simulation_report(rollouts: RolloutEvaluation | None, model: str, experiment: Experiment) -> Simulation | None:
    """The record of a simulation; None where the model was not or cannot be simulated.

    Parameters
    ----------
    rollouts
        The model's simulation and, where there is one, that of ``prior``; None: not asked for.
    model
        The model's name there.
    experiment
        What was simulated.
    """
    if rollouts is None or model in rollouts.failed:
        return None
    joints = experiment.model.joint_names
    units = {name: experiment.model.units[name] for name in joints}
    own = rollouts.errors[model]
    baseline = rollouts.errors["baseline"]
    prior = rollouts.errors.get("prior")
    sample_time = sum(run.signals.log.dt for run in experiment.runs) / len(experiment.runs)
    errors = _errors(own, joints)
    return Simulation(
        kind=rollouts.kind,
        window=rollouts.window,
        windows=WindowCount(simulated=rollouts.windows, of=rollouts.available),
        seconds=own.samples * sample_time,
        units=position_units(units),
        position=errors.position,
        velocity=errors.velocity,
        baseline=_errors(baseline, joints),
        prior=_errors(prior, joints) if prior else None,
        horizon=_horizons(joints, own, baseline, prior) if rollouts.kind == "open_loop" else (),
        lost=rollouts.diverged[model],
        prior_lost=rollouts.diverged["prior"] if prior else None,
    )


def why_not_simulated(rollouts: RolloutEvaluation | None, model: str, experiment: Experiment) -> str:
    """Why a model was not simulated, a clause.

    Parameters
    ----------
    rollouts, model, experiment
        As in `simulation_report`.
    """
    if rollouts is not None and model in rollouts.failed:
        return f"it cannot be simulated, because {rollouts.failed[model]}"
    if not experiment.has_only_joints:
        return "a robot with contacts or a floating base is not simulated while forces act on it"
    if not experiment.runs:
        return "logs that were reduced are not simulated"
    return "it was not simulated, as with --quick or --no-simulation"


def _horizons(
    joints: Sequence[str], own: RolloutError, baseline: RolloutError, prior: RolloutError | None
) -> list[Horizon]:
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


def _errors(error: RolloutError, joints: Sequence[str]) -> MotionErrors:
    return MotionErrors(
        position=_finite(error.rmse(joints, "position")), velocity=_finite(error.rmse(joints, "velocity"))
    )


def _finite(errors: Mapping[str, float]) -> dict[str, float | None]:
    """The errors, None for one that is not finite: rollouts that diverged may have no state."""
    return {name: error if math.isfinite(error) else None for name, error in errors.items()}
