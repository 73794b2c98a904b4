"""Which velocity is used, its lag, and whether jittering stamps are believed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from sentences import sentences
from swings import RATE, clock, joined, signals_of, swing, swinging

from idtool.data.logs.log import JointLog

Array = NDArray[np.float64]

DT = 1 / RATE


def noise(rng: np.random.Generator, like: Array, sigma: float) -> Array:
    return np.asarray(sigma * rng.normal(size=like.shape))


def test_of_two_velocities_the_quieter_is_used_joint_by_joint(rng: np.random.Generator) -> None:
    """Noise of 1e-5 rad in q is some 1e-2 rad/s in dq/dt; the hip's v has far less of it, the knee's far more."""
    t = clock(10)
    q = swing(t) + noise(rng, swing(t), 1e-5)
    v = swing(t, 1) + noise(rng, swing(t), 1.0) * [1e-4, 1.0]
    signals = signals_of(swinging(t, q=q, v=v))
    np.testing.assert_array_equal(signals.velocity_from_position, [False, True])
    error = joined(signals, lambda m: m.v) - swing(joined(signals, lambda m: m.t), 1).T
    assert error[0].std() < 1e-4
    assert error[1].std() < 1e-2


@pytest.mark.parametrize(("velocity", "differentiated"), [("measured", False), ("differentiated", True)])
def test_the_configuration_decides_where_it_says(rng: np.random.Generator, velocity: str, differentiated: bool) -> None:
    t = clock(10)
    q = swing(t) + noise(rng, swing(t), 1e-5)
    v = swing(t, 1) + noise(rng, swing(t), 1.0) * [1e-4, 1.0]
    signals = signals_of(swinging(t, q=q, v=v), velocity=velocity)
    np.testing.assert_array_equal(signals.velocity_from_position, [differentiated] * 2)


@pytest.mark.parametrize("velocity", ["auto", "measured"])
def test_a_missing_velocity_is_differentiated_and_said(velocity: str) -> None:
    t = clock(4)
    v = np.stack([swing(t, 1)[:, 0], np.full(len(t), np.nan)], axis=1)
    signals = signals_of(swinging(t, v=v), velocity=velocity)
    assert signals.velocity_from_position[1]
    assert "no velocity was logged; it is differentiated from q: knee" in sentences(signals.notices)
    np.testing.assert_allclose(joined(signals, lambda m: m.v), swing(joined(signals, lambda m: m.t), 1).T, atol=1e-6)
    both = signals_of(swinging(t, v=None), velocity=velocity)
    assert both.velocity_from_position.all()
    assert "no velocity was logged; it is differentiated from q: hip, knee" in sentences(both.notices)


@pytest.mark.parametrize("lag", [0.004, 0.0025, -0.0013, 0.08, -0.08])
def test_a_velocity_that_is_late_is_read_later(lag: float) -> None:
    """Up to the very ends of what is used: the samples that the lag takes are left out there."""
    t = clock(6)
    signals = signals_of(swinging(t, v=swing(t - lag, 1)), velocity="measured")
    np.testing.assert_allclose(signals.lag, lag, atol=0.05 * DT)
    relation = "lags" if lag > 0 else "leads"
    by = f"the derivative of the position by up to {abs(lag) * 1e3:.1f} ms"
    message = f"the measured velocity {relation} {by}; idtool corrects it"
    assert message in sentences(signals.notices)
    used = joined(signals, lambda m: m.t)
    truth = swing(used, 1).T
    assert np.abs(truth - swing(used - lag, 1).T).max() > 0.02
    np.testing.assert_allclose(joined(signals, lambda m: m.v), truth, atol=1e-3)
    np.testing.assert_allclose(joined(signals, lambda m: m.a), swing(used, 2).T, atol=0.05)


@pytest.mark.parametrize("sigma", [0.0, 1e-4])
def test_a_joint_at_rest_has_the_others_lag(rng: np.random.Generator, sigma: float) -> None:
    """Drives of one robot filter alike; where nothing moves but noise, nothing speaks against it."""
    t = clock(6)
    q = swing(t) * [1, 0] + noise(rng, swing(t), sigma) * [0, 1]
    v = swing(t - 0.003, 1) * [1, 0] + noise(rng, swing(t), 1e-4)
    signals = signals_of(swinging(t, q=q, v=v))
    np.testing.assert_allclose(signals.lag, 0.003, atol=0.05 * DT)
    assert not any("is not the derivative" in warning for warning in sentences(signals.notices))


def test_a_velocity_in_time_is_left_alone() -> None:
    t = clock(6)
    signals = signals_of(swinging(t), velocity="measured")
    np.testing.assert_array_equal(signals.lag, 0)
    assert not signals.notices


def jittering(rng: np.random.Generator, samples: float, true: bool) -> tuple[JointLog, Array]:
    """A log whose stamps jitter uniformly by so many samples, and the instants its samples were taken at."""
    even = clock(20)
    stamps = even + samples * DT * rng.uniform(-1, 1, len(even))
    taken = stamps if true else even
    return swinging(stamps, q=swing(taken), v=swing(taken, 1), tau=np.cos(swing(taken))), taken


@pytest.mark.parametrize("samples", [0.1, 0.4])
def test_samples_taken_at_jittering_instants_are_put_on_an_even_clock(rng: np.random.Generator, samples: float) -> None:
    log, _ = jittering(rng, samples, true=True)
    signals = signals_of(log, velocity="measured")
    t = log.t[0] + joined(signals, lambda m: m.t)
    np.testing.assert_allclose(np.diff(t), log.dt, rtol=1e-6)
    for derivative, of, allowed in ((0, lambda m: m.q, 2e-5), (1, lambda m: m.v, 4e-4), (2, lambda m: m.a, 0.2)):
        np.testing.assert_allclose(joined(signals, of), swing(t, derivative).T, atol=allowed)
    np.testing.assert_allclose(joined(signals, lambda m: m.tau), np.cos(swing(t)).T, atol=2e-5)


@pytest.mark.parametrize("samples", [0.1, 0.4])
@pytest.mark.parametrize("lag", [0.0, 0.0025])
def test_stamps_that_jitter_where_the_samples_do_not_are_not_believed(
    rng: np.random.Generator, samples: float, lag: float
) -> None:
    """The samples are taken as even, even where a velocity has to be read between them."""
    log, taken = jittering(rng, samples, true=False)
    log.signals["v"][:] = swing(taken - lag, 1)
    signals = signals_of(log, velocity="measured")
    used = np.isin(log.t - log.t[0], joined(signals, lambda m: m.t))
    for derivative, of, allowed in ((0, lambda m: m.q, 1e-9), (1, lambda m: m.v, 2e-3), (2, lambda m: m.a, 0.1)):
        np.testing.assert_allclose(joined(signals, of), swing(taken[used], derivative).T, atol=allowed)


def test_where_stamps_jitter_much_the_measured_velocity_is_used_and_said(rng: np.random.Generator) -> None:
    log, _ = jittering(rng, 0.4, true=True)
    log.signals["v"][:] += noise(rng, log.signals["v"], 0.1)
    signals = signals_of(log)
    assert not signals.velocity_from_position.any()
    assert any(
        "have a jitter of" in warning and "measured velocity is used" in warning
        for warning in sentences(signals.notices)
    )


def test_a_velocity_that_belongs_to_something_else_is_not_used(rng: np.random.Generator) -> None:
    """One in other units, or of another joint: it does not follow dq/dt."""
    t = clock(10)
    for strange in (swing(t, 1) * 180 / np.pi, swing(t, 1)[:, ::-1], noise(rng, swing(t), 1.0)):
        signals = signals_of(swinging(t, v=strange))
        assert signals.velocity_from_position.all()
        assert "the logged velocity is not the derivative of q; q is differentiated instead: hip, knee" in sentences(
            signals.notices
        )
        np.testing.assert_allclose(
            joined(signals, lambda m: m.v), swing(joined(signals, lambda m: m.t), 1).T, atol=1e-6
        )
