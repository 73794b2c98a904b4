"""report.html."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path

from idtool.diagnosis.records import ProfilesByJoint
from idtool.estimation.fit import Fit
from idtool.estimation.problem.certificate import GAP, ROUNDING
from idtool.reporting.number_text import rows_by_unit
from idtool.reporting.pages.base import Sections, heading, render
from idtool.reporting.pages.bodies import report_views
from idtool.reporting.pages.robot import ROBOT, robot_view, with_robot
from idtool.reporting.pages.simulation import SIMULATION, simulation_view, with_simulation
from idtool.reporting.pages.uncertainty import (
    BASE_PARAMETERS,
    BIAS,
    REPEATABILITY,
    SOURCES,
    uncertainty_view,
    with_uncertainty,
)
from idtool.reporting.plots.friction import fleet_figure
from idtool.reporting.plots.regularization import regularization_figure
from idtool.reporting.plots.residuals import residual_figures
from idtool.reporting.plots.torques import torque_figures
from idtool.reporting.results.fit import FitReport
from idtool.reporting.sections.fit import (
    BodiesSection,
    EffectsSection,
    ErrorsByKindSection,
    FrictionSection,
    PriorWeightsSection,
    TorqueErrorsSection,
    WholeRobotSection,
    WrenchSensorsSection,
)
from idtool.reporting.sections.fleet import FleetSection
from idtool.reporting.verdict import LEVEL_TEXTS

_PRIOR = PriorWeightsSection()
_FLEET = FleetSection()
_EFFECTS = EffectsSection()
_ERRORS_BY_KIND = ErrorsByKindSection()
_WHOLE_ROBOT = WholeRobotSection()
_WRENCH_SENSORS = WrenchSensorsSection()
_RESIDUALS = ("Residual by state, time and frequency", "residuals.html")
_BODIES_IN_3D = ("Bodies in 3D", "bodies_3d.html")
_SOLVER = ("Solver", "solver.html")
_ORIGIN = ("Origin of this report", "origin.html")
_MODEL_NAMES = ("prior", "identified")
_MODELS_TEXT = "the original URDF and of the identified model"
_BY_TOPIC: Mapping[str, Sections] = {
    "Summary": (("Verdict", "verdict.html"), ROBOT, ("Findings", "fit_findings.html")),
    "Accuracy": (
        TorqueErrorsSection(),
        _ERRORS_BY_KIND,
        _FLEET,
        SIMULATION,
        ("Measured and predicted torque", "torques.html"),
        _RESIDUALS,
    ),
    "Parameters": (BodiesSection(), _WHOLE_ROBOT, FrictionSection(), _EFFECTS, _WRENCH_SENSORS, _BODIES_IN_3D),
    "Reliability": (SOURCES, REPEATABILITY, BASE_PARAMETERS, BIAS),
    "Method and provenance": (_PRIOR, _SOLVER, _ORIGIN),
}
_SECTIONS = tuple(itertools.chain(*_BY_TOPIC.values()))
_TOPICS = {topic: tuple(map(heading, sections)) for topic, sections in _BY_TOPIC.items()}
_FOLDED_SECTIONS: Sections = (_RESIDUALS, _BODIES_IN_3D, SOURCES, BASE_PARAMETERS, BIAS, _PRIOR, _SOLVER, _ORIGIN)
_FOLDED = tuple(map(heading, _FOLDED_SECTIONS))


def fit_page(
    fit: Fit,
    report: FitReport,
    command: str,
    residual_maps: tuple[ProfilesByJoint, ProfilesByJoint] | None = None,
) -> str:
    """report.html.

    Parameters
    ----------
    fit
        The result.
    report
        The content of report.json.
    command
        The command line that made it.
    residual_maps
        Torque residuals of the prior and of the identified model, by joint; None: not asked for.
    """
    units = report.units
    rms = report.rms.validation or report.rms.train
    prior_rms = report.rms.prior_validation
    held_out = report.rms.validation is not None
    views = report_views(report.bodies)
    robot = robot_view(fit.experiment.model, views["bodies"], fit.evaluation.traces)
    gap = max(abs(report.solver.duality_gap), ROUNDING)
    known_rms = {name: error for name in report.joints if (error := rms[name]) is not None}
    worse = []
    if held_out and prior_rms:
        worse = [name for name, error in known_rms.items() if error >= (prior_rms[name] or 0.0)]
    automatic = report.regularization.automatic
    shown_if = {_RESIDUALS: bool(residual_maps), _EFFECTS: bool(report.effects), _PRIOR: automatic is not None}
    shown_if[_FLEET] = report.fleet is not None
    shown_if[_ERRORS_BY_KIND] = report.rms_by_kind is not None
    shown_if[_WHOLE_ROBOT] = report.whole_robot is not None
    shown_if[_WRENCH_SENSORS] = bool(report.wrench_sensors)
    sections: Sections = [section for section in _SECTIONS if shown_if.get(section, True)]
    sections = with_simulation(sections, report.simulation)
    sections = with_uncertainty(sections, report)
    sections = with_robot(sections, robot)
    return render(
        f"{Path(report.urdf).stem}: identified dynamics",
        sections,
        ["solids.js", "robot.js", "bodies.js", "trust.js"],
        {**views, **robot},
        folded=_FOLDED,
        topics=_TOPICS,
        report=report,
        verdict_level=report.verdict,
        verdict_text=LEVEL_TEXTS[report.verdict],
        groups=rows_by_unit(units),
        torques=torque_figures(fit.evaluation, "identified", units),
        residuals=residual_figures(*residual_maps, units, _MODEL_NAMES, _MODELS_TEXT) if residual_maps else None,
        friction_plot=fleet_figure(report),
        weights=regularization_figure(automatic) if automatic else None,
        **simulation_view(fit.simulation, report.simulation, "identified"),
        **uncertainty_view(report),
        where="On the held-out data" if held_out else "On the data that the model was fitted to",
        worse=worse,
        worst=max(report.joints, key=lambda name: known_rms.get(name, 0.0)),
        determined=fit.uncertainty.identifiable,
        gap=gap,
        certified=gap <= GAP,
        closest=fit.estimate.certificate.where,
        command=command,
    )
