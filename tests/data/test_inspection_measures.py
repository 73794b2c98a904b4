"""The measures of an inspection find the truth, in signals that are known and in real logs."""

from __future__ import annotations

import numpy as np
import pytest
from inspected import motion, needs_data
from paths import REAL
from scipy.signal import lfilter

from idtool.data.inspection import inspect_log, jitter, quantisation, sample_steps, signal_statistics
from idtool.data.logs import read_log
from idtool.data.velocity_agreement import velocity_agreement


@pytest.mark.parametrize("samples", [0.0, 0.3, 1.0, -2.4, 7.7])
@pytest.mark.parametrize(("seconds", "rate"), [(20.0, 1000.0), (23.5, 200.0), (3.0, 1000.0)])
def test_velocity_lag_is_exact_without_noise(samples: float, seconds: float, rate: float) -> None:
    t = np.arange(round(seconds * rate)) / rate
    lag, gain, agreement, _ = velocity_agreement(motion(t), 1.3 * motion(t - samples / rate, 0, 1), 1 / rate)
    assert lag * rate == pytest.approx(samples, abs=2e-3)
    assert gain == pytest.approx(1.3, rel=1e-3)
    assert agreement == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("samples", [0.0, 0.3, -1.6])
@pytest.mark.parametrize("rate", [200.0, 1000.0])
def test_velocity_lag_bears_noise_quantisation_and_jitter(samples: float, rate: float) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(round(30 * rate)) / rate
    at = t + 0.2 / rate * rng.normal(size=len(t))  # taken off the clock, q and v together
    q = np.round(motion(at) / 1e-4) * 1e-4
    v = np.round((motion(at - samples / rate, 0, 1) + 0.01 * rng.normal(size=len(t))) / 4e-3) * 4e-3
    lag, gain, agreement, _ = velocity_agreement(q, v, 1 / rate)
    assert lag * rate == pytest.approx(samples, abs=0.05)
    assert gain == pytest.approx(1.0, abs=2e-3)
    assert agreement > 0.999


def test_error_of_the_lag_is_its_scatter() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(5000) * 1e-3
    found = []
    for _ in range(40):
        v = motion(t - 0.002, 0, 1) + 0.3 * rng.normal(size=len(t))
        found.append(velocity_agreement(motion(t), v, 1e-3))
    scatter = np.std([one.lag for one in found])
    errors = [one.lag_error for one in found]
    assert 0.4 * scatter < np.mean(errors) < 2.5 * scatter


def test_a_lag_that_no_drive_has_is_none() -> None:
    t = np.arange(20000) * 1e-3
    late = velocity_agreement(motion(t), motion(t - 0.13, 0, 1), 1e-3)
    assert np.isnan(late.lag)
    assert late.agreement == 0


@pytest.mark.parametrize("cutoff", [80.0, 160.0])
def test_a_low_pass_comes_out_as_its_low_frequency_delay(cutoff: float) -> None:
    fine, rate = 20, 1000.0
    t = np.arange(round(20 * rate * fine)) / (rate * fine)
    pole = np.exp(-2 * np.pi * cutoff / (rate * fine))
    v = lfilter([1 - pole], [1, -pole], motion(t, 0, 1))[::fine]
    lag, gain, *_ = velocity_agreement(motion(t[::fine]), v, 1 / rate)
    assert lag == pytest.approx(pole / (1 - pole) / (rate * fine), rel=0.02)
    assert gain == pytest.approx(1.0, abs=5e-3)


def test_velocity_lag_says_when_nothing_agrees() -> None:
    t = np.arange(20000) * 1e-3
    noise = np.random.default_rng(0).normal(size=len(t))
    assert velocity_agreement(motion(t), noise, 1e-3).agreement < 0.01
    for at_rest_or_short in (
        velocity_agreement(motion(t), np.zeros(len(t)), 1e-3),
        velocity_agreement(motion(t)[:50], motion(t, 0, 1)[:50], 1e-3),
    ):
        assert np.isnan(at_rest_or_short[:3]).all()
        assert at_rest_or_short.lag_error == np.inf


@pytest.mark.parametrize("step", [2 * np.pi / 4096, 2 * np.pi / 2**16 / 6.33, 1e-3, 0.3])
@pytest.mark.parametrize("offset", [0.0, 0.1234567])
def test_quantisation_finds_the_step(step: float, offset: float) -> None:
    t = np.arange(20000) * 1e-3
    x = offset + np.round(motion(t) / step) * step
    assert quantisation(x) == pytest.approx(step, rel=1e-6)
    assert quantisation(x.astype(np.float32).astype(float)) == pytest.approx(step, rel=1e-4)
    printed = np.array([float(f"{value:.7g}") for value in x])
    assert quantisation(printed) == pytest.approx(step, rel=1e-3)


def test_quantisation_finds_a_step_of_which_most_levels_are_skipped() -> None:
    x = np.round(motion(np.arange(20000) * 1e-3) / 4e-6) * 4e-6
    assert np.diff(np.unique(x)).mean() > 5 * 4e-6
    assert quantisation(x) == pytest.approx(4e-6, rel=1e-6)


def test_quantisation_finds_a_step_that_was_rounded_again() -> None:
    count = np.round(100 * motion(np.arange(20000) * 1e-3))
    assert quantisation(0.01 * np.round(9.25 * count)) == pytest.approx(0.0925, rel=1e-3)


def test_quantisation_finds_the_step_of_a_poor_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of which some levels are off; a search that gives up sooner does not."""
    t, step = np.arange(8000) * 1e-3, 0.002
    levels, indices = np.unique(np.round(motion(t) / step) * step, return_inverse=True)
    jitter = np.random.default_rng(0).uniform(-0.1, 0.1, size=len(levels))
    jitter[::25] = 0.4
    x = (levels + step * jitter)[indices]
    assert quantisation(x) == pytest.approx(step, rel=1e-2)
    monkeypatch.setattr(signal_statistics, "_MAX_OFF_GRID_SHARE", 0.01)
    assert quantisation(x) is None


@pytest.mark.parametrize("samples", [5, 10, 20, 50, 200, 20000])
def test_continuous_signals_have_no_step(samples: int) -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        assert quantisation(rng.normal(size=samples)) is None
    assert quantisation(motion(np.arange(samples) * 1e-3)) is None
    assert quantisation(np.ones(samples)) is None


def test_jitter_is_measured_per_segment_and_in_samples() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(10000) * 2e-3
    parts = (slice(0, 4000), slice(4000, 10000))
    t[4000:] += 17.3
    assert jitter(t, 2e-3, parts) < 1e-9
    assert jitter(t + 1e-4 * rng.normal(size=len(t)), 2e-3, parts) == pytest.approx(0.05, rel=0.03)


def test_sample_steps_recover_the_clock_from_the_motion() -> None:
    steps = np.random.default_rng(0).choice([0.0, 1.0, 2.0], size=5000, p=[0.1, 0.8, 0.1])
    t = np.concatenate([[0], np.cumsum(steps)]) * 1e-3
    q, v = (np.stack([motion(t, j, d) for j in range(3)], axis=1) for d in (0, 1))
    found, error = sample_steps(q, -57.3 * v, 1e-3)
    told = error < 0.1
    assert told.mean() > 0.9
    assert np.array_equal(np.round(found[told] / np.median(found[told])), steps[told])


@needs_data
def test_panda() -> None:
    """Its source ticks every millisecond; the logger did not, and v is filtered."""
    inspection = inspect_log(read_log(REAL / "panda" / "excitation.mcap"))
    stamps = inspection.stamps
    assert stamps.repeated == pytest.approx(0.06, abs=0.01)
    assert stamps.sampling
    assert stamps.sampling.skipped == pytest.approx(0.076, abs=0.01)
    arm = [joint for name, joint in inspection.joints.items() if "finger" not in name]
    assert len(arm) == 7
    for joint in arm:
        assert joint.velocity
        assert joint.velocity.lag_ms == pytest.approx(5.4, abs=0.6)
        assert joint.velocity.gain == pytest.approx(1.0, abs=2e-3)
        assert joint.torque
        assert joint.torque.kind == "measured"


@needs_data
@pytest.mark.parametrize("run", [4, 7])
def test_go2(run: int) -> None:
    """Rounded stamps hide a millisecond of jitter; v's steps are the drive's."""
    inspection = inspect_log(read_log(REAL / "go2" / f"chirp_{run}.csv"))
    assert inspection.stamps.jitter_rms_ms < 1e-6
    assert inspection.stamps.sampling
    assert inspection.stamps.sampling.jitter_ms == pytest.approx(1.15, abs=0.15)
    assert len(inspection.joints) == 12
    for name, joint in inspection.joints.items():
        assert joint.signals["v"].step == pytest.approx(0.002022 if "calf" in name else 0.0038755, rel=1e-3)
        assert joint.velocity
        assert joint.velocity.lag_ms == pytest.approx(0.35, abs=0.4)
        assert joint.torque is None
