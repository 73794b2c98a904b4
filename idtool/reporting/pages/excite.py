"""excitation.html: a designed trajectory against its limits, and the standard errors to expect."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.pages.base import render
from idtool.reporting.plots.trajectory import trajectory_figures
from idtool.reporting.results.excitation import ExcitationReport
from idtool.reporting.sections.excite import (
    CriteriaSection,
    DecisionSection,
    ExpectedErrorsSection,
    GroundSection,
    LimitsSection,
)

_SECTIONS = (
    ("Findings", "excite_findings.html"),
    DecisionSection(),
    ("Trajectory", "excite_trajectory.html"),
    LimitsSection(),
    GroundSection(),
    ExpectedErrorsSection(),
    CriteriaSection(),
    ("Origin of this report", "origin.html"),
)


def excite_page(report: ExcitationReport, command: str) -> str:
    """The page.

    Parameters
    ----------
    report
        What `excite --json` prints.
    command
        The command line that made it.
    """
    return render(
        f"{Path(report.urdf).stem}: exciting trajectory",
        _SECTIONS,
        [],
        {},
        report=report,
        trajectories=trajectory_figures(report),
        gain=_information_gain(report),
        command=command,
    )


def _information_gain(report: ExcitationReport) -> float | None:
    """Criterion of a random motion over that of the design; None if one is not determined."""
    random = getattr(report.criteria["random"], report.criterion)
    design = getattr(report.criteria["design"], report.criterion)
    return random / design if random and design else None
