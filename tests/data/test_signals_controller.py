"""The torque of position-controlled joints, against the controller written out sample by sample."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sentences import sentences
from swings import RATE, clock, filtered, joined, signals_of, swing, swinging

from idtool.data.logs.log import JointLog
from idtool.data.signals import Signals

Array = NDArray[np.float64]

KP, KD = {"hip": 20.0, "knee": 35.0}, {"hip": 1.5, "knee": 0.4}


def command(t: Array, derivative: int = 0) -> Array:
    return swing(t + 0.02, derivative)


def controlled(log: JointLog, delay: float, n: int, kd: dict[str, float], v: Array) -> Array:
    """The torque at sample n: what was commanded ``delay`` before against what is now."""
    before = np.array([n / RATE - delay])
    qcmd, vcmd = command(before)[0], command(before, 1)[0] * ("vcmd" in log.signals)
    torque = np.zeros(2)
    for j, name in enumerate(log.joints):
        torque[j] = KP[name] * (qcmd[j] - log.signals["q"][n, j])
        torque[j] += kd.get(name, 0.0) * (vcmd[j] - v[n, j])
    return torque


def expected(signals: Signals, delay: float, kd: dict[str, float] = KD, v: Array | None = None) -> Array:
    """The loop over all samples that are used, shape (2, N)."""
    log = signals.log
    used = np.round(joined(signals, lambda m: m.t) * RATE).astype(int)
    v = log.signals["v"] if v is None else v
    return np.array([controlled(log, delay, n, kd, v) for n in used]).T


@pytest.mark.parametrize("delay", [0.0, 0.005, 0.0034, 0.0007])
@pytest.mark.parametrize("vcmd", [True, False])
def test_the_torque_is_the_controllers_on_the_late_command(delay: float, vcmd: bool) -> None:
    t = clock(3)
    log = swinging(t, tau=None, qcmd=command(t), vcmd=command(t, 1) if vcmd else None)
    signals = signals_of(log, controller={"kp": KP, "kd": KD, "delay": delay})
    torque = expected(signals, delay)
    np.testing.assert_allclose(joined(signals, lambda m: m.logged_tau), torque, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        joined(signals, lambda m: m.tau), torque, rtol=0, atol=1e-4
    )  # its filter passes 2.5 bands
    band = filtered(signals, lambda m: m.tau)
    assert band.shape[1] == pytest.approx(torque.shape[1] / signals.low_pass.stride, abs=1)


def test_a_joint_without_derivative_gain_needs_none() -> None:
    t = clock(2)
    signals = signals_of(swinging(t, tau=None, qcmd=command(t)), controller={"kp": KP, "kd": {"knee": 0.4}})
    torque = expected(signals, 0.0, kd={"knee": 0.4})
    np.testing.assert_allclose(joined(signals, lambda m: m.logged_tau), torque, rtol=0, atol=1e-9)


def test_without_a_measured_velocity_the_controllers_is_differentiated() -> None:
    t = clock(3)
    log = swinging(t, tau=None, v=None, qcmd=command(t))
    signals = signals_of(log, controller={"kp": KP, "kd": KD})
    torque = expected(signals, 0.0, v=swing(t, 1))
    np.testing.assert_allclose(joined(signals, lambda m: m.logged_tau), torque, rtol=0, atol=1e-6)


def test_the_controller_acts_on_the_velocity_as_it_was_logged() -> None:
    """A drive's velocity is late for its controller too; only the motion's v has that undone."""
    t = clock(4)
    log = swinging(t, tau=None, v=swing(t - 0.004, 1), qcmd=command(t))
    signals = signals_of(log, controller={"kp": KP, "kd": KD}, velocity="measured")
    np.testing.assert_allclose(signals.lag, 0.004, atol=1e-4)
    np.testing.assert_allclose(joined(signals, lambda m: m.logged_tau), expected(signals, 0.0), rtol=0, atol=1e-9)
    np.testing.assert_allclose(joined(signals, lambda m: m.v), swing(joined(signals, lambda m: m.t), 1).T, atol=1e-3)


def test_a_velocity_that_is_off_on_average_moves_neither_the_motion_nor_the_torque() -> None:
    """kd times what it is off by would else be a torque that nothing in the robot gives."""
    t = clock(4)
    right, off = swing(t, 1), np.array([0.03, -0.02])
    true, biased = (
        signals_of(swinging(t, tau=None, v=v, qcmd=command(t)), controller={"kp": KP, "kd": KD}, velocity="measured")
        for v in (right, right + off)
    )
    np.testing.assert_allclose(biased.channels.bias, off, atol=1e-4)
    for of in (lambda m: m.logged_tau, lambda m: m.v):
        np.testing.assert_allclose(joined(biased, of), joined(true, of), rtol=0, atol=2e-4)
    message = "the measured velocity has an offset of up to 0.03 rad/s or m/s: hip, knee"
    assert message in sentences(biased.notices)
    assert not any("offset" in warning for warning in sentences(true.notices))


@pytest.mark.parametrize("delay", [0.0, 0.0034])
def test_a_measured_torque_goes_before_the_controllers(delay: float) -> None:
    t = clock(3)
    tau = np.stack([np.cos(t), np.full(len(t), np.nan)], axis=1)
    log = swinging(t, tau=tau, qcmd=command(t), vcmd=command(t, 1))
    signals = signals_of(log, controller={"kp": KP, "kd": KD, "delay": delay})
    measured, commanded = joined(signals, lambda m: m.logged_tau)
    used = joined(signals, lambda m: m.t)
    np.testing.assert_array_equal(measured, np.cos(used))
    np.testing.assert_allclose(commanded, expected(signals, delay)[1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("delay", [0.0, 0.0137, 0.2437])
def test_a_delay_takes_its_samples_from_each_segments_start(delay: float) -> None:
    """Before the first command has arrived there is no torque."""
    t = clock(6)
    t[2500:] += 0.5
    log = swinging(t, tau=None, qcmd=command(t))
    config: dict[str, Any] = {"kp": KP, "kd": KD}
    late, prompt = (signals_of(log, controller={**config, "delay": d}) for d in (delay, 0.0))
    lost = int(np.ceil(delay * RATE))
    assert [r.start - p.start for r, p in zip(late.ranges, prompt.ranges, strict=True)] == [lost, lost]
    assert [r.stop for r in late.ranges] == [r.stop for r in prompt.ranges]
