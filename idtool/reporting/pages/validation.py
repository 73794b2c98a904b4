"""validation.html."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from idtool.common.arrays import Array
from idtool.estimation.evaluation.rollouts import RolloutEvaluation
from idtool.estimation.evaluation.torque_errors import Evaluation
from idtool.reporting.number_text import rows_by_unit
from idtool.reporting.pages.base import Sections, render
from idtool.reporting.pages.bodies import model_views
from idtool.reporting.pages.robot import ROBOT, robot_view, with_robot
from idtool.reporting.pages.simulation import SIMULATION, simulation_view, with_simulation
from idtool.reporting.plots.torques import torque_figures
from idtool.reporting.results.validation import ValidationReport
from idtool.reporting.sections.validation import ModelErrorsByKindSection, ModelErrorsSection
from idtool.reporting.verdict import LEVEL_TEXTS
from idtool.robot.model import RobotModel

_ERRORS_BY_KIND = ModelErrorsByKindSection()
_SECTIONS = (
    ("Verdict", "verdict.html"),
    ROBOT,
    ("Findings", "validation_findings.html"),
    ModelErrorsSection(),
    _ERRORS_BY_KIND,
    ("Measured and predicted torque", "torques.html"),
    SIMULATION,
    ("Origin of this report", "origin.html"),
)


def validation_page(
    evaluation: Evaluation,
    report: ValidationReport,
    command: str,
    rollouts: RolloutEvaluation | None = None,
    bodies: tuple[RobotModel, Mapping[str, Array]] | None = None,
) -> str:
    """validation.html.

    Parameters
    ----------
    evaluation
        Errors and curves of ``model`` and, where one was given, ``prior``.
    report
        The content of validation.json.
    command
        The command line that made it.
    rollouts
        The same models run forwards, if they were.
    bodies
        The tree of bodies, and coefficients of the same models, shape (p,) each: the robot is drawn.
    """
    units = report.units
    shown_if: dict[object, bool] = {_ERRORS_BY_KIND: report.rms_by_kind is not None}
    sections: Sections = [section for section in _SECTIONS if shown_if.get(section, True)]
    robot: dict[str, Any] = {"robot": None}
    if bodies:
        views = model_views(bodies[0], bodies[1]["model"], bodies[1].get("prior"))["bodies"]
        robot = robot_view(bodies[0], views, evaluation.traces, "model's")
    model = next((source.path for source in report.inputs if source.kind == "URDF"), "model")
    return render(
        f"{model}: validation",
        with_robot(with_simulation(sections, report.simulation), robot),
        ["solids.js", "robot.js"],
        robot,
        folded=("Origin of this report",),
        report=report,
        verdict_level=report.verdict,
        verdict_text=LEVEL_TEXTS[report.verdict],
        groups=rows_by_unit(units),
        torques=torque_figures(evaluation, "model", units),
        **simulation_view(rollouts, report.simulation, "model"),
        where="On the validation logs",
        command=command,
    )
