"""Effects of a simulator and of a robot side by side."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from disturbed import URDF, experiment_of, nothing, silent, torque_on_joint
from numpy.typing import NDArray

from idtool.common.notice import Notice
from idtool.diagnosis.comparison import (
    _changes,
    _simulator_notices,
    _unexplained_gap,
    _unexplained_notices,
    _unexplained_simulator,
)
from idtool.diagnosis.diagnose import Options, diagnose
from idtool.diagnosis.fitted_pair import FittedPair, FittedTerm, GapLevel, numbered_terms
from idtool.diagnosis.records import Diagnosis, ErrorSummary
from idtool.dynamics.effects import effect_from_entry
from idtool.estimation.fit import Fit, fit
from idtool.robot.config import EffectEntry, parse_config
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

NOTHING = np.zeros(2)  # mean squared error above the noise


def term(folder: Path, effect: str, **parameters: Any) -> FittedTerm:
    """An effect on the first joint with its parameters as they are configured."""
    (folder / "arm.urdf").write_text(URDF)
    model = build_model(read_robot(folder / "arm.urdf"), parse_config({}, ""), ["j1", "j2"])
    entry = EffectEntry(effect=effect, joint="j1", parameters=parameters)
    named = effect_from_entry(entry, model)
    count = len(named.coefficients)
    return FittedTerm(named, entry, np.array([c.prior for c in named.coefficients]), np.eye(count))


def places(terms: dict[Any, FittedTerm]) -> dict[int, float]:
    """Position or number of periods by the number of the effect."""
    return {number: term.effect.key[2] for (_, _, number), term in terms.items()}


def test_an_effect_is_compared_with_the_nearest_of_its_kind(tmp_path: Path) -> None:
    for effect, name, linear, simulator, robot in (
        ("end_stop", "position", {"stiffness": 9.0}, (0.7, -0.6), (-0.65, 0.75)),
        ("torque_ripple", "periods", {"amplitude": 1.0, "phase": 0.1}, (6.0, 12.0, 7.0), (12.1, 6.9, 6.1)),
    ):
        others = numbered_terms([term(tmp_path, effect, **linear, **{name: x}) for x in simulator], {})
        own = numbered_terms([term(tmp_path, effect, **linear, **{name: x}) for x in robot], others)
        matched = places(own)
        for number, place in places(others).items():
            assert abs(matched[number] - place) < 0.2
        assert len(own) == len(robot)


def test_effects_at_opposite_ends_or_of_other_joints_are_not_the_same(tmp_path: Path) -> None:
    upper, lower = (term(tmp_path, "end_stop", stiffness=9.0, position=x) for x in (0.7, -0.7))
    others = numbered_terms([upper], {})
    assert set(numbered_terms([lower], others)).isdisjoint(others)
    both = numbered_terms([lower, upper], others)
    assert both[next(iter(others))] is upper
    assert len(both) == 2


def test_a_parameter_that_was_left_out_is_zero(tmp_path: Path) -> None:
    given = term(tmp_path, "backlash", width=0.02, motor_friction={"value": 0.3, "standard_error": 0.05})
    left_out = term(tmp_path, "backlash", width=0.02)
    assert given.parameters()["motor_friction"] == (0.3, 0.05)
    assert left_out.parameters()["motor_friction"] == (0.0, None)


def stopped_at(*stops: tuple[float, float]) -> Any:
    """Torque of stops on the first joint, by position and stiffness."""

    def torque(t: Array, q: Array, v: Array, tau: Array) -> Array:
        total = np.zeros_like(q)
        for position, stiffness in stops:
            side = np.sign(position)
            total += stiffness * side * np.maximum(side * (q - position), 0)
        return total

    return torque_on_joint(0, torque)


def fitted(folder: Path, *effects: dict[str, Any], hidden: Any = nothing) -> Fit:
    folder.mkdir()
    return fit(experiment_of(folder, hidden, effects=list(effects)), silent)


def stop(position: float) -> dict[str, Any]:
    return {"effect": "end_stop", "joint": "j1", "parameters": {"stiffness": 0.0, "position": position}}


def test_stops_in_another_order_are_compared_one_by_one(tmp_path: Path) -> None:
    simulator = fitted(tmp_path / "simulator", stop(0.7), stop(-0.7), hidden=stopped_at((0.7, 20), (-0.7, 40)))
    robot = fitted(tmp_path / "robot", stop(-0.7), stop(0.7), hidden=stopped_at((-0.7, 40), (0.7, 60)))
    pair = FittedPair(simulator, robot, silent)
    changes, changed = _changes(pair, NOTHING)
    stops = [change for change in changes if change.effect == "end_stop"]
    assert [change.quantities["position"].simulator for change in stops] == [0.7, -0.7]
    needed, other = stops
    assert (needed.reason, bool(other.reason)) == ("", True)
    np.testing.assert_allclose(needed.quantities["stiffness"].simulator, 20, rtol=0.05)
    np.testing.assert_allclose(needed.quantities["stiffness"].robot, 60, rtol=0.05)
    level = pair.gap_level(changed, simulate=False)
    np.testing.assert_allclose(np.square([level.torque["j1"], level.torque["j2"]]), pair.mean_squared_errors(changed))


def test_a_difference_below_the_error_of_the_simulators_model_needs_no_change(tmp_path: Path) -> None:
    simulator = fitted(tmp_path / "simulator", stop(0.7), hidden=stopped_at((0.7, 20)))
    robot = fitted(tmp_path / "robot", stop(0.7), hidden=stopped_at((0.7, 60)))
    pair = FittedPair(simulator, robot, silent)
    gap = pair.mean_squared_errors(())[0]
    for unexplained, reason in (
        (0.5 * gap, ""),
        (2 * gap, "changes the torque by less than the simulator's own logs leave unexplained"),
    ):
        changes, changed = _changes(pair, np.array([unexplained, 0.0]))
        (change,) = [change for change in changes if change.effect == "end_stop"]
        assert change.reason == reason
        assert bool(changed) is not bool(reason)


def test_a_left_out_share_is_no_difference(tmp_path: Path) -> None:
    """Both have a play; its share of friction on the motor's side was not significant in one of them."""
    play = {"effect": "backlash", "joint": "j1", "parameters": {"width": {"value": 0.02, "standard_error": 0.001}}}
    shared = {**play, "parameters": {**play["parameters"], "motor_friction": {"value": 0.1, "standard_error": 0.05}}}
    bare = fitted(tmp_path / "bare", play)
    full = fitted(tmp_path / "full", shared)
    for simulator, robot in ((bare, full), (full, bare)):
        changes, _ = _changes(FittedPair(simulator, robot, silent), NOTHING)
        (change,) = [change for change in changes if change.effect == "backlash"]
        assert set(change.quantities) == {"width", "motor_friction"}
        assert {change.quantities["motor_friction"].simulator, change.quantities["motor_friction"].robot} == {0.0, 0.1}
        assert change.reason == "differs by less than 3 standard errors"


def test_a_value_that_was_not_fitted_to_the_logs_of_one_side_is_not_its_own(tmp_path: Path) -> None:
    """A friction that only the robot has: the simulator's logs say how large it is there, not at which velocity."""
    velocity = {"value": 0.3, "standard_error": 0.01}
    stribeck = {"effect": "stribeck_friction", "joint": "j1", "parameters": {"stribeck": 1.0, "velocity": velocity}}
    with_friction = torque_on_joint(0, lambda t, q, v, tau: np.exp(-np.square(v / 0.3)) * np.tanh(v / 0.01))
    simulator = fitted(tmp_path / "simulator")
    robot = fitted(tmp_path / "robot", stribeck, hidden=with_friction)
    for pair, own, other in (
        (FittedPair(simulator, robot, silent), "robot", "simulator"),
        (FittedPair(robot, simulator, silent), "simulator", "robot"),
    ):
        changes, changed = _changes(pair, NOTHING)
        (change,) = [change for change in changes if change.effect == "stribeck_friction"]
        assert change.reason == ""
        quantity = change.quantities["velocity"]
        assert (getattr(quantity, own), getattr(quantity, f"{own}_error")) == (0.3, 0.01)
        assert (getattr(quantity, other), getattr(quantity, f"{other}_error")) == (None, None)
        np.testing.assert_allclose(getattr(change.quantities["stribeck"], other), 0.0, atol=0.05)
        assert pair.gap_level(changed, simulate=False).torque["j1"] < 0.1


@pytest.fixture(scope="module")
def simulator(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    """Diagnosis of a simulator of the arm, with a tilt of the configuration."""
    tilt = {"effect": "gravity_tilt", "parameters": {"gravity": [0.0, 0.0, -9.81]}}
    experiment = experiment_of(tmp_path_factory.mktemp("simulator"), nothing, effects=[tilt])
    options = Options(inertia="fixed", effects=("payload",), simulate=False)
    return diagnose(experiment, options, silent)


def test_bodies_that_the_configuration_changes_are_those_of_the_simulator(simulator: Diagnosis) -> None:
    assert simulator.steps == ()
    assert list(_simulator_notices(simulator)) == []
    assert list(_unexplained_notices(simulator)) == []
    assert _unexplained_simulator(simulator) is None


def test_faults_of_the_simulator_are_not_corrected_in_the_configuration(simulator: Diagnosis) -> None:
    fault = Notice("wrong_unit", "problem", "j1", "q is in degrees", "set its `log.scale` to 0.0174533")
    (notice,) = _simulator_notices(replace(simulator, faults=(fault,)))
    assert (notice.subject, notice.message) == ("simulator, j1", "q is in degrees")
    assert "`log.scale` applies to the robot's logs only" in notice.advice


def test_a_comparison_is_not_conclusive_if_the_simulator_is_not_explained_by_its_model(simulator: Diagnosis) -> None:
    for error, noise, is_explained in ((0.01, 0.01, True), (3.0, 2.0, True), (3.0, 0.01, False), (99.0, 98.0, False)):
        errors = ErrorSummary({"j1": error, "j2": 0.01, "overall": error}, None, None)
        unlike = replace(simulator, after=errors, floor={"j1": noise, "j2": 0.01, "overall": noise})
        obstacle = _unexplained_simulator(unlike)
        assert (obstacle is None) == is_explained
        if obstacle is not None:
            assert obstacle.reason == "the simulator's own logs are not explained on j1"
            (notice,) = _unexplained_notices(unlike)
            assert f"the error is {error:g} N·m RMS, the torque " in notice.message


def test_no_change_is_no_agreement_if_the_error_is_far_above_the_noise_floor(simulator: Diagnosis) -> None:
    floor = simulator.floor
    near = GapLevel({name: 1.2 * noise for name, noise in floor.items()}, None)
    far = GapLevel({name: 20 * noise for name, noise in floor.items()}, None)
    assert _unexplained_gap(near, simulator) is None
    obstacle = _unexplained_gap(far, simulator)
    assert obstacle is not None
    assert obstacle.reason == "the simulator's error is far above the noise floor, and no difference explains it"
