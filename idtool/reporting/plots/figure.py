"""`Figure`: a plotly figure without its theme, so that a page and a notebook draw the same one.

Traces and layout are plain dictionaries, as plotly.js takes them: plotly's own Python classes would add about 5 ms a
figure to a page of a hundred. Colours are names in `templates/style.css`, an opacity behind them where they have one,
such as "c1 0.18"; a page looks them up for light and dark, `Figure.to_plotly` takes the light ones.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.reporting.plots.sampling import round_significant

if TYPE_CHECKING:
    from plotly.graph_objects import Figure as PlotlyFigure

PlotlyTrace = dict[str, Any]
Values = Sequence[float | None]

TALL, MEDIUM, SHORT = 484, 364, 264  # px, of which 32 are for the toolbar
_STACKED = 300  # px, of a figure among others
_COLORS = 8  # c0 to c7 in style.css
_DASHES = ("solid", "dash", "dot")  # of curves beyond the number of colours
_BAND_OPACITY = 0.18
_GAP = 0.07  # between panels, of the height
_MAX_MARKERS = 40  # points of a curve with markers
_X_DIGITS = 8
_LATE_TIME = 1e4  # s: later times are drawn as time since the first whole second


@dataclass(frozen=True)
class Figure:
    """A plotly figure without its theme.

    Attributes
    ----------
    caption
        Title above it; text.
    description
        Content in words, for readers who cannot see it.
    data, layout
        Traces and layout, with names of colours.
    """

    caption: str
    description: str
    data: list[PlotlyTrace]
    layout: dict[str, Any]

    @property
    def legend(self) -> list[tuple[str, str, str]]:
        """Name, colour and dash of each named curve, once."""
        curves = [trace for trace in self.data if "name" in trace]
        lines = {trace["name"]: trace["line"] for trace in reversed(curves)}
        return [(name, line["color"], line.get("dash", "solid")) for name, line in reversed(lines.items())]

    def to_plotly(self) -> PlotlyFigure:
        """Plotly's own figure, in the colours of a page on white."""
        import plotly.graph_objects as go

        data, layout = _with_colors(self.data), _with_colors(self.layout)
        return go.Figure(data, {**layout, "template": "plotly_white"})


@dataclass(frozen=True)
class FigureGroup:
    """Figures under one heading that a page can fold away, such as those of one log."""

    title: str
    figures: list[Figure]

    def to_plotly(self) -> PlotlyFigure:
        """One plotly figure with all figures, one below the other."""
        return stack_figures(self.figures, self.title).to_plotly()


@dataclass(frozen=True)
class Panel:
    """A y axis and its curves.

    Attributes
    ----------
    title
        Of the axis, with unit.
    curves
        Traces, see `curve`, `styled_curve` and `banded_curve`.
    log
        Whether the axis is logarithmic.
    level
        Value at which a dotted line is drawn across, or None.
    domain
        Lower and upper end, as shares of the figure's height; None: panels share it evenly.
    axis
        Further settings of the axis.
    """

    title: str
    curves: Iterable[PlotlyTrace]
    log: bool = False
    level: float | None = None
    domain: tuple[float, float] | None = None
    axis: Mapping[str, Any] = field(default_factory=dict)


def curve(
    name: str, x: Values, y: Values, color: str, width: float = 2, dash: str = "solid", **more: Any
) -> PlotlyTrace:
    """A line; None breaks it."""
    line: dict[str, Any] = {"color": color, "width": width}
    if dash != "solid":
        line["dash"] = dash
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": x,
        "y": y,
        "line": line,
        "hoverinfo": "x+y+name",
    } | more


def styled_curve(name: str, x: Values, y: Iterable[float | None], index: int) -> PlotlyTrace:
    """A curve in the colour and dash of its index, marked where it has few points."""
    color, dash = _style(index)
    more: dict[str, Any] = {} if len(x) > _MAX_MARKERS else {"mode": "lines+markers", "marker": {"size": 5}}
    return curve(name, round_significant(x, _X_DIGITS), round_significant(y), color, dash=dash, **more)


def banded_curve(
    name: str,
    x: Values,
    y: Iterable[float | None],
    lower: Iterable[float | None],
    upper: Iterable[float | None],
    index: int,
) -> list[PlotlyTrace]:
    """`styled_curve` with a band between lower and upper values."""
    color, _ = _style(index)
    edge: PlotlyTrace = {"type": "scatter", "mode": "lines", "x": round_significant(x, _X_DIGITS), "line": {"width": 0}}
    edge |= {"hoverinfo": "skip", "showlegend": False}
    below = {**edge, "y": round_significant(lower)}
    above = {**edge, "y": round_significant(upper), "fill": "tonexty", "fillcolor": f"{color} {_BAND_OPACITY}"}
    return [below, above, styled_curve(name, x, y, index)]


def _style(index: int) -> tuple[str, str]:
    return f"c{index % _COLORS}", _DASHES[index // _COLORS % len(_DASHES)]


def figure(
    caption: str,
    x_title: str,
    panels: Sequence[Panel],
    description: str | None = None,
    height: int | None = None,
    hovermode: str = "closest",
    x_log: bool = False,
    x_axis: Mapping[str, Any] | None = None,
) -> Figure:
    """A figure of panels one below the other over one x axis.

    Parameters
    ----------
    caption, description
        See `Figure`; by default the description is made of caption and axes.
    x_title
        Title of the x axis, with unit.
    panels
        From top to bottom, unless they have their own ``domain``.
    height
        In px; by default by the number of panels.
    hovermode
        Plotly's ``hovermode``: ``closest``, or ``x`` for all curves at one x.
    x_log
        Whether the x axis is logarithmic.
    x_axis
        Further settings of the x axis.
    """
    domains = [panel.domain or _even_domain(i, len(panels)) for i, panel in enumerate(panels)]
    lowest = min(range(len(panels)), key=lambda i: domains[i][0])
    x: dict[str, Any] = {"title": {"text": x_title}, "anchor": _axis("y", lowest)}
    if x_log:
        x["type"] = "log"
    layout: dict[str, Any] = {
        "height": height or (TALL if len(panels) > 1 else MEDIUM),
        "hovermode": hovermode,
        "hoverlabel": {"namelength": -1},
        "showlegend": False,
        "xaxis": x | dict(x_axis or {}),
    }
    data: list[PlotlyTrace] = []
    shapes = []
    for i, panel in enumerate(panels):
        y: dict[str, Any] = {"domain": list(domains[i]), "title": {"text": panel.title}}
        if panel.log:
            y |= {"type": "log", "exponentformat": "power"}
        layout[_axis("yaxis", i)] = y | dict(panel.axis)
        for trace in panel.curves:
            placed = {**trace, "y": _positive(trace["y"]) if panel.log else trace["y"]}
            if i:
                placed["yaxis"] = _axis("y", i)
            data.append(placed)
        if panel.level is not None:
            line = {"color": "quiet", "width": 1, "dash": "dot"}
            ends = {"x0": 0, "x1": 1, "y0": panel.level, "y1": panel.level}
            shapes.append({"type": "line", "xref": "paper", "yref": _axis("y", i), **ends, "line": line})
    if shapes:
        layout["shapes"] = shapes
    titles = ", ".join(panel.title for panel in panels)
    return Figure(caption, description or f"{caption}: {titles} against {x_title}", data, layout)


def _even_domain(i: int, count: int) -> tuple[float, float]:
    """Lower and upper end of a panel."""
    height = (1 - _GAP * (count - 1)) / count
    top = 1 - i * (height + _GAP)
    return max(top - height, 0.0), top


def _axis(name: str, i: int) -> str:
    """Plotly's name of an axis, such as y, y2, y3."""
    return f"{name}{i + 1}" if i else name


def _positive(values: Values) -> Values:
    """Values that a logarithmic axis can show."""
    return [value if value is not None and value > 0 else None for value in values]


def time_axis(t: Array) -> tuple[list[float], str]:
    """Times, shape (T,), to draw, and the title of their axis: late ones count from the first whole second [s]."""
    start = math.floor(t[0]) if len(t) and abs(t[0]) > _LATE_TIME else 0
    return (t - start).tolist(), time_title(start)


def time_title(start: int) -> str:
    """Title of an axis of times since ``start`` [s]."""
    return f"t − {start} [s]" if start else "t [s]"


def stack_figures(figures: Sequence[Figure], title: str = "") -> Figure:
    """Figures one below the other as one, with a legend; captions stand at their first y axes.

    Parameters
    ----------
    figures
        Each with as many y axes.
    title
        Of the whole.
    """
    count = max(len(figures), 1)
    share, gap = 1 / count, 0.2 / count
    layout: dict[str, Any] = {"height": max(_STACKED * count, 400), "showlegend": True, "title": {"text": title}}
    data: list[PlotlyTrace] = []
    legend_names: set[str] = set()
    rows = 0
    for k, figure in enumerate(figures):
        gap_below = gap if k + 1 < count else 0
        bottom = 1 - (k + 1) * share + gap_below
        height = share - gap_below
        axes = [name for name in figure.layout if name.startswith("yaxis")]
        new_y = {_axis("y", i): _axis("y", rows + i) for i in range(len(axes))}
        new_x = _axis("x", k)
        x = figure.layout["xaxis"]
        x_axis = {**x, "anchor": new_y[x["anchor"]]}
        if k:
            x_axis["matches"] = "x"
        layout[_axis("xaxis", k)] = x_axis
        for i, name in enumerate(axes):
            axis = figure.layout[name]
            text = axis["title"]["text"]
            layout[_axis("yaxis", rows + i)] = {
                **axis,
                "domain": [bottom + height * end for end in axis["domain"]],
                "title": {"text": text if i else f"{figure.caption}: {text}"},
                "anchor": new_x,
            }
        for trace in figure.data:
            placed = {**trace, "xaxis": new_x, "yaxis": new_y[trace.get("yaxis", "y")], "visible": True}
            if "name" in trace:
                curve_name = trace["name"]
                placed |= {"legendgroup": curve_name, "showlegend": curve_name not in legend_names}
                legend_names.add(curve_name)
            data.append(placed)
        for name in ("hovermode", "hoverlabel"):
            layout[name] = figure.layout[name]
        rows += len(axes)
    return Figure(title, title, data, layout)


@cache
def _light_colors() -> dict[str, str]:
    """The pages' colours on white, by name."""
    style = files("idtool.reporting").joinpath("templates/style.css").read_text(encoding="utf-8")
    light, _, _ = style.partition("@media")
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", light))


def _light_color(color: str) -> str:
    """A colour on white, by its name and opacity."""
    name, _, opacity = color.partition(" ")
    rgb = _light_colors()[name]
    if not opacity:
        return rgb
    red, green, blue = (int(rgb[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red}, {green}, {blue}, {opacity})"


def _with_colors(part: Any) -> Any:
    """A copy of a part of a figure with colours in place of their names."""
    if isinstance(part, dict):
        return {
            key: _light_color(value) if key.endswith("color") else _with_colors(value) for key, value in part.items()
        }
    if isinstance(part, list) and part and isinstance(part[0], dict):
        return [_with_colors(inner) for inner in part]
    return part
