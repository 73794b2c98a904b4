"""Constraint sets side by side, after the paper's Fig. 5 and Remark 5."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.reporting.figures import by_unit
from idtool.reporting.plots.figure import Figure, Panel, Trace, banded_curve, figure, styled_curve, time_axis
from idtool.reporting.plots.sampling import thinned
from idtool.reporting.results.study import StudyReport

# A set has one colour in all figures; the rest follow.
_ORDER = ("none", "semi", "known_com", "com_ellipsoid", "points", "full", "ellipsoid", "shape")
_MOST_TIMES = 1000
_BAND = 2.0  # standard errors
_SAMPLES = "training samples"


def learning_figure(report: StudyReport) -> Figure:
    """Held-out error against the number of samples."""
    learning = report.learning
    curves: list[Trace] = []
    for name, error in learning.curves.items():
        color = _color(name, learning.curves)
        curves += banded_curve(name, learning.counts, error.median, error.lower, error.upper, color)
    panel = Panel(f"RMS torque error [{by_unit(report.units)[-1][0]}]", curves, log=True)
    return figure("Fig. 5: held-out error", _SAMPLES, [panel], x_log=True)


def advantage_figure(report: StudyReport) -> Figure:
    """By how much the held-out error is below that with the first set."""
    learning = report.learning
    first, *others = learning.curves
    curves: list[Trace] = []
    for name in others:
        advantage, error = learning.advantage[name].advantage, learning.advantage[name].advantage_error
        y, lower, upper = (-100 * np.expm1(-advantage - k * error) for k in (0, -_BAND, _BAND))
        curves += banded_curve(name, learning.counts, y, lower, upper, _color(name, learning.curves))
    panel = Panel("error reduction [%]", curves, level=0)
    return figure(f"Reduction of the held-out error relative to {first}", _SAMPLES, [panel], x_log=True)


def violation_figure(report: StudyReport) -> Figure:
    """By how much the worst body violates realizability, against the number of samples."""
    learning = report.learning
    panel = Panel("violation, relative", _curves(learning.counts, learning.violation))
    return figure("Worst violation of realizability", _SAMPLES, [panel], x_log=True)


def online_figure(report: StudyReport) -> Figure:
    """Error of the parameters over time, identified online."""
    online = report.adaptation
    kept = thinned(len(online.t), _MOST_TIMES)
    t, title = time_axis(online.t[kept])
    curves = _curves(t, {name: values[kept] for name, values in online.error.items()})
    panel = Panel("relative error", curves, log=True, level=0.1)
    return figure("Remark 5: parameter error of the online estimate", title, [panel])


def _curves(x: Sequence[float | None], values: Mapping[str, Sequence[float | None] | Array]) -> list[Trace]:
    return [styled_curve(name, x, y, _color(name, values)) for name, y in values.items()]


def _color(name: str, names: Collection[str]) -> int:
    return _ORDER.index(name) if name in _ORDER else len(_ORDER) + list(names).index(name)
