"""Numbers as text, and the rows of tables by unit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence


def rows_by_unit(units: Mapping[str, str]) -> list[tuple[str, list[str]]]:
    """Units, each with the joints that have it; ``overall`` is below them, or by itself if there are several."""
    groups: dict[str, list[str]] = {}
    for name, unit in units.items():
        groups.setdefault(unit, []).append(name)
    if len(groups) == 1:
        return [(unit, [*names, "overall"]) for unit, names in groups.items()]
    return [*groups.items(), (f"mixed {' and '.join(groups)}", ["overall"])]


def number(x: float | None, digits: int = 3) -> str:
    """A figure to so many digits; a dash for none."""
    if x is None or not math.isfinite(x):
        return "–"
    size = math.floor(math.log10(abs(x))) if x else 0
    return f"{x:.{max(digits - 1 - size, 0)}f}" if -5 < size < 6 else f"{x:.{digits - 1}e}"


def four_digits(x: float | None) -> str:
    """A figure to four digits; a dash for none."""
    return number(x, 4)


def with_error(x: float | None, error: float | None) -> tuple[str, str]:
    """A figure and its standard error, to two digits of the error."""
    if x is None:
        return "–", ""
    if error is None or not math.isfinite(error):
        return four_digits(x), "not determined"
    size = math.floor(math.log10(error)) if error else -9
    if not -9 < size < 6:
        return number(x, 4), number(error, 2)
    decimals = max(1 - size, 0)
    return f"{x:.{decimals}f}", f"{error:.{decimals}f}"


def metres(x: float) -> str:
    """A length to a tenth of a millimetre."""
    return f"{round(x, 4) + 0:.4f}" if abs(x) < 1000 else number(x)


def percent(x: float | None) -> str:
    """A share in percent."""
    return "–" if x is None else f"{number(100 * x, 2)} %"


def range_text(low: float | None, high: float | None) -> str:
    """Two ends to two digits of the distance between them; None: no end."""
    if low is None and high is None:
        return "any"
    if high is None:
        return f"{number(low, 2)} or more"
    if low is None:
        return f"{number(high, 2)} or less"
    width = high - low
    if abs(low + high) < 0.01 * width:
        return f"±{number(width / 2, 2)}"
    size = math.floor(math.log10(width)) if width > 0 else -9
    if not -5 < size < 6:
        return f"{number(low, 2)} to {number(high, 2)}"
    decimals = max(1 - size, 0)
    low_text, high_text = (f"{round(x, decimals) + 0.0:.{decimals}f}" for x in (low, high))
    return f"{low_text} to {high_text}"


def interval_text(ends: Sequence[float | None] | None) -> str:
    """An interval; a dash for none."""
    return "–" if ends is None else range_text(*ends)
