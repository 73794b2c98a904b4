"""Effects that the export has never heard of: what they add to a mechanism decides whether a simulator carries it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported import EXACT, InMujoco, arm, mass_and_bias, model_of, state, unsupported_parts
from numpy.typing import NDArray
from reference import Reference

from idtool.data.signals import Motion
from idtool.dynamics.effects import JointTerm, effect_types
from idtool.dynamics.effects.simulator_element import Damping, SimulatorElement, Spring
from idtool.dynamics.mechanism import Mechanism, TorqueSensor, Transmission
from idtool.reporting.export import Export, to_drake, to_mujoco
from idtool.robot.inertia import from_mass_com_inertia

Array = NDArray[np.float64]


class Invented(JointTerm):
    """A torque that no simulator knows."""

    id, coefficient_name, units = "invented", "size", ("N·m", "N")

    def column(self, motion: Motion) -> Array:
        return np.asarray(np.sin(motion.q[self.joint]))


class Misread(Invented):
    """Positions that are less than the true ones."""

    id = "misread"

    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.position_offset[self.joint] += theta[0]


class Heavy(Invented):
    """Inertia on the joint."""

    id = "heavy"

    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.armature[self.joint] += theta[0]


class Laden(Invented):
    """Mass on the last link."""

    id = "laden"

    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.pi[-1] += from_mass_com_inertia(theta[0], [0.1, 0.0, 0.2], 0.01 * np.eye(3))


class Tilted(Invented):
    """Gravity along x."""

    id = "tilted"

    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.gravity = np.array([theta[0], 0.0, 0.0])


class Soft(Invented):
    """A soft gear."""

    id = "soft"

    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.transmissions[int(self.joint)] = Transmission(theta[0], 0.1)


class Braced(Invented):
    """A damper and a spring of the same size, which it says that it is."""

    id = "braced"

    def column(self, motion: Motion) -> Array:
        return np.asarray(motion.v[self.joint] + motion.q[self.joint] - 0.3)

    def simulator_elements(self, theta: Array) -> tuple[SimulatorElement, ...]:
        joint, size = int(self.joint), float(theta[0])
        return Damping(joint, size), Spring(joint, size, 0.3)


class Deaf(Invented):
    """A sensor that reads too little."""

    id = "deaf"

    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        gain = theta[0]
        mechanism.torque_sensors[int(self.joint)] = TorqueSensor(lambda x: gain * x, lambda x: x / gain)


@pytest.fixture
def urdf(rng: np.random.Generator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A robot whose effects these are."""
    for kind in (Invented, Misread, Heavy, Laden, Tilted, Soft, Braced, Deaf):
        monkeypatch.setitem(effect_types(), kind.id, kind)
    path = tmp_path / "identified.urdf"
    path.write_text(arm(rng, "0 0 1", "0 1 0"))
    return path


def entry(effect: str, size: float) -> dict[str, Any]:
    return {"effect": effect, "joint": "j2", "parameters": {"size": {"value": size, "standard_error": 0.1}}}


def truth(
    urdf: Path, q: Array, v: Array, gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
) -> tuple[Array, Array]:
    """M and h of the robot without effects."""
    return mass_and_bias(Reference(urdf.read_text(), ["j1", "j2"], {"gravity": gravity}), q, v)


def told(export: Export) -> dict[str, tuple[str, float | None, str | None]]:
    return {part.what: (part.of, part.value, part.unit) for part in export.not_carried if part.what != "fixed_base"}


@pytest.mark.parametrize("effect", ["invented", "soft", "deaf"])
def test_what_no_simulator_knows_is_said(urdf: Path, effect: str) -> None:
    for export in (to_mujoco, to_drake):
        assert told(export(model_of(urdf, effects=[entry(effect, 0.7)]))) == {effect: ("j2", 0.7, "N·m")}
    text = to_mujoco(model_of(urdf, effects=[entry(effect, 0.7)])).text.decode()
    assert f"{effect} of j2" in text
    if effect == "invented":
        assert told(to_mujoco(model_of(urdf, effects=[entry(effect, 0.0)]))) == {}


REAL: list[dict[str, Any]] = [
    {"effect": "quadratic_drag", "joint": "j1", "parameters": {"drag": 0.2}},
    {"effect": "end_stop", "joint": "j1", "parameters": {"stiffness": 40.0, "position": 0.5}},
    {"effect": "end_stop", "joint": "j1", "parameters": {"stiffness": 30.0, "position": -0.4}},
    {"effect": "rotor_inertia", "joint": "j2", "parameters": {"inertia": 0.3}},
    {"effect": "transmission_coupling", "joint": "j2", "parameters": {"source": "j1", "coefficient": 0.15}},
    {"effect": "torque_offset", "joint": "j1", "parameters": {"offset": 0.6}},
]


@pytest.mark.parametrize("place", [0.0, 0.9, -0.8])
def test_effects_that_mujoco_carries(rng: np.random.Generator, urdf: Path, place: float) -> None:
    model = model_of(urdf, effects=REAL, friction={"viscous": 0.1, "coulomb": False})
    export = to_mujoco(model)
    assert told(export) == {}
    found = InMujoco(export, ["j1", "j2"])
    q, v, tau = np.array([place, 0.4]), rng.uniform(-3, 3, 2), rng.uniform(-5, 5, 2)
    M, h = truth(urdf, q, v)
    beyond = max(place - 0.5, 0.0) * 40 + min(place + 0.4, 0.0) * 30
    acts = np.array([0.2 * v[0] * abs(v[0]) + beyond + 0.6, -0.15 * tau[0]]) + 0.1 * v
    expected = np.linalg.solve(M + np.diag([0.0, 0.3]), tau - h - acts)
    np.testing.assert_allclose(found.acceleration(q, v, tau), expected, **EXACT)
    assert {part.what for part in to_drake(model).not_carried} - {"fixed_base"} == {
        "quadratic_drag",
        "end_stop",
        "transmission_coupling",
        "torque_offset",
    }


def test_effects_that_say_what_they_are_to_a_simulator(rng: np.random.Generator, urdf: Path) -> None:
    """One is carried where the simulator has all of its elements; springs on a joint add up."""
    spring = {"effect": "parallel_spring", "joint": "j2", "parameters": {"stiffness": 5.0, "rest_position": 0.6}}
    model = model_of(urdf, effects=[entry("braced", 0.7), spring], friction={"viscous": 0.1, "coulomb": False})
    export = to_mujoco(model)
    assert told(export) == {}
    (part,) = [part for part in export.carried if part.what == "braced"]
    assert part.detail == "damping and stiffness, springref 0.3"
    q, v = state(rng, 2)
    M, h = truth(urdf, q, v)
    acts = 0.1 * v + np.array([0.0, 0.7 * v[1] + 0.7 * (q[1] - 0.3) + 5.0 * (q[1] - 0.6)])
    found = InMujoco(export, ["j1", "j2"])
    np.testing.assert_allclose(found.acceleration(q, v, np.zeros(2)), np.linalg.solve(M, -h - acts), **EXACT)

    drake = to_drake(model)
    assert told(drake).keys() == {"braced", "parallel_spring"}
    assert b'damping="0.8"' not in drake.text


UNKNOWN: list[tuple[dict[str, Any], float, str]] = [
    ({"effect": "stribeck_friction", "parameters": {"stribeck": 0.4, "velocity": 0.1}}, 0.4, "N·m"),
    ({"effect": "torque_ripple", "parameters": {"amplitude": 0.3, "periods": 6, "phase": 1.0}}, 0.3, "N·m"),
    ({"effect": "load_dependent_friction", "parameters": {"coefficient": 0.05}}, 0.05, "1"),
]


@pytest.mark.parametrize(
    ("given", "value", "unit"), UNKNOWN, ids=lambda x: x.get("effect") if isinstance(x, dict) else ""
)
def test_effects_that_it_does_not(urdf: Path, given: dict[str, Any], value: float, unit: str) -> None:
    model = model_of(urdf, effects=[{"joint": "j2", **given}])
    for export in (to_mujoco(model), to_drake(model)):
        (part,) = [part for part in export.not_carried if part.what == given["effect"]]
        assert (part.of, part.value, part.unit) == ("j2", pytest.approx(value), unit)


def test_positions_are_those_that_the_sensors_give(rng: np.random.Generator, urdf: Path) -> None:
    spring = {"effect": "parallel_spring", "joint": "j2", "parameters": {"stiffness": 5.0, "rest_position": 0.6}}
    stop = {"effect": "end_stop", "joint": "j2", "parameters": {"stiffness": 8.0, "position": 0.1}}
    model = model_of(
        urdf, effects=[entry("misread", 0.25), spring, stop], friction={"viscous": False, "coulomb": False}
    )
    assert told(to_mujoco(model)) == {}
    assert told(to_drake(model)).keys() == {"misread", "parallel_spring", "end_stop"}
    q, v = np.array([0.4, 0.9]), state(rng, 2)[1]
    true = q + np.array([0.0, 0.25])
    M, h = truth(urdf, true, v)
    expected = np.linalg.solve(M, -h - np.array([0.0, 5.0 * (true[1] - 0.6) + 8.0 * (true[1] - 0.1)]))
    found = InMujoco(to_mujoco(model), ["j1", "j2"])
    np.testing.assert_allclose(found.acceleration(q, v, np.zeros(2)), expected, **EXACT)


def test_inertia_on_a_joint_is_armature(rng: np.random.Generator, urdf: Path) -> None:
    model = model_of(urdf, effects=[entry("heavy", 0.3)])
    q, v = state(rng, 2)
    M, h = truth(urdf, q, v)
    own_M, own_h = InMujoco(to_mujoco(model), ["j1", "j2"]).mass_and_bias(q, v)
    np.testing.assert_allclose(own_M - M, np.diag([0, 0.3]), atol=1e-9)
    np.testing.assert_allclose(own_h, h, **EXACT)
    assert told(to_mujoco(model)) == told(to_drake(model)) == {}
    assert b'rotor_inertia value="0.3"' in to_drake(model).text


def test_mass_on_a_link_is_in_its_inertial(urdf: Path) -> None:
    bare, laden = model_of(urdf), model_of(urdf, effects=[entry("laden", 0.4)])
    found = InMujoco(to_mujoco(laden), ["j1", "j2"])
    own = bare.robot.links["l2"]
    assert own is not None
    pi = own + from_mass_com_inertia(0.4, [0.1, 0.0, 0.2], 0.01 * np.eye(3))
    assert found.model.body("l2").mass[0] == pytest.approx(pi[0], rel=1e-12)
    np.testing.assert_allclose(found.model.body("l2").ipos, pi[1:4] / pi[0], rtol=1e-9)
    assert told(to_mujoco(laden)) == told(to_drake(laden)) == {}
    urdf.write_bytes(to_drake(laden).text)
    np.testing.assert_allclose(model_of(urdf).robot.links["l2"], pi, rtol=1e-9, atol=1e-12)


def test_gravity_is_the_effects(rng: np.random.Generator, urdf: Path) -> None:
    model = model_of(urdf, effects=[entry("tilted", 3.0)])
    q, v = state(rng, 2)
    _, h = truth(urdf, q, v, (3.0, 0.0, 0.0))
    np.testing.assert_allclose(InMujoco(to_mujoco(model), ["j1", "j2"]).mass_and_bias(q, v)[1], h, **EXACT)
    assert [part.of for part in unsupported_parts(to_drake(model), "gravity")] == ["l0"]
