"""Figures as text, rows of tables, and advice on warnings."""

from __future__ import annotations

import math

import pytest

from idtool.common.number_text import number, with_error
from idtool.reporting.number_text import metres, percent, rows_by_unit


@pytest.mark.parametrize(
    ("x", "digits", "text"),
    [(0.108512, 3, "0.109"), (13.0461, 4, "13.05"), (12345.6, 3, "12346"), (1.2345e-7, 3, "1.23e-07"), (0.0, 3, "0.00"),
     (-2e7, 2, "-2.0e+07"), (None, 3, "–"), (math.nan, 3, "–")],
)  # fmt: skip
def test_figures_have_sensible_digits(x: float | None, digits: int, text: str) -> None:
    assert number(x, digits) == text


@pytest.mark.parametrize(
    ("x", "error", "text"),
    [(3.10606, 0.0067001, ("3.1061", "0.0067")), (1234.5, 21.0, ("1234", "21")), (None, None, ("–", "")),
     (0.5217, None, ("0.522", "not determined")), (0.5, 0.0, ("0.500", "0.0"))],
)  # fmt: skip
def test_figures_have_the_digits_of_their_error(x: float | None, error: float | None, text: tuple[str, str]) -> None:
    assert with_error(x, error) == text


def test_lengths_and_shares() -> None:
    assert [metres(x) for x in (-1e-9, 0.12346, 1e6)] == ["0.0000", "0.1235", "1.00e+06"]
    assert [percent(x) for x in (0.0213, None)] == ["2.1 %", "–"]


def test_joints_of_one_kind_share_a_table() -> None:
    assert rows_by_unit({"a": "N·m", "b": "N·m"}) == [("N·m", ["a", "b", "overall"])]
    assert [names for _, names in rows_by_unit({"a": "N·m", "b": "N", "c": "N·m"})] == [["a", "c"], ["b"], ["overall"]]
