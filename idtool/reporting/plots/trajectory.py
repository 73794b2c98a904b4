"""A designed trajectory against its limits."""

from __future__ import annotations

import numpy as np

from idtool.common.units import POSITION_UNITS
from idtool.reporting.plots.figure import Figure, Panel, figure, styled_curve, time_axis
from idtool.reporting.results.excitation import ExcitationReport

_SIGNALS = (("q", "position"), ("v", "velocity"), ("a", "acceleration"), ("tau", "effort"))


def trajectory_figures(report: ExcitationReport) -> list[Figure]:
    """Motion and predicted torque with the limits, one figure a joint."""
    return [trajectory_figure(report, joint) for joint in report.joints]


def trajectory_figure(report: ExcitationReport, joint: str) -> Figure:
    """Motion and predicted torque of a joint with the limits.

    Parameters
    ----------
    report
        What `excite --json` prints.
    joint
        Which joint.
    """
    t, title = time_axis(np.asarray(report.curves.t))
    limits, curves = report.limits[joint], report.curves.joints[joint]
    panels = []
    for signal, quantity in _SIGNALS:
        limit = getattr(limits, quantity)
        ends: tuple[float, ...] = ()
        if isinstance(limit, tuple):
            ends = limit
        elif limit is not None:
            ends = (-limit, limit)
        name = "predicted torque" if quantity == "effort" else quantity
        lines = [styled_curve(name, t, getattr(curves, signal), 0)]
        lines += [styled_curve("limit", t, [end] * len(t), 1) for end in ends]
        panels.append(Panel(f"{signal} [{unit_of(signal, report.units[joint])}]", lines))
    return figure(joint, title, panels)


def unit_of(signal: str, torque: str) -> str:
    """Unit of a joint's q, v, a or tau, told by the unit of its torque."""
    length = POSITION_UNITS[torque]
    return {"q": length, "v": f"{length}/s", "a": f"{length}/s²"}.get(signal, torque)
