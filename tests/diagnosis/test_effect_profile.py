"""The picture of a step: torques of Pinocchio, to which is added an effect in closed form."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from disturbed import NOISE, RATE, Hidden, contact, experiment_of, motion, nothing, silent, torque_on_joint
from numpy.typing import NDArray

from idtool.diagnosis.effect_profile import effect_profile
from idtool.diagnosis.records import EffectProfile
from idtool.diagnosis.trial import with_effects
from idtool.robot.config import EffectEntry

Array = NDArray[np.float64]

PERIODS = 41.0
BAND = 40.0  # Hz


def profile_of(folder: Path, hidden: Hidden, effect: str, **entry: Any) -> EffectProfile:
    """Profile of an effect with its true parameters, in a model that is otherwise true."""
    before = experiment_of(folder, hidden)
    added = EffectEntry(effect=effect, **entry)
    after = with_effects(before, [added])
    return effect_profile(added, before, before.equation.prior, after, after.equation.prior, silent)


def load_friction(t: Array, q: Array, v: Array, tau: Array) -> Array:
    """0.1 |y| sign(v), of the actuator torque y, which contains it."""
    return np.asarray(tau / (1 - 0.1 * np.sign(tau * v)) - tau)


LAWS: list[tuple[str, dict[str, float], Callable[..., Array], str, Callable[[Array], Array]]] = [
    (
        "parallel_spring",
        {"stiffness": 3.0, "rest_position": 0.2},
        lambda t, q, v, tau: 3.0 * (q - 0.2),
        "position",
        lambda x: 3.0 * (x - 0.2),
    ),
    ("viscous_friction", {"viscous": 0.4}, lambda t, q, v, tau: 0.4 * v, "velocity", lambda x: 0.4 * x),
    ("torque_gain", {"gain": 1.25}, lambda t, q, v, tau: 0.25 * tau, "torque", lambda x: 0.2 * x),
    ("load_dependent_friction", {"coefficient": 0.1}, load_friction, "torque", lambda x: 0.1 * np.abs(x)),
    (
        "torque_ripple",
        {"amplitude": 0.5, "periods": PERIODS, "phase": 0.0},
        lambda t, q, v, tau: 0.5 * np.sin(PERIODS * q),
        "position",
        lambda x: 0.5 * np.sin(PERIODS * x),
    ),
]


@pytest.mark.parametrize(("effect", "parameters", "law", "cause", "expected"), LAWS, ids=[law[0] for law in LAWS])
def test_before_is_the_law_after_is_noise(
    tmp_path: Path,
    effect: str,
    parameters: dict[str, float],
    law: Callable[..., Array],
    cause: str,
    expected: Callable[[Array], Array],
) -> None:
    profile = profile_of(tmp_path, torque_on_joint(0, law), effect, joint="j1", parameters=parameters)
    assert (profile.joint, profile.cause, profile.cause_joint) == ("j1", cause, "j1")
    assert len(profile.values) > 30
    assert (np.diff(profile.values) > 0).all()
    torque = expected(profile.values)
    tolerance = 0.05 * float(np.abs(torque).max())
    assert profile.effect_torque is not None
    for error in (profile.effect_torque - torque, profile.mean_before - torque, profile.mean_after):
        assert np.quantile(np.abs(error), 0.9) < tolerance  # a few bins are at reversals, where the filter smooths
    in_band = NOISE * np.sqrt(2 * BAND / RATE)
    assert np.median(profile.deviation_after) == pytest.approx(in_band, rel=0.5)


def test_a_ripple_is_reduced_to_its_period(tmp_path: Path) -> None:
    parameters = {"amplitude": 0.5, "periods": PERIODS, "phase": 0.0}
    profile = profile_of(tmp_path, nothing, "torque_ripple", joint="j1", parameters=parameters)
    assert profile.period == pytest.approx(2 * np.pi / PERIODS)
    assert profile.values.min() >= 0
    assert profile.values.max() <= profile.period


def test_friction_that_builds_up_is_drawn_along_the_motion_over_the_distance(tmp_path: Path) -> None:
    """After a reversal, Dahl's friction passes from against the new direction to along it."""
    parameters = {"amplitude": 0.5, "displacement": 0.05}
    profile = profile_of(tmp_path, nothing, "presliding_hysteresis", joint="j1", parameters=parameters)
    assert (profile.cause, profile.in_direction_of_motion) == ("distance_since_reversal", True)
    assert profile.effect_torque is not None
    expected = 0.5 * (1 - 2 * np.exp(-profile.values / 0.05))
    far = profile.values > 0.06  # nearer, the filter smooths
    np.testing.assert_allclose(profile.effect_torque[far], expected[far], atol=0.06)
    assert profile.effect_torque[0] < -0.3
    assert profile.effect_torque[-1] > 0.45


def test_a_coupling_is_drawn_against_the_torque_of_its_source(tmp_path: Path) -> None:
    _, _, _, tau = motion()
    hidden = torque_on_joint(1, lambda *_: -0.1 * tau[0])
    profile = profile_of(
        tmp_path, hidden, "transmission_coupling", joint="j2", parameters={"source": "j1", "coefficient": 0.1}
    )
    assert (profile.joint, profile.cause, profile.cause_joint) == ("j2", "torque", "j1")
    assert profile.effect_torque is not None
    np.testing.assert_allclose(profile.effect_torque, -0.1 * profile.values, atol=0.02)
    np.testing.assert_allclose(profile.mean_after, 0.0, atol=0.02)


def test_an_effect_on_a_link_is_drawn_where_it_explains_most(tmp_path: Path) -> None:
    window = [4.0, 6.0]
    wrench = [6.0, 0.0, 4.0, 0.0, 1.5, 0.0]
    profile = profile_of(
        tmp_path,
        contact((4.0, 6.0)),
        "external_contact",
        link="lower",
        parameters={"windows": [window], "wrench": wrench},
    )
    assert profile.cause == "time"
    within = (profile.values > 4.3) & (profile.values < 5.7)
    outside = (profile.values < 3.7) | (profile.values > 6.3)
    assert np.abs(profile.mean_before[within]).min() > 20 * np.abs(profile.mean_after[within]).max()
    assert np.abs(profile.mean_before[outside]).max() < 3 * NOISE


def test_a_torque_that_is_no_function_of_its_cause_has_no_line(tmp_path: Path) -> None:
    """Weight of a payload on the second link, which depends on both joints' positions, and its inertia."""
    parameters = {"mass": 0.5, "com": [0.0, 0.0, -0.3], "inertia": [0.0] * 6}
    profile = profile_of(tmp_path, nothing, "payload", link="lower", parameters=parameters)
    assert profile.cause == "position"
    assert profile.effect_torque is None
