"""The result of `idtool excite`."""

from __future__ import annotations

from pathlib import Path

from idtool.common.number_text import parameter_text, short_number
from idtool.reporting.results.excitation import ExcitationReport, ExplanationReport
from idtool.reporting.sections.excite import (
    CriteriaSection,
    DecisionSection,
    ExpectedErrorsSection,
    GroundSection,
    LimitsSection,
    decision_sentence,
    ground_sentence,
)
from idtool.reporting.terminal.output import Output


def show_excitation(terminal: Output, report: ExcitationReport) -> None:
    """The errors to expect, the limits, and where the files are."""
    sections = [ExpectedErrorsSection(), LimitsSection(), GroundSection(), CriteriaSection(), DecisionSection()]
    terminal.sections(sections, report)
    if report.standing is not None:
        terminal.say(ground_sentence(report))
    if report.decide is not None:
        for explanation in (report.decide.a, report.decide.b):
            terminal.say(f"{explanation.name}: {_parameters(explanation)} ({explanation.source})")
        terminal.say(decision_sentence(report))
    near = report.clearance
    if near and near.distance is not None:
        links = " and ".join(near.links)
        terminal.say(f"nearest links: {links}, {short_number(1000 * near.distance)} mm after {short_number(near.t)} s")
    terminal.notices(report.notices)
    if report.file is not None:
        terminal.say(f"written: {report.file} and {Path(report.file).with_suffix('.html').name}")


def _parameters(explanation: ExplanationReport) -> str:
    """Parameters of an explanation's effects, in their order."""
    parts = []
    for effect in explanation.effects:
        parts += [
            parameter_text(name, value, unit=effect.units[name], digits=3) for name, value in effect.parameters.items()
        ]
    return ", ".join(parts)
