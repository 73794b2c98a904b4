"""comparison.html."""

from __future__ import annotations

from idtool.reporting.pages.base import render
from idtool.reporting.plots.friction import friction_figure
from idtool.reporting.results.comparison import ComparisonReport
from idtool.reporting.sections.compare import (
    FRICTION,
    OTHERS,
    ComparedBaseParametersSection,
    ComparedBodiesSection,
    ComparedErrorsSection,
    ComparedResultsSection,
    ComparedRolloutsSection,
    SettingsSection,
)

_ORIGIN = ("Origin of this report", "origin.html")
_SECTIONS = (
    ("Are they the same?", "compare_findings.html"),
    ComparedResultsSection(),
    ComparedBaseParametersSection(),
    ComparedErrorsSection(),
    ComparedRolloutsSection(),
    ComparedBodiesSection(),
    FRICTION,
    OTHERS,
    SettingsSection(),
    _ORIGIN,
)


def comparison_page(report: ComparisonReport, command: str) -> str:
    """comparison.html.

    Parameters
    ----------
    report
        The content of comparison.json.
    command
        The command line that made it.
    """
    units = {**report.b.units, **report.a.units}
    friction = {"A": report.a.friction, "B": report.b.friction}
    sections = [section for section in _SECTIONS if isinstance(section, tuple) or section.table(report) is not None]
    return render(
        f"{report.a.report} and {report.b.report}: comparison",
        sections,
        [],
        {},
        folded=(_ORIGIN[0],),
        report=report,
        friction_plot=friction_figure("Friction of A and B, with bars of two standard errors", friction, units),
        command=command,
    )
