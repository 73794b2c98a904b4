"""The result of `idtool fit`."""

from __future__ import annotations

from pathlib import Path

from idtool.common.number_text import short_number
from idtool.estimation.problem.certificate import GAP, ROUNDING
from idtool.reporting.results.fit import FitReport, SolverReport
from idtool.reporting.sections.fit import (
    BodiesSection,
    EffectsSection,
    ErrorsByKindSection,
    FrictionSection,
    TorqueErrorsSection,
    WholeRobotSection,
    WrenchSensorsSection,
)
from idtool.reporting.sections.fleet import FleetSection
from idtool.reporting.sections.uncertainty import RepeatabilitySection
from idtool.reporting.terminal.output import Output
from idtool.reporting.terminal.simulation import show_simulation
from idtool.reporting.terminal.verdict import show_verdict


def show_fit(terminal: Output, report: FitReport, folder: Path | None = None) -> None:
    """The result of a fit: errors, bodies, friction, certificate, and where the files are, if any were written."""
    show_verdict(terminal, report.verdict, report.verdict_reasons, report.next)
    terminal.sections([TorqueErrorsSection(), ErrorsByKindSection(), FleetSection()], report)
    show_simulation(terminal, report.simulation)
    terminal.sections([BodiesSection(), WholeRobotSection(), FrictionSection()], report)
    terminal.sections([WrenchSensorsSection(), EffectsSection()], report)
    if report.controller_gains_text:
        terminal.say(f"controller gains: {report.controller_gains_text}")
    if report.controller and report.controller.text:
        terminal.say(f"controller delay: {report.controller.text}")
    if report.base_parameters:
        terminal.say(
            "data, combination, constraints, prior: how many of the body's ten parameters come mainly from each source "
            "(combination: the data determine them only together with other parameters)"
        )
    terminal.sections([RepeatabilitySection()], report)
    regularization = report.regularization
    if regularization.automatic is not None:
        reason = regularization.automatic.reason
        terminal.say(f"the prior's weight is {short_number(regularization.weight, 2)}: {reason}")
    terminal.say(_optimality_text(report.solver))
    terminal.notices(report.notices)
    if folder is not None:
        robots = ", robots/" if report.fleet else ""
        terminal.say(f"written: {folder}/identified.urdf, model.yaml, report.json, report.html{robots}")


def _optimality_text(solver: SolverReport) -> str:
    """Bound on the distance of the cost from the minimum, in words."""
    gap = max(abs(solver.duality_gap), ROUNDING)
    if gap <= GAP:
        return f"optimum certified to a relative duality gap of {gap:.1e}"
    return (
        f"optimum not certified: {solver.name} stopped at a cost that may exceed the minimum by a fraction of {gap:.1e}"
    )
