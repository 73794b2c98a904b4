"""Figures for a notebook: the curves, colours and titles of the pages, as plotly draws them in Python."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from idtool.common.arrays import Array
from idtool.estimation.evaluation.envelope import Envelope
from idtool.reporting.pages.curves import drawn

_MOST_VALUES = 80_000  # that all curves of a figure hold together
_JOINT = 300  # px, of a joint's plots
_CURVES = {
    "measured": {"color": "measured", "width": 4},
    "predicted": {"color": "predicted", "width": 1.3},
    "simulated": {"color": "predicted", "width": 1.3},
    "prior": {"color": "prior", "width": 1.3, "dash": "dot"},
    "residual": {"color": "residual", "width": 1},
}


@cache
def _colors() -> dict[str, str]:
    """The pages' colours on white, by name."""
    style = files("idtool.reporting").joinpath("templates/style.css").read_text(encoding="utf-8")
    light, _, _ = style.partition("@media")
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", light))


def torque_figure(view: Mapping[str, Any], log: int) -> go.Figure:
    """Measured and predicted torque and the residual, joint by joint.

    Parameters
    ----------
    view
        From `idtool.reporting.pages.curves`.
    log
        Which of its logs.

    Raises
    ------
    IndexError
        If there are not so many.
    """
    one = view["logs"][log]
    joints = one["joints"]
    figure = _panels(2 * len(joints), [0.7, 0.3] * len(joints), _JOINT * len(joints))
    for j, joint in enumerate(joints):
        shown = {name: joint[name] for name in ("measured", "predicted", "prior") if name in joint}
        _draw(figure, 2 * j + 1, one["t"], shown, f"{joint['name']} [{joint['unit']}]")
        _draw(figure, 2 * j + 2, one["t"], {"residual": joint["residual"]}, "residual")
    return _finished(figure, one)


def position_figure(t: Array, curves: Mapping[str, Array], units: Mapping[str, str]) -> go.Figure:
    """Positions over time, joint by joint.

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
    one = drawn([envelope.trace("")], {name: name for name in curves}, units, _MOST_VALUES)["logs"][0]
    figure = _panels(len(units), [1.0] * len(units), _JOINT * len(units))
    for j, joint in enumerate(one["joints"]):
        _draw(figure, j + 1, one["t"], {name: joint[name] for name in curves}, f"{joint['name']} [{joint['unit']}]")
    return _finished(figure, one)


def gap_figure(view: Mapping[str, Any]) -> go.Figure:
    """The gap closing step by step: errors of torque and, where there were any, of rollouts.

    Parameters
    ----------
    view
        From `idtool.reporting.pages.residuals.gap_views`.
    """
    joints, names = view["joints"], view["names"]
    kinds = ["torque", *(["rollout"] if any(joint["rollout"] for joint in joints) else [])]
    figure = make_subplots(len(joints), len(kinds), shared_xaxes=True, vertical_spacing=0.2 / len(joints))
    for j, joint in enumerate(joints, 1):
        for k, (kind, color) in enumerate(zip(kinds, ("c5", "c2"), strict=False), 1):
            errors = joint[kind]
            style = {"line": {"color": _colors()[color], "width": 2}, "marker": {"size": 7}}
            at = list(range(len(names)))
            curve = go.Scatter(x=at, y=errors["values"], text=names, name=kind, mode="lines+markers", **style)
            figure.add_trace(curve, row=j, col=k)
            figure.update_yaxes(
                title_text=f"{joint['name']}: {kind} [{errors['unit']}]", rangemode="tozero", row=j, col=k
            )
            if kind == "torque" and errors["floor"] is not None:
                floor = {"color": _colors()["quiet"], "width": 2, "dash": "dot"}
                level = go.Scatter(x=at, y=[errors["floor"]] * len(at), name="noise floor", mode="lines", line=floor)
                figure.add_trace(level, row=j, col=k)
    figure.update_xaxes(tickvals=list(range(len(names))), ticktext=names, row=len(joints))
    return figure.update_layout(template="plotly_white", showlegend=False, height=max(_JOINT * len(joints), 400))


def _panels(rows: int, heights: Sequence[float], height: int) -> go.Figure:
    """Plots one below the other over one time axis."""
    figure = make_subplots(rows, 1, shared_xaxes=True, row_heights=heights, vertical_spacing=0.2 / max(rows, 2))
    return figure.update_layout(template="plotly_white", height=max(height, 400), hovermode="x")


def _draw(figure: go.Figure, row: int, t: Sequence[float], curves: Mapping[str, Any], title: str) -> None:
    """Curves in a panel; each name stands in the legend once."""
    for name, values in curves.items():
        style = _CURVES[name]
        line = {**style, "color": _colors()[str(style["color"])]}
        known = any(trace.name == name for trace in figure.data)
        curve = go.Scatter(x=t, y=values, name=name, mode="lines", line=line, legendgroup=name, showlegend=not known)
        figure.add_trace(curve, row=row, col=1)
    figure.update_yaxes(title_text=title, row=row, col=1)


def _finished(figure: go.Figure, log: Mapping[str, Any]) -> go.Figure:
    since = f" − {log['start']}" if log["start"] else ""
    rows = len(list(figure.select_yaxes()))
    return figure.update_xaxes(title_text=f"t{since} [s]", row=rows, col=1).update_layout(title_text=log["name"])
