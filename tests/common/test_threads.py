"""Evaluations in threads."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest

from idtool.common import threads
from idtool.common.threads import BackgroundThread, Job, evaluated_ahead, in_threads


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


def test_threads_have_no_threads_of_their_own_and_later_calls_have() -> None:
    def names(item: int) -> tuple[str, set[str]]:
        inner_names = in_threads(lambda inner: threading.current_thread().name, range(8), 1e9)
        return threading.current_thread().name, set(inner_names)

    for outer, inner in in_threads(names, range(4), 1e9):
        assert inner == {outer}
    outer, inner = names(0)
    assert outer not in inner


def test_an_error_is_raised_here() -> None:
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda item: 1 / item, [1, 0], 1e9)


@pytest.mark.parametrize("processes", [1, 2])
def test_results_of_jobs_are_in_order_whatever_their_size(processes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "process_count", lambda: processes)
    sizes = [3, 100, 1, 0, 7, 100, 2] * 30
    jobs = [Job(size, lambda size=size, i=i: (i, size)) for i, size in enumerate(sizes)]  # type: ignore[misc]
    assert list(evaluated_ahead(jobs, 10)) == list(enumerate(sizes))


def test_jobs_are_begun_ahead_within_the_memory() -> None:
    begun: list[int] = []

    def jobs() -> Iterator[Job[int]]:
        for i in range(20):
            begun.append(i)
            yield Job(4, lambda i=i: i)  # type: ignore[misc]

    results = evaluated_ahead(jobs(), 10)
    assert next(results) == 0
    assert begun == [0, 1, 2]
    results.close()  # type: ignore[attr-defined]


@pytest.mark.parametrize("processes", [1, 2])
def test_errors_come_where_the_result_would_have_been(processes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "process_count", lambda: processes)

    def fail() -> int:
        raise ValueError("job")

    def jobs() -> Iterator[Job[int]]:
        yield Job(1, lambda: 0)
        yield Job(1, lambda: 1)
        raise KeyError("iterator")

    results = evaluated_ahead(jobs(), 100)
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(KeyError, match="iterator"):
        next(results)
    results = evaluated_ahead([Job(1, lambda: 0), Job(1, fail), Job(1, lambda: 2)], 100)
    assert next(results) == 0
    with pytest.raises(ValueError, match="job"):
        next(results)


def test_a_thread_ends_early_if_its_result_is_not_asked_for() -> None:
    has_begun = threading.Event()

    def wait(must_end: Callable[[], bool]) -> bool:
        has_begun.set()
        while not must_end():
            threading.Event().wait(0.001)
        return True

    with BackgroundThread(wait) as background:
        assert has_begun.wait(10)
    assert background.result()
