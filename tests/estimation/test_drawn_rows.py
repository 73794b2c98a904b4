"""Rows drawn at random: draws of parts are merged into the draw of all, in which every sample is as likely."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from idtool.common.provenance import InputFile
from idtool.data.logs.log import make_log
from idtool.estimation.dataset.drawn_rows import DrawnRows, log_identity, merged_draws, row_keys, uniform_draw

ACTIVE = (np.arange(2), np.arange(1))


def drawn(name: str, first: int, count: int, limit: int) -> DrawnRows:
    """A draw of rows of which each holds nothing but its number."""
    numbers = np.arange(first, first + count, dtype=float)
    rows = [np.tile(numbers, (len(columns) + 1, 1)) for columns in ACTIVE]
    keys = row_keys(name, first, count)
    return DrawnRows.empty(ACTIVE).with_rows(rows, [np.ones(count), np.ones(count)], 0.5, keys, limit)


def numbers_of(draw: DrawnRows) -> list[float]:
    """Numbers of the rows, the same for all joints."""
    for own in draw.rows:
        np.testing.assert_array_equal(own, np.tile(draw.rows[0][0], (len(own), 1)))
    return sorted(draw.rows[0][0].tolist())


@given(st.lists(st.integers(0, 30), min_size=1, max_size=8), st.integers(0, 40))
def test_a_draw_of_parts_is_that_of_the_whole(sizes: list[int], limit: int) -> None:
    """Row by row into one draw, or merged from draws of the parts."""
    whole = drawn("log", 0, sum(sizes), limit)
    parts, merged, first = [], DrawnRows.empty(ACTIVE), 0
    for size in sizes:
        part = drawn("log", first, size, limit)
        parts.append(part)
        keys = row_keys("log", first, size)
        all_rows = drawn("log", first, size, size)
        order = np.argsort(np.argsort(keys))
        merged = merged.with_rows([own[:, order] for own in all_rows.rows], [np.ones(size)] * 2, 0.5, keys, limit)
        first += size
    for other in (merged_draws(parts, limit), merged):
        assert numbers_of(other) == numbers_of(whole)
        assert other.drawn_from == whole.drawn_from == sum(sizes)
        np.testing.assert_array_equal(other.keys, whole.keys)
        assert other.are_all is (sum(sizes) <= limit)


def test_keys_do_not_depend_on_the_part_that_is_read() -> None:
    whole = row_keys("run1.mcap", 0, 100)
    np.testing.assert_array_equal(row_keys("run1.mcap", 37, 63), whole[37:])
    assert not (whole == row_keys("run2.mcap", 0, 100)).any()


def test_logs_of_one_name_have_other_keys() -> None:
    t = np.arange(3.0)
    a, b, c = (make_log(Path(folder, "run.csv"), t, ("hip",), {"q": t[:, None]}) for folder in "abc")
    a = replace(a, sources=(InputFile("log", "a/run.csv", "12"),))
    b = replace(b, sources=(InputFile("log", "b/run.csv", "34"),))
    assert len({log_identity(log) for log in (a, b, c)}) == 3
    assert log_identity(a) == log_identity(replace(a, path=Path("elsewhere/run.csv")))


def test_every_sample_is_as_likely_in_logs_of_different_length() -> None:
    """Though as many rows are kept of a short log as of a long one."""
    lengths = (1000, 150, 20)
    counts = np.zeros(3)
    for repeat in range(300):
        draws = [drawn(f"{repeat} {length}", 0, length, 60) for length in lengths]
        draw = uniform_draw(draws, 50)
        assert len(draw) <= 50
        assert draw.drawn_from == sum(lengths)
        keys = [set(own.keys.tolist()) for own in draws]
        counts += [len(own & set(draw.keys.tolist())) for own in keys]
    shares = counts / counts.sum()
    np.testing.assert_allclose(shares, np.array(lengths) / sum(lengths), atol=4 * np.sqrt(0.25 / counts.sum()))


def test_the_limit_holds_for_all_logs_together() -> None:
    draws = [drawn(f"run{i}", 0, 30, 60) for i in range(4)]
    assert uniform_draw(draws, 1000).are_all
    assert len(uniform_draw(draws, 100)) == 100


@pytest.mark.parametrize("limit", [0, 5])
def test_no_rows(limit: int) -> None:
    draw = merged_draws([DrawnRows.empty(ACTIVE), DrawnRows.empty(ACTIVE)], limit)
    assert (len(draw), draw.are_all) == (0, True)
