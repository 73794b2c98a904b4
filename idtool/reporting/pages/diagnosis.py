"""diagnosis.html: what the model lacks, how sure that is, and the gap closing step by step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from idtool.diagnosis.records import Diagnosis
from idtool.estimation.evaluation.envelope import Trace
from idtool.estimation.evaluation.rollouts import RolloutEvaluation
from idtool.reporting.diagnosis_words import UNKNOWN, effect_name, on, position_units
from idtool.reporting.figures import by_unit, number
from idtool.reporting.pages.base import render
from idtool.reporting.pages.bodies import report_views
from idtool.reporting.pages.robot import ROBOT, robot_view, with_robot
from idtool.reporting.pages.simulation import simulation_view
from idtool.reporting.pages.trust import trust_view
from idtool.reporting.plots.gap import gap_figures
from idtool.reporting.plots.log_series import DrawnLogs, drawn_logs, log_series
from idtool.reporting.plots.residuals import residual_figures
from idtool.reporting.plots.torques import torque_figure
from idtool.reporting.results.diagnosis import DiagnosisReport, StepReport
from idtool.reporting.sections.diagnosis import CandidatesSection, ErrorsBeforeAfterSection, parameter_texts
from idtool.reporting.sections.fit import BodiesSection, FrictionSection
from idtool.reporting.sections.simulation import SimulationErrorsSection
from idtool.reporting.simulation_report import simulation_report

_STEPS, _SIMULATION = ("The steps", "diagnosis_steps.html"), SimulationErrorsSection("diagnosis_simulation.html")
_SECTIONS = (
    ("Findings", "diagnosis_findings.html"),
    ErrorsBeforeAfterSection(),
    _STEPS,
    ("Residual by state, time and frequency", "residuals.html"),
    ("Measured and predicted torque", "diagnosis_torques.html"),
    _SIMULATION,
    FrictionSection(),
    BodiesSection(),
    ROBOT,
    ("Origin of this report", "origin.html"),
)
_NAMES, _MODELS = ("before", "after"), "the original model and of the model with the effects"
_MOST_VALUES = 50_000  # that all curves of torque hold together: some 400 kB of text
_MOST_ROWS = 30  # candidates of a step that are listed
_VERDICTS = {
    "no_disagreement": ("good", "No disagreement"),
    "explained": ("good", "Explained"),
    "partly_explained": ("note", "Partly explained"),
    "unexplained": ("bad", "Unexplained"),
}


def diagnosis_page(diagnosis: Diagnosis, report: DiagnosisReport, command: str) -> str:
    """diagnosis.html.

    Parameters
    ----------
    diagnosis
        The result.
    report
        The content of diagnosis.json.
    command
        The command line that made it.
    """
    units = report.units
    simulated = _side_by_side(diagnosis)
    simulation = simulation_report(simulated, "identified", diagnosis.last.experiment)
    held_out = report.before.validation is not None
    views = report_views(report.bodies)["bodies"]
    last, first = diagnosis.last.evaluation, diagnosis.first.evaluation
    robot = robot_view(diagnosis.last.experiment.model, views, last.traces)
    shown_if = {_STEPS: bool(report.steps), _SIMULATION: simulation is not None}
    sections = [section for section in _SECTIONS if shown_if.get(section, True)]
    return render(
        f"{Path(report.urdf).stem}: what the model lacks",
        with_robot(sections, robot),
        ["solids.js", "robot.js"],
        robot,
        report=report,
        torques=_torques(last.traces, first.traces, units),
        gap=gap_figures(report),
        residuals=residual_figures(diagnosis.maps_before, diagnosis.maps_after, units, _NAMES, _MODELS),
        groups=by_unit(units),
        position_unit=position_units(units),
        verdict=_VERDICTS[report.verdict],
        cards=[_card(i, step) for i, step in enumerate(report.steps, 1)],
        held_out=held_out,
        worst=_worst(report),
        near=CandidatesSection("Candidates that explain nearly as much"),
        others=CandidatesSection("Other candidates"),
        **{
            "position_groups": by_unit(position_units(units)),
            **simulation_view(simulated, simulation, "identified"),
            **trust_view(report),
        },
        where=f"On the {'held-out data' if held_out else 'data that the model was fitted to'}",
        command=command,
    )


def _worst(report: DiagnosisReport) -> str | None:
    """The joint that is the farthest from the noise floor before, in units of that."""
    before, floor = report.before.torque, report.noise_floor
    return max(report.joints, key=lambda joint: (before[joint] or 0.0) / (floor[joint] or 1.0), default=None)


def _card(index: int, step: StepReport) -> dict[str, Any]:
    """A step, as its template reads it."""
    known = step.effect != UNKNOWN
    return {
        **{name: getattr(step, name) for name in StepReport.model_fields},
        "index": index,
        "known": known,
        "title": f"{_title(step.effect)} on {on(step)}" if known else f"Unknown effect on {on(step)}",
        "sentence": _closed(step.evidence.sentence),
        "separate": _closed(step.evidence.separate),
        "texts": parameter_texts(step),
        "windows": [f"{number(a, 4)} to {number(b, 4)} s" for a, b in step.where.windows],
        "near": [(effect_name(found.effect), on(found)) for found in step.alternatives],
        "others": step.rejected[:_MOST_ROWS],
        "hidden": max(len(step.rejected) - _MOST_ROWS, 0),
    }


def _closed(sentence: str) -> str:
    """A sentence with its full stop."""
    return sentence if sentence[-1:] in ("", ".", "!", "?") else f"{sentence}."


def _title(effect: str) -> str:
    name = effect_name(effect)
    return name[:1].upper() + name[1:]


def _torques(last: Sequence[Trace], first: Sequence[Trace], units: Mapping[str, str]) -> DrawnLogs:
    """Measured torque and that of the last model; that of the first one as ``prior``, where it is at the same times."""
    names = {"measured": "measured", "predicted": "identified", "prior": "first", "residual": "residual"}
    traces = []
    for own, former in zip(last, first, strict=True):
        curves = {name: own.curves[name] for name in ("measured", "identified", "residual")}
        if len(own.t) == len(former.t):
            curves["first"] = former.curves["identified"]
        traces.append(replace(own, curves=curves))
    return drawn_logs(log_series(traces, names, units, _MOST_VALUES), len(traces), torque_figure)


def _side_by_side(diagnosis: Diagnosis) -> RolloutEvaluation | None:
    """Rollouts of the last model and, as ``prior``, of the first one, where both were run over the same windows."""
    last, first = diagnosis.last.simulation, diagnosis.first.simulation
    if last is None or "identified" in last.failed:
        return None
    keep = ("identified", "baseline")
    errors = {name: last.errors[name] for name in keep}
    diverged = {"identified": last.diverged["identified"]}
    traces = [_only(t, ("measured", "identified")) for t in last.traces]
    if first is not None and "identified" not in first.failed and first.windows == last.windows:
        errors["prior"] = first.errors["identified"]
        diverged["prior"] = first.diverged["identified"]
        traces = [
            replace(own, curves={**own.curves, "prior": former.curves["identified"]})
            for own, former in zip(traces, first.traces, strict=True)
        ]
    return replace(last, errors=errors, diverged=diverged, traces=tuple(traces), failed={})


def _only(trace: Trace, names: Sequence[str]) -> Trace:
    return replace(trace, curves={name: trace.curves[name] for name in names})
