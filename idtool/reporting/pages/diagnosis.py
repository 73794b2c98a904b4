"""diagnosis.html: the missing effects, their evidence, and the gap closing step by step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from idtool.common.number_text import range_text
from idtool.common.units import position_units
from idtool.diagnosis.records import Diagnosis
from idtool.estimation.dataset.envelope import Trace
from idtool.estimation.evaluation.rollouts import RolloutEvaluation
from idtool.reporting.diagnosis_text import (
    RESIDUAL_MAPS,
    UNKNOWN,
    effect_name,
    owner_name,
    step_title,
    worse_motion,
    worse_motion_sentence,
)
from idtool.reporting.number_text import rows_by_unit
from idtool.reporting.pages.base import render
from idtool.reporting.pages.bodies import report_views
from idtool.reporting.pages.robot import ROBOT, robot_view, with_robot
from idtool.reporting.pages.simulation import simulation_view
from idtool.reporting.pages.uncertainty import uncertainty_view
from idtool.reporting.plots.effect_profile import effect_profile_figure
from idtool.reporting.plots.gap import gap_figures
from idtool.reporting.plots.log_series import LogFigures, log_figures, log_series
from idtool.reporting.plots.residuals import residual_figures
from idtool.reporting.plots.torques import torque_figure
from idtool.reporting.results.diagnosis import DiagnosisReport, StepReport
from idtool.reporting.sections.against import ChangesSection, SimulatorGapSection, UnchangedSection
from idtool.reporting.sections.diagnosis import CandidatesSection, ErrorsBeforeAfterSection, parameter_texts
from idtool.reporting.sections.fit import BodiesSection, FrictionSection
from idtool.reporting.sections.simulation import SimulationErrorsSection
from idtool.reporting.simulation_report import simulation_report
from idtool.reporting.verdict import LEVEL_TEXTS

_STEPS = ("The steps", "diagnosis_steps.html")
_SIMULATION = SimulationErrorsSection("diagnosis_simulation.html")
_AGAINST = (ChangesSection(), SimulatorGapSection(), UnchangedSection())
_SECTIONS = (
    ("Verdict", "verdict.html"),
    ("Findings", "diagnosis_findings.html"),
    *_AGAINST,
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
_MODEL_NAMES = ("before", "after")
_MODELS_TEXT = "the original model and of the model with the effects"
_MAX_VALUES = 50_000  # that all curves of torque hold together: some 400 kB of text
_MAX_ROWS = 30  # of a step's table of candidates


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
    rollouts = _rollouts_before_and_after(diagnosis)
    simulation = simulation_report(rollouts, "identified", diagnosis.last.experiment)
    held_out = report.before.validation is not None
    views = report_views(report.bodies)["bodies"]
    last = diagnosis.last.evaluation
    first = diagnosis.first.evaluation
    robot = robot_view(diagnosis.last.experiment.model, views, last.traces)
    shown_if = {_STEPS: bool(report.steps), _SIMULATION: simulation is not None}
    shown_if |= {section: section.table(report) is not None for section in _AGAINST}
    sections = [section for section in _SECTIONS if shown_if.get(section, True)]
    return render(
        f"{Path(report.urdf).stem}: diagnosis",
        with_robot(sections, robot),
        ["solids.js", "robot.js"],
        robot,
        report=report,
        torques=_torque_figures(last.traces, first.traces, units),
        gap=gap_figures(report),
        residuals=residual_figures(diagnosis.maps_before, diagnosis.maps_after, units, _MODEL_NAMES, _MODELS_TEXT),
        groups=rows_by_unit(units),
        position_unit=position_units(units),
        verdict_level=report.model_verdict,
        verdict_text=LEVEL_TEXTS[report.model_verdict],
        cards=[_step_view(i, step, report) for i, step in enumerate(report.steps, 1)],
        held_out=held_out,
        removed=[_with_full_stop(sentence) for sentence in report.removed],
        residual_maps=RESIDUAL_MAPS,
        worst=_worst_joint(report),
        lost=CandidatesSection("Effects that were tried in this step", _MAX_ROWS),
        **{
            "position_groups": rows_by_unit(position_units(units)),
            **simulation_view(rollouts, simulation, "identified"),
            **uncertainty_view(report),
        },
        where=f"On the {'held-out data' if held_out else 'data that the model was fitted to'}",
        command=command,
    )


def _worst_joint(report: DiagnosisReport) -> str | None:
    """The joint whose error before is the largest multiple of its noise floor."""
    before, floor = report.before.torque, report.noise_floor
    return max(report.joints, key=lambda joint: (before[joint] or 0.0) / (floor[joint] or 1.0), default=None)


def _step_view(index: int, step: StepReport, report: DiagnosisReport) -> dict[str, Any]:
    """Template variables of a step."""
    known = step.effect != UNKNOWN
    return {
        **{name: getattr(step, name) for name in StepReport.model_fields},
        "index": index,
        "known": known,
        "title": step_title(step),
        "sentence": _with_full_stop(step.evidence.sentence),
        "separate": _with_full_stop(step.evidence.separate),
        "texts": parameter_texts(step),
        "windows": [f"{range_text(first, last)} s" for first, last in step.where.windows],
        "near": [(effect_name(rival.effect), owner_name(rival)) for rival in step.alternatives],
        "step": step,
        "lost_count": len(step.alternatives) + len(step.rejected),
        "picture": effect_profile_figure(step, report.units),
        "worse": _with_full_stop(worse_motion_sentence(step, report)) if worse_motion(step) else "",
    }


def _with_full_stop(sentence: str) -> str:
    """A sentence with its full stop."""
    return sentence if sentence[-1:] in ("", ".", "!", "?") else f"{sentence}."


def _torque_figures(last: Sequence[Trace], first: Sequence[Trace], units: Mapping[str, str]) -> LogFigures:
    """Measured torque, that of the last model, and as ``prior`` that of the first one, if it is at the same times."""
    names = {"measured": "measured", "predicted": "identified", "prior": "first", "residual": "residual"}
    traces = []
    for last_trace, first_trace in zip(last, first, strict=True):
        curves = {name: last_trace.curves[name] for name in ("measured", "identified", "residual")}
        if len(last_trace.t) == len(first_trace.t):
            curves["first"] = first_trace.curves["identified"]
        traces.append(replace(last_trace, curves=curves))
    return log_figures(log_series(traces, names, units, _MAX_VALUES), len(traces), torque_figure)


def _rollouts_before_and_after(diagnosis: Diagnosis) -> RolloutEvaluation | None:
    """Rollouts of the last model and, as ``prior``, of the first one, if both were run over the same windows."""
    last, first = diagnosis.last.simulation, diagnosis.first.simulation
    if last is None or "identified" in last.failed:
        return None
    errors = {name: last.errors[name] for name in ("identified", "baseline")}
    diverged = {"identified": last.diverged["identified"]}
    traces = [_select_curves(t, ("measured", "identified")) for t in last.traces]
    if first is not None and "identified" not in first.failed and first.windows == last.windows:
        errors["prior"] = first.errors["identified"]
        diverged["prior"] = first.diverged["identified"]
        for i, first_trace in enumerate(first.traces):
            curves = {**traces[i].curves, "prior": first_trace.curves["identified"]}
            traces[i] = replace(traces[i], curves=curves)
    return replace(last, errors=errors, diverged=diverged, traces=tuple(traces), failed={})


def _select_curves(trace: Trace, names: Sequence[str]) -> Trace:
    return replace(trace, curves={name: trace.curves[name] for name in names})
