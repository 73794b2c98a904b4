"""Line charts as plain data, which `templates/lines.js` draws: panels over one x axis, a curve a name."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array

_COLORS = 8  # c0 to c7 in style.css
_DASHES = ("solid", "dash", "dot")  # of curves beyond the number of colours
_DIGITS = 4
_LATE = 1e4  # s: later times are drawn as time since the first whole second


def line(
    name: str,
    y: Iterable[float | None],
    index: int,
    band: tuple[Iterable[float | None], Iterable[float | None]] | None = None,
) -> dict[str, Any]:
    """A curve.

    Parameters
    ----------
    name
        What it shows.
    y
        Its values; None and what is not finite break it.
    index
        Of its colour and dash.
    band
        Lower and upper values around it.
    """
    style = {"color": f"c{index % _COLORS}", "dash": _DASHES[index // _COLORS % len(_DASHES)]}
    drawn = {"name": name, "y": significant(y), **style}
    return drawn if band is None else {**drawn, "lower": significant(band[0]), "upper": significant(band[1])}


def panel(title: str, lines: Iterable[dict[str, Any]], log: bool = False, level: float | None = None) -> dict[str, Any]:
    """A y axis with its title, its curves and, where given, a level to compare them with."""
    return {"title": title, "log": log, "level": level, "lines": list(lines)}


def chart(
    caption: str, x: Iterable[float | None], title: str, panels: Iterable[dict[str, Any]], log: bool = False
) -> dict[str, Any]:
    """A chart: panels one below the other over the same x."""
    return {"caption": caption, "x": {"values": significant(x, 8), "title": title, "log": log}, "panels": list(panels)}


def over_time(caption: str, t: Array, panels: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """A chart over times t [s], shape (T,)."""
    start = math.floor(t[0]) if len(t) and abs(t[0]) > _LATE else 0
    return chart(caption, (t - start).tolist(), f"t − {start} [s]" if start else "t [s]", panels)


def significant(x: Iterable[float | None], digits: int = _DIGITS) -> list[float | None]:
    """Values to so many digits each, as a logarithmic axis needs them; None for what is not finite."""
    return [None if v is None or not math.isfinite(v) else float(f"{v:.{digits}g}") for v in x]


def thinned(count: int, most: int) -> NDArray[np.int64]:
    """Indices of at most about ``most`` of so many values, evenly spread, the last among them."""
    step = max(math.ceil(count / max(most, 1)), 1)
    return np.arange(count - 1, -1, -step)[::-1] if count else np.arange(0)


def numbers(values: Sequence[float | None]) -> Array:
    """Values as an array, shape (n,), with NaN for None."""
    return np.array([math.nan if v is None else v for v in values], dtype=float)
