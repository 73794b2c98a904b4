"""adapt.html: parameters identified online, over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from idtool.common.arrays import Array
from idtool.reporting.figures import by_unit
from idtool.reporting.pages.base import Sections, render
from idtool.reporting.plots.adaptation import center_figure, history, joint_figures, mass_figure
from idtool.reporting.results.adaptation import AdaptationReport

_SETTLED = 0.05  # of the last value


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
    sections: Sections = [
        ("What was found", "adapt_findings.html"),
        ("Masses", "adapt_masses.html"),
        ("Centres of mass", [center_figure(report)]),
        ("Friction", "adapt_friction.html"),
        ("Torque error", "adapt_errors.html"),
        ("How this was made", "origin.html"),
    ]
    columns = {(c.owner, c.name): i for i, c in enumerate(report.coefficients)}
    masses = {body: theta[:, columns[body, "m"]] for body in report.bodies if (body, "m") in columns}
    return render(
        f"{Path(report.urdf).stem}: online identification",
        sections,
        [],
        {},
        report=report,
        groups=by_unit(report.units),
        settled={body: settling_time(t - t[0], mass) for body, mass in masses.items()},
        masses=mass_figure(report),
        frictions=joint_figures(report),
        command=command,
    )


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
