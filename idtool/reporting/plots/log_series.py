"""Curves over the time of logs, joint by joint, of bounded size."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from idtool.common.dataclass import dataclass
from idtool.estimation.dataset.envelope import Trace
from idtool.reporting.plots.figure import Figure, FigureGroup
from idtool.reporting.plots.sampling import merge_stretches, round_curve

_MAX_LOGS = 6  # that are drawn
_LATE_TIME = 1e4  # s: later times are drawn as time since the curve's first whole second


@dataclass(frozen=True)
class JointSeries:
    """Curves of one joint.

    Attributes
    ----------
    name
        The joint's.
    unit
        Of the curves, but a position beside torques.
    curves
        Values by the curve's name; None breaks a line.
    """

    name: str
    unit: str
    curves: dict[str, list[float | None]]


@dataclass(frozen=True)
class LogSeries:
    """Curves of one log: its name, times ``t`` [s] after ``start``, and the joints' curves then."""

    name: str
    start: int
    t: list[float]
    joints: list[JointSeries]


@dataclass(frozen=True)
class LogFigures:
    """Figures of the first logs, and how many more are ``omitted``.

    Attributes
    ----------
    groups
        A log's figures, one a joint.
    with_prior
        Whether they have a curve ``prior``.
    """

    groups: list[FigureGroup]
    omitted: int
    with_prior: bool


def log_series(
    traces: Sequence[Trace], names: Mapping[str, str], units: Mapping[str, str], most_values: int
) -> list[LogSeries]:
    """Series of the first few logs.

    Parameters
    ----------
    traces
        One a log.
    names
        A curve's name in the figure to that in the trace; one that a trace has not is left out.
    units
        By joint, in the order of the curves.
    most_values
        Values that all curves hold together.
    """
    drawn = traces[:_MAX_LOGS]
    values = sum(x.size for trace in drawn for x in trace.curves.values())
    stretches = max(math.ceil(values / most_values), 1)
    logs = []
    for trace in drawn:
        start = math.floor(trace.t[0]) if abs(trace.t[0]) > _LATE_TIME else 0
        t = merge_stretches(trace.t[None] - start, stretches)[0].round(5).tolist()
        coarse = {
            name: merge_stretches(trace.curves[key], stretches) for name, key in names.items() if key in trace.curves
        }
        joints = [
            JointSeries(joint, unit, {name: round_curve(x[j]) for name, x in coarse.items()})
            for j, (joint, unit) in enumerate(units.items())
        ]
        logs.append(LogSeries(trace.name, start, t, joints))
    return logs


def log_figures(logs: Sequence[LogSeries], total: int, draw: Callable[[LogSeries, JointSeries], Figure]) -> LogFigures:
    """Figures of the first of ``total`` logs, drawn by a function of a log and a joint."""
    groups = [FigureGroup(log.name, [draw(log, joint) for joint in log.joints]) for log in logs]
    with_prior = any("prior" in joint.curves for log in logs[:1] for joint in log.joints)
    return LogFigures(groups, total - len(logs), with_prior)
