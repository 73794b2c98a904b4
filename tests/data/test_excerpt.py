"""Excerpts of logs: windows of samples as logged, spread evenly, without gaps within."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from paths import SAMPLES

from idtool.data.excerpt import duration_of, excerpt_of, seconds_that_fit
from idtool.data.inspection.clock import gaps
from idtool.data.logs import JointLog, make_log, read_log
from idtool.data.logs.log import Channel


@pytest.fixture(scope="module")
def log() -> JointLog:
    return read_log(SAMPLES / "leg_train.mcap")


def test_windows_are_spread_evenly(log: JointLog) -> None:
    excerpt = excerpt_of(log, 3.0, 0.5)
    starts = np.array([excerpt.t[part.start] for part in excerpt.segments])
    assert [part.stop - part.start for part in excerpt.segments] == [500] * 6
    np.testing.assert_allclose(np.diff(starts), (log.t[-1] - log.t[0]) / 6, atol=2e-3)
    assert duration_of(excerpt) == pytest.approx(3.0, abs=1e-3)


def test_samples_are_those_of_the_log(log: JointLog) -> None:
    excerpt = excerpt_of(log, 3.0, 0.5)
    places = np.searchsorted(log.t, excerpt.t)
    np.testing.assert_array_equal(log.t[places], excerpt.t)
    for name, values in log.signals.items():
        np.testing.assert_array_equal(excerpt.signals[name], values[places])
    for part in excerpt.segments:
        assert np.diff(places[part]).tolist() == [1] * (part.stop - part.start - 1)


def test_a_short_log_is_kept_whole(log: JointLog) -> None:
    excerpt = excerpt_of(log, 11.0, 5.0)
    np.testing.assert_array_equal(excerpt.t, log.t)
    assert excerpt.segments == log.segments


def test_there_is_a_window_of_any_log(log: JointLog) -> None:
    assert duration_of(excerpt_of(log, 0.01, 2.0)) == pytest.approx(2.0, abs=1e-3)


def test_of_many_segments_only_some_are_taken() -> None:
    t = np.arange(10_000) * 1e-3 + np.repeat(np.arange(100), 100)  # a gap after every 0.1 s
    log = make_log(Path("log"), t, ("hip",), {"q": np.sin(t)[:, None]})
    assert len(log.segments) == 100
    assert duration_of(excerpt_of(log, 2.0, 1.0)) == pytest.approx(2.0, abs=0.2)


def test_channels_reach_beyond_the_windows(log: JointLog) -> None:
    times = np.arange(0.0, 10.0, 0.01)
    with_force = replace(log, channels={"force_tool_fx": Channel(times, np.sin(times))})
    excerpt = excerpt_of(with_force, 2.0, 0.5)
    channel = excerpt.channels["force_tool_fx"]
    assert len(channel.t) < 0.7 * len(times)
    np.testing.assert_array_equal(channel.at(excerpt.t), with_force.channels["force_tool_fx"].at(excerpt.t))


def test_time_between_the_windows_is_not_lost(log: JointLog) -> None:
    assert gaps(excerpt_of(log, 3.0, 0.5)) == ()


def test_memory_of_a_time(log: JointLog) -> None:
    arrays = [log.t, *log.signals.values()]
    assert seconds_that_fit(log, sum(array.nbytes for array in arrays)) == pytest.approx(len(log) * log.dt)


def test_a_flag_keeps_its_value_however_long_ago_it_was_set(log: JointLog) -> None:
    """It is published when it changes."""
    flag = Channel(np.array([0.0, 0.01, 4.0, 9.9]), np.array([0.0, 1.0, 0.0, 1.0]))
    silent = Channel(np.zeros(0), np.zeros(0))
    with_flag = replace(log, channels={"contact_foot": flag, "contact_other": silent})
    excerpt = excerpt_of(with_flag, 2.0, 0.5)
    kept = excerpt.channels["contact_foot"]
    np.testing.assert_array_equal(kept.is_set(excerpt.t), flag.is_set(excerpt.t))
    assert len(excerpt.channels["contact_other"].t) == 0


def test_gaps_of_a_log_that_is_kept_whole_are_seen() -> None:
    t = np.concatenate([np.arange(3000) * 1e-3, 50 + np.arange(3000) * 1e-3])
    whole = make_log(Path("log"), t, ("hip",), {"q": np.sin(t)[:, None]})
    assert len(gaps(excerpt_of(whole, 1000.0, 2.0))) == 1
