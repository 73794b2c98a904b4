"""Entries under `effects`: read, refused, and written as they are read; parameters made of coefficients and back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from arms import JOINTS, Physics, recording, written
from effect_torques import TWO, Build, effects_of, entry, random_motion, torque
from hypothesis import given
from hypothesis import strategies as st
from robots import chain, joint

import idtool.dynamics.effects
from idtool.common.exceptions import ConfigError
from idtool.dynamics.effects import build_effects, effect_from_entry, effect_types
from idtool.dynamics.effects.joint_effect import JointEffect
from idtool.estimation.dataset.experiment import coefficients_of, prepare
from idtool.estimation.fit import fit
from idtool.reporting.fit_report import model_config
from idtool.robot.config import EffectEntry, parse_config
from idtool.robot.inertia import PI_SIZE
from idtool.robot.urdf.reading import read_robot

# Parameters of the effects that are functions of the joints' state.
PARAMETERS = {
    "viscous_friction": {"viscous"},
    "coulomb_friction": {"coulomb"},
    "stribeck_friction": {"stribeck", "velocity"},
    "load_dependent_friction": {"coefficient"},
    "quadratic_drag": {"drag"},
    "torque_offset": {"offset"},
    "torque_ripple": {"amplitude", "periods", "phase"},
    "parallel_spring": {"stiffness", "rest_position"},
    "end_stop": {"stiffness", "position"},
    "rotor_inertia": {"inertia"},
    "transmission_coupling": {"source", "coefficient"},
    "friction_drift": {"viscous", "coulomb", "time_constant"},
    "rounded_friction": {"velocity"},
}


def test_the_documented_effects_have_the_documented_parameters(build: Build) -> None:
    model = build(TWO, JOINTS)
    values: dict[str, Any] = {name: 0.5 for names in PARAMETERS.values() for name in names} | {"source": "shoulder"}
    assert set(effect_types()) >= set(PARAMETERS)
    for effect, names in PARAMETERS.items():
        given = EffectEntry(**entry(effect, **{name: values[name] for name in names}))
        assert effect_from_entry(given, model).key[:2] == (effect, "elbow")


def test_what_physics_demands_of_the_coefficients(build: Build) -> None:
    free = {"torque_offset", "torque_ripple", "transmission_coupling", "friction_drift"}
    values: dict[str, Any] = {name: 0.5 for names in PARAMETERS.values() for name in names} | {"source": "shoulder"}
    for effect, names in PARAMETERS.items():
        (found,) = effects_of(build, entry(effect, **{name: values[name] for name in names}))
        assert {c.lower for c in found.coefficients} == {-np.inf if effect in free else 0.0}


STOP = {"stiffness": 5, "position": 1}
COUPLING = {"coefficient": 0.1, "source": "shoulder"}
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "an unknown effect": (entry("end_stopp", **STOP), "end_stopp: is not an effect of this version; did you mean end_"),
    "an unknown joint": (
        entry("end_stop", "elbo", **STOP),
        "end_stop: elbo is not a moving joint; did you mean elbow?",
    ),
    "no joint": ({"effect": "end_stop", "parameters": STOP}, "end_stop: acts on a joint"),
    "a link": (
        {**entry("end_stop", **STOP), "link": "lower"},
        "end_stop: acts on a joint; give `joint` and not `link`",
    ),
    "an unknown parameter": (entry("end_stop", **STOP, stif=1), "end_stop: has no parameter stif; did you mean stiff"),
    "a missing one": (entry("end_stop", stiffness=1), "end_stop: needs the parameters stiffness, position; add posi"),
    "one of two lines": (entry("end_stop", **STOP, **{"a\nb": 1}), r"end_stop: has no parameter a\nb"),
    "a side that is none": (entry("end_stop", **STOP, side=0.5), "end_stop: side of 0.5 is out of range; give -1 or 1"),
    "a word": (entry("end_stop", stiffness="hard", position=1), "end_stop: stiffness is not a number of possible size"),
    "a list": (entry("end_stop", stiffness=1, position=[1]), "end_stop: position is not a number"),
    "not finite": (entry("end_stop", stiffness=1, position=float("nan")), "end_stop: position is not a number"),
    "a spring that pushes": (
        entry("end_stop", stiffness=-1, position=1),
        "stiffness of -1 is out of range; give 0 or more",
    ),
    "friction that drives": (entry("stribeck_friction", stribeck=-1, velocity=1), "stribeck of -1 is out of range"),
    "no Stribeck velocity": (
        entry("stribeck_friction", stribeck=1, velocity=0),
        "velocity of 0 is out of range; give 1e-06",
    ),
    "negative periods": (entry("torque_ripple", amplitude=1, phase=0, periods=-2), "periods of -2 is out of range"),
    "no time constant": (
        entry("friction_drift", viscous=1, coulomb=0, time_constant=0),
        "time_constant of 0 is out of range",
    ),
    "inertia below nothing": (entry("rotor_inertia", inertia=-1), "inertia of -1 is out of range"),
    "drag that drives": (entry("quadratic_drag", drag=-1), "drag of -1 is out of range"),
    "an unknown source": (
        entry("transmission_coupling", coefficient=1, source="sholder"),
        "transmission_coupling: source sholder is not a moving joint; did you mean shoulder?",
    ),
    "a number as source": (entry("transmission_coupling", coefficient=1, source=0), "source 0 is not a moving joint"),
    "a list as source": (
        entry("transmission_coupling", coefficient=1, source=["a"]),
        "is not a moving joint; available:",
    ),
    "itself as source": (
        entry("transmission_coupling", "shoulder", **COUPLING),
        "transmission_coupling: source must not be the joint shoulder itself; name another",
    ),
}


@pytest.mark.parametrize(("bad", "message"), BAD.values(), ids=BAD)
def test_a_bad_entry_is_refused_in_one_line(build: Build, bad: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        effects_of(build, bad)
    said = str(caught.value)
    assert said.startswith("effects: ")
    assert message in said
    assert said.isprintable()
    assert len(said) < 200


def test_a_joint_may_have_an_effect_more_than_once_where_shapes_tell_them_apart(build: Build) -> None:
    pairs = [
        [entry("end_stop", stiffness=5, position=x) for x in (-1, 1)],
        [entry("torque_ripple", amplitude=1, phase=0, periods=n) for n in (6, 12)],
        [entry("transmission_coupling", at, **COUPLING) for at in ("elbow", "wrist")],
    ]
    text = chain(*(joint(n, "revolute", f"l{i}", f"l{i + 1}") for i, n in enumerate((*JOINTS, "wrist"))))
    model = build(text, (*JOINTS, "wrist"))
    entries = [e for pair in pairs for e in pair]
    coefficients = [c for e in build_effects(model, parse_config({"effects": entries}, ""))[1:] for c in e.coefficients]
    assert len({c.key for c in coefficients}) == len(coefficients) == 6 + 8
    for pair in pairs[:2]:
        with pytest.raises(ConfigError, match="is listed twice for elbow"):
            effects_of(build, *pair, pair[0])
    with pytest.raises(ConfigError, match="is listed twice for elbow"):  # one spring does what two do
        effects_of(build, *(entry("parallel_spring", stiffness=1, rest_position=x) for x in (0, 1)))


def test_an_entry_takes_the_place_of_the_friction_of_its_name(build: Build) -> None:
    config = {"friction": {"coulomb": 0.3}, "effects": [entry("coulomb_friction", coulomb=0.7)]}
    effects = build_effects(build(TWO, JOINTS), parse_config(config, ""))[1:]
    priors = {c.owner: c.prior for e in effects for c in e.coefficients if c.name == "coulomb"}
    assert priors == {"shoulder": 0.3, "elbow": 0.7}


@given(st.floats(1e-3, 1e3), st.floats(-20, 20))
def test_amplitude_and_phase_go_there_and_back(amplitude: float, phase: float) -> None:
    kind = effect_types()["torque_ripple"]
    assert issubclass(kind, JointEffect)
    theta = np.array([amplitude * np.cos(phase), amplitude * np.sin(phase)])
    found = kind.parameters(object.__new__(kind), theta, np.full((2, 2), np.inf))
    assert found["amplitude"] == (pytest.approx(amplitude), None)
    assert abs(found["phase"][0]) <= np.pi
    np.testing.assert_allclose(np.exp(1j * found["phase"][0]), np.exp(1j * phase), atol=1e-9)


def test_the_errors_of_amplitude_and_phase_are_those_of_many_draws(build: Build) -> None:
    rng = np.random.default_rng(2)
    theta, covariance = np.array([-0.8, 1.1]), 1e-4 * np.array([[4.0, 1.5], [1.5, 1.0]])
    (effect,) = effects_of(build, entry("torque_ripple", amplitude=1, phase=0, periods=6))
    assert isinstance(effect, JointEffect)
    found = effect.parameters(theta, covariance)
    sine, cosine = rng.multivariate_normal(theta, covariance, 100_000).T
    assert found["amplitude"] == (
        pytest.approx(np.hypot(0.8, 1.1)),
        pytest.approx(np.hypot(sine, cosine).std(), rel=0.02),
    )
    assert found["phase"][1] == pytest.approx(np.arctan2(cosine, sine).std(), rel=0.02)
    assert effect.parameters(np.zeros(2), covariance) == {"amplitude": (0.0, None), "phase": (0.0, None)}


MODULE = '''
from idtool.dynamics.effects.joint_term import JointTerm

class Cubic(JointTerm):
    """k q³."""

    id = "cubic_spring"
    coefficient_name = "cubic"
    units = ("N·m/rad³", "N/m³")

    def column(self, motion):
        """The cube."""
        return motion.q[self.joint] ** 3
'''


def test_a_new_effect_is_one_new_file(build: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cubic_for_a_test.py").write_text(MODULE)
    monkeypatch.setattr(idtool.dynamics.effects, "__path__", [*idtool.dynamics.effects.__path__, str(tmp_path)])
    effect_types.cache_clear()
    try:
        motion = random_motion()
        np.testing.assert_allclose(torque(build, motion, entry("cubic_spring", cubic=2.0))[1], 2 * motion.q[1] ** 3)
    finally:
        monkeypatch.undo()
        effect_types.cache_clear()
    assert "cubic_spring" not in effect_types()


@pytest.mark.parametrize("effect", sorted(effect_types()))
def test_an_effect_is_in_the_file_of_its_id(effect: str) -> None:
    assert effect_types()[effect].__module__ == f"{idtool.dynamics.effects.__name__}.{effect}"


EVERY = [
    entry("stribeck_friction", stribeck=0, velocity=0.5),
    entry("load_dependent_friction", coefficient=0),
    entry("quadratic_drag", drag=0),
    entry("torque_ripple", amplitude=0, periods=9.3, phase=0),
    entry("torque_ripple", amplitude=0.1, periods=4, phase={"value": 1.0}),
    entry("end_stop", stiffness=0, position=0.9),
    entry("end_stop", stiffness={"value": 0, "standard_error": 1}, position=-0.9),
    entry("rotor_inertia", inertia=0),
    entry("transmission_coupling", source="shoulder", coefficient=0),
    entry("friction_drift", viscous=0, coulomb=0, time_constant=3),
    entry("parallel_spring", "shoulder", stiffness=0, rest_position=0.2),
    entry("torque_offset", "shoulder", offset=0.1),
]


def test_the_written_model_reads_back_to_the_same_coefficients(tmp_path: Path) -> None:
    """Through the text of model.yaml."""
    urdf, log = written(tmp_path, recording(Physics(lambda t, q, v, tau: 0.3 * v), 3))
    experiment = prepare(read_robot(urdf), parse_config({"effects": EVERY}, ""), [log], holdout=0)
    done = fit(experiment, lambda stage, share: None)
    config = parse_config(yaml.safe_load(yaml.safe_dump(model_config(done))), "")
    again = coefficients_of(read_robot(urdf), config, experiment)
    own = slice(PI_SIZE * len(experiment.model.bodies), None)
    assert len(again[own]) == 4 + len(EVERY) + 3  # friction; ripples and drift have two each
    assert np.count_nonzero(done.estimate.theta[own]) > 12
    np.testing.assert_allclose(again[own], done.estimate.theta[own], rtol=1e-9, atol=1e-14)
    for before, after in zip(EVERY, config.effects, strict=True):
        assert set(after.parameters) == set(before["parameters"])
        for held in ("velocity", "periods", "position", "source", "time_constant", "rest_position"):
            assert after.parameters.get(held) == before["parameters"].get(held)
