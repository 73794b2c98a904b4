"""Band in which the noise of a gyroscope hardly counts, against the power of white noise and of sines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from idtool.common.arrays import Array
from idtool.data.gyroscope_cutoff import gyroscope_cutoff
from idtool.data.logs import JointLog
from idtool.data.logs.log import Channel

RATE = 500.0  # samples/s
SECONDS = 60.0
AMPLITUDE = np.array([0.3, 0.2, 0.1])  # rad/s
HERTZ = np.array([0.7, 1.3, 2.1])


def log_of(rates: Array, rate: float = RATE) -> JointLog:
    """A log with a gyroscope, shape (3, N) [rad/s]."""
    t = np.arange(rates.shape[1]) / rate
    channels = {f"imu_w{axis}": Channel(t, x) for axis, x in zip("xyz", rates, strict=True)}
    return JointLog(Path("log.csv"), (), t, {}, (slice(0, len(t)),), 1 / rate, channels=channels)


def swaying(noise: float, rate: float = RATE, seed: int = 0) -> Array:
    """Angular velocity of a base that sways, with white noise [rad/s]."""
    t = np.arange(round(SECONDS * rate)) / rate
    motion = AMPLITUDE[:, None] * np.sin(2 * np.pi * HERTZ[:, None] * t)
    return np.asarray(motion + noise * np.random.default_rng(seed).normal(size=motion.shape))


def expected_cutoff(noise: float, rate: float = RATE) -> float:
    """Frequency f below which three derivatives of white noise have a thousandth of the sines' power [Hz].

    The noise of each has the spectral density 2 noise² / rate, and its derivative that times (2 π f)².
    """
    power = np.sum(np.square(AMPLITUDE * 2 * np.pi * HERTZ)) / 2
    return float(np.cbrt(1e-3 * power * 3 / (3 * 2 * noise**2 / rate * (2 * np.pi) ** 2)))


@pytest.mark.parametrize("noise", [0.001, 0.002, 0.004])
def test_band_ends_where_noise_has_a_thousandth_of_the_power(noise: float) -> None:
    assert gyroscope_cutoff([log_of(swaying(noise))]) == pytest.approx(expected_cutoff(noise), rel=0.05, abs=0.5)


def test_band_does_not_end_below_what_contacts_need() -> None:
    assert expected_cutoff(0.03) < 8.0
    assert gyroscope_cutoff([log_of(swaying(0.03))]) == 8.0


def test_band_of_a_gyroscope_without_noise_does_not_end() -> None:
    assert gyroscope_cutoff([log_of(swaying(0.0))]) == np.inf


def test_noisiest_log_ends_the_band_unless_the_base_is_held() -> None:
    noisy, clear = log_of(swaying(0.004)), log_of(4 * swaying(0.001))
    held = log_of(0.004 * np.random.default_rng(1).normal(size=(3, 30_000)))
    assert gyroscope_cutoff([clear, noisy, held]) == gyroscope_cutoff([noisy])


def test_slow_gyroscope_in_a_table_of_fast_joints() -> None:
    """Its values are missing in between."""
    slow = swaying(0.004, rate=RATE / 2)
    in_table = np.full((3, 2 * slow.shape[1]), np.nan)
    in_table[:, ::2] = slow
    assert gyroscope_cutoff([log_of(in_table)]) == pytest.approx(expected_cutoff(0.004, RATE / 2), rel=0.05, abs=0.5)


def test_gyroscope_slower_than_the_lowest_cutoff_tells_nothing() -> None:
    assert gyroscope_cutoff([log_of(swaying(0.004, rate=10.0), rate=10.0)]) == np.inf


def test_longest_part_without_a_gap_counts() -> None:
    """Over the gap, the samples jump."""
    noisy = log_of(np.concatenate([np.full((3, 2000), 5.0), swaying(0.004)], axis=1))
    parts = replace(noisy, segments=(slice(0, 2000), slice(2000, len(noisy.t))))
    assert gyroscope_cutoff([parts]) == pytest.approx(gyroscope_cutoff([log_of(swaying(0.004))]))


def test_log_of_a_second_tells_nothing() -> None:
    assert gyroscope_cutoff([log_of(swaying(0.004)[:, :500])]) == np.inf
