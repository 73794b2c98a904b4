"""Figures of results that must agree."""

from __future__ import annotations

from typing import Any

import pytest

_AMBIGUOUS = ("rpy", "witness")  # signs of axes, and the order of point masses, which rounding decides


def assert_same_figures(a: Any, b: Any, where: str = "", rel: float = 1e-9) -> None:
    """Plain data are equal but for rounding of numbers."""
    if isinstance(a, dict):
        assert a.keys() == b.keys(), where
        for key, value in a.items():
            if key not in _AMBIGUOUS:
                assert_same_figures(value, b[key], f"{where}.{key}", rel)
    elif isinstance(a, list):
        assert len(a) == len(b), where
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_same_figures(x, y, f"{where}[{i}]", rel)
    elif isinstance(a, float):
        assert a == pytest.approx(b, rel=rel, abs=1e-12), where
    else:
        assert a == b, where
