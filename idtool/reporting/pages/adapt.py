"""adapt.html: parameters identified online, over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.reporting.figures import by_unit
from idtool.reporting.pages.base import render
from idtool.reporting.pages.charts import line, over_time, panel, thinned
from idtool.reporting.results.adaptation import AdaptationReport
from idtool.reporting.sections.adapt import (
    FinalBodiesSection,
    FinalFrictionSection,
    PredictionErrorsSection,
    history,
    settling_times,
)

_SECTIONS = (
    ("What was found", "adapt_findings.html"),
    FinalBodiesSection(),
    ("Centres of mass", "adapt_centers.html"),
    FinalFrictionSection(),
    PredictionErrorsSection(),
    ("How this was made", "origin.html"),
)
_MOST_VALUES = 80_000  # that all curves hold together
_MOST_TIMES = 1500
_MOMENTS = ("mc_x", "mc_y", "mc_z")


def adapt_page(report: AdaptationReport, command: str) -> str:
    """adapt.html.

    Parameters
    ----------
    report
        The content of adapt.json.
    command
        The command line that made it.
    """
    t, theta = history(report)
    return render(
        f"{Path(report.urdf).stem}: online identification",
        _SECTIONS,
        ["lines.js"],
        {"charts": charts(report, t, theta)},
        report=report,
        groups=by_unit(report.units),
        settled=settling_times(report),
        command=command,
    )


def charts(report: AdaptationReport, t: Array, theta: Array) -> dict[str, Any]:
    """What `lines.js` draws, of bounded size: every so many samples of ``t`` (T,) and ``theta`` (T, p)."""
    kept = thinned(len(t), min(_MOST_TIMES, _MOST_VALUES // max(theta.shape[1], 1)))
    t, theta = t[kept], theta[kept]
    of = {(c.owner, c.name): theta[:, i] for i, c in enumerate(report.coefficients)}
    bodies = [(i, body) for i, body in enumerate(report.bodies) if (body, "m") in of]

    def center(body: str, moment: str) -> Array:
        mass = of[body, "m"]
        return np.divide(of[body, moment], mass, out=np.full_like(mass, np.nan), where=mass > 0)

    masses = panel("mass [kg]", [line(body, of[body, "m"], i) for i, body in bodies])
    centers = [
        panel(f"{moment[-1]} [m]", [line(body, center(body, moment), i) for i, body in bodies]) for moment in _MOMENTS
    ]
    return {
        "masses": over_time("Mass of each body", t, [masses]),
        "centers": over_time("Centre of mass of each body, in its frame", t, centers),
        **{f"joint {i}": drawn for i, drawn in enumerate(_joint_charts(report, t, theta))},
    }


def _joint_charts(report: AdaptationReport, t: Array, theta: Array) -> list[dict[str, Any]]:
    """One chart for each kind of coefficient that is not a body's, a curve a joint."""
    joints = report.joints
    kinds: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for i, c in enumerate(report.coefficients):
        if c.owner not in report.bodies:
            index = joints.index(c.owner) if c.owner in joints else len(joints)
            kinds.setdefault((c.effect, c.name, c.unit), []).append(line(c.owner, theta[:, i], index))
    return [
        over_time(f"{effect.replace('_', ' ').capitalize()} of each joint", t, [panel(f"{name} [{unit}]", lines)])
        for (effect, name, unit), lines in kinds.items()
    ]
