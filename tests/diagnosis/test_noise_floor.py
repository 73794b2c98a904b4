"""The noise floor: noise of known size is found, whatever else the residual holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import INERTIA, PENDULUM, WEIGHT
from numpy.typing import NDArray
from prescribed_motions import Log, prescribed_motion, silent, sines, with_torque
from scipy.integrate import cumulative_trapezoid
from spatial_arm import RATE, RIGID, experiment, in_band, written

from idtool.diagnosis.noise_floor import NoiseFloor, estimate_noise_floor
from idtool.diagnosis.records import ErrorSummary
from idtool.diagnosis.unexplained import RemainingResidual
from idtool.estimation.dataset.experiment import prepare
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

SECONDS = 24.0
HINGE = ("hinge",)


def noise(white: float, quick: float, seed: int = 0) -> Array:
    """White noise, and such as has power with the fourth power of frequency, of so much in all [N·m], shape (N,)."""
    one, other = np.random.default_rng(seed).normal(size=(2, round(SECONDS * RATE) + 2))
    return np.asarray(white * one[1:-1] + quick * np.diff(other, 2))


def rms(x: Array) -> float:
    """In the band, by scipy's filter, away from the ends."""
    return float(np.sqrt(np.mean(np.square(in_band(x[:, None])[RATE // 2 : -RATE // 2]))))


def floor_of(folder: Path, log: Log, extra: Array, **config: Any) -> NoiseFloor:
    """That of the true model under further torque."""
    paths = written(folder, with_torque(log, 0, extra), HINGE, text=PENDULUM)
    tried = experiment(*paths, fitted=True, **config)
    return estimate_noise_floor(tried, tried.equation.prior, silent)


@pytest.fixture(scope="module")
def log() -> Log:
    """A pendulum that swings, without noise."""
    return prescribed_motion(SECONDS, PENDULUM)


def stopping() -> Log:
    """A pendulum that comes to rest after two thirds of the time: its torque by hand."""
    t = np.arange(round(SECONDS * RATE)) / RATE
    x = np.clip(t - 15, 0, 1)  # s of stopping
    pace, brake = 1 - x**3 * (10 - 15 * x + 6 * x**2), -30 * x**2 * (1 - x) ** 2
    q, v, a = sines(cumulative_trapezoid(pace, t, initial=0), 1)
    v, a = v * pace[:, None], a * np.square(pace)[:, None] + v * brake[:, None]
    return {"t": t, "q": q, "v": v, "tau": INERTIA * a + WEIGHT * np.sin(q)}


def structure(log: Log) -> Array:
    """What a model may lack: functions of the motion, up to some Hz, and blows now and then."""
    q, v, t = log["q"][:, 0], log["v"][:, 0], log["t"]
    blows = sum(np.exp(-0.5 * np.square((t - at) / 0.008)) for at in (3.1, 15.2))
    return np.asarray(0.3 * np.sin(2 * q) + 0.1 * v * np.abs(v) + 0.3 * np.sin(2 * np.pi * 3 * t) + blows)


@pytest.mark.parametrize(("white", "quick"), [(0.1, 0.0), (0.0, 3.0), (0.07, 2.0)])
def test_noise_is_found_to_its_size(tmp_path: Path, log: Log, white: float, quick: float) -> None:
    own = noise(white, quick)
    found = floor_of(tmp_path, log, own)
    assert found.rms[0] == pytest.approx(rms(own), rel=0.1)
    assert found.noise[0] == pytest.approx(rms(own), rel=0.1)
    assert found.residual[0] == pytest.approx(rms(own), rel=0.05)
    assert found.slow_power_ratio[0] < 1.6


@pytest.mark.parametrize(("white", "quick"), [(0.1, 0.0), (0.0, 3.0), (0.07, 2.0)])
def test_what_a_model_lacks_is_no_noise(tmp_path: Path, log: Log, white: float, quick: float) -> None:
    own = noise(white, quick, seed=1)
    found = floor_of(tmp_path, log, own + structure(log))
    assert found.rms[0] == pytest.approx(rms(own), rel=0.15)
    assert found.residual[0] == pytest.approx(rms(own + structure(log)), rel=0.02)
    assert found.residual[0] > 10 * found.noise[0]
    assert found.slow_power_ratio[0] > 100


def test_a_line_is_no_noise(tmp_path: Path, log: Log) -> None:
    """Such as gears or current controllers make, within the band."""
    own = noise(0.1, 0.0)
    found = floor_of(tmp_path, log, own + 0.3 * np.sin(2 * np.pi * 27.3 * log["t"]))
    assert found.rms[0] == pytest.approx(rms(own), rel=0.15)
    assert found.residual[0] > 5 * rms(own)


def test_what_is_left_at_rest_is_no_models_to_explain(tmp_path: Path, log: Log) -> None:
    """A third of the time the joint rests, on friction of any size below its level, and shakes."""
    still, rest = stopping(), slice(16 * RATE, None)
    own, moving = noise(0.1, 0.0), still["v"][:, 0] != 0
    assert not moving[rest].any()
    held = np.where(moving, 0.0, 1.2 * np.sin(2 * np.pi * 0.7 * still["t"]) + noise(0.6, 0.0, seed=2))
    friction = {"viscous": False, "coulomb": 1.5}
    sliding = 1.5 * np.sign(still["v"][:, 0])
    found = floor_of(tmp_path, still, own + held + sliding, friction=friction)
    assert found.noise[0] == pytest.approx(rms(own), rel=0.15)
    assert found.residual[0] < 2 * rms(own)
    left = in_band((own + held)[:, None])[:, 0]
    expected = np.sqrt((2 * rms(own) ** 2 + np.mean(np.square(left[rest]))) / 3)
    assert found.rms[0] == pytest.approx(expected, rel=0.1)
    assert found.rms[0] > 3 * found.noise[0]


def test_a_short_log_has_its_residual_for_a_floor(tmp_path: Path, log: Log) -> None:
    """Two seconds are too few to say what is noise."""
    short = {name: x[: 2 * RATE] for name, x in log.items()}
    found = floor_of(tmp_path, short, structure(short))
    np.testing.assert_array_equal(found.rms, found.residual)
    np.testing.assert_array_equal(found.noise, found.residual)
    np.testing.assert_array_equal(found.slow_power_ratio, 1)
    assert not found.is_estimated


def test_where_the_held_out_data_are_short_the_noise_is_that_of_all_data(tmp_path: Path, log: Log) -> None:
    own = noise(0.1, 0.0)
    urdf, csv = written(tmp_path, with_torque(log, 0, own), HINGE, text=PENDULUM)
    prepared = prepare(read_robot(urdf), parse_config(RIGID, ""), [csv], [], holdout=1.5 / SECONDS)
    found = estimate_noise_floor(prepared, prepared.equation.prior, silent)
    assert found.is_estimated
    assert found.noise[0] == pytest.approx(rms(own), rel=0.15)
    assert found.residual[0] == pytest.approx(rms(own), rel=0.25)


def test_noise_that_falls_with_the_frequency_counts_up_to_a_limit() -> None:
    """Only on joints without structure: what rest adds stays, and the noise becomes all of the residual."""
    rms, noise, residual = np.full(4, 0.3), np.full(4, 0.2), np.full(4, 0.5)
    floor = NoiseFloor(rms, noise, residual, np.array([1.0, 14.9, 15.1, 14.9]))
    found = floor.with_coloured_noise(np.array([True, True, True, False]))
    np.testing.assert_allclose(found.noise, [0.5, 0.5, 0.2, 0.2])
    np.testing.assert_allclose(found.rms, [np.sqrt(0.3**2 - 0.2**2 + 0.5**2)] * 2 + [0.3] * 2)
    np.testing.assert_array_equal(found.residual, residual)


def test_what_is_known_to_be_structure_is_no_noise() -> None:
    floor = NoiseFloor(np.full(3, 0.3), np.full(3, 0.2), np.full(3, 0.25), np.ones(3))
    found = floor.without_structure(np.array([0.0, 0.75, 1.0]))
    np.testing.assert_allclose(found.noise, [0.2, 0.125, 0.0])
    np.testing.assert_allclose(found.rms, np.sqrt(0.3**2 - 0.2**2 + np.square([0.2, 0.125, 0.0])))


def test_the_reported_floor_counts_what_is_only_fitted_along() -> None:
    """A model without such an effect cannot go below what the effect explains; a joint where it explains none can."""
    floor = NoiseFloor(np.array([0.3, 0.4]), np.zeros(2), np.zeros(2), np.ones(2))
    remaining = ErrorSummary({}, {"a": 0.35, "b": 0.5, "overall": 0.4}, None)
    after = ErrorSummary({}, {"a": 0.45, "b": 0.49, "overall": 0.5}, None)
    found = RemainingResidual(remaining, [], floor).reported_floor(after)
    expected = np.sqrt(0.3**2 + 0.45**2 - 0.35**2)
    assert found == pytest.approx({"a": expected, "b": 0.4, "overall": np.sqrt((expected**2 + 0.4**2) / 2)})


def test_the_reported_floor_is_not_above_the_error_that_the_reported_model_has() -> None:
    """Where an effect is undefined, chance decides which of two nearly equal models has the smaller error."""
    floor = NoiseFloor(np.array([0.6]), np.zeros(1), np.zeros(1), np.ones(1))
    search_model, reported = (ErrorSummary({}, {"a": rms, "overall": rms}, None) for rms in (0.65, 0.45))
    found = RemainingResidual(search_model, [], floor).reported_floor(reported)
    assert found == pytest.approx({"a": 0.45, "overall": 0.45})
