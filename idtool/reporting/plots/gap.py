"""The gap between model and data closing step by step."""

from __future__ import annotations

from typing import Any

from idtool.reporting.diagnosis_words import UNKNOWN, effect_name, on, position_units, together
from idtool.reporting.plots.figure import MEDIUM, SHORT, Figure, Panel, Values, curve, figure
from idtool.reporting.plots.sampling import significant
from idtool.reporting.results.diagnosis import DiagnosisReport


def gap_figures(report: DiagnosisReport) -> list[Figure]:
    """Errors of torque and rollouts by step, of all joints together and of each.

    Parameters
    ----------
    report
        The content of diagnosis.json.
    """
    steps = [(i, step) for i, step in enumerate(report.steps, 1) if step.effect != UNKNOWN]
    models = ["original model", *(f"{i}: {effect_name(step.effect)} on {on(step)}" for i, step in steps)]
    first, last = report.before, report.after
    torques = [first.torque, *(step.validation_rms_after for _, step in steps)]
    rollouts = [first.simulation, *(step.evidence.simulation_after for _, step in steps)]
    if len(models) > 1 and torques[-1] != last.torque:  # what came to be superfluous was taken out again
        models.append("final model")
        torques.append(last.torque)
        rollouts.append(last.simulation)
    torque_units = {"overall": together(report.units), **report.units}
    lengths = {"overall": together(position_units(report.units)), **position_units(report.units)}
    figures = []
    for joint, unit in torque_units.items():
        moved = significant([errors[joint] if errors else None for errors in rollouts]) if any(rollouts) else None
        figures.append(
            gap_figure(
                "all joints" if joint == "overall" else joint,
                models,
                (significant([errors[joint] for errors in torques]), unit),
                None if moved is None else (moved, lengths[joint]),
                significant([report.noise_floor[joint]])[0],
                MEDIUM if joint == "overall" else SHORT,
            )
        )
    return figures


def gap_figure(
    name: str,
    models: list[str],
    torque: tuple[Values, str],
    rollout: tuple[Values, str] | None,
    floor: float | None,
    height: int,
) -> Figure:
    """Errors of one joint, or of all, by step.

    Parameters
    ----------
    name
        The joint's.
    models
        Names of the models, the first the one without effects.
    torque, rollout
        Error of each model, and its unit; of rollouts None where there were none.
    floor
        Noise floor of the torque.
    height
        In px.
    """
    at = list(range(len(models)))
    ends = [-0.3, len(at) - 0.7]
    marked: dict[str, Any] = {"text": models, "hoverinfo": "y+text", "mode": "lines+markers", "marker": {"size": 7}}
    torques = [curve("torque", at, torque[0], "c5", **marked)]
    if floor is not None:
        torques.append(curve("noise floor", ends, [floor, floor], "quiet", 2, "dot", hoverinfo="skip"))
    zero = {"rangemode": "tozero"}
    domain = (0.0, 1.0) if rollout is None else (0.55, 1.0)
    panels = [Panel(f"torque [{_short(torque[1])}]", torques, domain=domain, axis=zero)]
    if rollout is not None:
        errors = [curve("simulation", at, rollout[0], "c2", **marked)]
        panels.append(Panel(f"position [{_short(rollout[1])}]", errors, domain=(0, 0.45), axis=zero))
    steps = [_step(i, model) for i, model in enumerate(models)]
    x_axis = {"range": ends, "tickvals": at, "ticktext": steps, "zeroline": False}
    description = f"Errors of {name} by step, against the noise floor"
    return figure(name, "step", panels, description, height, x_axis=x_axis)


def _step(i: int, model: str) -> str:
    """A model's name below the axis."""
    if i == 0:
        return "original"
    number, colon, _ = model.partition(":")
    return number if colon else "final"


def _short(unit: str) -> str:
    return unit.replace(" together", "")
