"""Simulation along a log: one mass on a rail with a spring and a damper, whose motion is known exactly.

Letters: m mass, b damping, k stiffness; W windows, N samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forward import friction, mechanism, sliders, torque_of_one_state
from numpy.typing import NDArray
from robots import chain, link
from scipy.integrate import solve_ivp
from scipy.signal import lsim
from stick_slip import StickSlip

from idtool.common.exceptions import ModelError
from idtool.data.logs.log import JointLog, make_log
from idtool.data.signals import Signals
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation import simulation
from idtool.dynamics.simulation.simulation import SimulatedWindows, simulate
from idtool.dynamics.simulation.windows import Window, measured_states, split_into_windows
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
ReadRobot = Callable[[str | bytes], Robot]

M, B, K = 2.0, 3.0, 50.0  # kg, N·s/m, N/m
SPRING = {"effect": "parallel_spring", "joint": "x1", "parameters": {"stiffness": K, "rest_position": 0.0}}
CONFIG = {"friction": friction(["x1"], [B], [0]), "effects": [SPRING]}


def clock(count: int, rate: float) -> Array:
    return np.arange(count) / rate


def log_of(t: Array, names: Sequence[str] = ("x1",), **signals: Array) -> JointLog:
    """Signals (N,) of one joint, or (N, nv)."""
    return make_log(Path("log.csv"), t, tuple(names), {name: x.reshape(len(t), -1) for name, x in signals.items()})


def signals_of(log: JointLog, **config: Any) -> Signals:
    return Signals(log, log.joints, parse_config(config, ""))


def force(t: Array) -> Array:
    return 3 * np.sin(8 * t) + np.cos(21 * t)


def run(machine: Mechanism, signals: Signals, windows: Sequence[slice]) -> list[SimulatedWindows]:
    return list(simulate(machine, [Window(signals, part) for part in windows], lambda share: None))


def exact(t: Array, tau: Array, q: float, v: float) -> tuple[Array, Array]:
    """The mass under a torque that is straight between samples; exact."""
    system = np.array([[0, 1], [-K / M, -B / M]]), np.array([[0], [1 / M]]), np.eye(2), np.zeros((2, 1))
    _, states, _ = lsim(system, tau, t - t[0], [q, v])
    return states[:, 0], states[:, 1]


@pytest.mark.parametrize(("rate", "tolerance"), [(250, 1e-8), (1000, 1e-5)])
def test_windows_follow_the_logged_torque_from_the_measured_state(
    robot_of: ReadRobot, rate: int, tolerance: float
) -> None:
    """Straight between samples. At 1 kHz two samples are one step, and the torque is smoothed a little for that."""
    t = clock(rate * 3, rate)
    signals = signals_of(log_of(t, q=0.1 * np.sin(7 * t), tau=force(t)))
    windows = [slice(0, rate), slice(rate, rate + 7), slice(rate + 7, 3 * rate), slice(3 * rate - 2, 3 * rate)]
    (found,) = run(mechanism(robot_of(sliders(M)), CONFIG), signals, windows)
    assert [window.part for window in found.windows] == windows
    assert not found.diverged.any()
    q0, v0 = measured_states(signals, [window.start for window in windows])
    np.testing.assert_allclose(v0[0], 0.7 * np.cos(7 * t[[w.start for w in windows]]), atol=1e-2)
    for w, window in enumerate(windows):
        length = window.stop - window.start
        q, v = exact(t[window], force(t[window]), q0[0, w], v0[0, w])
        assert (found.q[0, w, 0], found.v[0, w, 0]) == (q0[0, w], v0[0, w])
        np.testing.assert_allclose(found.q[0, w, :length], q, rtol=0, atol=tolerance)
        np.testing.assert_allclose(found.v[0, w, :length], v, rtol=0, atol=30 * tolerance)
        np.testing.assert_allclose(found.tau[0, w, :length], force(t[window]), rtol=0, atol=0.01)


def test_noise_in_the_torque_weighs_the_same_in_every_sample(robot_of: ReadRobot) -> None:
    """A free mass has the impulse of all samples, whatever steps it is simulated in."""
    t, tau = clock(2000, 1000), np.random.default_rng(0).normal(size=2000)
    signals = signals_of(log_of(t, q=0 * t, tau=tau))
    machine = mechanism(robot_of(sliders(1.0)), {"friction": friction(["x1"], [0], [0])})
    (found,) = run(machine, signals, [slice(first, first + 501) for first in range(0, 1500, 20)])
    impulse = [tau[first : first + 501].sum() - (tau[first] + tau[first + 500]) / 2 for first in range(0, 1500, 20)]
    assert np.std(impulse) > 20
    np.testing.assert_allclose(found.v[0, :, 500], np.array(impulse) / 1000, rtol=0, atol=3e-3)


def test_a_gap_parts_windows_and_torque(robot_of: ReadRobot) -> None:
    """What is on its other side does not count, and time runs on."""
    t = clock(1500, 250)
    t[700:] += 0.85
    tau = np.where(t < 3, force(t), 5 - force(t))
    signals = signals_of(log_of(t, q=np.where(t < 3, 0.1, -0.2), tau=tau))
    windows = split_into_windows(signals, signals.ranges, 1.0)
    assert windows == [slice(a, min(a + 250, e)) for s, e in ((0, 700), (700, 1500)) for a in range(s, e, 250)]
    (found,) = run(mechanism(robot_of(sliders(M)), CONFIG), signals, windows)
    for w, window in enumerate(windows):
        length = window.stop - window.start
        q, _ = exact(t[window], tau[window], 0.1 if window.stop <= 700 else -0.2, 0.0)
        np.testing.assert_allclose(found.q[0, w, :length], q, rtol=0, atol=1e-8)


KP, KD = 80.0, 5.0


def wanted(t: Array, derivative: int = 0) -> Array:
    """A command, or its rate."""
    return 0.3 * np.sin(4 * t) if not derivative else 1.2 * np.cos(4 * t)


@pytest.mark.parametrize("delay", [0.0, 0.005, 0.0034, 0.0201])
@pytest.mark.parametrize("with_rate", [True, False])
def test_the_controller_sees_the_command_late(robot_of: ReadRobot, delay: float, with_rate: bool) -> None:
    """By whole samples and parts of them. What was commanded before a window counts in it, but not beyond a gap."""
    t = clock(2000, 1000)
    t[1500:] += 0.3
    command = {"qcmd": wanted(t), **({"vcmd": wanted(t, 1)} if with_rate else {})}
    controller = {"kp": {"x1": KP}, "kd": {"x1": KD}, "delay": delay}
    signals = signals_of(log_of(t, q=0.05 + 0 * t, **command), controller=controller)
    windows = [slice(0, 800), slice(800, 1500), slice(1500, 2000)]
    (found,) = run(mechanism(robot_of(sliders(M)), CONFIG), signals, windows)

    def torque(now: Array, q: Array, v: Array) -> Array:
        late = np.maximum(now - delay, np.where(now < t[1500], 0, t[1500]))
        return KP * (wanted(late) - q) + KD * (wanted(late, 1) * with_rate - v)

    def slope(now: float, x: Array) -> Array:
        return np.array([x[1], (torque(now, *x) - B * x[1] - K * x[0]) / M])

    for w, window in enumerate(windows):
        times = t[window]
        states = solve_ivp(slope, times[[0, -1]], [0.05, 0], t_eval=times, max_step=5e-3, rtol=1e-9, atol=1e-11).y
        np.testing.assert_allclose(found.q[0, w, : len(times)], states[0], rtol=0, atol=2e-6)
        np.testing.assert_allclose(found.v[0, w, : len(times)], states[1], rtol=0, atol=2e-5)
        np.testing.assert_allclose(found.tau[0, w, : len(times)], torque(times, *states), rtol=0, atol=1e-3)


def test_joints_with_torque_and_with_a_controller_together(robot_of: ReadRobot) -> None:
    """And the torque of the one is not the other's."""
    t, nan = clock(1000, 250), np.full(1000, np.nan)
    log = log_of(
        t, ("x1", "x2"), q=np.stack([0.1 + 0 * t, -0.1 + 0 * t], axis=1), tau=np.stack([force(t), nan], axis=1),
        qcmd=np.stack([nan, wanted(t)], axis=1),
    )  # fmt: skip
    signals = signals_of(log, controller={"kp": {"x2": KP}})
    config = {"friction": friction(["x1", "x2"], [B, B], [0, 0]), "effects": [SPRING]}
    (found,) = run(mechanism(robot_of(sliders(M, M)), config), signals, [slice(0, 1000)])
    np.testing.assert_allclose(found.q[0, 0], exact(t, force(t), 0.1, 0.0)[0], rtol=0, atol=1e-8)
    other = solve_ivp(
        lambda now, x: [x[1], (KP * (wanted(now) - x[0]) - B * x[1]) / M], (0, t[-1]), [-0.1, 0], t_eval=t,
        rtol=1e-10, atol=1e-12,
    ).y  # fmt: skip
    np.testing.assert_allclose(found.q[1, 0], other[0], rtol=0, atol=5e-5)


@pytest.mark.parametrize("kp", [KP, 0.0])
def test_a_long_window_is_one_motion(robot_of: ReadRobot, kp: float) -> None:
    """With friction that sticks; in pieces or not, it begins once. Without gain nothing pulls the pieces together."""
    t = clock(5000, 1000)
    names = {"tau": force(t)} if not kp else {"qcmd": wanted(t)}
    signals = signals_of(log_of(t, q=0.05 + 0.02 * np.sin(t), **names), controller={"kp": {"x1": kp}})
    level = 4.0 if kp else 2.0
    machine = mechanism(robot_of(sliders(M)), {"friction": friction(["x1"], [B], [level]), "effects": [SPRING]})
    shares: list[float] = []
    (found,) = simulate(machine, [Window(signals, slice(0, 5000))], shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1

    def input_torque(now: Array, q: Array, v: Array, rollout_ids: NDArray[np.intp]) -> Array:
        return kp * (wanted(now)[None] - q) if kp else force(now)[None]

    torque = torque_of_one_state(input_torque)
    witness = StickSlip(
        lambda q, v: (np.array([[M]]), np.zeros(1)),
        lambda now, q, v: torque(now, q, v) - B * v - K * q,
        lambda v: np.array([level]),
    )
    q0, v0 = measured_states(signals, [0])
    expected, _ = witness.run(q0[:, 0], v0[:, 0], t)
    assert len(witness.changes) > 6
    assert any(s == 0 for _, _, s in witness.changes)
    np.testing.assert_allclose(found.q[:, 0], expected, rtol=0, atol=2e-5)


def test_windows_do_not_know_of_each_other_and_come_in_order(robot_of: ReadRobot) -> None:
    """More than are simulated at once; the share that is done only grows."""
    t = clock(1300, 250)
    signals = signals_of(log_of(t, q=0.1 * np.sin(7 * t), tau=force(t)))
    config = {"friction": friction(["x1"], [B], [1.0]), "effects": [SPRING]}
    machine = mechanism(robot_of(sliders(M)), config)
    windows = [slice(4 * i, 4 * i + 5 + i % 7) for i in range(300)]
    shares: list[float] = []
    found = list(simulate(machine, [Window(signals, part) for part in windows], shares.append))
    assert [window.part for some in found for window in some.windows] == windows
    assert len(found) > 1
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1)
    together = [x.q[0, w, : len(window)] for x in found for w, window in enumerate(x.windows)]
    for i in (0, 1, 130, 299):
        (one,) = run(machine, signals, [windows[i]])
        np.testing.assert_allclose(one.q[0, 0], together[i], rtol=0, atol=1e-12)


def test_windows_of_several_logs_advance_together(robot_of: ReadRobot) -> None:
    """Each has its own clock, torque or command, gains and delay."""
    machine = mechanism(robot_of(sliders(M)), {"friction": friction(["x1"], [B], [1.0]), "effects": [SPRING]})
    slow, medium, fast = clock(300, 90), clock(800, 250), clock(3000, 1000)
    controller = {"kp": {"x1": KP}, "kd": {"x1": KD}, "delay": 0.0201}
    weak = {"kp": {"x1": KP / 2}, "delay": 0.0034}
    logs = [
        signals_of(log_of(slow, q=0.1 * np.sin(7 * slow), tau=force(slow)), filter={"cutoff_hz": 10}),
        signals_of(log_of(medium, q=0.05 + 0 * medium, qcmd=wanted(medium)), controller=controller),
        signals_of(log_of(fast, q=0.1 * np.sin(7 * fast), tau=2 * force(fast))),
        signals_of(log_of(fast, q=0.02 + 0 * fast, qcmd=wanted(fast), vcmd=wanted(fast, 1)), controller=weak),
    ]
    windows = [Window(log, slice(start, start + 100 + 10 * i)) for i, log in enumerate(logs) for start in (0, 30, 60)]
    (together,) = simulate(machine, windows, lambda share: None)
    assert together.windows == tuple(windows)
    for w, window in enumerate(windows):
        (alone,) = simulate(machine, [window], lambda share: None)
        for name in ("q", "v", "tau"):
            own = getattr(together, name)[:, w, : len(window)]
            np.testing.assert_allclose(own, getattr(alone, name)[:, 0], rtol=0, atol=1e-12)


def test_a_contact_during_one_log_is_not_felt_in_the_others(robot_of: ReadRobot) -> None:
    """Though all are simulated with one model."""
    parameters = {"log": "log.csv", "windows": [[0.2, 0.6]], "wrench": [5.0, 0, 0, 0, 0, 0]}
    push = {"effect": "external_contact", "link": "m1", "parameters": parameters}
    t = clock(250, 250)
    pushed = signals_of(log_of(t, q=0.1 + 0 * t, tau=force(t)))
    other = signals_of(replace(pushed.log, path=Path("other.csv")))
    parts = [Window(log, slice(0, 250)) for log in (pushed, other, pushed)]
    free = mechanism(robot_of(sliders(M)), CONFIG)
    with_push = mechanism(robot_of(sliders(M)), {**CONFIG, "effects": [SPRING, push]})
    (expected,) = simulate(free, parts[:1], lambda share: None)
    found = [some.q[0, w] for some in simulate(with_push, parts, lambda share: None) for w in range(len(some.windows))]
    assert np.abs(found[0] - expected.q[0, 0]).max() > 0.01
    np.testing.assert_allclose(found[1], expected.q[0, 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found[2], found[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize(("is_driven", "sizes"), [(False, [256, 44, 12, 2, 1]), (True, [256, 44, 12, 1, 1, 1])])
def test_what_advances_together_is_bounded(
    robot_of: ReadRobot, monkeypatch: pytest.MonkeyPatch, is_driven: bool, sizes: list[int]
) -> None:
    """Long windows of many logs would take much memory; few under a controller are done one by one, in pieces."""
    monkeypatch.setattr(simulation, "_MAX_ARRAY_ELEMENTS", 4000)
    t = clock(2000, 250)
    driven = log_of(t, q=0.1 + 0 * t, qcmd=wanted(t))
    config = {"controller": {"kp": {"x1": KP}}} if is_driven else {}
    signals = signals_of(driven if is_driven else log_of(t, q=0.1 + 0 * t, tau=force(t)), **config)
    short, medium, long = [Window(signals, slice(0, count)) for count in (10, 200, 2000)]
    windows = [short] * 300 + [medium] * 12 + [long] * 2 + [short]
    found = simulate(mechanism(robot_of(sliders(M)), CONFIG), windows, lambda share: None)
    assert [len(some.windows) for some in found] == sizes


@pytest.mark.parametrize("speed", [1e10, 2e3])  # m/s
def test_a_rollout_that_runs_away_is_stopped_and_told(robot_of: ReadRobot, speed: float) -> None:
    t = clock(900, 250)
    tau = force(t)
    tau[400:420] = speed * M / (t[420] - t[400])
    signals = signals_of(log_of(t, q=0 * t, tau=tau))
    (found,) = run(mechanism(robot_of(sliders(M)), CONFIG), signals, [slice(a, a + 300) for a in (0, 300, 600)])
    assert found.diverged.tolist() == [False, True, False]
    assert np.isfinite(found.q).all()
    for w in (0, 2):
        part = slice(300 * w, 300 * w + 300)
        np.testing.assert_allclose(found.q[0, w], exact(t[part], tau[part], 0.0, 0.0)[0], rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("most", "limit"), [(1, "_MAX_STEPS"), (3, "_MAX_STEPS"), (1000, "_MAX_STEPS"), (1, "_MAX_STEP_ELEMENTS")]
)
def test_samples_are_the_same_however_many_steps_are_recorded_together(
    robot_of: ReadRobot, most: int, limit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With friction, whose changes cut steps, and with a rollout that diverges while others' steps wait."""
    t = clock(2100, 1000)
    tau = force(t)
    tau[1300:1310] = 3e5 * M
    signals = signals_of(log_of(t, q=0.02 * np.sin(7 * t), tau=tau))
    machine = mechanism(robot_of(sliders(M)), {"friction": friction(["x1"], [B], [1.0]), "effects": [SPRING]})
    windows = [slice(0, 1000), slice(1000, 2000), slice(1400, 2010), slice(2000, 2002)]
    (usual,) = run(machine, signals, windows)
    assert usual.diverged.tolist() == [False, True, False, False]
    monkeypatch.setattr(simulation, limit, most)
    monkeypatch.setattr(simulation, "_SAMPLES_AT_ONCE", 100 * most)
    shares: list[float] = []
    (found,) = simulate(machine, [Window(signals, part) for part in windows], shares.append)
    assert found.diverged.tolist() == usual.diverged.tolist()
    for w, window in enumerate(windows):
        for name in ("q", "v", "tau"):
            own = getattr(found, name)[:, w, : window.stop - window.start]
            expected = getattr(usual, name)[:, w, : window.stop - window.start]
            np.testing.assert_allclose(own, expected, rtol=0, atol=1e-12, equal_nan=False)
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert len(shares) > 500 / most


@pytest.mark.parametrize(("measured", "diverges"), [(30.0, False), (10.0, True)])  # m/s
def test_what_moves_fast_in_the_log_may_be_faster(robot_of: ReadRobot, measured: float, diverges: bool) -> None:
    """Than 1,000 m/s: up to 100 times as fast as it was measured, in its own window."""
    t = clock(600, 250)
    tau = force(t)
    tau[400:420] = 2e3 * M / (t[420] - t[400])
    q = np.where(t < t[300], 0.0, measured * (t - t[300]))
    signals = signals_of(log_of(t, q=q, tau=tau))
    (found,) = run(mechanism(robot_of(sliders(M)), CONFIG), signals, [slice(0, 300), slice(301, 600)])
    assert found.diverged.tolist() == [False, diverges]


def test_a_joint_that_has_no_inertia_cannot_be_simulated(robot_of: ReadRobot) -> None:
    t = clock(500, 250)
    signals = signals_of(log_of(t, ("j1",), q=0 * t, tau=0 * t))
    with pytest.raises(ModelError, match="cannot be simulated: a joint has zero or negative inertia"):
        run(mechanism(robot_of(chain(link(1))), {}), signals, [slice(0, 100)])


@pytest.mark.parametrize("rate", [250, 1000])
def test_measured_states_of_a_parabola_are_exact(rate: int) -> None:
    """At the ends and beside a gap, too, where it is another one."""
    t = clock(2 * rate, rate)
    t[rate:] += 0.5

    def parabola(t: Array, derivative: int) -> Array:
        later = t >= t[rate]
        a, b, c = np.where(later, -0.3, 0.4), np.where(later, 2.0, -1.0), np.where(later, 5.0, 3.0)
        return a + b * t + c * t**2 if not derivative else b + 2 * c * t

    q = np.stack([parabola(t, 0), -2 * parabola(t, 0)], axis=1)
    signals = signals_of(log_of(t, ("x1", "x2"), q=q, tau=0 * q))
    samples = [0, 1, 2, 100, rate - 2, rate - 1, rate, rate + 1, rate + 99, 2 * rate - 2, 2 * rate - 1]
    found_q, found_v = measured_states(signals, samples)
    np.testing.assert_allclose(found_q, q[samples].T, rtol=0, atol=1e-11)
    speed = parabola(t, 1)[samples]
    np.testing.assert_allclose(found_v, [speed, -2 * speed], rtol=0, atol=1e-8)


def test_measured_states_are_smoother_than_samples() -> None:
    """By white noise, the position of a parabola through 13 samples is half as wrong as a sample of it."""
    t, rng = clock(5000, 1000), np.random.default_rng(0)
    signals = signals_of(log_of(t, q=np.sin(2 * t) + 1e-3 * rng.normal(size=5000), tau=0 * t))
    samples = np.arange(100, 4900, 20)
    q, v = measured_states(signals, samples.tolist())
    assert np.std(q[0] - np.sin(2 * t[samples])) < 0.6e-3
    assert np.std(v[0] - 2 * np.cos(2 * t[samples])) < 0.1  # of two neighbours' difference it would be 1.4


def test_windows_cover_parts_of_a_log() -> None:
    t = clock(1000, 250)
    signals = signals_of(log_of(t, q=np.sin(t), tau=0 * t))
    (usable,) = signals.ranges
    assert 0 < usable.start < usable.stop < 1000
    whole = [slice(0, 300), slice(300, 600), slice(600, 900), slice(900, 1000)]
    assert split_into_windows(signals, signals.ranges, 1.2) == whole
    again = [slice(0, 301), slice(300, 601), slice(600, 901), slice(900, 1000)]
    assert split_into_windows(signals, signals.ranges, 1.2, share_ends=True) == again
    assert split_into_windows(signals, signals.ranges, None) == [slice(0, 1000)]
    parts = [slice(usable.start, 400), slice(500, 700)]
    assert split_into_windows(signals, parts, 0.6) == [
        slice(0, 150), slice(150, 300), slice(300, 400), slice(500, 650), slice(650, 700),
    ]  # fmt: skip
    assert split_into_windows(signals, [slice(500, 651)], 0.6) == [slice(500, 650)]  # one sample is no motion
    assert split_into_windows(signals, [slice(500, 700)], None) == [slice(500, 700)]
    assert split_into_windows(signals, [slice(500, 504)], 1e-9) == [slice(500, 501), slice(501, 502), slice(502, 503)]
