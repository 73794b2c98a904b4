"""adapt.html: parameters identified online, over time."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.number_text import rows_by_unit
from idtool.reporting.pages.base import Sections, render
from idtool.reporting.plots.adaptation import center_figure, joint_figures, mass_figure
from idtool.reporting.results.adaptation import AdaptationReport
from idtool.reporting.sections.adapt import (
    FinalBodiesSection,
    FinalFrictionSection,
    PredictionErrorsSection,
    settling_times,
)


def adapt_page(report: AdaptationReport, command: str) -> str:
    """adapt.html.

    Parameters
    ----------
    report
        The content of adapt.json.
    command
        The command line that made it.
    """
    sections: Sections = [
        ("Findings", "adapt_findings.html"),
        FinalBodiesSection(),
        ("Centres of mass", [center_figure(report)]),
        FinalFrictionSection(),
        PredictionErrorsSection(),
        ("Origin of this report", "origin.html"),
    ]
    return render(
        f"{Path(report.urdf).stem}: online identification",
        sections,
        [],
        {},
        report=report,
        groups=rows_by_unit(report.units),
        settled=settling_times(report),
        masses=mass_figure(report),
        frictions=joint_figures(report),
        command=command,
    )
