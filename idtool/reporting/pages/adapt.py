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

_SECTIONS = (
    ("What was found", "adapt_findings.html"),
    ("Masses", "adapt_masses.html"),
    ("Centres of mass", "adapt_centers.html"),
    ("Friction", "adapt_friction.html"),
    ("Torque error", "adapt_errors.html"),
    ("How this was made", "origin.html"),
)
_MOST_VALUES = 80_000  # that all curves hold together
_MOST_TIMES = 1500
_SETTLED = 0.05  # of the last value
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
    columns = {(c.owner, c.name): i for i, c in enumerate(report.coefficients)}
    masses = {body: theta[:, columns[body, "m"]] for body in report.bodies if (body, "m") in columns}
    return render(
        f"{Path(report.urdf).stem}: online identification",
        _SECTIONS,
        ["lines.js"],
        {"charts": charts(report, t, theta)},
        report=report,
        groups=by_unit(report.units),
        settled={body: settling_time(t - t[0], mass) for body, mass in masses.items()},
        command=command,
    )


def history(report: AdaptationReport) -> tuple[Array, Array]:
    """Times [s], shape (T,), and coefficients, shape (T, p), NaN where there is none."""
    p = len(report.coefficients)
    return np.array(report.t, dtype=float), np.array(report.theta, dtype=float).reshape(-1, p)


def settling_time(t: Array, values: Array) -> float | None:
    """From when on values stay within a twentieth of the last one [s]; None if only at the end.

    Parameters
    ----------
    t
        Times [s], shape (T,).
    values
        Values, shape (T,).
    """
    if not len(values):
        return None
    out = np.flatnonzero(~(np.abs(values - values[-1]) <= _SETTLED * abs(values[-1])))
    first = int(out[-1]) + 1 if len(out) else 0
    return float(t[first]) if first < len(values) - 1 else None


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
