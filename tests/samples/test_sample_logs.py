"""The sample logs against Pinocchio: with the true parameters only the torque noise is left.

Letters: q [rad], v [rad/s], a [rad/s^2], tau [N m], each (N, nj); C the rotors' coupling (nr, nj).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from paths import SAMPLES
from sample_truth import EDGE, FILTER, LOGS, RATE, TRUTH, config_of, inertia_of, low_pass, rigid_torque
from scipy.signal import sosfilt

from idtool.data.logs import JointLog, read_log

Array = NDArray[np.float64]


def prior_bodies(robot: str) -> dict[str, Any]:
    config = config_of(robot)
    model = pin.buildModelFromUrdf(str(SAMPLES / f"{robot}.urdf"))
    bodies = {name: rotor["inertial"] for name, rotor in config["rotors"].items()}
    for name in config["bounding_ellipsoids"]:
        inertia = model.inertias[model.frames[model.getFrameId(name)].parentJoint]
        entries = inertia.inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        bodies[name] = {"mass": inertia.mass, "com": inertia.lever, "inertia": entries}
    return bodies


def residual(log: JointLog, robot: str, bodies: dict[str, Any]) -> Array:
    """What bodies and the true friction leave of the torque in the band, (N, nj)."""
    q = low_pass(log.signals["q"])
    v = np.gradient(q, 1 / RATE, axis=0)
    step = np.gradient(v, axis=0)
    friction = TRUTH[robot]["friction"]
    viscous, coulomb = (np.array([friction[joint][k] for joint in log.joints]) for k in ("viscous", "coulomb"))
    sign = np.clip(2 * v / np.abs(step), -1, 1)  # mean of sign(v) over a sample in which v crosses zero
    model = rigid_torque(robot, bodies, q, v, step * RATE) + viscous * v + coulomb * sign
    return low_pass(log.signals["tau"] - model)[EDGE]


def noise_floor(robot: str) -> float:
    """Root mean square that white torque noise has left after the filter, there and back."""
    impulse = sosfilt(FILTER, np.eye(1, 4 * RATE)[0])
    energy = np.abs(np.fft.fft(impulse)) ** 2
    return float(TRUTH[robot]["sensors"]["torque_noise"] * np.sqrt((energy**2).mean()))


def rms(x: Array) -> Array:
    return np.asarray(np.sqrt((x**2).mean(axis=0)))


def load(name: str) -> tuple[str, JointLog]:
    return name.rpartition("_")[0], read_log(SAMPLES / f"{name}.mcap")


@pytest.mark.parametrize("name", LOGS)
def test_true_parameters_leave_the_noise(name: str) -> None:
    robot, log = load(name)
    left, floor = residual(log, robot, TRUTH[robot]["bodies"]), noise_floor(robot)
    assert rms(left.ravel()) == pytest.approx(floor, rel=0.03)
    assert rms(left) == pytest.approx(floor, rel=0.05)


@pytest.mark.parametrize("robot", ["leg", "belt_arm"])
def test_prior_leaves_more(robot: str) -> None:
    left = residual(load(f"{robot}_validate")[1], robot, prior_bodies(robot))
    assert rms(left).min() > 2 * noise_floor(robot)


@pytest.mark.parametrize("robot", ["leg", "belt_arm"])
def test_true_bodies_fit_their_ellipsoids(robot: str) -> None:
    config = config_of(robot)
    bounds = {name: several[0] for name, several in config["bounding_ellipsoids"].items()}
    bounds |= {name: rotor["bounding_ellipsoid"] for name, rotor in config["rotors"].items()}
    assert set(bounds) == set(TRUTH[robot]["bodies"])
    for name, bound in bounds.items():
        body = inertia_of(TRUTH[robot]["bodies"][name])
        moments = np.trace(body.inertia) / 2 * np.eye(3) - body.inertia
        assert np.linalg.eigvalsh(moments)[0] > 0
        offset = body.lever - np.array(bound["center"])
        spread = (np.diag(moments) / body.mass + offset**2) / np.square(bound["semi_axes"])
        assert spread.sum() <= 1  # tr(J Q) >= 0, divided by the mass


@pytest.mark.parametrize("robot", ["leg", "belt_arm"])
def test_velocity_lags_as_stated(robot: str) -> None:
    log = load(f"{robot}_train")[1]
    v = np.gradient(low_pass(log.signals["q"]), 1 / RATE, axis=0)
    a, late = np.gradient(v, 1 / RATE, axis=0)[EDGE], (v - low_pass(log.signals["v"]))[EDGE]
    assert (a * late).sum() / (a**2).sum() == pytest.approx(TRUTH[robot]["sensors"]["velocity_lag"], abs=5e-5)


@pytest.mark.parametrize("name", LOGS)
def test_joints_stay_within_their_limits(name: str) -> None:
    robot, log = load(name)
    model = pin.buildModelFromUrdf(str(SAMPLES / f"{robot}.urdf"))
    index = [model.joints[model.getJointId(joint)].idx_v for joint in log.joints]
    assert (log.signals["q"] > model.lowerPositionLimit[index]).all()
    assert (log.signals["q"] < model.upperPositionLimit[index]).all()
    assert (np.abs(log.signals["v"]) < model.velocityLimit[index]).all()
    assert (np.abs(log.signals["tau"]) < model.effortLimit[index]).all()


def test_leg_is_one_run_cut_in_two() -> None:
    first, second = load("leg_train")[1], load("leg_validate")[1]
    assert len(first) == len(second) == 10_000
    assert second.t[0] - first.t[-1] == pytest.approx(1 / RATE)
    assert second.signals["q"][0] - first.signals["q"][-1] == pytest.approx(first.signals["v"][-1] / RATE, abs=2e-4)


def test_csv_is_the_mcap() -> None:
    csv = np.genfromtxt(SAMPLES / "leg_validate.csv", delimiter=",", names=True)
    log = load("leg_validate")[1]
    np.testing.assert_allclose(csv["t"], log.t, atol=1e-9)
    for k, joint in enumerate(log.joints):
        for signal in ("q", "v", "tau"):
            np.testing.assert_array_equal(csv[f"{signal}_{joint}"], log.signals[signal][:, k])
