"""The gap between model and data closing step by step, as a staircase down to the noise floor."""

from __future__ import annotations

from typing import Any

from idtool.common.units import common_unit, position_units
from idtool.reporting.diagnosis_text import UNKNOWN, effect_name, owner_name
from idtool.reporting.plots.figure import MEDIUM, SHORT, Figure, Panel, PlotlyTrace, Values, curve, figure
from idtool.reporting.plots.sampling import round_significant
from idtool.reporting.results.diagnosis import DiagnosisReport


def gap_figures(report: DiagnosisReport) -> list[Figure]:
    """Errors of torque and rollouts by step, of all joints together and of each.

    Parameters
    ----------
    report
        The content of diagnosis.json.
    """
    steps = [(i, step) for i, step in enumerate(report.steps, 1) if step.effect != UNKNOWN]
    models = ["original model"]
    torques = [report.before.torque]
    rollouts = [report.before.simulation]
    for i, step in steps:
        models.append(f"{i}: {effect_name(step.effect)} on {owner_name(step)}")
        torques.append(step.validation_rms_after)
        rollouts.append(step.evidence.simulation_after)
    if len(models) > 1 and torques[-1] != report.after.torque:  # a superfluous effect was removed again
        models.append("final model")
        torques.append(report.after.torque)
        rollouts.append(report.after.simulation)
    torque_units = {"overall": common_unit(report.units), **report.units}
    lengths = {"overall": common_unit(position_units(report.units)), **position_units(report.units)}
    figures = []
    for joint, unit in torque_units.items():
        if torques[-1][joint] is None:  # its torque is not known
            continue
        rollout = None
        if any(rollouts):
            errors = [error[joint] if error else None for error in rollouts]
            rollout = (round_significant(errors), lengths[joint])
        figures.append(
            gap_figure(
                "all joints" if joint == "overall" else joint,
                models,
                (round_significant([error[joint] for error in torques]), unit),
                rollout,
                round_significant([report.noise_floor[joint]])[0],
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
    torques = [_staircase("torque", at, torque[0], "c5", models)]
    if floor is not None:
        torques.append(curve("noise floor", ends, [floor, floor], "quiet", 2, "dot", hoverinfo="skip"))
    zero = {"rangemode": "tozero"}
    domain = (0.0, 1.0) if rollout is None else (0.55, 1.0)
    panels = [Panel(f"torque [{_unit_text(torque[1])}]", torques, domain=domain, axis=zero)]
    if rollout is not None:
        errors = [_staircase("simulation", at, rollout[0], "c2", models)]
        panels.append(Panel(f"position [{_unit_text(rollout[1])}]", errors, domain=(0, 0.45), axis=zero))
    steps = [_step_label(i, model) for i, model in enumerate(models)]
    x_axis = {"range": ends, "tickvals": at, "ticktext": steps, "zeroline": False}
    description = f"Errors of {name} by step, against the noise floor"
    return figure(name, "step", panels, description, height, x_axis=x_axis)


def _staircase(name: str, at: list[int], errors: Values, color: str, models: list[str]) -> PlotlyTrace:
    """A level for each model, from half a step before its mark to half a step behind it."""
    marks: dict[str, Any] = {"text": models, "hoverinfo": "y+text", "mode": "lines+markers", "marker": {"size": 7}}
    stairs = curve(name, at, errors, color, **marks)
    stairs["line"]["shape"] = "hvh"
    return stairs


def _step_label(i: int, model: str) -> str:
    """A model's name below the axis."""
    if i == 0:
        return "original"
    number, colon, _ = model.partition(":")
    return number if colon else "final"


def _unit_text(unit: str) -> str:
    return unit.removeprefix("mixed ")
