"""No look ahead: the future has no influence, and what is left of the torque equation is exact all the same."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from robots import chain, inertial, joint
from scipy.optimize import minimize_scalar
from scipy.signal import butter, sosfilt
from swings import JOINTS, clock, everything, signals_of, swing, swinging

from idtool.data import causal as module
from idtool.data.causal import CausalLowPass, causal_batches
from idtool.data.filters import LowPass
from idtool.data.logs.log import JointLog
from idtool.data.signals import Batch, Motion, Signals
from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.robot.config import parse_config
from idtool.robot.model import RobotModel, build_model
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]

BANDS = [(40.0, 4, 0.001), (5.0, 2, 0.001), (20.0, 1, 0.002), (12.0, 8, 0.01), (200.0, 4, 0.001)]
PD = {"kp": {"hip": 20.0, "knee": 30.0}, "kd": {"hip": 1.0, "knee": 0.5}, "delay": 0.0034}


def plain(t: Array) -> JointLog:
    return swinging(t)


def late(t: Array) -> JointLog:
    return swinging(t, v=swing(t - 0.0025, 1))


def commanded(t: Array) -> JointLog:
    return swinging(t, tau=None, v=None, qcmd=swing(t + 0.01))


LOGS: dict[str, tuple[Callable[[Array], JointLog], dict[str, Any]]] = {
    "measured": (plain, {"velocity": "measured"}),
    "differentiated": (plain, {"velocity": "differentiated"}),
    "late velocity": (late, {"velocity": "measured"}),
    "commanded": (commanded, {"controller": PD}),
    "no wide filter": (plain, {"filter": {"cutoff_hz": 100}}),
}


def batches(signals: Signals) -> Iterator[Batch]:
    return causal_batches(signals, 4)


def seen(signals: Signals) -> tuple[Array, Array]:
    """Times, and all signals in the band."""
    found = [(batch.t, batch.filter(everything(batch.motion)[1:])) for batch in batches(signals)]
    return np.concatenate([t for t, _ in found]), np.concatenate([x for _, x in found], axis=1)


@pytest.mark.parametrize(("cutoff", "order", "dt"), BANDS)
def test_it_is_the_butterworth_twice_with_the_magnitude_of_the_zero_phase_filter(
    cutoff: float, order: int, dt: float
) -> None:
    low_pass, zero_phase = CausalLowPass(cutoff, order, dt), LowPass(cutoff, order, dt)
    impulse = np.eye(1, 1 << 15)[0]
    response = low_pass(impulse, 0, 0)
    sections = butter(order, cutoff, fs=1 / dt, output="sos")
    np.testing.assert_allclose(response, sosfilt(sections, sosfilt(sections, impulse)), atol=1e-12)
    kernel = np.pad(zero_phase.kernel, (0, len(impulse) - len(zero_phase.kernel)))
    ours, theirs = (np.abs(np.fft.rfft(x)) for x in (response, kernel))
    np.testing.assert_allclose(ours, theirs, atol=1e-5)
    assert low_pass.redundancy == pytest.approx(1 / np.square(response).sum(), rel=1e-3)


@pytest.mark.parametrize(("cutoff", "order", "dt"), BANDS)
def test_slow_signals_are_late_by_its_delay(cutoff: float, order: int, dt: float) -> None:
    low_pass = CausalLowPass(cutoff, order, dt)
    ramp = dt * np.arange(4.0 * low_pass.reach)
    np.testing.assert_allclose(low_pass(ramp, 3 * low_pass.reach, 0), ramp[3 * low_pass.reach :] - low_pass.delay)


def test_what_comes_after_the_samples_asked_for_has_no_influence(rng: np.random.Generator) -> None:
    low_pass, x = CausalLowPass(40, 4, 0.001, 3), rng.normal(size=(2, 900))
    filtered = low_pass(x, 100, 50)
    np.testing.assert_array_equal(filtered, low_pass(x[:, :850], 100, 0))
    assert filtered.shape == (2, 250)


@pytest.mark.parametrize("kind", LOGS)
@pytest.mark.parametrize("cut", [1500, 3003])
def test_the_future_does_not_change_the_past(kind: str, cut: int, rng: np.random.Generator) -> None:
    """What the log says from a sample on changes nothing that was there before it, to the last bit."""
    make, config = LOGS[kind]
    log = make(clock(5))
    signals = signals_of(log, **config)
    t, before = seen(signals)
    for x in log.signals.values():  # what was calibrated stays
        x[cut:] += rng.normal(size=x[cut:].shape)
    again, after = seen(signals)
    np.testing.assert_array_equal(t, again)
    past = t < log.t[cut]
    assert 100 < past.sum() < len(t) - 100
    np.testing.assert_array_equal(before[:, past], after[:, past])
    assert (before[:, t > log.t[cut] + 0.005] != after[:, t > log.t[cut] + 0.005]).any(axis=0).all()


@pytest.mark.parametrize("kind", LOGS)
@pytest.mark.parametrize("size", [1, 2500])
def test_batches_of_any_size_give_what_the_whole_gives(monkeypatch: pytest.MonkeyPatch, kind: str, size: int) -> None:
    make, config = LOGS[kind]
    signals = signals_of(make(clock(12)), **config)
    results = []
    for batch in (size, 1 << 30):
        monkeypatch.setattr(module, "BATCH_SAMPLES", batch)
        results.append((*seen(signals), len(list(batches(signals)))))
    (t, part, count), (whole_t, whole, one) = results
    assert one == 1 < count
    np.testing.assert_array_equal(t, whole_t)
    rounding = np.repeat([1e-12, 1e-11, 1e-8, 1e-11, 1e-11], 2)[:, None]  # a = q / dt²
    assert (np.abs(part - whole) <= rounding).all(), np.abs(part - whole).max(axis=1)


@pytest.mark.parametrize("kind", ["measured", "differentiated", "late velocity"])
def test_one_delay_for_position_velocity_acceleration_and_torque(kind: str) -> None:
    make, config = LOGS[kind]
    (batch,) = batches(signals_of(make(clock(6)), **config))
    m = batch.motion

    def distance(delay: float) -> float:
        return float(np.abs(m.q - swing(m.t - delay).T).max())

    delay = float(minimize_scalar(distance, bounds=(0, 0.05), method="bounded", options={"xatol": 1e-9}).x)
    assert 0.008 < delay < 0.03
    t = m.t - delay
    read = 1e-4 if kind == "late velocity" else 1e-5  # between samples
    for signal, truth, size in ((m.v, swing(t, 1), read), (m.a, swing(t, 2), read), (m.tau, np.cos(swing(t)), 1e-5)):
        np.testing.assert_allclose(signal, truth.T, atol=size * np.abs(truth).max())


def test_a_gap_starts_it_anew() -> None:
    """After a gap everything is as in a log that begins there; no state is carried across."""
    t = clock(6)
    there = (t < 2.5) | (t > 3.0)
    t = t[there]
    log = swinging(t)
    config = {"velocity": "differentiated"}
    assert len(log.segments) == 2
    when, x = seen(signals_of(log, **config))
    alone_when, alone = seen(signals_of(swinging(t[t > 3]), **config))
    after = when > 3
    np.testing.assert_allclose(when[after], t[t > 3][0] + alone_when, atol=1e-12)
    np.testing.assert_allclose(x[:, after], alone, atol=1e-9)
    assert (when[~after] < 2.5).all()


def test_ranges_are_kept() -> None:
    signals = signals_of(swinging(clock(6)))
    t, x = seen(signals)
    (batch,) = causal_batches(signals, 4, [slice(2000, 4000)])
    assert batch.t[0] >= signals.log.t[2000]
    assert batch.t[-1] < signals.log.t[4000] + 0.02
    assert len(batch.t) < 2000 / signals.low_pass.stride
    assert len(t) > 2 * len(batch.t)
    assert x.shape[1] == len(t)


@pytest.fixture
def arm(rng: np.random.Generator, robot_of: Callable[[str], Robot]) -> tuple[RobotModel, LinearModel, Array]:
    """Two links that swing, with friction, and coefficients of theirs."""
    links = "".join(f'<link name="l{i}">{inertial(rng)}</link>' for i in range(3))
    joints = [joint(name, "revolute", f"l{i}", f"l{i + 1}", '<axis xyz="0 1 0"/>') for i, name in enumerate(JOINTS)]
    text = chain(*joints).replace('<link name="l0"/><link name="l1"/><link name="l2"/>', links)
    config = parse_config({}, "")
    model = build_model(robot_of(text), config, JOINTS)
    linear = LinearModel(model.names, build_effects(model, config))
    theta = linear.prior.copy()
    theta[20:] = rng.uniform(0.2, 1, 4)
    return model, linear, theta


def test_the_torque_equation_holds_almost_as_well_as_without_a_delay(
    arm: tuple[RobotModel, LinearModel, Array],
) -> None:
    _, linear, theta = arm
    t = clock(8)
    q, v, a = (swing(t, k).T for k in range(3))
    exact = Motion(t, q, v, a, np.zeros_like(q), np.zeros_like(q), np.full(2, 3e-3), 0.001)
    tau = linear.torque(exact, theta)
    log = swinging(t, v=None, tau=tau.T)
    signals = signals_of(log)
    residuals = []
    for found in (batches(signals), signals.batches()):
        blocks = [linear.block(batch) for batch in found]
        joints = zip(*blocks, linear.active(), strict=True)
        for *parts, active in joints:
            block = np.concatenate(parts, axis=1)
            residuals.append(np.abs(theta[active] @ block[:-1] - block[-1]).max() / np.abs(block[-1]).max())
    causal, zero_phase = np.array(residuals).reshape(2, 2)
    assert (zero_phase < 1e-6).all(), zero_phase
    assert (causal < 3e-4).all(), causal  # the wide filter's delay is not quite the same at 40 Hz
