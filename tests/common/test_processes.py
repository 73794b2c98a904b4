"""Evaluations in copies of this process."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from idtool.common import processes
from idtool.common.exceptions import ConfigError
from idtool.common.processes import Background, in_processes, interleaved_shares, limit_processes, process_count

Progress = Callable[[str, float], None]


def silent(stage: str, share: float) -> None:
    """Show nothing."""


@pytest.fixture(params=[1, 2])
def cores(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """Number of processes that can work at once, outside copies."""
    here = os.getpid()
    monkeypatch.setattr(processes, "process_count", lambda: request.param if os.getpid() == here else 1)
    return int(request.param)


def test_results_are_in_the_order_of_the_items(cores: int) -> None:
    def square(item: int, progress: Progress) -> int:
        return item**2

    assert in_processes(square, range(5), silent) == [0, 1, 4, 9, 16]
    assert in_processes(square, [], silent) == []


def test_only_the_first_item_is_evaluated_here_if_there_are_cores(cores: int) -> None:
    def where(item: str, progress: Progress) -> bool:
        return os.getpid() == here

    here = os.getpid()
    assert in_processes(where, ["first", "second"], silent) == [True, cores == 1]


def test_arrays_of_a_copy_arrive_and_can_be_changed(cores: int) -> None:
    """They are sent beside what is pickled, in any order of memory; empty ones and parts of others too."""
    table = np.arange(12.0).reshape(3, 4)
    arrays = [table, table.T, table[:, 1:], np.zeros((0, 5)), np.array([True, False]), np.array(3.0)]

    def twice(item: int, progress: Progress) -> dict[str, list[np.ndarray[Any, Any]]]:
        return {"arrays": [array.copy("K") for array in arrays]}

    for result in in_processes(twice, range(2), silent):
        for array, expected in zip(result["arrays"], arrays, strict=True):
            np.testing.assert_array_equal(array, expected)
            array += array
            assert array.dtype == expected.dtype


def test_a_copy_shows_no_progress(cores: int) -> None:
    def tell(item: str, progress: Progress) -> None:
        progress(item, 0.5)

    told: list[str] = []
    in_processes(tell, ["first", "second"], lambda stage, share: told.append(stage))
    assert told == (["first", "second"] if cores == 1 else ["first"])


def test_a_failure_in_a_copy_is_raised_here(cores: int) -> None:
    def divide(item: int, progress: Progress) -> float:
        return 1 / item

    with pytest.raises(ZeroDivisionError):
        in_processes(divide, [1, 0], silent)


@pytest.mark.parametrize("end", [lambda: os._exit(3), lambda: os.kill(os.getpid(), signal.SIGKILL)])
def test_what_a_copy_could_not_finish_is_evaluated_here(cores: int, end: Callable[[], None]) -> None:
    def evaluate(progress: Progress) -> str:
        if os.getpid() != here:
            end()
        return "done"

    here = os.getpid()
    with Background(evaluate) as background:
        assert background.result(silent) == "done"


def test_a_result_that_cannot_be_sent_is_evaluated_here(cores: int) -> None:
    def evaluate(progress: Progress) -> Any:
        return threading.Lock()

    with Background(evaluate) as background:
        assert background.result(silent) is not None


def test_no_copy_is_left_behind(cores: int) -> None:
    def evaluate(progress: Progress) -> None:
        time.sleep(60)

    started = time.monotonic()
    with Background(evaluate) as background:
        copy = background._process
    assert copy is None or not copy.is_alive()
    assert time.monotonic() - started < 30


def test_ctrl_c_ends_the_copies_with_the_first_process() -> None:
    def interrupt_or_wait(item: str, progress: Progress) -> None:
        if item == "first":
            raise KeyboardInterrupt
        time.sleep(60)

    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        in_processes(interrupt_or_wait, ["first", "second"], silent)
    assert time.monotonic() - started < 30


def test_a_copy_does_not_copy_itself() -> None:
    def count(item: str, progress: Progress) -> int:
        return process_count()

    here, in_copy = in_processes(count, ["first", "second"], silent)
    assert in_copy == 1 or here == 1


@pytest.mark.skipif(process_count() == 1, reason="there are no copies on a single processor core")
def test_a_copy_ends_when_the_first_process_is_killed() -> None:
    script = """
import os, time
from idtool.common.processes import Background

def work(progress):
    time.sleep(60)

with Background(work) as background:
    print(background._process.pid, flush=True)
    os.kill(os.getpid(), 9)
"""
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=30, check=False)
    assert result.returncode == -signal.SIGKILL
    copy = Path(f"/proc/{int(result.stdout)}/stat")
    deadline = time.monotonic() + 10
    while copy.exists() and copy.read_text().split()[2] != "Z":  # a zombie has ended
        assert time.monotonic() < deadline, "the copy goes on"
        time.sleep(0.05)


def test_an_error_of_idtool_can_be_sent_between_processes() -> None:
    error = ConfigError("robot.yaml", "unknown key")
    received = pickle.loads(pickle.dumps(error))  # noqa: S301  # our own
    assert type(received) is ConfigError
    assert str(received) == str(error)


@pytest.mark.parametrize(("count", "shares"), [(0, []), (1, [[0]]), (5, [[0, 2, 4], [1, 3]])])
def test_shares_are_interleaved(monkeypatch: pytest.MonkeyPatch, count: int, shares: list[list[int]]) -> None:
    monkeypatch.setattr(processes, "process_count", lambda: 2)
    assert [list(share) for share in interleaved_shares(count)] == shares


def test_the_number_of_processes_can_be_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """But not beyond the processor cores."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1, 2})
    for limit, count in ((1, 1), (2, 2), (8, 3), (None, 3)):
        limit_processes(limit)
        assert process_count() == count
