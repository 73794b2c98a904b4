"""Numbers of reports as text, and the rows of tables by unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from idtool.common.number_text import number, range_text


def rows_by_unit(units: Mapping[str, str]) -> list[tuple[str, list[str]]]:
    """Units, each with the joints that have it; ``overall`` is below them, or by itself if there are several."""
    groups: dict[str, list[str]] = {}
    for name, unit in units.items():
        groups.setdefault(unit, []).append(name)
    if len(groups) == 1:
        return [(unit, [*names, "overall"]) for unit, names in groups.items()]
    return [*groups.items(), (f"mixed {' and '.join(groups)}", ["overall"])]


def metres(x: float) -> str:
    """A length to a tenth of a millimetre."""
    return f"{round(x, 4) + 0:.4f}" if abs(x) < 1000 else number(x)


def percent(x: float | None) -> str:
    """A share in percent."""
    return "–" if x is None else f"{number(100 * x, 2)} %"


def interval_text(ends: Sequence[float | None] | None) -> str:
    """An interval; a dash for none."""
    return "–" if ends is None else range_text(*ends)
