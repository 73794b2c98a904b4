"""Dry friction: joints that stay where they are, break away, stop and turn, against what can be written by hand.

Letters: m mass [kg], c level of the friction [N or N·m], W rollouts, N samples.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from forward import (
    LEG,
    LEG_JOINTS,
    LEG_ROTORS,
    friction,
    hinge,
    mechanism,
    run_rollouts,
    sliders,
    torque_of_time,
    zero_torque,
)
from mujoco_robots import Tree
from numpy.typing import NDArray
from scipy.optimize import brentq

from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.stiction import first_crossing
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
ReadRobot = Callable[[str | bytes], Robot]

G = 9.81


def slider(robot_of: ReadRobot, c: float, m: float = 1.0, slope: float = 0.0) -> Mechanism:
    """A mass on a rail with Coulomb friction, along x downhill."""
    return mechanism(robot_of(sliders(m, slope=slope)), {"friction": friction(["x1"], [0], [c])})


def still(q: Array, v: Array) -> None:
    """Nothing has moved."""
    assert np.abs(q - q[..., :1]).max() <= 1e-9
    np.testing.assert_array_equal(v, np.zeros_like(v))


def turns(v: Array) -> list[int]:
    """Directions that a joint takes one after the other, 0 for rest, of its velocities (N,)."""
    s = np.sign(v).astype(int)
    return s[np.flatnonzero(np.diff(s, prepend=9))].tolist()


@pytest.mark.parametrize("share", [0.0, 0.999, -0.5])
def test_a_joint_on_a_slope_stays(robot_of: ReadRobot, share: float) -> None:
    """Gravity takes a share of what friction can hold."""
    m, length, c = 2.0, 0.3, 5.0
    machine = mechanism(robot_of(hinge(0.01, m, length)), {"friction": friction(["x1"], [0], [c])})
    angle = np.arcsin(share * c / (m * G * length))
    still(*run_rollouts(machine, [angle], [0], zero_torque, np.linspace(0, 10, 51)))


@pytest.mark.parametrize("seconds", [2, pytest.param(10, marks=pytest.mark.slow)])
def test_two_hundred_joints_stay_where_friction_holds_them(robot_of: ReadRobot, seconds: int) -> None:
    """On slopes from one limit to the other; of those beyond, none stays."""
    m, length, c = 2.0, 0.3, 3.0
    machine = mechanism(robot_of(hinge(0.01, m, length)), {"friction": friction(["x1"], [0.1], [c])})
    share = np.linspace(-1.2, 1.2, 200)
    assert not (np.abs(np.abs(share) - 1) < 1e-4).any()
    angle = np.arcsin(share * c / (m * G * length))
    q, v = run_rollouts(machine, angle[None], np.zeros((1, 200)), zero_torque, np.linspace(0, seconds, 11))
    held = np.abs(share) < 1
    still(q[:, held], v[:, held])
    assert (q[0, ~held, 1] * share[~held] < angle[~held] * share[~held] - 1e-6).all()  # down
    assert np.abs(q[0, ~held, -1] - q[0, ~held, -2]).max() <= 1e-9  # and at rest further down
    assert (m * G * length * np.abs(np.sin(q[0, :, -1])) <= c).all()


LEVEL = 10.0  # N·m, of the abad


def leg(robot_of: ReadRobot) -> Mechanism:
    config = {"rotors": LEG_ROTORS, "friction": friction(LEG_JOINTS, [0.1] * 3, [LEVEL, 0.5, 0.5])}
    return mechanism(robot_of(LEG), config, LEG_JOINTS)


def vigorous(t: Array) -> Array:
    """Nothing on the abad, hip and knee to and fro [N·m]."""
    return np.stack([0 * t, 20 * np.sin(9 * t), 12 * np.sin(13 * t + 1)])


def coupling(q: Array, v: Array) -> Array:
    """What the abad has to hold as hip and knee move, by MuJoCo, shape (N − 2,) [N·m]; accelerations by differences."""
    tree = Tree(LEG, LEG_JOINTS, {"rotors": LEG_ROTORS})
    a = (v[:, 2:] - v[:, :-2]) / 2e-2
    parts = [tree(x, y) for x, y in zip(q[:, 1:-1].T, v[:, 1:-1].T, strict=True)]
    return np.array([M[0] @ b + h[0] for (M, h), b in zip(parts, a.T, strict=True)])


def test_a_joint_stays_while_others_shake_it(robot_of: ReadRobot) -> None:
    q, v = run_rollouts(leg(robot_of), [0.3, 0.2, -1.0], [0, 0, 0], torque_of_time(vigorous), np.linspace(0, 10, 1001))
    still(q[0], v[0])
    assert np.ptp(q[1:], axis=-1).min() > 0.5
    load = np.abs(coupling(q[:, 0], v[:, 0]))
    assert LEVEL / 2 < load.max() < LEVEL


def test_in_many_rollouts_joints_stay_while_others_shake_them(robot_of: ReadRobot) -> None:
    rng, count = np.random.default_rng(3), 200
    q0 = np.array([[0.0], [0.2], [-1.0]]) + rng.uniform(-0.3, 0.3, (3, count))
    late = rng.uniform(0, 1, count)
    input_torque = lambda t, q, v, rollout_ids: vigorous(t + late[rollout_ids])  # noqa: E731
    q, v = run_rollouts(leg(robot_of), q0, np.zeros((3, count)), input_torque, np.linspace(0, 0.5, 11))
    still(q[0], v[0])
    assert np.ptp(q[1:], axis=-1).min() > 0.01


def test_beyond_its_friction_a_mass_slides(robot_of: ReadRobot) -> None:
    m, c, slope = 3.0, 4.0, 0.3
    a = G * np.sin(slope) - c / m
    samples = np.linspace(0, 2, 21)
    q, v = run_rollouts(slider(robot_of, c, m, slope), [0], [0], zero_torque, samples)
    np.testing.assert_allclose(q[0, 0], a * samples**2 / 2, rtol=0, atol=1e-12)
    np.testing.assert_allclose(v[0, 0], a * samples, rtol=0, atol=1e-12)


@pytest.mark.parametrize("c", [8.0, 10.0])
def test_a_mass_shot_uphill_stops_where_and_when_it_must(robot_of: ReadRobot, c: float) -> None:
    """And slides back, or not."""
    m, slope, v0 = 3.0, 0.3, -1.7
    pull, samples = G * np.sin(slope), np.linspace(0, 2, 400)
    stop = -v0 / (pull + c / m)
    q, v = run_rollouts(slider(robot_of, c, m, slope), [0], [v0], zero_torque, samples)
    up, down = np.minimum(samples, stop), np.maximum(samples - stop, 0)
    back = max(pull - c / m, 0)
    expected = v0 * up + (pull + c / m) * up**2 / 2 + back * down**2 / 2
    np.testing.assert_allclose(q[0, 0], expected, rtol=0, atol=1e-11)
    assert turns(v[0, 0]) == ([-1, 1] if back else [-1, 0])


@pytest.mark.parametrize("power", [0.5, 1, 2, 5])
@pytest.mark.parametrize("rate", [1.0, -20.0])
def test_a_mass_breaks_away_in_the_moment_it_must(robot_of: ReadRobot, rate: float, power: float) -> None:
    """Under a force rate · t^power, at t0."""
    m, c = 2.0, 3.0
    way, size = np.sign(rate), abs(rate)
    t0 = (c / size) ** (1 / power)
    t = t0 + np.array([-1e-3, 1e-3, 0.05, 0.1, 0.2])
    force = torque_of_time(lambda t: rate * t[None] ** power)
    q, v = run_rollouts(slider(robot_of, c, m), [0], [0], force, np.concatenate([[0.0], t]))
    p, t = power + 1, np.maximum(t, t0)
    speed = size * (t**p - t0**p) / p - c * (t - t0)
    gone = size * ((t ** (p + 1) - t0 ** (p + 1)) / (p + 1) - t0**p * (t - t0)) / p - c * (t - t0) ** 2 / 2
    assert v[0, 0, 1] == 0
    np.testing.assert_allclose(v[0, 0, 1:], way * speed / m, rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(q[0, 0, 1:], way * gone / m, rtol=0, atol=1e-9 * size)


MASS, LEVEL_OF_MASS, FORCE, RATE = 2.0, 2.4, 3.0, 7.0  # kg; N; N and rad/s of a force FORCE sin(RATE t)
HALF = np.pi / RATE


def swung(t: float) -> float:
    """Where the mass is in the first half period, from rest: it breaks away as the force passes its friction."""
    m, c, start = MASS, LEVEL_OF_MASS, np.arcsin(LEVEL_OF_MASS / FORCE) / RATE

    def speed(t: float) -> float:
        return float(FORCE / RATE * (np.cos(RATE * start) - np.cos(RATE * t)) - c * (t - start)) / m

    stop = brentq(speed, HALF - start, HALF + start, xtol=1e-15)
    assert stop < HALF + start
    t = np.clip(t, start, stop)
    sines = (np.sin(RATE * t) - np.sin(RATE * start)) / RATE
    return float(FORCE / RATE * ((t - start) * np.cos(RATE * start) - sines) - c * (t - start) ** 2 / 2) / m


@pytest.mark.parametrize("every", [3e-3, 4.3e-2])
def test_a_mass_swung_to_and_fro(robot_of: ReadRobot, every: float) -> None:
    """It breaks away, moves, stops and rests, and the same the other way, with nothing in between."""
    samples = np.arange(0, 6 * HALF, every)
    force = torque_of_time(lambda t: FORCE * np.sin(RATE * t)[None])
    q, v = run_rollouts(slider(robot_of, LEVEL_OF_MASS, MASS), [0], [0], force, samples)
    expected = [sum((-1) ** k * swung(t - k * HALF) for k in range(6)) for t in samples]
    np.testing.assert_allclose(q[0, 0], expected, rtol=0, atol=1e-8)
    assert turns(v[0, 0]) == [0, 1, 0, -1] * 3 + [0]


def test_the_first_of_several_crossings_is_found_just_beyond() -> None:
    """Of lines, at both ends of the interval and of its sections, and of cubics with three roots a section apart."""
    roots = np.array([[1e-9, 2, 3], [0.25, 2, 3], [0.3, 2, 3], [1.0, 2, 3], [0.2, 0.5, 0.9], [0.2, 0.24, 0.9]])
    sign = np.array([1.0, -1.0, 1.0, 1.0, 1.0, -1.0])

    def curves(x: Array) -> Array:
        return -sign * np.prod(x[..., None] - roots, axis=-1)

    found = first_crossing(curves, sign)
    assert (found >= roots[:, 0]).all()
    np.testing.assert_allclose(found, roots[:, 0], rtol=0, atol=2e-12)
