"""Logs are prepared in threads, with the same result as one after the other."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from paths import SAMPLES

from idtool.common import threads
from idtool.common.exceptions import LogError
from idtool.data.logs import JointLog, make_log, read_log
from idtool.data.signals import Signals
from idtool.estimation.dataset import experiment
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.robot.config import read_config
from idtool.robot.urdf.reading import read_robot

URDF = SAMPLES / "leg.urdf"


def set_process_count(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    for module in (threads, experiment):
        monkeypatch.setattr(module, "process_count", lambda: count)


@pytest.fixture(autouse=True)
def as_many_processes_as_logs(monkeypatch: pytest.MonkeyPatch) -> None:
    set_process_count(monkeypatch, 3)


@pytest.fixture
def used_threads(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Names of the threads in which logs are prepared."""
    used = set()

    def signals_of(*arguments: object) -> Signals:
        used.add(threading.current_thread().name)
        return original(*arguments)  # type: ignore[arg-type]

    original = experiment.signals_of
    monkeypatch.setattr(experiment, "signals_of", signals_of)
    return used


def parts_of_the_sample_log() -> list[JointLog]:
    """Three stretches of different lengths; the velocity of the second lags."""
    whole = read_log(SAMPLES / "leg_train.mcap")
    parts = []
    for name, count in (("a.csv", 3000), ("b.csv", 4000), ("c.csv", 2500)):
        signals = {key: values[:count] for key, values in whole.signals.items()}
        if name == "b.csv":
            signals["v"] = np.roll(signals["v"], 12, axis=0)
        parts.append(make_log(Path(name), whole.t[:count], whole.joints, signals))
    return parts


def prepared(logs: list[JointLog]) -> Experiment:
    return prepare(read_robot(URDF), read_config(SAMPLES / "leg.yaml"), logs)


def test_threads_change_nothing(monkeypatch: pytest.MonkeyPatch, used_threads: set[str]) -> None:
    logs = parts_of_the_sample_log()
    alone = prepared(logs)
    assert used_threads == {threading.current_thread().name}
    used_threads.clear()
    monkeypatch.setattr(threads, "_LEAST_WORK", 1)
    together = prepared(logs)
    assert threading.current_thread().name not in used_threads
    assert [run.signals.log.path.name for run in together.runs] == ["a.csv", "b.csv", "c.csv"]
    delayed, others = together.runs[1], together.runs[::2]
    for other in others:
        delay = delayed.signals.channels.lag - other.signals.channels.lag
        np.testing.assert_allclose(delay, 12e-3, atol=1e-5)
    for own, expected in zip(together.runs, alone.runs, strict=True):
        assert (own.train, own.held_out) == (expected.train, expected.held_out)
        np.testing.assert_array_equal(own.signals.channels.lag, expected.signals.channels.lag)


def test_fewer_logs_than_processes_are_prepared_one_after_the_other(
    monkeypatch: pytest.MonkeyPatch, used_threads: set[str]
) -> None:
    monkeypatch.setattr(threads, "_LEAST_WORK", 1)
    set_process_count(monkeypatch, 4)
    prepared(parts_of_the_sample_log())
    assert used_threads == {threading.current_thread().name}


def test_the_first_of_two_logs_that_cannot_be_used_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "_LEAST_WORK", 1)
    good, second, third = parts_of_the_sample_log()
    short = [replace(log, t=log.t[:20], signals={k: x[:20] for k, x in log.signals.items()}) for log in (second, third)]
    with pytest.raises(LogError, match=r"b\.csv"):
        prepared([good, *short])
