"""Effects on one joint: their columns by formulas, and the coefficients of MuJoCo's arm found again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import JOINTS, Physics, recording, written
from effect_torques import Build, effects_of, entry, random_motion, torque
from numpy.typing import NDArray
from robots import chain, joint

from idtool.data.signals import Motion
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.experiment import prepare
from idtool.estimation.fit import Fit, fit
from idtool.reporting.fit_report import model_config
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]
Elbow = Callable[[float, Array, Array, Array], Array]


FORMS: dict[str, tuple[dict[str, Any], Callable[[Motion], Array]]] = {
    "stribeck": (
        entry("stribeck_friction", stribeck=0.7, velocity=1.5),
        lambda m: 0.7 * np.exp(-((m.v[1] / 1.5) ** 2)) * np.sign(m.v[1]),
    ),
    "drag": (entry("quadratic_drag", drag=0.3), lambda m: 0.3 * m.v[1] * np.abs(m.v[1])),
    "ripple": (
        entry("torque_ripple", amplitude=0.4, periods=7.5, phase=-2.0),
        lambda m: 0.4 * np.sin(7.5 * m.q[1] - 2.0),
    ),
    "upper stop": (
        entry("end_stop", stiffness=9.0, position=0.4),
        lambda m: np.where(m.q[1] > 0.4, 9.0 * (m.q[1] - 0.4), 0.0),
    ),
    "lower stop": (
        entry("end_stop", stiffness=9.0, position=-0.4),
        lambda m: np.where(m.q[1] < -0.4, 9.0 * (m.q[1] + 0.4), 0.0),
    ),
    "rotor": (entry("rotor_inertia", inertia=0.06), lambda m: 0.06 * m.a[1]),
    "drift": (
        entry("friction_drift", viscous=0.5, coulomb=-0.2, time_constant=2.0),
        lambda m: (0.5 * m.v[1] - 0.2 * np.sign(m.v[1])) * (1 - np.exp(-m.t / 2.0)),
    ),
}


@pytest.mark.parametrize(("given", "form"), FORMS.values(), ids=FORMS)
def test_the_torque_is_the_documented_one(build: Build, given: dict[str, Any], form: Callable[[Motion], Array]) -> None:
    motion = random_motion()
    found = torque(build, motion, given)
    np.testing.assert_array_equal(found[0], 0)
    assert np.abs(form(motion)).max() > 0.05
    inner = slice(1, -1)  # the first and last mean are over half a sample
    np.testing.assert_allclose(found[1, inner], form(motion)[inner], rtol=1e-9, atol=2e-5)


LOADED: dict[str, tuple[dict[str, Any], Callable[[Array, Motion], Array]]] = {
    "load": (
        entry("load_dependent_friction", coefficient=0.2),
        lambda tau, m: 0.2 * np.abs(tau[1]) * np.sign(m.v[1]),
    ),
    "coupling": (entry("transmission_coupling", source="shoulder", coefficient=0.1), lambda tau, m: -0.1 * tau[0]),
}


@pytest.mark.parametrize(("given", "form"), LOADED.values(), ids=LOADED)
def test_what_follows_from_torque_follows_from_the_models(
    build: Build, given: dict[str, Any], form: Callable[[Array, Motion], Array]
) -> None:
    """The form is that of all the torque that the actuators give by the model, and the measured one has no say."""
    motion = random_motion()
    load = [entry("parallel_spring", joint, stiffness=7.0, rest_position=0.3) for joint in ("shoulder", "elbow")]
    plain, found = torque(build, motion, *load), torque(build, motion, *load, given)
    inner = slice(1, -1)  # the first and last mean are over half a sample
    np.testing.assert_allclose(found[0], plain[0], atol=1e-12)
    assert np.abs(found[1] - plain[1]).max() > 0.5
    np.testing.assert_allclose((found - plain)[1, inner], form(found, motion)[inner], rtol=1e-9, atol=2e-5)
    other = torque(build, replace(motion, tau=motion.tau + 3.0), *load, given)
    np.testing.assert_allclose(other, found, atol=1e-12)


@pytest.mark.parametrize("step", [1e-4, 0.003, 0.04, 0.5])
def test_where_the_velocity_turns_stribeck_friction_is_the_mean_over_the_sample(build: Build, step: float) -> None:
    """A straight passage through zero, against quadrature: all of the Stribeck range may lie within one sample."""
    still, width = 2e-3, 0.02
    v = step * (np.arange(-30, 31) + 0.37)
    within = v[:, None] + step * np.linspace(-0.5, 0.5, 20001)
    mean = np.mean(np.tanh(within / still) * np.exp(-np.square(within / width)), axis=1)
    both, nothing = np.stack([v, v]), np.zeros((2, len(v)))
    t = np.arange(float(len(v)))
    motion = Motion(t, nothing, both, nothing, nothing, nothing, np.full(2, still), 1.0)
    found = torque(build, motion, entry("stribeck_friction", stribeck=1.0, velocity=width))[1]
    np.testing.assert_allclose(found[1:-1], mean[1:-1], atol=3e-3)


LIMITS = {
    "no limits": ("", [(0.4, 1), (-0.4, -1), (0.0, 1)]),
    "limits": ('<limit lower="0.2" upper="1" effort="1" velocity="1"/>', [(0.4, -1), (0.8, 1)]),
    "limits below zero": ('<limit lower="-2" upper="-1" effort="1" velocity="1"/>', [(-1.1, 1), (-1.9, -1)]),
}


@pytest.mark.parametrize(("limit", "cases"), LIMITS.values(), ids=LIMITS)
def test_a_stop_acts_on_its_side_or_on_that_of_the_nearer_limit(
    build: Build, limit: str, cases: list[tuple[float, int]]
) -> None:
    kind = "revolute" if limit else "continuous"
    pair = [f'<parent link="l{i}"/><child link="l{i + 1}"/><axis xyz="0 0 1"/>{limit}' for i in (0, 1)]
    text = chain(*(f'<joint name="{n}" type="{kind}">{p}</joint>' for n, p in zip(JOINTS, pair, strict=True)))
    for position, usual_side in cases:
        for side in (None, 1.0, -1.0):
            given = {} if side is None else {"side": side}
            (effect,) = effects_of(build, entry("end_stop", stiffness=1.0, position=position, **given), text=text)
            motion = random_motion(3)
            motion.q[1] = [position - 0.1, position, position + 0.1]
            linear = LinearModel(JOINTS, (effect,))
            expected = [0, 0, 0.1] if (side or usual_side) > 0 else [-0.1, 0, 0]
            np.testing.assert_allclose(linear.torque(motion, linear.prior)[1], expected, atol=1e-12)


def test_units_follow_the_kinds_of_the_joints(build: Build) -> None:
    text = chain(joint("shoulder", "revolute", "l0", "l1"), joint("elbow", "prismatic", "l1", "l2"))
    given = [
        entry("transmission_coupling", "shoulder", source="elbow", coefficient=0.1),
        entry("transmission_coupling", "elbow", source="shoulder", coefficient=0.1),
        entry("rotor_inertia", "elbow", inertia=0.1),
        entry("load_dependent_friction", "elbow", coefficient=0.1),
    ]
    effects = effects_of(build, *given, text=text)
    assert [effect.coefficients[0].unit for effect in effects] == ["m", "1/m", "kg", "1"]


@pytest.mark.parametrize("name", ["stribeck", "load", "drift", "drag"])
def test_where_the_joint_rests_only_what_is_dry_is_not_known(build: Build, name: str) -> None:
    motion = random_motion()
    motion.v[1, 100:150] = 0
    (effect,) = effects_of(build, (FORMS | LOADED)[name][0])
    unknown = effect.invalid_mask(motion)
    if name == "drag":
        assert not unknown
    else:
        np.testing.assert_array_equal(np.flatnonzero(unknown.pop(1)), np.arange(100, 150))
        assert not unknown


B, C = np.array([0.3, 0.2]), np.array([0.2, 0.15])  # viscous and Coulomb friction of shoulder and elbow


def arm(
    smooth: Callable[..., Any] | None = None, level: Callable[..., Any] | None = None, rotor: float = 0.0
) -> Physics:
    """The arm with its viscous and Coulomb friction, and more on the elbow, as functions of t, q, v, tau."""
    elbow = np.array([0.0, 1.0])

    def resists(t: float, q: Array, v: Array, tau: Array) -> Array:
        return np.asarray(B * v + elbow * (smooth(t, q, v, tau) if smooth else 0.0))

    def rubs(t: float, q: Array, v: Array, tau: Array) -> Array:
        return np.asarray(C + elbow * (level(t, q, v, tau) if level else 0.0))

    return Physics(resists, rubs, (0.0, rotor))


# The physics, the entry with its shape values, what is to be found, and how near.
TRUTHS: dict[str, tuple[Physics, dict[str, Any], dict[str, float], float]] = {
    "stribeck": (
        arm(level=lambda t, q, v, tau: 0.3 * np.exp(-((v / 0.5) ** 2))),
        entry("stribeck_friction", stribeck=0, velocity=0.5),
        {"stribeck": 0.3},
        0.03,
    ),
    "load": (
        arm(level=lambda t, q, v, tau: 0.15 * np.abs(tau)),
        entry("load_dependent_friction", coefficient=0),
        {"coefficient": 0.15},
        0.01,
    ),
    "drag": (
        arm(lambda t, q, v, tau: 0.1 * v * np.abs(v)),
        entry("quadratic_drag", drag=0),
        {"drag": 0.1},
        0.01,
    ),
    "ripple": (
        arm(lambda t, q, v, tau: 0.3 * np.sin(9.3 * q + 2.2)),
        entry("torque_ripple", amplitude=0, periods=9.3, phase=0),
        {"amplitude": 0.3, "phase": 2.2},
        0.01,
    ),
    "stop": (
        arm(lambda t, q, v, tau: 30 * np.maximum(q - 0.9, 0)),
        entry("end_stop", stiffness=0, position=0.9),
        {"stiffness": 30},
        0.005,
    ),
    "rotor": (arm(rotor=0.05), entry("rotor_inertia", inertia=0), {"inertia": 0.05}, 0.005),
    "coupling": (
        arm(lambda t, q, v, tau: -0.07 * tau[0]),
        entry("transmission_coupling", source="shoulder", coefficient=0),
        {"coefficient": 0.07},
        0.01,
    ),
    "drift": (
        arm(
            lambda t, q, v, tau: 0.25 * (1 - np.exp(-t / 3)) * v,
            lambda t, q, v, tau: -0.1 * (1 - np.exp(-t / 3)),
        ),
        entry("friction_drift", viscous=0, coulomb=0, time_constant=3),
        {"viscous": 0.25, "coulomb": -0.1},
        0.02,
    ),
}


def fitted(folder: Path, physics: Physics, entries: list[dict[str, Any]], seconds: float = 8.0) -> Fit:
    """The fit to a recording of the arm."""
    urdf, log = written(folder, recording(physics, seconds))
    config = parse_config({"effects": entries}, "")
    return fit(prepare(read_robot(urdf), config, [log], holdout=0), lambda stage, share: None)


@pytest.mark.parametrize(("physics", "given", "truth", "near"), TRUTHS.values(), ids=TRUTHS)
def test_what_mujocos_arm_has_is_found_again(
    tmp_path: Path, physics: Physics, given: dict[str, Any], truth: dict[str, float], near: float
) -> None:
    found = model_config(fitted(tmp_path, physics, [given]))
    (effect,) = found["effects"]
    for name, value in truth.items():
        assert effect["parameters"][name]["value"] == pytest.approx(value, rel=near)
        assert 0 < effect["parameters"][name]["standard_error"] < near * abs(value)
    assert found["friction"]["elbow"]["viscous"]["value"] == pytest.approx(B[1], rel=0.03)
    assert found["friction"]["elbow"]["coulomb"]["value"] == pytest.approx(C[1], rel=0.03)
