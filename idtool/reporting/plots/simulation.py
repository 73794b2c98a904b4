"""Measured and simulated motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from idtool.common.arrays import Array
from idtool.estimation.dataset.envelope import Envelope
from idtool.estimation.evaluation.rollouts import RolloutEvaluation
from idtool.reporting.number_text import rows_by_unit
from idtool.reporting.plots.figure import SHORT, Figure, FigureGroup, Panel, curve, figure, styled_curve, time_title
from idtool.reporting.plots.log_series import JointSeries, LogFigures, LogSeries, log_figures, log_series
from idtool.reporting.results.rollouts import Simulation

BASELINES = {"open_loop": "hold", "closed_loop": "q = qcmd"}
_MAX_VALUES = 40_000  # that all curves hold together: some 300 kB of text
_MAX_VALUES_ALONE = 80_000  # where there are no other figures
_MARGIN = 0.5  # of the measured range, by which a curve that leaves it is shown to either side
_COLORS = {"model": 5, "prior": 1, "baseline": 0}  # as in the figures over time


def position_figures(rollouts: RolloutEvaluation, simulation: Simulation, model: str) -> LogFigures:
    """Measured and simulated position of every joint over time.

    Parameters
    ----------
    rollouts
        The simulation.
    simulation
        Its record.
    model
        Whose motion is the ``simulated`` one.
    """
    names = {"measured": "measured", "simulated": model}
    if simulation.prior:
        names["prior"] = "prior"
    series = log_series(rollouts.traces, names, simulation.units, _MAX_VALUES)
    return log_figures(series, len(rollouts.traces), position_figure)


def motion_figures(t: Array, curves: Mapping[str, Array], units: Mapping[str, str]) -> FigureGroup:
    """Measured and simulated position of every joint, for one motion that is not part of an evaluation.

    Parameters
    ----------
    t
        Times [s], shape (N,).
    curves
        ``measured`` and ``simulated``, shape (nv, N).
    units
        Unit of the position, by joint.
    """
    envelope = Envelope([slice(0, len(t))], t)
    envelope.add(t, curves)
    series = log_series([envelope.trace("")], {name: name for name in curves}, units, _MAX_VALUES_ALONE)
    return log_figures(series, 1, position_figure).groups[0]


def position_figure(log: LogSeries, joint: JointSeries) -> Figure:
    """Measured and simulated position of a joint.

    Parameters
    ----------
    log
        The log, with the times.
    joint
        ``measured`` and maybe ``simulated`` and ``prior``.
    """
    curves = joint.curves
    lines = [curve("measured", log.t, curves["measured"], "measured", 4)]
    if "simulated" in curves:
        lines.append(curve("simulated", log.t, curves["simulated"], "predicted", 1.3))
    if "prior" in curves:
        lines.append(curve("prior", log.t, curves["prior"], "prior", 1.3, "dot", visible="legendonly"))
    title = "position [m]" if joint.unit == "m" else "angle [rad]"
    shown = _shown_range(_array(curves["measured"]), _array(curves.get("simulated", [])))
    description = f"Measured and simulated position of {joint.name} over time"
    panels = [Panel(title, lines, axis={"range": shown})]
    return figure(joint.name, time_title(log.start), panels, description, SHORT, hovermode="x")


def _array(values: list[float | None]) -> Array:
    """Values as an array, shape (n,), with NaN for None."""
    return np.array(values, dtype=float)


def _shown_range(measured: Array, simulated: Array) -> list[float]:
    """The range of positions to show: that of both, of what leaves the measured one not more than a part."""
    low, high = np.nanmin(measured), np.nanmax(measured)
    margin = _MARGIN * (high - low)
    both = np.concatenate([measured, np.clip(simulated, low - margin, high + margin)])
    low, high = np.nanmin(both), np.nanmax(both)
    padding = 0.05 * (high - low) or 0.01
    return [float(f"{low - padding:.4g}"), float(f"{high + padding:.4g}")]


def horizon_figure(simulation: Simulation) -> Figure | None:
    """Position error against the time since a restart; None where that was not evaluated at several times."""
    horizons = simulation.horizon
    if len(horizons) < 2:
        return None
    seconds = [horizon.seconds for horizon in horizons]
    lines = []
    for name, key in {"model": "position", "prior": "prior", "baseline": "baseline"}.items():
        errors = [getattr(horizon, key) for horizon in horizons]
        if all(errors):
            label = BASELINES[simulation.kind] if name == "baseline" else name
            lines.append(styled_curve(label, seconds, [error["overall"] for error in errors], _COLORS[name]))
    panel = Panel(f"RMS error [{rows_by_unit(simulation.units)[-1][0]}]", lines, log=True)
    caption = "Position error against time since the restart, all joints"
    return figure(caption, "time since the restart [s]", [panel], x_log=True)
