"""Evaluations in threads."""

from __future__ import annotations

import threading

import pytest

from idtool.common import threads
from idtool.common.threads import in_threads


@pytest.fixture(autouse=True)
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "process_count", lambda: 2)


@pytest.mark.parametrize("work", [0, 1e9])
def test_results_are_in_the_order_of_the_items(work: float) -> None:
    assert in_threads(lambda item: item**2, range(7), work) == [0, 1, 4, 9, 16, 25, 36]
    assert in_threads(lambda item: item**2, [], work) == []


@pytest.mark.parametrize(("work", "at_once"), [(0, False), (1e9, True)])
def test_only_much_work_is_shared(work: float, at_once: bool) -> None:
    """Two threads meet at a barrier; a single one waits there until it gives up."""
    barrier = threading.Barrier(2)

    def meets(item: int) -> bool:
        try:
            barrier.wait(timeout=10 if at_once else 0.01)
        except threading.BrokenBarrierError:
            return False
        return True

    assert in_threads(meets, range(2), work) == [at_once, at_once]


def test_an_error_is_raised_here() -> None:
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda item: 1 / item, [1, 0], 1e9)
