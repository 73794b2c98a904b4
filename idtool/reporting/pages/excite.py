"""excitation.html: a designed trajectory against its limits, and what it will tell."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.pages.base import render
from idtool.reporting.plots.trajectory import trajectory_figures
from idtool.reporting.results.excitation import ExcitationReport
from idtool.reporting.sections.excite import CriteriaSection, ExpectedErrorsSection, LimitsSection

_SECTIONS = (
    ("Findings", "excite_findings.html"),
    ("Trajectory", "excite_trajectory.html"),
    LimitsSection(),
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
        gain=_gain(report),
        command=command,
    )


def _gain(report: ExcitationReport) -> float | None:
    """How many times smaller the criterion is than of a random motion."""
    kind = report.criterion
    before, after = (getattr(report.criteria[motion], kind) for motion in ("random", "design"))
    return before / after if before and after else None
