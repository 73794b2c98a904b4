"""From log to motion: derivatives, batches, gaps, ends, memory, and logs that cannot be used."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sentences import sentences
from swings import RATE, clock, everything, filtered, joined, signals_of, swing, swinging

from idtool.common.exceptions import ConfigError, LogError
from idtool.data import signals as module
from idtool.data.logs.log import JointLog

Array = NDArray[np.float64]

PD = {"kp": {"hip": 20.0, "knee": 30.0}, "kd": {"hip": 1.0, "knee": 0.5}, "delay": 0.0034}


def late(t: Array) -> JointLog:
    return swinging(t, v=swing(t - 0.0025, 1))


def jittering(t: Array) -> JointLog:
    stamps = t + np.random.default_rng(0).uniform(-2e-4, 2e-4, len(t))
    return swinging(stamps)


def commanded(t: Array) -> JointLog:
    return swinging(t, tau=None, v=None, qcmd=swing(t + 0.01))


LOGS: dict[str, tuple[Callable[[Array], JointLog], dict[str, Any]]] = {
    "measured": (swinging, {"velocity": "measured"}),
    "differentiated": (swinging, {"velocity": "differentiated"}),
    "late velocity": (late, {"velocity": "measured"}),
    "jittering stamps": (jittering, {}),
    "commanded": (commanded, {"controller": PD}),
}


@pytest.mark.parametrize("velocity", ["measured", "differentiated"])
def test_the_derivatives_of_sines_are_their_derivatives(velocity: str) -> None:
    signals = signals_of(swinging(clock(4)), velocity=velocity)
    t = joined(signals, lambda m: m.t)
    for derivative, of in enumerate((lambda m: m.q, lambda m: m.v, lambda m: m.a)):
        np.testing.assert_allclose(joined(signals, of), swing(t, derivative).T, atol=1e-7)


@pytest.mark.parametrize("frequency", [10.0, 40.0, 100.0])
def test_up_to_two_and_a_half_times_the_band_derivatives_are_true(frequency: float) -> None:
    """The signals' own filter lets 2.5 times the band of 40 Hz pass to half a percent, and differentiates it right."""
    t = clock(2)
    w = 2 * np.pi * frequency
    q = np.stack([np.sin(w * t), np.cos(w * t)], axis=1)
    signals = signals_of(swinging(t, q=q), velocity="differentiated")
    t = joined(signals, lambda m: m.t)
    np.testing.assert_allclose(joined(signals, lambda m: m.v)[0], w * np.cos(w * t), atol=6e-3 * w)
    np.testing.assert_allclose(joined(signals, lambda m: m.a)[1], -w * w * np.cos(w * t), atol=6e-3 * w * w)


def test_constants_stay_what_they_are_up_to_both_ends() -> None:
    t = clock(1)
    x = np.ones((len(t), 2)) * [0.3, -2.0]
    signals = signals_of(swinging(t, q=x, v=0 * x, tau=x))
    for of in (lambda m: m.q, lambda m: m.tau):
        np.testing.assert_allclose(filtered(signals, of), np.tile(x[:1].T, filtered(signals, of).shape[1]), rtol=1e-12)
    np.testing.assert_allclose(filtered(signals, lambda m: np.vstack([m.v, m.a])), 0, atol=1e-9)


@pytest.mark.parametrize("kind", LOGS)
@pytest.mark.parametrize("size", [1, 700, 3000])
def test_batches_of_any_size_give_what_the_whole_gives(monkeypatch: pytest.MonkeyPatch, kind: str, size: int) -> None:
    log, config = LOGS[kind]
    signals = signals_of(log(clock(12)), **config)
    results = []
    for batch in (size, 1 << 30):
        monkeypatch.setattr(module, "BATCH_SAMPLES", batch)
        results.append((joined(signals, everything), filtered(signals, everything), len(list(signals.batches()))))
    (motion, band, count), (whole_motion, whole_band, one) = results
    assert one == 1 < count
    rounding = np.repeat([1e-12, 1e-12, 5e-12, 5e-9, 5e-12, 5e-12], [1, 2, 2, 2, 2, 2])[:, None]  # a = q / dt²
    for part, whole in ((motion, whole_motion), (band, whole_band)):
        assert (np.abs(part - whole) <= rounding).all(), np.abs(part - whole).max(axis=1)


@pytest.mark.parametrize("kind", LOGS)
@pytest.mark.parametrize("long_part_first", [True, False])
def test_nothing_reaches_across_a_gap(kind: str, long_part_first: bool) -> None:
    """Samples beyond a gap may be a million times as large: those on this side come out the same to the last bit."""
    make, config = LOGS[kind]
    t = clock(12)
    break_at = 8000 if long_part_first else 4000
    t[break_at:] += 0.5
    log = make(t)
    assert len(log.segments) == 2
    other = log.segments[1] if long_part_first else log.segments[0]
    wild = {name: x.copy() for name, x in log.signals.items()}
    for x in wild.values():
        x[other] *= 1e6
    results = []
    for signals in (signals_of(log, **config), signals_of(replace(log, signals=wild), **config)):
        (mine,) = [r for r in signals.ranges if (r.start < break_at) == long_part_first]
        batches = list(signals.batches([mine]))
        results.append([(everything(b.motion), b.filter(everything(b.motion))) for b in batches])
    for (motion, band), (same_motion, same_band) in zip(*results, strict=True):
        np.testing.assert_array_equal(motion, same_motion)
        np.testing.assert_array_equal(band, same_band)


def test_every_sample_of_a_segment_but_the_derivatives_margin_is_used_once() -> None:
    t = clock(9)
    t[3000:] += 0.25
    t[7000:] += 0.25
    signals = signals_of(swinging(t), velocity="differentiated")
    margin = signals.ranges[0].start
    assert [(r.start, r.stop) for r in signals.ranges] == [
        (start + margin, stop - margin) for start, stop in ((0, 3000), (3000, 7000), (7000, 9000))
    ]
    used = joined(signals, lambda m: m.t)
    assert (np.diff(used) > 0).all()
    edge = signals.full_rate_low_pass.edge
    assert len(used) == sum(r.stop - r.start - 2 * edge for r in signals.ranges)


@pytest.mark.parametrize("kind", ["measured", "jittering stamps", "late velocity"])
def test_the_memory_that_batches_take_does_not_grow_with_the_log(kind: str) -> None:
    make, config = LOGS[kind]
    peaks = []
    for seconds in (40, 320):
        signals = signals_of(make(clock(seconds)), **config)
        tracemalloc.start()
        count = sum(len(batch.t) for batch in signals.batches())
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert count > 0.9 * seconds * RATE / signals.low_pass.stride
    assert peaks[1] < 1.1 * peaks[0]


def test_a_log_too_short_for_the_filter_is_refused_with_the_length_it_takes() -> None:
    signals = signals_of(swinging(clock(2)))
    needed = 2 * signals.ranges[0].start
    with pytest.raises(
        LogError,
        match=r"no segment without gaps is longer than the 0\.\d+ s that the 40 Hz filter.*; give a longer log",
    ):
        signals_of(swinging(clock(2)[:needed]))
    assert signals_of(swinging(clock(2)[: needed + 1])).ranges


def test_a_stretch_too_short_for_the_filter_is_left_out_and_said() -> None:
    t = clock(3)
    t[2980:] += 1.0
    signals = signals_of(swinging(t))
    assert len(signals.ranges) == 1
    assert signals.ranges[0].stop < 2980
    assert "1 segment between gaps was too short for the filter" in sentences(signals.notices)


@pytest.mark.parametrize("rate", [100.0, 500.0])
def test_a_cut_off_too_high_for_the_sampling_rate_is_refused(rate: float) -> None:
    log = swinging(clock(5, rate))
    with pytest.raises(ConfigError, match=rf"filter.cutoff_hz: {rate / 2:g} Hz is too high .* sampled at {rate:g} Hz"):
        signals_of(log, filter={"cutoff_hz": rate / 2})
    assert signals_of(log, filter={"cutoff_hz": 0.44 * rate}).band_hz == 0.44 * rate


@pytest.mark.parametrize(("rate", "band"), [(1000.0, 40.0), (250.0, 40.0), (100.0, 20.0), (30.0, 6.0)])
def test_the_band_is_40_hz_or_a_fifth_of_a_slow_rate(rate: float, band: float) -> None:
    signals = signals_of(swinging(clock(20, rate)))
    assert signals.band_hz == pytest.approx(band)
    assert 1 / (signals.low_pass.stride * signals.log.dt) >= 4 * band * (1 - 1e-9)


def test_a_joint_without_torque_and_command_is_refused() -> None:
    t = clock(1)
    tau = np.stack([np.ones(len(t)), np.full(len(t), np.nan)], axis=1)
    with pytest.raises(LogError, match="joint knee has neither torque nor position command"):
        signals_of(swinging(t, tau=tau))


@pytest.mark.parametrize("controller", [None, {"kp": {"hip": 1.0}}])
def test_a_joint_without_torque_needs_its_gains(controller: dict[str, Any] | None) -> None:
    t = clock(1)
    log = swinging(t, tau=None, qcmd=swing(t))
    missing = "hip" if controller is None else "knee"
    with pytest.raises(LogError, match=f"joint {missing} has no torque; set its gains controller.kp and kd"):
        signals_of(log, controller=controller)
