"""A model with an effect in it, whose shape values move to where the data have them: Pinocchio and closed forms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import PENDULUM
from numpy.typing import NDArray
from prescribed_motions import Log, prescribed_motion, silent, with_noise, with_torque
from spatial_arm import experiment, recorded, spec_of, written

from idtool.common.exceptions import ConfigError
from idtool.common.processes import in_processes
from idtool.diagnosis import trial as module
from idtool.diagnosis.candidate_fit import imprecise_parameter
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.screen import screen_probes
from idtool.diagnosis.trial import (
    TrialFit,
    _gain_with_unit_coefficient,
    _parameter_probe,
    _standard_errors,
    fit_trial,
    has_fixed_inertia,
    parameter_value,
    pattern_search,
    with_effects,
    with_fixed_inertia,
)
from idtool.diagnosis.trial_transfer import trial_from_bytes, trial_to_bytes
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.estimation.dataset.experiment import Experiment
from idtool.robot.config import EffectEntry

Array = NDArray[np.float64]

HINGE = ("hinge",)
NOISE = 0.05  # N·m
STRIBECK, VELOCITY = 0.8, 0.25  # N·m, rad/s
STIFFNESS, STOP = 15.0, 0.55  # N·m/rad, rad
FRICTION = {"viscous": False, "coulomb": True, "offset": False}


def entry(effect: str, **parameters: float) -> EffectEntry:
    """On the hinge."""
    return EffectEntry(effect=effect, joint="hinge", parameters=parameters)


@pytest.fixture(scope="module")
def log() -> Log:
    """A pendulum with Stribeck friction and a stop, without noise."""
    plain = prescribed_motion(8.0, PENDULUM)
    q, v = plain["q"][:, 0], plain["v"][:, 0]
    friction = np.sign(v) * (1.0 + STRIBECK * np.exp(-np.square(v / VELOCITY)))
    return with_torque(plain, 0, friction + STIFFNESS * np.maximum(q - STOP, 0))


def grounded(folder: Path, log: Log, seed: int = 0, **config: Any) -> LinearizedFit:
    """A fit of the pendulum without the effects."""
    paths = written(folder, with_noise(log, NOISE, seed), HINGE, text=PENDULUM)
    return linearize_fit(experiment(*paths, fitted=True, **{"friction": FRICTION, **config}), silent)


def found(base: LinearizedFit, steps: int = 3, off: float = 0.8) -> TrialFit:
    """Both effects, from values that are off."""
    entries = [
        entry("stribeck_friction", stribeck=0.0, velocity=off * VELOCITY),
        entry("end_stop", stiffness=0.0, position=off * STOP),
    ]
    done = fit_trial(base, entries, (0, 1), silent, steps)
    return done


def values(done: TrialFit) -> Array:
    """The Stribeck velocity and the stop's position."""
    stribeck, stop = done.entries
    return np.array([parameter_value(stribeck, "velocity"), parameter_value(stop, "position")], dtype=float)


KEYS = ((0, "velocity"), (1, "position"))


def errors(done: TrialFit) -> Array:
    """Their standard errors."""
    return np.array([done.standard_errors[key] for key in KEYS])


def named(base: LinearizedFit) -> dict[str, float]:
    """The fit's coefficients beside the inertia."""
    pairs = zip(base.experiment.equation.coefficients, base.estimate.theta, strict=True)
    return {c.name: float(x) for c, x in pairs if c.effect != "rigid_body"}


@pytest.mark.parametrize("off", [0.8, 1.2])
def test_shape_values_are_found_from_a_fifth_off(tmp_path: Path, log: Log, off: float) -> None:
    base = grounded(tmp_path, log)
    done = found(base, 4, off)
    assert (np.abs(values(done) - [VELOCITY, STOP]) < 4 * errors(done)).all()
    assert (errors(done) < [0.05 * VELOCITY, 0.01 * STOP]).all()
    assert done.linearized.total_cv_squared_error < 1e-3 * base.total_cv_squared_error
    expected = {"coulomb": 1.0, "stribeck": STRIBECK, "stiffness": STIFFNESS}
    assert named(done.linearized) == pytest.approx(expected, rel=0.02)
    assert np.sqrt(base.total_cv_squared_error / base.row_counts.sum()) > 10 * NOISE / base.noise[0]


def test_standard_errors_are_what_other_noise_does(tmp_path: Path, log: Log) -> None:
    every = [found(grounded(tmp_path, log, seed), off=0.95) for seed in range(8)]
    scatter = np.std([values(done) for done in every], axis=0, ddof=1)
    said = np.sqrt(np.mean([np.square(errors(done)) for done in every], axis=0))
    ratio = said / scatter
    assert ((ratio > 0.5) & (ratio < 2)).all(), ratio
    bias = np.mean([values(done) for done in every], axis=0) - [VELOCITY, STOP]
    assert (np.abs(bias) < 1.5 * scatter).all()


def test_a_derivative_is_that_of_the_parameter_alone(tmp_path: Path, log: Log) -> None:
    """A spring's torque by its rest position is its stiffness, whatever other effects make of other coefficients."""
    elastic = entry("joint_elasticity", stiffness=200.0, motor_friction=0.5)
    spring = entry("parallel_spring", stiffness=0.0, rest_position=0.2)
    base = grounded(tmp_path, log)
    other_theta = 1.5 * base.theta
    fit = linearize_fit(with_effects(base.experiment, [elastic, spring], other_theta), silent, base)
    probe = _parameter_probe(fit, [(1, "rest_position")], {})
    (batch,) = list(fit.experiment.batches(fit.experiment.runs[0], held_out=False))[:1]
    model = LinearizedModel(fit.experiment.equation, fit.theta, batch.motion)
    (column,) = probe.columns(model.true_motion, model)[0]
    by_key = {c.key: float(x) for c, x in zip(fit.experiment.equation.coefficients, fit.theta, strict=True)}
    (stiffness,) = (x for key, x in by_key.items() if "stiffness" in key)
    np.testing.assert_allclose(column, -stiffness, rtol=1e-6)


def test_a_value_that_is_right_stays_and_what_is_not_to_move_does_not(tmp_path: Path, log: Log) -> None:
    base = grounded(tmp_path, log)
    right = found(base, 1, 1.0)
    assert (np.abs(values(right) - [VELOCITY, STOP]) < 4 * errors(right)).all()
    entries = [
        entry("stribeck_friction", stribeck=0.0, velocity=0.8 * VELOCITY),
        entry("end_stop", stiffness=0.0, position=STOP),
    ]
    done = fit_trial(base, entries, [0], silent, 3)
    assert values(done)[0] == pytest.approx(VELOCITY, rel=0.03)
    assert values(done)[1] == STOP
    assert set(done.standard_errors) == {KEYS[0]}
    fixed = fit_trial(base, entries, [0], silent, 0)
    assert fixed.standard_errors == {}
    assert fixed.linearized.total_cv_squared_error > done.linearized.total_cv_squared_error


def test_a_pattern_search_follows_a_ridge() -> None:
    """To its top at (7, -7), although a change of one coordinate alone leads down; no point is evaluated twice."""
    evaluated: list[tuple[int, ...]] = []

    def height(point: Sequence[int]) -> float:
        to_top = point[0] - point[1] - 14
        off_ridge = point[0] + point[1]
        return -float(to_top**2 + 100 * off_ridge**2)

    def evaluate(points: Sequence[tuple[int, ...]]) -> list[float]:
        evaluated.extend(points)
        return [height(point) for point in points]

    best, values = pattern_search(evaluate, 2)
    assert best == (7, -7)
    assert values == {point: height(point) for point in evaluated}
    assert len(evaluated) == len(set(evaluated))


@pytest.mark.parametrize("is_alone", [True, False])
def test_where_a_stop_is_that_is_never_reached_the_data_do_not_tell(tmp_path: Path, log: Log, is_alone: bool) -> None:
    base = grounded(tmp_path, log)
    beyond = 1.2 * float(np.abs(log["q"]).max())
    entries = [entry("end_stop", stiffness=0.0, position=beyond)]
    if not is_alone:
        entries.append(entry("stribeck_friction", stribeck=0.0, velocity=VELOCITY))
    done = fit_trial(base, entries, range(len(entries)), silent)
    error = done.standard_errors[0, "position"]
    assert error == np.inf
    assert imprecise_parameter(done.entries[0], {"position": error}) == "position"
    assert is_alone or 0 < done.standard_errors[1, "velocity"] < VELOCITY


def test_a_probe_that_fails_determines_nothing_and_is_worse_than_any_other(tmp_path: Path, log: Log) -> None:
    def columns(motion: Any, linearized: Any) -> Any:
        raise ValueError("as this test wants it")

    base = grounded(tmp_path, log)
    (screened,) = screen_probes(base, [Probe("", None, None, columns, 2, lambda c, information: None)], silent)
    assert _standard_errors(screened) == [np.inf, np.inf]
    assert _gain_with_unit_coefficient(screened) == -np.inf


def test_what_cannot_be_is_not_tried(tmp_path: Path, log: Log) -> None:
    base = grounded(tmp_path, log)
    with pytest.raises(ConfigError, match="velocity of -1 is out of range"):
        fit_trial(base, [entry("stribeck_friction", stribeck=0.0, velocity=-1.0)], [0], silent)


def test_an_effect_that_the_motion_does_not_tell_is_not_fitted(tmp_path: Path, log: Log) -> None:
    """Presliding whose state is known only once the joint has moved nearly as far as in the whole log."""
    base = grounded(tmp_path, log)
    way = float(np.abs(np.diff(log["q"][:, 0])).sum())
    short, long = (
        entry("presliding_hysteresis", amplitude=0.0, displacement=share * way / 4) for share in (0.04, 0.98)
    )
    assert fit_trial(base, [short], [0], silent, 0).linearized.row_counts.sum() == base.row_counts.sum()
    with pytest.raises(ConfigError, match=r"at joint hinge, all effects are defined in only \d+ of \d+ samples"):
        fit_trial(base, [long], [0], silent, 0)


def fitted(tried: Experiment) -> LinearizedFit:
    """A fit."""
    return linearize_fit(tried, silent)


def test_fixed_inertia_is_the_urdfs_whatever_the_data_say(tmp_path: Path, log: Log) -> None:
    """The data ask for another mass; friction is free, and so it stays when effects join and leave."""
    heavy = with_torque(log, 0, 0.5 * np.sin(log["q"][:, 0]))
    free = grounded(tmp_path, heavy).experiment
    prior = free.equation.prior[:10]
    assert not has_fixed_inertia(free)
    assert np.abs(fitted(free).estimate.theta[:10] - prior).max() > 1e-2
    base = with_fixed_inertia(free)
    more = with_effects(base, [entry("stribeck_friction", stribeck=0.0, velocity=VELOCITY)])
    for one in (base, more, with_effects(more, [])):
        assert has_fixed_inertia(one)
        done = fitted(one)
        for theta in (done.theta, done.estimate.theta):
            np.testing.assert_allclose(theta[:10], prior, rtol=0, atol=1e-6)
        assert 0.8 < named(done)["coulomb"] < 1.6
        assert done.directions[:10] == pytest.approx(0, abs=1e-6 * np.abs(done.directions).max())
    assert not has_fixed_inertia(with_effects(free, []))


def test_what_else_is_known_is_kept(tmp_path: Path, log: Log) -> None:
    """A mass that was weighed would contradict the URDF's, friction is no part of that."""
    known = {"mass": {"bob": {"value": 3.0}}}
    base = with_fixed_inertia(grounded(tmp_path, log, known=known).experiment)
    np.testing.assert_allclose(fitted(base).estimate.theta[:10], base.equation.prior[:10], rtol=0, atol=1e-6)


def in_a_copy(base: LinearizedFit, progress: Any) -> bytes:
    """A trial that is fitted in another process, on the rows at which its own columns are defined."""
    trial = found(base)
    own = trial.linearized.experiment
    on_own_rows = linearize_fit(own, silent, trial.linearized, own_rows=True)
    moved = with_effects(own, trial.entries, trial.linearized.theta)
    return trial_to_bytes(replace(trial, linearized=linearize_fit(moved, silent, on_own_rows)))


def test_a_trial_of_a_copy_is_as_if_fitted_here(tmp_path: Path, log: Log) -> None:
    base = grounded(tmp_path, log)
    here, there = in_processes(in_a_copy, [base, base], silent)
    assert len(there) < 1e6  # no log is sent
    ours, theirs = trial_from_bytes(here, base), trial_from_bytes(there, base)
    for trial in (ours, theirs):
        fitted = trial.linearized
        again = linearize_fit(fitted.experiment, silent, fitted)
        np.testing.assert_array_equal(again.score, fitted.score)
        np.testing.assert_array_equal(again.theta, fitted.theta)
        assert fitted.row_experiment not in (fitted.experiment, base.row_experiment)
    np.testing.assert_array_equal(ours.linearized.gram, theirs.linearized.gram)
    assert ours.entries == theirs.entries
    assert ours.standard_errors == theirs.standard_errors
    kept = trial_from_bytes(trial_to_bytes(found(base)), base)
    assert kept.linearized.row_experiment is base.row_experiment


def payload_beside_tilt(folder: Path) -> tuple[LinearizedFit, list[EffectEntry]]:
    """MuJoCo's arm, which carries a load on a base that leans, without these effects; and entries to begin with."""
    spec = spec_of()
    load = spec.body("tool").add_body(name="load", pos=[0.02, 0.05, 0.1], explicitinertial=True, mass=0.8)
    load.ipos, load.fullinertia = [0.0] * 3, [0.004, 0.003, 0.002, 0.0, 0.0, 0.0]
    spec.option.gravity = [0.6, -0.9, -9.75]
    files = written(folder, recorded(spec.compile(), 6.0), noise=0.01)
    base = linearize_fit(with_fixed_inertia(experiment(*files, fitted=True)), silent)
    begun = {"mass": 0.6, "com": [0.0, 0.0, 0.05], "inertia": [0.02, 0.0, 0.02, 0.0, 0.0, 0.02]}
    entries = [
        EffectEntry(effect="payload", link="tool", parameters=begun),
        EffectEntry(effect="gravity_tilt", parameters={"gravity": [0.0, 0.0, -9.81]}),
    ]
    return base, entries


def test_a_payload_is_estimated_anew_beside_a_tilt(tmp_path: Path) -> None:
    """Its inertia too, which no gradient moves."""
    base, entries = payload_beside_tilt(tmp_path)
    payload, tilt = fit_trial(base, entries, (0, 1), silent, 5).entries
    assert payload.parameters["mass"] == pytest.approx(0.8, rel=0.01)
    np.testing.assert_allclose(payload.parameters["com"], [0.02, 0.05, 0.1], atol=0.002)
    np.testing.assert_allclose(payload.parameters["inertia"], [0.004, 0, 0.003, 0, 0, 0.002], atol=0.002)
    np.testing.assert_allclose(tilt.parameters["gravity"], [0.6, -0.9, -9.75], atol=0.02)


def test_a_fit_goes_on_as_long_as_the_coefficients_of_a_payload_improve(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Although a step of the parameters alone does not help."""
    base, entries = payload_beside_tilt(tmp_path)
    monkeypatch.setattr(module, "_gauss_newton_step", lambda current, *others: (current, {}))
    errors = [fit_trial(base, entries, (0, 1), silent, n).linearized.total_cv_squared_error for n in (0, 1, 5)]
    assert errors[1] < 0.9 * errors[0]
    assert errors[2] < 0.9 * errors[1]
