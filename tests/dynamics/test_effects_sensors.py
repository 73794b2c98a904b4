"""Sensors that give something else than what is: an arm's log as they would have it, explained and run forwards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import config_with, idtool, refuse
from disturbed import experiment_of, nothing
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import CubicSpline
from spatial_arm import RIGID, Log, recorded, residuals, rolled_out, spec_of, written

from idtool.data.signals import Motion
from idtool.dynamics.effects import NamedEffect, effect_from_entry, effect_types
from idtool.dynamics.effects.delayed_series import delayed
from idtool.dynamics.effects.torque_sensor import TorqueSensorEffect
from idtool.dynamics.regressor import LinearModel
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel

Array = NDArray[np.float64]
Build = Callable[..., RobotModel]


def entry(effect: str, joint: str | None = "lift", **parameters: Any) -> dict[str, Any]:
    """An entry under `effects`."""
    return {"effect": effect, **({} if joint is None else {"joint": joint}), "parameters": parameters}


@pytest.fixture(scope="module")
def log() -> Log:
    """What true sensors give."""
    return recorded(spec_of().compile(), 2.0)


def of_lift(log: Log, signal: str, sensor: Callable[[Array], Array]) -> Log:
    """The log with one of the lift's signals as a sensor gives it."""
    x = log[signal].copy()
    x[:, 1] = sensor(x[:, 1])
    return {**log, signal: x}


def late(log: Log, delay: float, joints: list[int]) -> Log:
    """The log with torque of some joints as it was a delay before."""
    tau = log["tau"].copy()
    tau[:, joints] = CubicSpline(log["t"], tau[:, joints])(log["t"] - delay)
    return {**log, "tau": tau}


def falling(tau: Array) -> Array:
    """The measured torque that solves x = y + 0.3 y²/2 above 6 N·m."""
    x = np.maximum(np.abs(tau) - 6, 0)
    return np.asarray(np.sign(tau) * (np.minimum(np.abs(tau), 6) + (np.sqrt(1 + 0.6 * x) - 1) / 0.3))


def rising(tau: Array) -> Array:
    """The commanded torque that solves x = (1 − exp(−0.1 y)) / 0.1 above 6 N·m."""
    x = np.maximum(np.abs(tau) - 6, 0)
    return np.asarray(np.sign(tau) * (np.minimum(np.abs(tau), 6) - 10 * np.log(1 - 0.1 * x)))


LOSS = entry("torque_gain", gain=0.9)
GAIN, SATURATION = entry("torque_gain", gain=1.15), entry("torque_saturation", level=6, bend=0.3)
MOTOR = entry("torque_saturation", level=6, bend=-0.1)
SENSORS: dict[str, tuple[Callable[[Log], Log], list[dict[str, Any]]]] = {
    "gain": (lambda log: of_lift(log, "tau", lambda tau: 1.15 * tau), [GAIN]),
    "saturation": (lambda log: of_lift(log, "tau", falling), [SATURATION]),
    "a motor's iron": (
        lambda log: of_lift(log, "tau", rising),
        [MOTOR],
    ),
    "gain behind saturation": (lambda log: of_lift(log, "tau", lambda tau: 1.15 * falling(tau)), [GAIN, SATURATION]),
    "saturation behind gain": (lambda log: of_lift(log, "tau", lambda tau: falling(1.15 * tau)), [SATURATION, GAIN]),
    "gain behind a motor's iron": (lambda log: of_lift(log, "tau", lambda tau: 1.15 * rising(tau)), [GAIN, MOTOR]),
    "a motor's iron behind gain": (lambda log: of_lift(log, "tau", lambda tau: rising(0.9 * tau)), [MOTOR, LOSS]),
    "offset": (lambda log: of_lift(log, "q", lambda q: q - 0.05), [entry("encoder_offset", offset=0.05)]),
    "late": (lambda log: late(log, 0.0064, [1]), [entry("time_delay", delay=0.0064)]),
    "early": (lambda log: late(log, -0.0064, [1]), [entry("time_delay", delay=-0.0064)]),
    "all late": (lambda log: late(log, 0.0064, [0, 1, 2]), [entry("time_delay", None, delay=0.0064)]),
}


@pytest.mark.parametrize(("sensor", "entries"), SENSORS.values(), ids=SENSORS)
def test_with_the_entry_nothing_but_noise_is_left(
    tmp_path: Path, log: Log, sensor: Callable[[Log], Log], entries: list[dict[str, Any]]
) -> None:
    """The URDF's inertias, which are the true ones; errors in units of the measured torque's noise.

    What reaches the joint of a motor that saturates has less noise than its command.
    """
    with_them, without = residuals(tmp_path, sensor(log), *entries)
    np.testing.assert_allclose(with_them[[0, 2]], 1, atol=0.05)
    least = 0.7 if MOTOR in entries else 0.95
    assert least < with_them[1] < 1.05
    assert without[1] > 20


@pytest.mark.parametrize(("sensor", "entries"), SENSORS.values(), ids=SENSORS)
def test_under_the_measured_torque_the_arm_moves_as_it_did(
    tmp_path: Path, log: Log, sensor: Callable[[Log], Log], entries: list[dict[str, Any]]
) -> None:
    seen = sensor(log)
    assert np.abs(rolled_out(tmp_path, seen, *entries)).max() < 2e-4
    assert np.abs(rolled_out(tmp_path, seen, seconds=0.4)).max() > 1e-3


TWO = (
    '<robot name="r"><link name="a"/><link name="b"/><link name="c"/>'
    '<joint name="x" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint>'
    '<joint name="y" type="prismatic"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/></joint></robot>'
)


def effect_of(build: Build, effect: str, joint: str | None = "x", **parameters: Any) -> NamedEffect:
    """An effect on a robot of two joints, x and y."""
    return effect_from_entry(EffectEntry(**entry(effect, joint, **parameters)), build(TWO, ["x", "y"]))


def motion(tau: Array, dt: float = 1e-3) -> Motion:
    """Samples of a torque, the same on both joints."""
    both, nothing = np.stack([tau, tau]), np.zeros((2, len(tau)))
    return Motion(np.arange(len(tau)) * dt, nothing, nothing, nothing, both, both, np.full(2, 1e-3), dt)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(level=st.floats(0.1, 50), bend=st.floats(-5, 5), scale=st.floats(0.1, 1e3))
def test_saturation_is_one_to_one_odd_and_smooth(build: Build, level: float, bend: float, scale: float) -> None:
    effect = effect_of(build, "torque_saturation", level=level, bend=bend)
    tau = scale * np.linspace(-1, 1, 2001)
    seen = effect.apply_sensor(motion(tau).tau, motion(tau))
    np.testing.assert_array_equal(seen[1], tau)  # the other joint
    np.testing.assert_allclose(effect.correct_motion(motion(seen[0])).tau[0], tau, rtol=1e-9, atol=1e-9 * scale)
    np.testing.assert_allclose(seen[0], -seen[0, ::-1], rtol=1e-12)
    below = np.abs(tau) <= level
    np.testing.assert_array_equal(seen[0, below], tau[below])
    slope = np.diff(seen[0]) / np.diff(tau)
    assert (slope > 0).all()
    assert (np.diff(slope[1000:]) * np.sign(bend) < 1e-6).all()  # falls, or rises, from 1 on
    near = motion(level * np.array([1, 1 + 1e-6]))
    at_level = np.diff(effect.apply_sensor(near.tau, near)[0])
    assert at_level == pytest.approx(1e-6 * level, rel=1e-3)


@pytest.mark.parametrize(("coefficient", "bend"), [(0.3, 0.3), (-0.3, -0.3), (-1e3, -4.0)])
def test_a_fit_does_not_begin_at_a_limit_on_which_the_torque_hardly_depends(coefficient: float, bend: float) -> None:
    """As the first-order bend is, where only peaks exceed the level."""
    kind = effect_types()["torque_saturation"]
    assert issubclass(kind, TorqueSensorEffect)
    assert kind.values_from_coefficient(coefficient, {"level": 5.0}) == {"level": 5.0, "bend": bend}


def test_the_slope_has_halved_where_the_measured_torque_is_the_inverse_of_the_bend_above_the_level(
    build: Build,
) -> None:
    effect = effect_of(build, "torque_saturation", level=6, bend=0.25)
    true = effect.correct_motion(motion(6 + 4 * np.array([1 - 1e-6, 1 + 1e-6]))).tau[0]
    assert 8e-6 / np.diff(true) == pytest.approx(0.5, rel=1e-4)


def test_of_sensors_on_a_joint_the_first_entry_is_nearest_to_the_log(build: Build) -> None:
    effects = [
        effect_of(build, "torque_gain", gain=1.5),
        effect_of(build, "torque_saturation", level=6, bend=0.3),
    ]
    sensor = LinearModel(("x", "y"), tuple(effects)).mechanism(build(TWO, ["x", "y"]), np.zeros(0)).torque_sensors[0]
    tau = np.linspace(-20, 20, 101)
    np.testing.assert_allclose(sensor.to_measured(tau), 1.5 * falling(tau), rtol=1e-12)
    np.testing.assert_allclose(sensor.to_true(1.5 * falling(tau)), tau, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("samples", [0.37, -0.5, 2.6, -3.2, 1.0, 40.25])
def test_a_delay_is_the_shift_of_a_spline(samples: float) -> None:
    """Of scipy, which weights each sample anew; also of a series that is shorter than the delay."""
    for count in (20, 500):
        x = np.cumsum(np.random.default_rng(0).normal(size=(3, count)), axis=1)
        expected = [ndimage.shift(row, samples, order=5, mode="nearest") for row in x]
        np.testing.assert_allclose(delayed(x, samples), expected, atol=1e-4)


@pytest.mark.parametrize(("rate", "hertz"), [(1000, 40), (200, 38)])
@pytest.mark.parametrize("delay", [0.0064, -0.0131])
def test_a_delay_leaves_the_size_of_what_is_in_the_band(build: Build, rate: int, hertz: int, delay: float) -> None:
    t, turn = np.arange(2000) / rate, 2 * np.pi * hertz
    effect, inner = effect_of(build, "time_delay", delay=delay), slice(50, -50)
    seen = motion(np.sin(turn * t), 1 / rate)
    true = effect.correct_motion(seen)
    np.testing.assert_allclose(true.tau[0, inner], np.sin(turn * (t + delay))[inner], atol=5e-3)
    np.testing.assert_array_equal(true.tau[1], seen.tau[1])
    np.testing.assert_allclose(effect.apply_sensor(true.tau, seen)[0, inner], seen.tau[0, inner], atol=1e-2)
    models = np.stack([true.tau, 2 * true.tau])
    np.testing.assert_allclose(
        effect.apply_sensor(models, seen)[1], 2 * effect.apply_sensor(true.tau, seen), rtol=1e-12
    )


@pytest.mark.parametrize(("delay", "lost"), [(0.0025, slice(-3, None)), (-0.0025, slice(3))])
def test_samples_whose_torque_lies_beyond_the_log_do_not_count(build: Build, delay: float, lost: slice) -> None:
    seen = motion(np.zeros(20))
    expected = np.zeros(20, dtype=bool)
    expected[lost] = True
    for joint, which in (("x", [0]), (None, [0, 1])):
        masks = effect_of(build, "time_delay", joint, delay=delay).invalid_mask(seen)
        assert sorted(masks) == which
        for mask in masks.values():
            np.testing.assert_array_equal(mask, expected)


def test_a_delay_of_a_joint_adds_to_that_of_all(build: Build) -> None:
    effects = effect_of(build, "time_delay", None, delay=0.004), effect_of(build, "time_delay", "y", delay=-0.001)
    late = LinearModel(("x", "y"), effects).mechanism(build(TWO, ["x", "y"]), np.zeros(0)).torque_delay
    np.testing.assert_allclose(late, [0.004, 0.003])


def test_every_command_takes_the_entries_and_the_model_keeps_them(tmp_path: Path, log: Log) -> None:
    entries = [
        entry("torque_gain", gain={"value": 1.15, "standard_error": 0.01}),
        entry("torque_saturation", level=7, bend=0.25),
        entry("encoder_offset", "roll", offset=-0.03),
        entry("time_delay", None, delay=0.003),
        entry("time_delay", "turn", delay=0.001),
    ]
    urdf, csv = written(tmp_path, log)
    config = config_with(tmp_path / "given.yaml", **RIGID, effects=entries)
    done = idtool("fit", urdf, csv, "--config", config, "--out", tmp_path / "out", "--quiet", "--no-simulation")
    assert done.code == 0, done.err
    model = tmp_path / "out" / "model.yaml"
    assert yaml.safe_load(model.read_text())["effects"] == entries
    for command, out in ((["validate", "--no-simulation"], "again"), (["simulate"], "simulated.csv")):
        identified = tmp_path / "out" / "identified.urdf"
        done = idtool(*command, identified, csv, "--config", model, "--out", tmp_path / out, "--quiet")
        assert done.code == 0, done.err


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no gain": (entry("torque_gain", gain=0), "torque_gain: gain of 0 is out of range"),
    "a gain that turns the torque round": (entry("torque_gain", gain=-1), "torque_gain: gain of -1 is out of range"),
    "a gain by another name": (entry("torque_gain", gan=1), "torque_gain: has no parameter gan; did you mean gain?"),
    "no level": (entry("torque_saturation", level=0, bend=1), "torque_saturation: level of 0 is out of range"),
    "no bend": (entry("torque_saturation", level=1), "torque_saturation: needs the parameters level, bend; add bend"),
    "a word": (entry("encoder_offset", offset="left"), "encoder_offset: offset is not a number"),
    "no joint": (entry("encoder_offset", None, offset=1), "encoder_offset: acts on a joint"),
    "an unknown joint": (entry("time_delay", "lit", delay=0.01), "lit is not a moving joint; did you mean lift?"),
    "a link": (
        {**entry("time_delay", None, delay=0.01), "link": "fore"},
        "time_delay: acts on one joint, or on all joints",
    ),
    "milliseconds": (entry("time_delay", delay=5), "a delay of 5 s is too long; give at most 1 s"),
}


@pytest.mark.parametrize(("bad", "message"), BAD.values(), ids=BAD)
def test_a_bad_entry_is_refused(tmp_path: Path, log: Log, bad: dict[str, Any], message: str) -> None:
    urdf, csv = written(tmp_path, {name: x[:300] for name, x in log.items()})
    config_with(tmp_path / "arm.yaml", effects=[bad])
    refuse(tmp_path, "fit", urdf, csv, "--out", "out", naming=message)


def test_one_entry_of_a_kind_a_joint(tmp_path: Path, log: Log) -> None:
    urdf, csv = written(tmp_path, {name: x[:300] for name, x in log.items()})
    for twice, on in ((entry("torque_gain", gain=2), " for lift"), (entry("time_delay", None, delay=0.01), "")):
        folder = tmp_path / twice["effect"]
        folder.mkdir()
        config = config_with(tmp_path / "twice.yaml", effects=[twice, twice])
        said = f"effects: {twice['effect']}: is listed twice{on}; keep one entry"
        refuse(folder, "fit", urdf, csv, "--config", config, "--out", "out", naming=said)


def test_noise_of_the_accelerations_does_not_bend_the_predicted_torque(tmp_path: Path) -> None:
    """A saturated mean is not the mean of saturated values, by Jensen's inequality."""
    level, bend = 3.0, 0.3
    saturation = {"effect": "torque_saturation", "joint": "j1", "parameters": {"level": level, "bend": bend}}
    experiment = experiment_of(tmp_path, nothing, effects=[saturation])
    theta = experiment.equation.prior
    (run,) = experiment.runs
    rng = np.random.default_rng(0)
    shifts = []
    for batch in experiment.batches(run, held_out=False):
        noisy_a = batch.motion.a + 20 * rng.standard_normal(batch.motion.a.shape)
        noisy = replace(batch, motion=replace(batch.motion, a=noisy_a, kept_columns=None))
        _, predicted, _ = experiment.equation.compared_torques(batch, theta)
        _, predicted_of_noisy, _ = experiment.equation.compared_torques(noisy, theta)
        is_bent = np.abs(predicted[0]) > level
        shifts.append((np.abs(predicted_of_noisy[0]) - np.abs(predicted[0]))[is_bent])
    shift = np.concatenate(shifts)
    assert abs(shift.mean()) < 0.1 * shift.std()
