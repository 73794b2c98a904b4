"""excitation.html: a designed trajectory against its limits, and what it will tell."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from idtool.reporting.pages.base import render
from idtool.reporting.pages.charts import line, over_time, panel
from idtool.reporting.results.excitation import ExcitationReport
from idtool.reporting.sections.excite import CriteriaSection, ExpectedErrorsSection, LimitsSection

_SECTIONS = (
    ("What to expect", "excite_findings.html"),
    ("Trajectory", "excite_trajectory.html"),
    LimitsSection(),
    ExpectedErrorsSection(),
    CriteriaSection(),
    ("How this was made", "origin.html"),
)
_SIGNALS = (("q", "position"), ("v", "velocity"), ("a", "acceleration"), ("tau", "effort"))


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
        ["lines.js"],
        {"charts": charts(report)},
        report=report,
        gain=_gain(report),
        command=command,
    )


def charts(report: ExcitationReport) -> dict[str, Any]:
    """What `lines.js` draws: a chart a joint, its motion and predicted torque with the limits."""
    t = report.curves.t
    return {f"joint {i}": over_time(joint, t, _panels(report, joint, len(t))) for i, joint in enumerate(report.joints)}


def _panels(report: ExcitationReport, joint: str, count: int) -> list[dict[str, Any]]:
    limits, curves = report.limits[joint], report.curves.joints[joint]
    panels = []
    for signal, quantity in _SIGNALS:
        limit = getattr(limits, quantity)
        ends = limit if isinstance(limit, tuple) else () if limit is None else (-limit, limit)
        lines = [line(quantity if quantity != "effort" else "predicted torque", getattr(curves, signal), 0)]
        lines += [line("limit", [end] * count, 1) for end in ends]
        panels.append(panel(f"{signal} [{unit_of(signal, report.units[joint])}]", lines))
    return panels


def unit_of(signal: str, torque: str) -> str:
    """Unit of a joint's q, v, a or tau, told by the unit of its torque."""
    way = "m" if torque == "N" else "rad"
    return {"q": way, "v": f"{way}/s", "a": f"{way}/s²"}.get(signal, torque)


def _gain(report: ExcitationReport) -> float | None:
    """How many times smaller the criterion is than of a random motion."""
    kind = report.criterion
    before, after = (getattr(report.criteria[motion], kind) for motion in ("random", "design"))
    return before / after if before and after else None
