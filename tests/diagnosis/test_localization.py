"""Where a disagreement is found: torques of Pinocchio, to which is added what acts somewhere that is known."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from disturbed import (
    NOISE,
    RATE,
    SECONDS,
    WRENCH,
    Hidden,
    after_reversals,
    contact,
    experiment_of,
    motion,
    noisy,
    nothing,
    silent,
    torque_on_joint,
)
from numpy.typing import NDArray

from idtool.diagnosis.linearized_fit import linearize_fit
from idtool.diagnosis.localization import energy_windows, localize_residual, localize_unexplained
from idtool.diagnosis.regions import JointResidual, describe_region
from idtool.diagnosis.residual_maps import residual_maps
from idtool.diagnosis.residual_series import ResidualSeries, residual_series
from idtool.diagnosis.trial import with_effects
from idtool.robot.config import EffectEntry

FLOOR = {"j1": NOISE, "j2": NOISE}

REGIONS: list[tuple[Hidden, str, list[float]]] = [
    (noisy(lambda t, q, v, tau: np.abs(v) < 0.3), "at speeds below {} rad/s", [0.3]),
    (noisy(lambda t, q, v, tau: np.abs(v) > 2.0), "at speeds above {} rad/s", [2.0]),
    (noisy(lambda t, q, v, tau: q > 0.6), "at positions above {} rad", [0.6]),
    (noisy(lambda t, q, v, tau: np.abs(q - 0.3) < 0.2), "at positions between {} and {} rad", [0.1, 0.5]),
    (noisy(lambda t, q, v, tau: np.abs(q) > 0.7), "at positions below {} or above {} rad", [-0.7, 0.7]),
    (noisy(lambda t, q, v, tau: np.abs(tau) > 10), "at torques above {} N·m", [10.0]),
    (noisy(lambda t, q, v, tau: t < 4), "at the start of the log, up to {} s", [4.0]),
    (noisy(lambda t, q, v, tau: t > 12), "at the end of the log, from {} s", [12.0]),
    (noisy(lambda t, q, v, tau: np.abs(t - 6) < 1), "from {} to {} s", [5.0, 7.0]),
    (noisy(lambda t, q, v, tau: t > 0), "in the whole log", []),
    (torque_on_joint(0, after_reversals), "in the first {} rad after reversals", [0.05]),
    (torque_on_joint(0, lambda t, q, v, tau: 0.4 * np.sin(2 * np.pi * 6.3 * t)), "at {} Hz", [6.3]),
    (torque_on_joint(0, lambda t, q, v, tau: 0.4 * np.sin(28 * q + 1)), "at {} periods per turn", [28.0]),
]


@pytest.mark.parametrize(("hidden", "words", "bounds"), REGIONS, ids=[words for _, words, _ in REGIONS])
def test_the_region_is_said_in_words(tmp_path: Path, hidden: Hidden, words: str, bounds: list[float]) -> None:
    experiment = experiment_of(tmp_path, hidden)
    ((joint, where),) = localize_unexplained(experiment, experiment.equation.prior, FLOOR, silent).items()
    assert (joint, where.joints) == ("j1", ("j1",))
    number = r"(-?[\d.]+)"
    match = re.fullmatch(re.escape(words).replace(r"\{\}", number), where.region)
    assert match, where.region
    np.testing.assert_allclose([float(x) for x in match.groups()], bounds, rtol=0.1)


def test_a_torque_that_comes_with_another_joints_motion(tmp_path: Path) -> None:
    _, q, v, _ = motion()
    moves = np.abs(v[1]) > 0.3
    experiment = experiment_of(tmp_path, noisy(lambda *_: moves))
    region = localize_unexplained(experiment, experiment.equation.prior, FLOOR, silent)["j1"].region
    assert re.fullmatch(r"while j2 moves faster than 0\.(3|2[89]|3[0-3]) rad/s", region)
    experiment = experiment_of(tmp_path, noisy(lambda *_: moves & (q[0] > 0.4)))
    one, other = sorted(
        localize_unexplained(experiment, experiment.equation.prior, FLOOR, silent)["j1"].region.split(" and ")
    )
    assert re.fullmatch(r"at positions above 0\.(4|3\d|4\d) rad", one)
    assert re.fullmatch(r"while j2 moves faster than 0\.(3|2\d|3\d) rad/s", other)


def test_noise_is_nowhere(tmp_path: Path) -> None:
    experiment = experiment_of(tmp_path, nothing)
    assert not localize_unexplained(experiment, experiment.equation.prior, FLOOR, silent)


def test_a_prismatic_joint_has_metres_and_several_joints_have_names() -> None:
    n = 4000
    rng = np.random.default_rng(1)
    q, v, a, tau = rng.normal(size=(4, 2, n))
    kept = np.ones((2, n), dtype=bool)
    still, none = np.full(2, 1e-3), np.zeros((1, 2, n))
    found = ResidualSeries(np.arange(n) * 0.006, np.full(n, 0.006), q, v, a, tau, none, kept, still, (0,))

    def said(within: NDArray[np.bool_]) -> str:
        energy = rng.normal(size=n) ** 2 * within
        residual = JointResidual(found, 0, ("slide", "turn"), (True, False), 40.0, energy, np.zeros(n), True, True)
        return describe_region(residual, ())

    assert re.fullmatch(r"at speeds of slide below 0\.(50|49) m/s", said(np.abs(v[0]) < 0.5))
    assert re.fullmatch(r"at positions of slide above 0\.5\d? m", said(q[0] > 0.5))
    assert re.fullmatch(r"at torques of slide above 1(\.\d)? N", said(np.abs(tau[0]) > 1))
    assert re.fullmatch(r"while turn moves faster than 1(\.\d)? rad/s", said(np.abs(v[1]) > 1))


WINDOWS = ((2.113, 4.207), (6.551, 7.009), (10.204, 14.498))


def test_a_contact_is_located(tmp_path: Path) -> None:
    """In its windows, by all joints, whether it is explained or not."""
    friction = {"viscous": True, "coulomb": True}
    experiment = experiment_of(tmp_path, contact(*WINDOWS), friction=friction)
    assert set(localize_unexplained(experiment, linearize_fit(experiment, silent).theta, FLOOR, silent)) == {"j1", "j2"}
    parameters = {"windows": [list(window) for window in WINDOWS], "wrench": WRENCH}
    entry = EffectEntry(effect="external_contact", link="lower", parameters=parameters)
    with_it = with_effects(experiment, [entry])
    where = localize_residual(experiment, experiment.equation.prior, with_it, with_it.equation.prior, silent)
    assert where.joints == ("j1", "j2")
    t = motion()[0]
    told = np.any([(t >= first) & (t <= last) for first, last in where.windows], axis=0)
    truth = np.any([(t >= first) & (t <= last) for first, last in WINDOWS], axis=0)
    near = np.any([(t >= first - 0.1) & (t <= last + 0.1) for first, last in WINDOWS], axis=0)
    assert not told[~near].any()
    assert told[truth].mean() > 0.7
    assert re.fullmatch(r"in \d time intervals, [\d.]+ s in total", where.region)


def test_windows_are_few_and_short_or_none() -> None:
    """What comes again after 0.4 s is one window, unless it is there most of the time."""
    t = np.arange(6000) * 0.01
    none = np.zeros((2, len(t)))
    found = ResidualSeries(t, np.full(len(t), 0.01), none, none, none, none, none[None], none == 0, np.zeros(2), (0,))
    pulses = 1.0 * (t % 0.4 < 0.1)
    energy = pulses * ((np.abs(t - 15) < 5) | (np.abs(t - 40) < 1))
    np.testing.assert_allclose(energy_windows(found, energy, t >= 0), [[10, 20], [39, 41]], atol=0.4)
    assert energy_windows(found, pulses, t >= 0) == ()


def test_what_a_step_explains_is_located(tmp_path: Path) -> None:
    """Friction of the second joint is known after the step, and a little of the first's; and a step that does harm."""
    friction = {"j1": {"coulomb": True}, "j2": {"coulomb": True}}
    experiment = experiment_of(tmp_path, lambda t, q, v, tau: 0.7 * np.sign(v), friction=friction)
    keys = [c.key[:2] for c in experiment.equation.coefficients]
    before, after = experiment.equation.prior, experiment.equation.prior.copy()
    for joint, coulomb in (("j1", 0.02), ("j2", 0.7)):
        after[keys.index(("coulomb_friction", joint))] = coulomb
    assert localize_residual(experiment, before, experiment, after, silent).joints == ("j2",)
    assert localize_residual(experiment, after, experiment, before, silent).joints == ()


def test_maps(tmp_path: Path) -> None:
    """Closed forms: a line in time, a line in angle, and a curve over each variable."""
    experiment = experiment_of(
        tmp_path,
        lambda t, q, v, tau: np.stack([0.3 * np.sin(2 * np.pi * 6.5 * t), 0.2 * np.sin(41 * q[1]) + 0.05 * v[1]]),
    )
    maps = residual_maps(experiment, experiment.equation.prior, silent)
    one, two = maps["j1"], maps["j2"]
    peak = int(np.argmax(one.density))
    assert one.frequency[peak] == 6.5
    assert np.sqrt(np.square(one.density[peak - 4 : peak + 5]).sum() * one.frequency[0]) == pytest.approx(
        0.3 / np.sqrt(2), rel=0.02
    )
    rest = one.density[one.frequency > 9]
    np.testing.assert_allclose(np.median(rest[:80]), NOISE * np.sqrt(2 / RATE), rtol=0.1)  # white, of both sides
    line = int(np.argmax(two.amplitude))
    assert two.angle[line] == pytest.approx(41, abs=0.5)
    assert two.amplitude[line] == pytest.approx(0.2, rel=0.03)
    travel = np.ptp(motion()[1][1])
    assert two.angle[0] == pytest.approx(2 * np.pi / travel, rel=0.05)
    fast = np.abs(two.against["velocity"]) > 0.5
    np.testing.assert_allclose(two.mean["velocity"][fast], 0.05 * two.against["velocity"][fast], atol=0.1)
    slope = np.polyfit(two.against["velocity"], two.mean["velocity"], 1)[0]
    assert slope == pytest.approx(0.05, rel=0.15)
    np.testing.assert_allclose(one.rms["time"], np.hypot(0.3 / np.sqrt(2), NOISE), rtol=0.15)
    assert np.ptp(one.against["time"]) == pytest.approx(SECONDS, rel=0.03)


def test_maps_of_logs_follow_each_other(tmp_path: Path) -> None:
    """Time runs on; velocity's bins are finer near zero; nothing is drawn where nothing was."""
    experiment = experiment_of(tmp_path, nothing, torque_on_joint(0, lambda t, q, v, tau: 0 * t + 1.0))
    one = residual_maps(experiment, experiment.equation.prior, silent)["j1"]
    time, mean = one.against["time"], one.mean["time"]
    assert (np.diff(time) > 0).all()
    np.testing.assert_allclose(mean[time < SECONDS - 0.3], 0.0, atol=0.01)
    np.testing.assert_allclose(mean[time > SECONDS + 0.3], 1.0, atol=0.01)
    width = np.diff(one.against["velocity"])
    assert width.min() < 0.2 * width.max()
    assert np.abs(one.against["velocity"][np.argmin(width)]) < 0.3


def test_a_log_too_long_to_be_held_is_sampled(tmp_path: Path) -> None:
    experiment = experiment_of(tmp_path, torque_on_joint(0, lambda t, q, v, tau: 0.3 * np.sin(40 * t)))
    models = [(experiment.equation, experiment.equation.prior)]
    whole = residual_series(experiment, models, silent, "")
    part = residual_series(experiment, models, silent, "", most_numbers=whole.residuals.size * 3.0)
    assert len(whole.segments) == 1
    assert 0.3 * len(whole.t) < len(part.t) < 0.7 * len(whole.t)
    assert set(part.t) < set(whole.t)
    long = replace(whole, segment_starts=(0, 100))
    assert long.segments == (slice(0, 100), slice(100, len(whole.t)))
