"""Constraint sets side by side, after the paper's Fig. 5 and Remark 5."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.reporting.number_text import rows_by_unit
from idtool.reporting.plots.figure import Figure, Panel, PlotlyTrace, banded_curve, figure, styled_curve, time_axis
from idtool.reporting.plots.sampling import subsample_indices
from idtool.reporting.results.study import StudyReport

# A set has one colour in all figures; the rest follow.
_ORDER = ("none", "semi", "known_com", "com_ellipsoid", "points", "full", "ellipsoid", "shape")
_MAX_TIMES = 1000
_BAND_ERRORS = 2.0  # standard errors to either side
_SAMPLES = "training samples"


def learning_figure(report: StudyReport) -> Figure:
    """Held-out error against the number of samples."""
    learning = report.learning
    curves: list[PlotlyTrace] = []
    for name, error in learning.curves.items():
        color = _color(name, learning.curves)
        curves += banded_curve(name, learning.counts, error.median, error.lower, error.upper, color)
    panel = Panel(f"RMS torque error [{rows_by_unit(report.units)[-1][0]}]", curves, log=True)
    return figure("Fig. 5: held-out error", _SAMPLES, [panel], x_log=True)


def advantage_figure(report: StudyReport) -> Figure:
    """Advantage in held-out error over the first set, against the number of samples."""
    learning = report.learning
    first, *others = learning.curves
    curves: list[PlotlyTrace] = []
    for name in others:
        advantage = learning.advantage[name].advantage
        deviation = _BAND_ERRORS * learning.advantage[name].advantage_error
        y = -100 * np.expm1(-advantage)
        lower = -100 * np.expm1(-advantage + deviation)
        upper = -100 * np.expm1(-advantage - deviation)
        curves += banded_curve(name, learning.counts, y, lower, upper, _color(name, learning.curves))
    panel = Panel("error reduction [%]", curves, level=0)
    return figure(f"Reduction of the held-out error relative to the set “{first}”", _SAMPLES, [panel], x_log=True)


def violation_figure(report: StudyReport) -> Figure:
    """Violation of realizability by the worst body, against the number of samples."""
    learning = report.learning
    panel = Panel("violation, relative", _curves(learning.counts, learning.violation))
    return figure("Worst violation of realizability", _SAMPLES, [panel], x_log=True)


def online_figure(report: StudyReport) -> Figure:
    """Error of the parameters over time, identified online."""
    online = report.adaptation
    indices = subsample_indices(len(online.t), _MAX_TIMES)
    t, title = time_axis(online.t[indices])
    curves = _curves(t, {name: values[indices] for name, values in online.error.items()})
    panel = Panel("relative error", curves, log=True, level=0.1)
    return figure("Remark 5: parameter error of the online estimate", title, [panel])


def _curves(x: Sequence[float | None], values: Mapping[str, Sequence[float | None] | Array]) -> list[PlotlyTrace]:
    return [styled_curve(name, x, y, _color(name, values)) for name, y in values.items()]


def _color(name: str, names: Collection[str]) -> int:
    """Index of a set's colour."""
    if name in _ORDER:
        return _ORDER.index(name)
    return len(_ORDER) + list(names).index(name)
