"""Figures as text."""

from __future__ import annotations

import pytest

from idtool.common.number_text import number, short_number


@pytest.mark.parametrize(
    ("x", "digits", "text", "short"),
    [
        (160.4, 2, "160", "160"),
        (0.0032, 2, "0.0032", "0.0032"),
        (1234.5, 3, "1234", "1234"),
        (200.0, 3, "200", "200"),
        (1.5, 3, "1.50", "1.5"),
        (-1.0, 3, "-1.00", "-1"),
        (0.0, 3, "0.00", "0"),
        (2.5e-9, 2, "2.5e-09", "2.5e-09"),
        (float("nan"), 3, "–", "–"),
        (None, 3, "–", "–"),
    ],
)
def test_figures_have_no_exponent_where_decimals_do(x: float | None, digits: int, text: str, short: str) -> None:
    assert number(x, digits) == text
    assert short_number(x, digits) == short
