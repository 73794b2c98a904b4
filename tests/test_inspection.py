"""Clean logs raise no alarm, every defect put into one is named and nothing else, and the measures find the truth."""

import itertools
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


def late_and_slow(s: Signals) -> None:
    s["q"][:, 1], s["v"][:, 1] = motion(s["t"] / 5, 1), motion(s["t"] / 5 - 1e-4, 1, 1) / 5


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


def in_degrees(s: Signals) -> None:
    s["q"][:, 1] *= 180 / np.pi
    s["v"][:, 1] *= 180 / np.pi


def position_controlled(s: Signals) -> None:
    s["qcmd"] = np.stack([motion(s["t"] + 5e-3, j) for j in range(3)], axis=1)
    s["tau"][:, 1] = np.nan


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
    "v a little late": (late_and_slow, "note", "hip", "v lags the derivative of q by 0.5"),
    "v missing": (drop("v"), "note", "hip", "v is missing"),
    "v in degrees": (scale("v", 180 / np.pi), "problem", "hip", "v is 57."),
    "v's sign turned": (scale("v", -1.0), "problem", "hip", "v is -1 times the derivative of q"),
    "v a little off": (scale("v", 1.1), "warning", "hip", "v is 1.1 times the derivative of q"),
    "v of another joint": (another_joints_velocity, "problem", "hip", "of v's power in the motion's band"),
    "v not filled": (constant("v"), "problem", "hip", "v is 0 throughout while q moves"),
    "v coarse": (rounded("v", 0.3), "warning", "hip", "v comes in steps of 0.3"),
    "v saturated": (clipped("v", 2.0), "warning", "hip", "v sits at its extremes, -2 and 2"),
    "tau missing": (drop("tau"), "problem", "hip", "tau is missing"),
    "tau from a controller": (position_controlled, "note", "hip", "tau is missing, qcmd is there"),
    "tau not filled": (constant("tau"), "problem", "hip", "tau is 0 throughout while q moves"),
    "tau coarse": (rounded("tau", 0.3), "warning", "hip", "tau comes in steps of 0.3"),
    "tau saturated": (clipped("tau", 1.5), "warning", "hip", "tau sits at its extremes, -1.5 and 1.5"),
    "tau held": (held("tau", 4), "warning", "hip", "of tau's samples repeat the one before"),
    "tau not finite": (not_finite, "warning", "hip", "10 samples of tau not finite"),
    "q coarse": (rounded("q", 2 * np.pi / 1000), "warning", "hip", "q comes in steps of 0.00628"),
    "q held": (held("q", 2), "warning", "hip", "50.0% of q's samples repeat"),
    "q wrapped": (wrapped, "problem", "hip", "of q by about a full turn"),
    "q missing": (drop("q"), "problem", "hip", "q is missing"),
    "q and v in degrees": (in_degrees, "note", "hip", "q spans 88."),
    "joint at rest": (at_rest, "warning", "hip", "the joint does not move"),
    "joint mostly at rest": (seldom_moving, "note", "hip", "the joint stands still 7"),
    "gap": (gap, "note", None, "1 gap, 0.25 s in all"),
    "long gap": (long_gap, "warning", None, "1 gap, 2 s in all; the longest, 2 s, 14.999 s into the log"),
    "clock set back": (backward, "warning", None, "1 stamp earlier than the one before"),
    "duplicate stamps": (duplicates, "note", None, "15 stamps equal to the one before"),
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


def test_a_control_law_is_told_from_a_measurement() -> None:
    """A noise-free law, the same with noise of its own, the same a sample late."""
    s = clean_signals()
    rng = np.random.default_rng(3)
    s["qcmd"] = s["q"] + 0.05 * np.stack([motion(2 * s["t"], j) for j in range(3)], axis=1)
    tau = 20.0 * (s["qcmd"] - s["q"]) - 1.0 * s["v"]
    s["tau"] = tau + np.array([0.0, 0.02, 0.0]) * rng.normal(size=tau.shape)
    s["tau"][1:, 2] = tau[:-1, 2]
    joints = inspect(s).joints
    sources = [joints[name].torque for name in JOINTS]
    assert [source.kind for source in sources if source] == ["commanded", "measured", "commanded"]
    assert "-20 q -1 v +20 qcmd" in (sources[0].reason if sources[0] else "")
    assert "1 samples late" in (sources[2].reason if sources[2] else "")


def test_a_clipped_command_is_still_a_command() -> None:
    s = clean_signals()
    s["tau"] = np.clip(-10.0 * s["q"] - 1.0 * s["v"], -4.0, 4.0)
    source = inspect(s).joints["hip"].torque
    assert source
    assert source.kind == "commanded"


def test_feedback_through_an_unknown_law_is_known_by_its_noise() -> None:
    s = clean_signals()
    s["tau"][:, 1] = torque(s["t"], 1) - 30.0 * np.tanh(s["v"][:, 1] / 4)
    source = inspect(s).joints["hip"].torque
    assert source
    assert (source.kind, "of its noise is that of q and v" in source.reason) == ("commanded", True)


@pytest.mark.parametrize("step", [0.1, 0.25])
def test_a_torque_whose_rounding_hides_its_noise_is_unknown(step: float) -> None:
    s = clean_signals()
    s["tau"][:, 1] = np.round(torque(s["t"], 1) / step) * step
    source = inspect(s).joints["hip"].torque
    assert source
    assert source.kind == "unknown"


def test_motion_too_fast_for_its_sampling_is_named() -> None:
    findings = inspect(clean_signals(seconds=120.0, rate=25.0)).findings
    assert [f.joint for f in findings] == list(JOINTS)
    assert all("99 % of the velocity's power reaches up to 6" in f.what for f in findings)


def test_many_short_segments() -> None:
    s = clean_signals(seconds=20.0)
    s["q"][::10, 0] = np.nan
    inspection = inspect(s)
    assert inspection.segments == 2000
    assert (inspection.stamps.gaps, inspection.joints["abad"].signals["q"].not_finite) == (0, 2000)


@pytest.mark.parametrize("samples", [0.0, 0.3, 1.0, -2.4, 7.7])
@pytest.mark.parametrize(("seconds", "rate"), [(20.0, 1000.0), (23.5, 200.0), (3.0, 1000.0)])
def test_velocity_lag_is_exact_without_noise(samples: float, seconds: float, rate: float) -> None:
    t = np.arange(round(seconds * rate)) / rate
    lag, gain, agreement = velocity_lag(motion(t), 1.3 * motion(t - samples / rate, 0, 1), 1 / rate)
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
    lag, gain, agreement = velocity_lag(q, v, 1 / rate)
    assert lag * rate == pytest.approx(samples, abs=0.05)
    assert gain == pytest.approx(1.0, abs=2e-3)
    assert agreement > 0.999


@pytest.mark.parametrize("cutoff", [80.0, 160.0])
def test_a_low_pass_comes_out_as_its_low_frequency_delay(cutoff: float) -> None:
    fine, rate = 20, 1000.0
    t = np.arange(round(20 * rate * fine)) / (rate * fine)
    pole = np.exp(-2 * np.pi * cutoff / (rate * fine))
    v = lfilter([1 - pole], [1, -pole], motion(t, 0, 1))[::fine]
    lag, gain, _ = velocity_lag(motion(t[::fine]), v, 1 / rate)
    assert lag == pytest.approx(pole / (1 - pole) / (rate * fine), rel=0.02)
    assert gain == pytest.approx(1.0, abs=5e-3)


def test_velocity_lag_says_when_nothing_agrees() -> None:
    t = np.arange(20000) * 1e-3
    noise = np.random.default_rng(0).normal(size=len(t))
    assert velocity_lag(motion(t), noise, 1e-3)[2] < 0.01
    assert np.isnan(velocity_lag(motion(t), np.zeros(len(t)), 1e-3)).all()
    assert np.isnan(velocity_lag(motion(t)[:50], motion(t, 0, 1)[:50], 1e-3)).all()


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


def test_the_band_and_the_time_at_rest_are_measured() -> None:
    s = clean_signals(seconds=60.0)
    joint = inspect(s).joints["abad"]
    assert joint.band_hz == pytest.approx(6.0, abs=0.3)
    assert joint.standstill < 0.1
    still = inspect({**s, "v": np.full_like(s["v"], np.nan)}).joints["abad"]
    assert still.band_hz == pytest.approx(6.0, abs=0.3)


def test_a_long_log_is_inspected_by_its_stretches() -> None:
    s = clean_signals(seconds=200.0)
    inspection = inspect(s)
    assert inspection.findings == ()
    assert inspection.samples == 200_000
    assert inspection.joints["knee"].signals["q"].maximum == s["q"][:, 2].max()


@pytest.mark.parametrize("samples", [2, 3, 17, 40, 65, 130, 400])
def test_short_logs_and_senseless_values_are_inspected_too(samples: int) -> None:
    s = clean_signals(seconds=samples / 1000)
    for factor in (1.0, 0.0, 1e300):
        x = {name: y * factor if name in ("q", "v") else y for name, y in s.items()}
        json.dumps(inspect(x).to_dict(), allow_nan=False)


def test_an_inspection_is_plain_values() -> None:
    s = clean_signals(seconds=5.0)
    another_joints_velocity(s)
    inspection = inspect(s)
    plain = json.loads(json.dumps(inspection.to_dict(), allow_nan=False))
    assert set(plain["joints"]) == set(JOINTS)
    assert plain["joints"]["abad"]["signals"]["q"]["maximum"] == s["q"][:, 0].max()
    assert plain["findings"][0]["severity"] == "problem"


@needs_data
def test_panda() -> None:
    """Its source ticks every millisecond; the logger did not, and v is filtered."""
    inspection = inspect_log(read_log(DATA / "panda" / "excitation.mcap"))
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
    inspection = inspect_log(read_log(DATA / "go2" / f"chirp_{run}.csv"))
    assert inspection.stamps.jitter_rms_ms < 1e-6
    assert inspection.stamps.sampling
    assert inspection.stamps.sampling.jitter_ms == pytest.approx(1.15, abs=0.15)
    assert len(inspection.joints) == 12
    for name, joint in inspection.joints.items():
        assert joint.signals["v"].step == pytest.approx(0.002022 if "calf" in name else 0.0038755, rel=1e-3)
        assert joint.velocity
        assert joint.velocity.lag_ms == pytest.approx(0.35, abs=0.4)
        assert joint.torque is None


def test_findings_of_one_meaning_stand_side_by_side() -> None:
    s = clean_signals()
    s["v"] *= 1.1
    s["tau"] = np.clip(s["tau"], -1.5, 1.5)
    found = inspect(s).findings
    assert len(found) == 6
    assert len(list(itertools.groupby(found, key=lambda f: f.meaning))) == 2
