"""Figures as a page holds them: for JSON, with equal arrays stored once."""

from __future__ import annotations

from typing import Any

from idtool.reporting.plots.figure import Figure

_ARRAYS = ("x", "y", "text")  # of traces


class EmbeddedFigures:
    """The figures of a page, in the order in which its templates place them."""

    def __init__(self) -> None:
        self._arrays: dict[tuple[Any, ...], int] = {}
        self._figures: list[dict[str, Any]] = []

    def add(self, figure: Figure) -> int:
        """Embed a figure; its index, which `templates/figures.js` draws it by."""
        data = [{key: self._embed_value(key, value) for key, value in trace.items()} for trace in figure.data]
        self._figures.append({"data": data, "layout": figure.layout})
        return len(self._figures) - 1

    def _embed_value(self, key: str, value: Any) -> Any:
        """A trace's attribute; for an array, its index among all arrays."""
        if key not in _ARRAYS:
            return value
        return self._arrays.setdefault(tuple(value), len(self._arrays))

    def to_json(self) -> dict[str, Any]:
        """``figures``, each with traces whose ``x``, ``y`` and ``text`` are indices into ``arrays``."""
        return {"figures": self._figures, "arrays": list(self._arrays)}
