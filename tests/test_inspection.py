"""Clean logs raise no alarm, every defect put into one is named and nothing else, and the measures find the truth."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from idtool.inspection import Inspection, inspect_log, jitter, quantisation, sample_steps, velocity_lag
from idtool.logs import read_log
from idtool.logs.log import Log, make_log

Array = NDArray[np.float64]
Signals = dict[str, Array]

DATA = Path(__file__).parents[2] / "shared" / "data"
JOINTS = ("abad", "hip", "knee")
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the shared development data is not here")


def motion(t: Array, joint: int = 0, derivative: int = 0) -> Array:
    """Sum of seven sines from 0.2 to 6 Hz with velocities of like size, or its derivative."""
    rng = np.random.default_rng(joint)
    w = 2 * np.pi * np.array([0.2, 0.5, 1.1, 1.9, 2.9, 4.3, 6.0]) * (1 + 0.05 * joint)
    phase, speed = rng.uniform(0, 2 * np.pi, len(w)), rng.uniform(0.3, 1.0, len(w))
    angle = np.outer(np.asarray(t), w) + phase + derivative * np.pi / 2
    return np.asarray(np.sin(angle) @ (speed * w ** (derivative - 1.0)))


def torque(t: Array, joint: int) -> Array:
    """Inertia, gravity and friction of a pendulum."""
    q, v, a = (motion(t, joint, d) for d in range(3))
    return np.asarray(0.05 * a + 2.0 * np.sin(q) + 0.1 * v + 0.3 * np.tanh(v / 0.02))


def clean_signals(seconds: float = 30.0, rate: float = 1000.0, noise: float = 1.0, joints: int = 3) -> Signals:
    t = np.arange(round(seconds * rate)) / rate
    rng = np.random.default_rng(7)
    levels = {"q": 1e-5, "v": 3e-3, "tau": 0.02}
    x = {
        "q": np.stack([motion(t, j) for j in range(joints)], axis=1),
        "v": np.stack([motion(t, j, 1) for j in range(joints)], axis=1),
        "tau": np.stack([torque(t, j) for j in range(joints)], axis=1),
    }
    return {"t": t} | {name: y + noise * levels[name] * rng.normal(size=y.shape) for name, y in x.items()}


def log_of(signals: Signals) -> Log:
    rest = {name: x for name, x in signals.items() if name != "t"}
    return make_log(Path("synthetic.csv"), signals["t"], JOINTS[: rest["q"].shape[1]], rest)


def inspect(signals: Signals) -> Inspection:
    return inspect_log(log_of(signals))


@pytest.mark.parametrize("rate", [200.0, 1000.0])
@pytest.mark.parametrize("joints", [1, 3])
def test_a_clean_log_raises_no_finding(rate: float, joints: int) -> None:
    assert inspect(clean_signals(rate=rate, joints=joints)).findings == ()


def test_a_log_without_noise_raises_no_warning() -> None:
    assert {(f.severity, f.what.split(":")[0]) for f in inspect(clean_signals(noise=0.0)).findings} == {
        ("note", "tau looks commanded")
    }


def test_fine_quantisation_jitter_and_rest_raise_no_warning() -> None:
    s = clean_signals()
    t = s["t"]
    at = np.clip(t, 5.0, 25.0)  # at rest at both ends
    s["q"] = np.stack([motion(at, j) for j in range(3)], axis=1)
    s["v"] = np.where(np.abs(t - 15.0)[:, None] < 10.0, s["v"], 0.0)
    for name, step in {"q": 2 * np.pi / 65536 / 6.33, "v": 4e-3, "tau": 0.03}.items():
        s[name] = np.round(s[name] / step) * step
    s["t"] = t + 2e-5 * np.random.default_rng(0).normal(size=len(t))
    assert [f for f in inspect(s).findings if f.severity != "note"] == []


# What each defect does to the clean signals, and the one finding it must raise: severity, joint, part of the sentence.
Defect = tuple[Callable[[Signals], None], str, str | None, str]


def lag(seconds: float) -> Callable[[Signals], None]:
    def late(s: Signals) -> None:
        s["v"][:, 1] = motion(s["t"] - seconds, 1, 1)

    return late


def drop(name: str) -> Callable[[Signals], None]:
    def without(s: Signals) -> None:
        s[name][:, 1] = np.nan

    return without


def scale(name: str, factor: float) -> Callable[[Signals], None]:
    def scaled(s: Signals) -> None:
        s[name][:, 1] *= factor

    return scaled


def constant(name: str) -> Callable[[Signals], None]:
    def stuck(s: Signals) -> None:
        s[name][:, 1] = 0.0

    return stuck


def rounded(name: str, step: float) -> Callable[[Signals], None]:
    def coarse(s: Signals) -> None:
        s[name][:, 1] = np.round(s[name][:, 1] / step) * step

    return coarse


def held(name: str, every: int) -> Callable[[Signals], None]:
    def slow(s: Signals) -> None:
        s[name][:, 1] = np.repeat(s[name][::every, 1], every)[: len(s["t"])]

    return slow


def clipped(name: str, level: float) -> Callable[[Signals], None]:
    def clip(s: Signals) -> None:
        s[name][:, 1] = np.clip(s[name][:, 1], -level, level)

    return clip


def another_joints_velocity(s: Signals) -> None:
    s["v"][:, 1] = s["v"][:, 2]


def not_finite(s: Signals) -> None:
    s["tau"][4000:4010, 1] = np.inf


def at_rest(s: Signals) -> None:
    rng = np.random.default_rng(0)
    for name, level in {"q": 1e-5, "v": 3e-3, "tau": 0.02}.items():
        s[name][:, 1] = 0.7 + level * rng.normal(size=len(s["t"]))


def seldom_moving(s: Signals) -> None:
    t = np.clip(s["t"], 10.0, 19.0)
    s["q"][:, 1] = motion(t, 1)
    s["v"][:, 1] = np.where(t == s["t"], motion(t, 1, 1), 0.0)


def wrapped(s: Signals) -> None:
    s["q"][:, 1] = np.mod(s["q"][:, 1], 2 * np.pi)


def gap(s: Signals) -> None:
    s["t"][15000:] += 0.25


def long_gap(s: Signals) -> None:
    s["t"][15000:] += 2.0


def backward(s: Signals) -> None:
    s["t"][15000:] -= 3.0


def duplicates(s: Signals) -> None:
    s["t"][1000::2000] = s["t"][999::2000]


def late_stamps(s: Signals) -> None:
    s["t"] += 4e-4 * np.random.default_rng(0).random(len(s["t"]))


def moved_to(s: Signals, t: Array) -> None:
    for j in range(3):
        for name, x in {"q": motion(t, j), "v": motion(t, j, 1), "tau": torque(t, j)}.items():
            s[name][:, j] += x - {"q": motion, "v": lambda t, j: motion(t, j, 1), "tau": torque}[name](s["t"], j)


def hidden_jitter(s: Signals) -> None:
    moved_to(s, s["t"] + 2.5e-4 * np.random.default_rng(0).normal(size=len(s["t"])))


def repeated_rows(s: Signals) -> None:
    rows = np.arange(0, len(s["t"]), 8)[1:]
    for name in ("q", "v", "tau"):
        s[name][rows] = s[name][rows - 1]


def skipped_samples(s: Signals) -> None:
    t = np.cumsum(np.random.default_rng(0).choice([1.0, 2.0], size=len(s["t"]), p=[0.97, 0.03])) * 1e-3
    moved_to(s, t)
    for name in ("q", "v", "tau"):
        s[name] = s[name][: len(t)]


DEFECTS: dict[str, Defect] = {
    "v late": (lag(2e-3), "warning", "hip", "v lags the derivative of q by 2"),
    "v early": (lag(-2e-3), "warning", "hip", "v leads the derivative of q by 2"),
    "v a little late": (lag(3e-4), "note", "hip", "v lags the derivative of q by 0.3"),
    "v missing": (drop("v"), "note", "hip", "v is missing"),
    "v in degrees": (scale("v", 180 / np.pi), "problem", "hip", "v is 57.3 times the derivative of q"),
    "v's sign turned": (scale("v", -1.0), "problem", "hip", "v is -1 times the derivative of q"),
    "v a little off": (scale("v", 1.1), "warning", "hip", "v is 1.1 times the derivative of q"),
    "v of another joint": (another_joints_velocity, "problem", "hip", "of v's power in the motion's band"),
    "v not filled": (constant("v"), "problem", "hip", "v is 0 throughout while q moves"),
    "v coarse": (rounded("v", 0.3), "warning", "hip", "v comes in steps of 0.3"),
    "v saturated": (clipped("v", 2.0), "warning", "hip", "v sits at its extremes, -2 and 2"),
    "tau missing": (drop("tau"), "problem", "hip", "tau is missing"),
    "tau not filled": (constant("tau"), "problem", "hip", "tau is 0 throughout while q moves"),
    "tau coarse": (rounded("tau", 0.3), "warning", "hip", "tau comes in steps of 0.3"),
    "tau saturated": (clipped("tau", 1.5), "warning", "hip", "tau sits at its extremes, -1.5 and 1.5"),
    "tau held": (held("tau", 4), "warning", "hip", "of tau's samples repeat the one before"),
    "tau not finite": (not_finite, "warning", "hip", "10 samples of tau are not finite"),
    "q coarse": (rounded("q", 2 * np.pi / 1000), "warning", "hip", "q comes in steps of 0.00628"),
    "q held": (held("q", 2), "warning", "hip", "50.0% of q's samples repeat"),
    "q wrapped": (wrapped, "problem", "hip", "by about a full turn"),
    "joint at rest": (at_rest, "warning", "hip", "the joint does not move"),
    "joint mostly at rest": (seldom_moving, "note", "hip", "the joint stands still 7"),
    "gap": (gap, "note", None, "1 gaps, 0.25 s in all"),
    "long gap": (long_gap, "warning", None, "1 gaps, 2 s in all; the longest, 2e+03 ms, at 14.999 s"),
    "clock set back": (backward, "warning", None, "1 stamps lie before the one before"),
    "duplicate stamps": (duplicates, "note", None, "15 stamps equal the one before"),
    "late stamps": (late_stamps, "warning", None, "the stamps stray from an even clock by 0.115 ms rms"),
    "samples off their stamps": (hidden_jitter, "warning", None, "the samples were taken 0.25"),
    "rows repeated": (repeated_rows, "warning", None, "12.5% of the samples repeat"),
    "samples skipped": (skipped_samples, "note", None, "2.9% of the steps took the time of two samples"),
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_raises_its_finding_and_no_other(defect: str) -> None:
    spoil, severity, joint, what = DEFECTS[defect]
    signals = clean_signals()
    spoil(signals)
    (finding,) = inspect(signals).findings
    assert (finding.severity, finding.joint) == (severity, joint)
    assert what in finding.what
    assert finding.meaning
