"""Measured and predicted torque over time."""

from __future__ import annotations

from collections.abc import Mapping

from idtool.estimation.evaluation.torque_errors import Evaluation
from idtool.reporting.plots.figure import MEDIUM, TALL, Figure, Panel, curve, figure, time_title
from idtool.reporting.plots.log_series import JointSeries, LogFigures, LogSeries, log_figures, log_series

_MAX_VALUES = 60_000  # that all curves of torque hold together: some 450 kB of text


def torque_figures(evaluation: Evaluation, model: str, units: Mapping[str, str], position: bool = False) -> LogFigures:
    """Measured and predicted torque of the first few logs, of bounded size.

    Parameters
    ----------
    evaluation
        Its traces are drawn.
    model
        Whose torque is the ``predicted`` one.
    units
        Unit of the torque by joint, in the order of the curves.
    position
        Whether the joints' positions are drawn too, where the traces have them.
    """
    names = {"measured": "measured", "predicted": model, "prior": "prior", "residual": "residual"}
    if position:
        names["position"] = "q"
    series = log_series(evaluation.traces, names, units, _MAX_VALUES)
    return log_figures(series, len(evaluation.traces), torque_figure)


def torque_figure(log: LogSeries, joint: JointSeries) -> Figure:
    """Measured and predicted torque of a joint, the residual, and its position where the series has it.

    Parameters
    ----------
    log
        The log, with the times.
    joint
        ``measured``, ``predicted``, ``residual`` and maybe ``prior`` and ``position``.
    """
    curves = joint.curves
    torques = [
        curve("measured", log.t, curves["measured"], "measured", 4),
        curve("predicted", log.t, curves["predicted"], "predicted", 1.3),
    ]
    if "prior" in curves:
        torques.append(curve("prior", log.t, curves["prior"], "prior", 1.3, "dot", visible="legendonly"))
    residual = [curve("residual", log.t, curves["residual"], "residual", 1)]
    with_position = any(curves.get("position", ()))  # not for the rows of the base and of wrench sensors
    panels = [
        Panel(f"torque [{joint.unit}]", torques, domain=(0.3, 0.64) if with_position else (0.36, 1)),
        Panel("residual", residual, domain=(0, 0.24) if with_position else (0, 0.28), axis={"nticks": 6}),
    ]
    if with_position:
        title = "position [m]" if joint.unit == "N" else "angle [rad]"
        position = [curve("position", log.t, curves["position"], "ink", 1.3)]
        panels.append(Panel(title, position, domain=(0.7, 1)))
    description = f"Measured and predicted torque and residual of {joint.name} over time"
    return figure(
        joint.name,
        time_title(log.start),
        panels,
        description + (", and its position" if with_position else ""),
        TALL if with_position else MEDIUM,
        hovermode="x",
    )
