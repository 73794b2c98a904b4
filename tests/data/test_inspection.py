"""Clean logs raise no alarm, and every defect put into one is named and nothing else."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable

import numpy as np
import pytest
from defects import (
    another_joints_velocity,
    at_rest,
    backward,
    clipped,
    constant,
    drop,
    duplicates,
    exchanged_velocities,
    frozen,
    gap,
    held_samples,
    hidden_jitter,
    in_degrees,
    lag,
    late_and_slow,
    late_stamps,
    long_gap,
    not_finite,
    position_controlled,
    repeated_rows,
    rounded,
    scale,
    seldom_moving,
    skipped_samples,
    wrapped,
)
from inspected import JOINTS, Signals, clean_signals, inspect, motion, torque

from idtool.data.inspection import data_fault


@pytest.mark.parametrize("rate", [200.0, 1000.0])
@pytest.mark.parametrize("joints", [1, 3])
def test_a_clean_log_raises_no_finding(rate: float, joints: int) -> None:
    assert inspect(clean_signals(rate=rate, joints=joints)).findings == ()


def test_a_torque_without_noise_may_come_from_a_sensor_and_a_filter() -> None:
    inspection = inspect(clean_signals(noise=0.0))
    assert inspection.findings == ()
    source = inspection.joints[JOINTS[0]].torque
    assert source
    assert source.kind == "unknown"
    assert source.reason == "it has no noise: it was computed, or a sensor's torque was smoothed"


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


DEFECTS: dict[str, Defect] = {
    "v late": (lag(2e-3), "note", "hip", "v lags the derivative of q by 2.00 ms"),
    "v early": (lag(-2e-3), "note", "hip", "v leads the derivative of q by 2.00 ms"),
    "v missing": (drop("v"), "note", "hip", "v is missing"),
    "v in degrees": (scale("v", 180 / np.pi), "problem", "hip", "v is 57."),
    "v's sign turned": (scale("v", -1.0), "problem", "hip", "v is -1 times the derivative of q"),
    "v a little off": (scale("v", 1.1), "warning", "hip", "v is 1.1 times the derivative of q"),
    "v of another joint": (another_joints_velocity, "problem", "hip", "of the power of v in the band of the motion"),
    "v not filled": (constant("v"), "problem", "hip", "v is 0 throughout while q moves"),
    "v coarse": (rounded("v", 0.3), "warning", "hip", "v has a resolution of 0.3"),
    "v saturated": (clipped("v", 2.0), "warning", "hip", "v stays at its extremes, -2 and 2"),
    "tau missing": (drop("tau"), "problem", "hip", "tau is missing"),
    "tau from a controller": (position_controlled, "note", "hip", "tau is missing, but qcmd is available"),
    "tau not filled": (constant("tau"), "problem", "hip", "tau is 0 throughout while q moves"),
    "tau not filled, with a sign": (constant("tau", -0.0), "problem", "hip", "tau is 0 throughout while q moves"),
    "tau coarse": (rounded("tau", 0.3), "warning", "hip", "tau has a resolution of 0.3"),
    "tau saturated": (clipped("tau", 1.5), "warning", "hip", "tau stays at its extremes, -1.5 and 1.5"),
    "tau held": (held_samples("tau", 4), "warning", "hip", "of the samples of tau repeat the previous one"),
    "tau not finite": (not_finite, "warning", "hip", "tau is not finite in 10 samples"),
    "q coarse": (rounded("q", 2 * np.pi / 1000), "warning", "hip", "q has a resolution of 0.00628"),
    "q held": (held_samples("q", 2), "warning", "hip", "50.0 % of the samples of q repeat"),
    "q frozen": (
        frozen("q"),
        "warning",
        "hip",
        "q keeps one value for 0.2 s in total while the joint moves, first 4",
    ),
    "v frozen": (
        frozen("v"),
        "warning",
        "hip",
        "v keeps one value for 0.2 s in total while the joint moves, first 4",
    ),
    "tau frozen": (frozen("tau"), "warning", "hip", "tau keeps one value for 0.2 s in total while the joint moves"),
    "q clipped": (clipped("q", 0.4), "warning", "hip", "q stays at its extremes, -0.4 and 0.4"),
    "q wrapped": (wrapped, "problem", "hip", "of q by about a full turn"),
    "q missing": (drop("q"), "problem", "hip", "q is missing"),
    "q and v in degrees": (in_degrees, "note", "hip", "q spans 88."),
    "joint at rest": (at_rest, "warning", "hip", "the joint does not move"),
    "joint mostly at rest": (seldom_moving, "note", "hip", "the joint is at rest 7"),
    "gap": (gap, "note", None, "1 gap, 0.25 s in total"),
    "long gap": (long_gap, "warning", None, "1 gap, 2 s in total; the longest is 2 s, 14.999 s after the start"),
    "clock set back": (backward, "warning", None, "1 stamp earlier than the previous one"),
    "duplicate stamps": (duplicates, "note", None, "15 stamps equal to the previous one"),
    "late stamps": (late_stamps, "warning", None, "the time between stamps varies by 0.16 sample periods rms"),
    "samples off their stamps": (hidden_jitter, "warning", None, "stamps by 0.25 sample periods rms"),
    "rows repeated": (repeated_rows(8), "warning", None, "12.5 % of the samples repeat"),
    "samples skipped": (skipped_samples, "warning", None, "2.9 % of the steps are two or more sample periods long"),
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_raises_its_finding_and_no_other(defect: str) -> None:
    spoil, severity, joint, what = DEFECTS[defect]
    signals = clean_signals()
    spoil(signals)
    (finding,) = inspect(signals).findings
    assert (finding.severity, finding.subject) == (severity, joint)
    assert what in finding.message
    assert finding.advice
    assert data_fault(finding) == FAULTS.get(defect)


# The faults among the defects: the others are too little to matter, or for the model to decide, or of no kind.
FAULTS = {
    "v late": "velocity_lag",
    "v early": "velocity_lag",
    "v not filled": "stale",
    "v saturated": "clipped",
    "v frozen": "stale",
    "tau not filled": "stale",
    "tau not filled, with a sign": "stale",
    "tau held": "stale",
    "tau frozen": "stale",
    "q held": "stale",
    "q frozen": "stale",
    "q clipped": "clipped",
    "q wrapped": "wrapped_position",
    "long gap": "dropped_samples",
    "late stamps": "time_jitter",
    "samples off their stamps": "time_jitter",
    "rows repeated": "stale",
    "samples skipped": "dropped_samples",
}


@pytest.mark.parametrize("every", [30, 120])
def test_a_hiccup_is_noted_and_no_fault(every: int) -> None:
    signals = clean_signals()
    repeated_rows(every)(signals)
    (finding,) = inspect(signals).findings
    assert (finding.severity, data_fault(finding)) == ("note", None)


def test_velocities_that_are_exchanged_are_named_at_both_joints() -> None:
    signals = clean_signals()
    exchanged_velocities(signals)
    findings = inspect(signals).findings
    assert [(f.severity, f.subject, data_fault(f)) for f in findings] == [
        ("problem", "hip", "wrong_joint_order"),
        ("problem", "knee", "wrong_joint_order"),
    ]
    assert "v of knee is the derivative of q of hip" in findings[0].message


def test_a_joint_at_an_end_stop_is_not_clipped() -> None:
    """Its position rests at the extreme, and so does its velocity."""
    s = clean_signals(noise=0.0)
    q = motion(s["t"], 1)
    s["q"][:, 1] = np.clip(q, -0.4, 0.4)
    s["v"][:, 1] = np.where(np.abs(q) < 0.4, s["v"][:, 1], 0.0)
    assert [f for f in inspect(s).findings if f.severity != "note"] == []


def test_frozen_stretches_and_jumps_are_sought_in_every_sample() -> None:
    """Of a log that is longer than its statistics are taken from."""
    s = clean_signals(seconds=300.0)
    for start in range(20_000, 300_000, 20_000):
        s["tau"][start : start + 40, 1] = s["tau"][start, 1]
    s["q"][155_500:, 2] += 2 * np.pi
    findings = {finding.subject: finding for finding in inspect(s).findings}
    assert set(findings) == {"hip", "knee"}
    assert findings["hip"].message.startswith("tau keeps one value for")
    assert "first 20.000 s into the log" in findings["hip"].message
    assert findings["knee"].message == "1 jump of q by about a full turn"


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
    assert "with a delay of 1 sample period," in (sources[2].reason if sources[2] else "")


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
    assert (source.kind, "of its noise comes from q and v" in source.reason) == ("commanded", True)


@pytest.mark.parametrize("step", [0.1, 0.25])
def test_a_torque_whose_rounding_hides_its_noise_is_unknown(step: float) -> None:
    s = clean_signals()
    s["tau"][:, 1] = np.round(torque(s["t"], 1) / step) * step
    source = inspect(s).joints["hip"].torque
    assert source
    assert source.kind == "unknown"


def test_motion_too_fast_for_its_sampling_is_named() -> None:
    findings = inspect(clean_signals(seconds=120.0, rate=25.0)).findings
    assert [f.subject for f in findings] == list(JOINTS)
    assert all("99 % of the velocity's power lies below 6" in f.message for f in findings)


def test_many_short_segments() -> None:
    s = clean_signals(seconds=20.0)
    s["q"][::10, 0] = np.nan
    inspection = inspect(s)
    assert inspection.segments == 2000
    assert (inspection.stamps.gaps, inspection.joints["abad"].signals["q"].not_finite) == (0, 2000)
    first = inspection.findings[0]
    assert (first.severity, first.subject) == ("problem", None)
    assert (
        first.message
        == "gaps and missing values divide the log into 2000 segments: 100 % of it is in segments shorter than 0.5 s"
    )
    assert "hardly any usable data remain for the fit" in first.advice


@pytest.mark.parametrize(("stretches", "severity"), [(15, "problem"), (3, "warning"), (1, None)])
def test_values_that_are_missing_here_and_there(stretches: int, severity: str | None) -> None:
    """They leave so many stretches of 0.4 s in ten seconds, and one long one."""
    s = clean_signals(seconds=10.0)
    s["tau"][400 * np.arange(stretches + 1), 2] = np.nan
    found = [f.severity for f in inspect(s).findings if "segments shorter than 0.5 s" in f.message]
    assert found == [severity] * (severity is not None)


def test_a_drifting_clock_is_no_jitter() -> None:
    """It strays by many samples in all, and by hardly any from one to the next: what a fit asks for."""
    s = clean_signals()
    s["t"] += 0.02 * np.sin(s["t"] / 5)
    inspection = inspect(s)
    assert inspection.stamps.jitter_rms_ms > 5
    assert inspection.stamps.step_jitter == pytest.approx(0.004 / np.sqrt(2), rel=0.1)
    assert inspection.findings == ()


def test_a_lag_too_small_to_matter_raises_no_finding() -> None:
    s = clean_signals()
    late_and_slow(s)
    inspection = inspect(s)
    velocity = inspection.joints["hip"].velocity
    assert velocity
    assert velocity.lag_ms == pytest.approx(0.5, abs=0.01)
    assert inspection.findings == ()


def test_an_inspection_does_not_contradict_itself() -> None:
    """Where differentiating q is noisy it is not asked for because v lags, which a fit undoes."""
    s = clean_signals()
    late_stamps(s)
    lag(5e-3)(s)
    said = {finding.advice for finding in inspect(s).findings}
    assert len(said) == 2
    assert not [meaning for meaning in said if "velocity: " in meaning]


@pytest.mark.parametrize("per_second", [1e3, 1e6])
def test_a_velocity_is_not_blamed_for_the_unit_of_the_times(per_second: float) -> None:
    s = clean_signals()
    s["t"] = s["t"] * per_second
    inspection = inspect(s)
    (finding,) = inspection.findings
    assert (finding.severity, data_fault(finding), finding.subject) == ("problem", "wrong_unit", None)
    assert ("in ms, according to v" if per_second == 1e3 else "in us, according to v") in finding.message
    assert inspection.reading == ()


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
    assert set(plain["findings"][0]) == {"code", "severity", "subject", "message", "advice"}


def test_findings_of_one_meaning_stand_side_by_side() -> None:
    s = clean_signals()
    s["v"] *= 1.1
    s["tau"] = np.clip(s["tau"], -1.5, 1.5)
    found = inspect(s).findings
    assert len(found) == 6
    assert len(list(itertools.groupby(found, key=lambda f: f.advice))) == 2
