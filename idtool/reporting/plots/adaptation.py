"""Parameters identified online, over time."""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.reporting.plots.figure import Figure, Panel, PlotlyTrace, figure, styled_curve, time_axis
from idtool.reporting.plots.sampling import subsample_indices
from idtool.reporting.results.adaptation import AdaptationReport
from idtool.reporting.sections.adapt import coefficient_history

_MAX_VALUES = 80_000  # that all curves hold together
_MAX_TIMES = 1500
_MOMENTS = ("mc_x", "mc_y", "mc_z")


def plotted_history(report: AdaptationReport) -> tuple[Array, Array]:
    """`coefficient_history` at evenly spread times, few enough to draw."""
    t, theta = coefficient_history(report)
    max_times = min(_MAX_TIMES, _MAX_VALUES // max(theta.shape[1], 1))
    indices = subsample_indices(len(t), max_times)
    return t[indices], theta[indices]


def mass_figure(report: AdaptationReport) -> Figure:
    """Mass of each body."""
    times, theta = plotted_history(report)
    t, title = time_axis(times)
    columns = _columns(report)
    curves = [styled_curve(body, t, theta[:, columns[body, "m"]], i) for i, body in _bodies(report)]
    return figure("Mass of each body", title, [Panel("mass [kg]", curves)])


def center_figure(report: AdaptationReport) -> Figure:
    """Centre of mass of each body; none where its mass is not positive."""
    times, theta = plotted_history(report)
    t, title = time_axis(times)
    columns = _columns(report)
    panels = []
    for moment in _MOMENTS:
        curves = []
        for i, body in _bodies(report):
            mass = theta[:, columns[body, "m"]]
            center = np.full_like(mass, np.nan)
            np.divide(theta[:, columns[body, moment]], mass, out=center, where=mass > 0)
            curves.append(styled_curve(body, t, center, i))
        panels.append(Panel(f"{moment[-1]} [m]", curves))
    return figure("Centre of mass of each body, in its frame", title, panels)


def joint_figures(report: AdaptationReport) -> list[Figure]:
    """One figure for each kind of coefficient that is not a body's, a curve a joint."""
    times, theta = plotted_history(report)
    t, title = time_axis(times)
    joints = report.joints
    kinds: dict[tuple[str, str, str], list[PlotlyTrace]] = {}
    for i, coefficient in enumerate(report.coefficients):
        owner = coefficient.owner
        if owner in report.bodies:
            continue
        index = joints.index(owner) if owner in joints else len(joints)
        kind = (coefficient.effect, coefficient.name, coefficient.unit)
        kinds.setdefault(kind, []).append(styled_curve(owner, t, theta[:, i], index))
    return [
        figure(f"{effect.replace('_', ' ').capitalize()} of each joint", title, [Panel(f"{name} [{unit}]", curves)])
        for (effect, name, unit), curves in kinds.items()
    ]


def _columns(report: AdaptationReport) -> dict[tuple[str, str], int]:
    """Column of each coefficient, by owner and name."""
    return {(coefficient.owner, coefficient.name): i for i, coefficient in enumerate(report.coefficients)}


def _bodies(report: AdaptationReport) -> list[tuple[int, str]]:
    """Bodies whose mass is estimated, with the indices of their colours."""
    columns = _columns(report)
    return [(i, body) for i, body in enumerate(report.bodies) if (body, "m") in columns]
