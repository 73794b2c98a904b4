"""Effects run forwards, against scipy's integration of their forms, joints at rest among them, and MuJoCo's arm."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from arms import ARM, INERTIA, JOINTS, PENDULUM, WEIGHT, Physics, acceleration
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from idtool.data.signals import Motion
from idtool.dynamics.effects import build_effects
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.regressor import LinearModel
from idtool.dynamics.simulation.rollouts import Rollouts
from idtool.robot.config import parse_config
from idtool.robot.model import RobotModel

Array = NDArray[np.float64]
Build = Callable[..., RobotModel]
Scalar = Callable[[float, float, float, float], float]  # t, q, v, tau

_EXACT = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-12}
SAMPLES = np.linspace(0, 1, 101)


def entry(effect: str, at: str, **parameters: Any) -> dict[str, Any]:
    """An entry under `effects`."""
    return {"effect": effect, "joint": at, "parameters": parameters}


def mechanism(build: Build, text: str, joints: tuple[str, ...], friction: dict[str, Any], *entries: Any) -> Mechanism:
    """A robot with effects, its prior being the truth."""
    config = {"friction": friction, "effects": list(entries)}
    model = build(text, joints, **config)
    linear = LinearModel(model.names, build_effects(model, parse_config(config, "")))
    return linear.mechanism(model, linear.prior)


def rolled_out(machine: Mechanism, q: Array, v: Array, drive: Callable[[float], Array], step: float = 5e-3) -> Array:
    """Positions at the samples, shape (nv, samples)."""

    def torque(t: Array, q: Array, v: Array, rollout_ids: NDArray[np.intp]) -> Array:
        return np.stack([drive(float(x)) for x in t], axis=1)

    rollouts = Rollouts(machine, SAMPLES[:1], q[:, None], v[:, None], torque, step)
    found = [q]
    for sample in SAMPLES[1:]:
        rollouts.advance(np.array([sample]))
        found.append(rollouts.q[:, 0].copy())
    return np.stack(found, axis=1)


def pendulum(q: float, v: float, drive: Scalar, level: Scalar, inertia: float) -> tuple[Array, int, int]:
    """A pendulum's positions at the samples, and how often it came to rest and broke loose.

    Integrated from one change of the friction's direction to the next; ``drive`` is all torque but gravity and dry
    friction, ``level`` the latter's at speed v.
    """
    t, out, rests, breaks = 0.0, np.full(len(SAMPLES), q), 0, 0

    def pull(t: float, q: float, v: float) -> float:
        return drive(t, q, v, 0.0) - WEIGHT * np.sin(q)

    def breaks_loose(t: float, x: Array) -> float:
        return level(t, x[0], 0.0, 0.0) - abs(pull(t, x[0], 0.0))

    def stops(t: float, x: Array) -> float:
        return float(x[1])

    for event in (breaks_loose, stops):
        event.terminal = True  # type: ignore[attr-defined]
    breaks_loose.direction = -1  # type: ignore[attr-defined]
    while t < SAMPLES[-1]:
        s = np.sign(v) or (
            0.0 if abs(pull(t, q, 0.0)) < level(t, q, 0.0, 0.0) * (1 - 1e-9) else np.sign(pull(t, q, 0.0))
        )
        stops.direction = -s  # type: ignore[attr-defined]

        def slope(t: float, x: Array, s: float = s) -> list[float]:
            a = (pull(t, x[0], x[1]) - s * level(t, x[0], x[1], 0.0)) / inertia
            return [x[1], a] if s else [0.0, 0.0]

        start = np.array([q, v])
        found = solve_ivp(
            slope, (t, SAMPLES[-1]), start, events=[stops if s else breaks_loose], dense_output=True, **_EXACT
        )
        now = (t < SAMPLES) & (found.t[-1] >= SAMPLES)
        if now.any():
            out[now] = found.sol(SAMPLES[now])[0]
        t, q, v = float(found.t[-1]), float(found.y[0, -1]), float(found.y[1, -1])
        if found.status == 1:
            rests, breaks = rests + bool(s), breaks + (not s)
            v = 0.0
    return out, rests, breaks


def push(t: float) -> float:
    """The actuator's torque: to and fro, with time to rest in between [N·m]."""
    return float(1.5 * np.sin(2 * np.pi * 1.7 * t) + 0.3)


def smooth(form: Scalar) -> tuple[Scalar, Scalar]:
    """A smooth effect: drive and level."""
    return lambda t, q, v, tau: push(t) - form(t, q, v, push(t)), lambda t, q, v, tau: 0.0


def dry(level: Scalar) -> tuple[Scalar, Scalar]:
    """A dry one, on top of Coulomb friction of 0.4."""
    return lambda t, q, v, tau: push(t), lambda t, q, v, tau: 0.4 + level(t, q, v, push(t))


# The entry; drive and level by hand; the inertia about the hinge.
ONE: dict[str, tuple[dict[str, Any], tuple[Scalar, Scalar], float]] = {
    "drag": (
        entry("quadratic_drag", "hinge", drag=0.2),
        smooth(lambda t, q, v, tau: 0.2 * v * abs(v)),
        INERTIA,
    ),
    "ripple": (
        entry("torque_ripple", "hinge", amplitude=0.8, periods=20.0, phase=0.7),
        smooth(lambda t, q, v, tau: 0.8 * np.sin(20.0 * q + 0.7)),
        INERTIA,
    ),
    "stop": (
        entry("end_stop", "hinge", stiffness=400.0, position=0.3),
        smooth(lambda t, q, v, tau: 400.0 * max(q - 0.3, 0.0)),
        INERTIA,
    ),
    "rotor": (entry("rotor_inertia", "hinge", inertia=0.05), smooth(lambda t, q, v, tau: 0.0), INERTIA + 0.05),
    "stribeck": (
        entry("stribeck_friction", "hinge", stribeck=0.9, velocity=0.4),
        dry(lambda t, q, v, tau: 0.9 * np.exp(-((v / 0.4) ** 2))),
        INERTIA,
    ),
    "load": (
        entry("load_dependent_friction", "hinge", coefficient=0.6),
        dry(lambda t, q, v, tau: 0.6 * abs(tau)),
        INERTIA,
    ),
    "drift": (
        entry("friction_drift", "hinge", viscous=0.5, coulomb=1.2, time_constant=0.4),
        (
            lambda t, q, v, tau: push(t) - 0.5 * v * (1 - np.exp(-t / 0.4)),
            lambda t, q, v, tau: 0.4 + 1.2 * (1 - np.exp(-t / 0.4)),
        ),
        INERTIA,
    ),
}
DRY = {"stribeck", "load", "drift"}


@pytest.mark.parametrize("name", ONE)
def test_a_pendulum_moves_as_the_forms_say(build: Build, name: str) -> None:
    given, (drive, level), inertia = ONE[name]
    friction = {"viscous": False, "coulomb": 0.4 if name in DRY else False}
    machine = mechanism(build, PENDULUM, ("hinge",), friction, given)
    near = 5e-5 if name == "stop" else 1e-5
    ours = rolled_out(machine, np.array([0.1]), np.zeros(1), lambda t: np.array([push(t)]))
    expected, rests, breaks = pendulum(0.1, 0.0, drive, level, inertia)
    assert np.ptp(expected) > 0.05
    if name == "stop":
        assert expected.max() > 0.35
    if name in DRY:
        assert rests >= 2
        assert breaks >= 2
    np.testing.assert_allclose(ours[0], expected, rtol=0, atol=near)


@pytest.mark.parametrize(("torque", "moves"), [(1.25, False), (1.35, True)])
def test_a_joint_at_rest_holds_up_to_coulomb_and_stribeck_friction_together(
    build: Build, torque: float, moves: bool
) -> None:
    machine = mechanism(
        build,
        PENDULUM,
        ("hinge",),
        {"viscous": False, "coulomb": 0.4},
        entry("stribeck_friction", "hinge", stribeck=0.9, velocity=0.4),
    )
    q = rolled_out(machine, np.zeros(1), np.zeros(1), lambda t: np.array([torque]))
    assert bool(abs(q[0, -1]) > 0.1) is moves
    if not moves:
        np.testing.assert_array_equal(q, 0)


def test_an_arm_moves_as_mujocos_does(build: Build) -> None:
    """Every smooth effect at once, on both joints, with other sizes; torque of the one leaks into the other."""
    given = [
        e
        for at, other, k in (("shoulder", "elbow", 1.0), ("elbow", "shoulder", 1.7))
        for e in (
            entry("quadratic_drag", at, drag=0.1 * k),
            entry("torque_ripple", at, amplitude=0.3 * k, periods=9.0 * k, phase=k),
            entry("end_stop", at, stiffness=60.0 * k, position=0.2 * k),
            entry("rotor_inertia", at, inertia=0.02 * k),
            entry("transmission_coupling", at, source=other, coefficient=0.1 * k),
            entry("parallel_spring", at, stiffness=2.0 * k, rest_position=0.1 * k),
        )
    ]
    k = np.array([1.0, 1.7])

    def resists(t: float, q: Array, v: Array, tau: Array) -> Array:
        stop = 60 * k * np.maximum(q - 0.2 * k, 0)
        ripple = 0.3 * k * np.sin(9 * k * q + k)
        spring = 2 * k * (q - 0.1 * k)
        return np.asarray(0.1 * k * v * abs(v) + ripple + stop + spring - 0.1 * k * tau[::-1])

    def drive(t: float) -> Array:
        return np.array([4 * np.sin(7 * t), 2.5 * np.cos(9 * t)])

    slope = acceleration(Physics(resists, armature=tuple(0.02 * k)))
    start = np.array([0.1, 0.2, 0.0, 0.0])
    found = solve_ivp(
        lambda t, x: np.concatenate([x[2:], slope(t, x[:2], x[2:], drive(t))]), (0, 1), start, t_eval=SAMPLES, **_EXACT
    )
    assert (found.y[:2].max(axis=1) > 0.2 * k).all()  # both run into their stops
    machine = mechanism(build, ARM, JOINTS, {"viscous": False, "coulomb": False}, *given)
    ours = rolled_out(machine, start[:2], start[2:], drive)
    np.testing.assert_allclose(ours, found.y[:2], rtol=0, atol=1e-4)


def test_two_stops_and_two_ripples_on_a_joint_act_both(build: Build) -> None:
    machine = mechanism(
        build,
        PENDULUM,
        ("hinge",),
        {"viscous": False, "coulomb": False},
        *(entry("end_stop", "hinge", stiffness=k, position=x) for k, x in ((50.0, -0.8), (70.0, 0.3))),
        *(entry("torque_ripple", "hinge", amplitude=a, periods=n, phase=0.0) for a, n in ((0.3, 6.0), (0.2, 12.0))),
    )
    q = np.array([[-0.9, -0.1, 0.5]])
    nothing = np.zeros_like(q)
    found = machine.smooth_torque()(Motion(np.zeros(3), q, nothing, nothing, nothing, nothing, np.zeros(1), 0.0))
    stops = 50 * np.minimum(q + 0.8, 0) + 70 * np.maximum(q - 0.3, 0)
    np.testing.assert_allclose(found, stops + 0.3 * np.sin(6 * q) + 0.2 * np.sin(12 * q), rtol=1e-12)
