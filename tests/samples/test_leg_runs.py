"""The leg's simulation against Pinocchio, and what its sensors add against what was asked for.

Letters as in leg_runs.py.
"""

from __future__ import annotations

from dataclasses import replace

import leg_runs as runs
import numpy as np
import pinocchio as pin
import pytest
from leg_runs import PERFECT, TRUTH, Friction, LegRun, LegSensors, Motion, Truth
from leg_truth import PAPER
from numpy.typing import NDArray
from sample_truth import EDGE, low_pass, rigid_torque

from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.robot.config import read_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

RATE = 1000
NOISE_IN_BAND = 0.265  # of white noise, filtered there and back: the square root of the filter's band over 500 Hz
SMOOTH = replace(TRUTH, friction={joint: Friction(f.viscous, 0.0) for joint, f in TRUTH.friction.items()})


@pytest.fixture(scope="module")
def motion() -> Motion:
    return runs.fourier(3, 3.0)


def rms(x: Array) -> Array:
    return np.asarray(np.sqrt(np.square(x).mean(axis=0)))


def derivative(x: Array) -> Array:
    """Of fourth order."""
    d = np.zeros_like(x)
    d[2:-2] = (8 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) * RATE / 12
    return d


def model_torque(truth: Truth, q: Array) -> Array:
    """What Pinocchio asks for along positions, friction c sign(v) added."""
    v = derivative(q)
    bodies = {name: body.to_config() for name, body in truth.bodies.items()}
    viscous, coulomb = np.transpose([(f.viscous, f.coulomb) for f in truth.friction.values()])
    return rigid_torque("leg", bodies, q, v, derivative(v)) + viscous * v + coulomb * np.sign(v)


def moving(run: LegRun) -> NDArray[np.bool_]:
    """Samples with no reversal within the filter's reach, (N, 3)."""
    slow = (np.abs(run.true.v) < 0.05).astype(float)
    near = np.apply_along_axis(lambda x: np.convolve(x, np.ones(201), mode="same"), 0, slow)
    return np.asarray(near < 0.5)


@pytest.mark.parametrize("seed", [1, 5])
def test_inverse_dynamics_are_pinocchios(motion: Motion, seed: int) -> None:
    truth = runs.draw_truth(seed)
    some = Motion(*(x[::50] for x in motion))
    bodies = {name: body.to_config() for name, body in truth.bodies.items()}
    np.testing.assert_allclose(runs.inverse_dynamics(truth, some), rigid_torque("leg", bodies, *some), atol=1e-9)


@pytest.mark.parametrize("gears", ["rigid", "elastic"])
def test_without_coulomb_friction_the_model_is_exact(motion: Motion, gears: str) -> None:
    run = runs.track_leg(motion.q, motion.v, 0, truth=SMOOTH, sensors=PERFECT, gears=gears)
    error = low_pass(run.true.tau - model_torque(SMOOTH, run.true.q))[EDGE]
    assert (rms(error) < 0.02 * NOISE_IN_BAND * LegSensors().torque_noise).all()


def test_between_reversals_the_model_is_exact(motion: Motion) -> None:
    run = runs.track_leg(motion.q, motion.v, 0, sensors=PERFECT)
    keep = moving(run)[EDGE]
    error = low_pass(run.true.tau - model_torque(TRUTH, run.true.q))[EDGE]
    assert (keep.mean(axis=0) > 0.2).all()
    for joint in range(3):
        assert rms(error[keep[:, joint], joint]) < 0.02 * NOISE_IN_BAND * LegSensors().torque_noise


def test_true_parameters_leave_the_noise(motion: Motion) -> None:
    truth = replace(runs.draw_truth(9), friction=SMOOTH.friction)
    log = runs.run_leg(motion.q, motion.v, 4, acmd=motion.a, truth=truth)
    floor = NOISE_IN_BAND * LegSensors().torque_noise
    left = low_pass(log.signals["tau"] - model_torque(truth, low_pass(log.signals["q"])))[EDGE]
    other = low_pass(log.signals["tau"] - model_torque(SMOOTH, low_pass(log.signals["q"])))[EDGE]
    assert rms(left.ravel()) == pytest.approx(floor, rel=0.06)
    assert rms(other.ravel()) > 2 * floor


def test_rigid_gears_move_as_stiff_ones(motion: Motion) -> None:
    rigid, elastic = (
        runs.track_leg(motion.q, motion.v, 0, sensors=PERFECT, gears=gears).true for gears in ("rigid", "elastic")
    )
    np.testing.assert_allclose(rigid.q, elastic.q, atol=1e-4)
    departure = rms(low_pass(rigid.tau - elastic.tau)[EDGE])
    assert (departure < 0.02 * rms(rigid.tau)).all()


def test_the_leg_follows_its_command_within_the_limits() -> None:
    low, high = runs.position_limits()
    model = pin.buildModelFromUrdf(str(runs.URDF))
    for command in (runs.shell(3.0, 5.0), runs.fourier(2, 3.0)):
        run = runs.track_leg(command.q, command.v, 1, acmd=command.a)
        assert np.abs(run.true.q - command.q).max() < 0.02
        assert (run.true.q > low).all()
        assert (run.true.q < high).all()
        assert np.abs(run.true.v).max() < model.velocityLimit.min()
        assert np.abs(run.log.signals["tau"]).max() < model.effortLimit.min()


def test_the_foot_follows_the_shell() -> None:
    command = runs.shell(40.0, 0.0)
    model = pin.buildModelFromUrdf(str(runs.URDF))
    data, foot = model.createData(), model.getFrameId("foot")
    for k in range(0, len(command.q), 997):
        pin.forwardKinematics(model, data, command.q[k], command.v[k])
        pin.updateFramePlacements(model, data)
        velocity = pin.getFrameVelocity(model, data, foot, pin.LOCAL_WORLD_ALIGNED).linear
        target = PAPER.foot_target(k / RATE)
        np.testing.assert_allclose(data.oMf[foot].translation, target[0], atol=1e-9)
        np.testing.assert_allclose(velocity, target[1], atol=1e-5)


@pytest.mark.parametrize("command", [runs.shell(2.0, 7.0), runs.fourier(4, 2.0)], ids=["shell", "fourier"])
def test_commands_are_derivatives_of_each_other(command: Motion) -> None:
    inner = slice(2, -2)
    np.testing.assert_allclose(derivative(command.q)[inner], command.v[inner], atol=1e-5)
    np.testing.assert_allclose(derivative(command.v)[inner], command.a[inner], atol=1e-3)


@pytest.mark.parametrize("seed", range(20))
def test_random_commands_stay_within_their_limits(seed: int) -> None:
    low, high = runs.position_limits()
    command = runs.fourier(seed, 10.0, speed=6.0, share=0.7)
    margin = 0.15 * (high - low) - 1e-9
    assert (command.q >= low + margin).all()
    assert (command.q <= high - margin).all()
    assert np.abs(command.v).max() <= 6.0 + 1e-9
    assert np.abs(command.q - runs.fourier(seed + 100, 10.0).q).max() > 0.1


def test_sensors_read_as_they_should(motion: Motion) -> None:
    sensors = LegSensors(position_step=runs.encoder_step(12), velocity_lag=3e-3)
    run = runs.track_leg(motion.q, motion.v, 2, sensors=sensors)
    q, v = run.log.signals["q"], run.log.signals["v"]
    assert np.abs(q - run.true.q).max() <= sensors.position_step / 2 + 1e-12
    assert sensors.position_step == pytest.approx(2 * np.pi / 4096 / 10.604)
    a, late = derivative(low_pass(run.true.v))[EDGE], low_pass(run.true.v - v)[EDGE]
    assert (a * late).sum() / (a**2).sum() == pytest.approx(sensors.velocity_lag, abs=1e-4)
    tachometer = runs.track_leg(motion.q, motion.v, 2, sensors=replace(sensors, velocity_noise=0.05))
    assert rms(tachometer.log.signals["v"] - tachometer.true.v) == pytest.approx(0.05, rel=0.05)
    assert not runs.run_leg(motion.q, motion.v, 2, sensors=replace(sensors, logs_velocity=False)).has("v", "hip")


def test_coloured_noise_has_its_size_and_time() -> None:
    sensors = LegSensors(torque_noise=0.0, coloured_noise=0.3, coloured_time=0.1)
    noise = sensors.torque_errors(np.random.default_rng(0), (200_000, 3))
    assert rms(noise) == pytest.approx(0.3, rel=0.1)
    later = (noise[100:] * noise[:-100]).mean(axis=0) / np.square(noise).mean(axis=0)
    assert later == pytest.approx(np.exp(-1), abs=0.08)
    assert rms(sensors.torque_errors(np.random.default_rng(0), (1, 30_000))[0]) == pytest.approx(0.3, rel=0.02)


def test_what_the_encoder_adds_goes_round_the_loop(motion: Motion) -> None:
    """A position read too high lowers the torque of the next millisecond: the errors of q and tau correlate."""
    run = runs.track_leg(motion.q, motion.v, 2, sensors=LegSensors(position_step=runs.encoder_step(10)))
    error = (run.log.signals["q"] - run.true.q)[:-1]
    above = run.true.tau - low_pass(run.true.tau)
    for joint in range(3):
        assert np.corrcoef(error[:, joint], above[1:, joint])[0, 1] < -0.2


def test_what_the_drive_does_not_deliver_moves_the_leg(motion: Motion) -> None:
    """The log is as noisy in both cases, but only torque errors that act on the joints move the leg."""
    for acting_share in (0.0, 1.0):
        run = runs.track_leg(motion.q, motion.v, 3, sensors=LegSensors(position_step=0.0, acting_share=acting_share))
        still = runs.track_leg(motion.q, motion.v, 4, sensors=LegSensors(position_step=0.0, acting_share=acting_share))
        error = run.log.signals["tau"] - run.true.tau
        assert rms(error) == pytest.approx(LegSensors().torque_noise, rel=0.05)
        answer = (run.true.a - low_pass(run.true.a))[5:]
        correlation = [np.corrcoef(answer[:, j], error[5:, j])[0, 1] for j in range(3)]
        if acting_share:
            assert (np.array(correlation) < -0.5).all()
            assert np.abs(run.true.q - still.true.q).max() > 1e-4
        else:
            assert np.abs(correlation).max() < 0.1
            np.testing.assert_array_equal(run.true.q, still.true.q)


def test_the_same_seed_gives_the_same_log(motion: Motion) -> None:
    logs = [runs.run_leg(motion.q[:500], motion.v[:500], seed).signals for seed in (1, 1, 2)]
    np.testing.assert_array_equal(logs[0]["tau"], logs[1]["tau"])
    assert np.abs(logs[0]["tau"] - logs[2]["tau"]).max() > 0.1


def test_an_unstable_loop_is_refused(motion: Motion) -> None:
    with pytest.raises(RuntimeError, match="lost its command"):
        runs.run_leg(motion.q, motion.v, 0, controller=runs.Controller(kd=(900.0, 900.0, 900.0)))


def test_stribeck_friction_is_larger_at_rest(motion: Motion) -> None:
    stribeck = {"abad": 1.0, "hip": 0.0, "knee": 2.0}
    run = runs.track_leg(motion.q, motion.v, 0, truth=replace(TRUTH, stribeck=stribeck, stribeck_velocity=0.5))
    v = run.true.v
    for joint, (name, extra) in enumerate(stribeck.items()):
        friction = TRUTH.friction[name]
        clear = np.abs(v[:, joint]) > 0.1
        expected = friction.viscous * v + (friction.coulomb + extra * np.exp(-np.square(v / 0.5))) * np.sign(v)
        np.testing.assert_allclose(run.true.friction[clear, joint], expected[clear, joint], atol=0.1)


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return prepare(read_robot(runs.URDF), read_config(runs.SAMPLES / "leg.yaml"), [runs.SAMPLES / "leg_train.mcap"])


def test_true_coefficients_are_pinocchios(experiment: Experiment) -> None:
    theta = runs.true_theta(experiment)
    names = [body.name for body in experiment.model.bodies]
    for i, name in enumerate(names):
        body = TRUTH.bodies[name]
        expected = pin.Inertia(body.mass, body.com, body.inertia).toDynamicParameters()
        np.testing.assert_allclose(theta[10 * i : 10 * i + 10], expected, rtol=1e-12, atol=1e-15)
    friction = {(c.owner, c.name): x for c, x in zip(experiment.equation.coefficients, theta, strict=True)}
    assert friction["hip", "coulomb"] == 1.25
    assert friction["knee", "viscous"] == 0.10
    assert sorted(names) == sorted(TRUTH.bodies)


def test_the_prior_is_the_urdfs(experiment: Experiment) -> None:
    np.testing.assert_allclose(runs.true_theta(experiment, runs.prior_truth()), experiment.equation.prior, atol=1e-12)
