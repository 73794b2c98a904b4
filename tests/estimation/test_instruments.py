"""Instruments of a leg with coarse encoders, run by MuJoCo: they do not know the noise, and nor does the estimate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import leg_runs as runs
import numpy as np
import pytest
import yaml
from leg_runs import Controller, LegSensors, Motion
from numpy.typing import NDArray
from sentences import sentences

from idtool.common.exceptions import ModelError
from idtool.data.logs import JointLog, make_log
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.identification import choose_sets
from idtool.estimation.instruments import Instruments, instruments, smoothing
from idtool.estimation.problem.estimate import estimate
from idtool.estimation.two_stage import TwoStage, project, stack, two_stage_estimate, unprojected
from idtool.estimation.uncertainty.base_parameters import structural_base_parameters
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

COARSE = LegSensors(position_step=runs.encoder_step(12, on_motor=False), position_noise=5e-4, velocity_lag=5e-3)
STIFF = Controller()
DELAY = 1e-3  # s
KINDS = ("closed_loop", "smoothed")


def silent(stage: str, share: float) -> None:
    """No progress."""


def of(log: JointLog, controller: Controller | None, holdout: float = 0.0) -> Experiment:
    """The leg with a log, its velocities differentiated, and no prior to speak of."""
    config: dict[str, Any] = yaml.safe_load((runs.SAMPLES / "leg.yaml").read_text())
    config |= {"velocity": "differentiated", "regularization": {"kind": "euclidean", "weight": 1e-6}}
    if controller is not None:
        kp, kd = (dict(zip(runs.JOINTS, gains, strict=True)) for gains in (controller.kp, controller.kd))
        config["controller"] = {"kp": kp, "kd": kd, "delay": DELAY}
    file = runs.SAMPLES / "leg_train.mcap"
    return prepare(read_robot(runs.URDF), parse_config(config, ""), [file], holdout=holdout, transform=lambda _: log)


def run(motion: Motion, seed: int, **options: Any) -> JointLog:
    return runs.run_leg(motion.q, motion.v, seed, acmd=motion.a, **options)


@pytest.fixture(scope="module")
def motion() -> Motion:
    """The paper's, from where it is under way."""
    return runs.shell(4.0, 4.0)


@pytest.fixture(scope="module")
def coarse(motion: Motion) -> JointLog:
    return run(motion, 1, sensors=COARSE)


def least_squares(experiment: Experiment) -> Array:
    bodies, regularization = experiment.model.bodies, experiment.config.regularization
    sets = choose_sets(bodies, None)
    reduction = experiment.reduce(silent)
    return estimate(experiment.equation, bodies, reduction, sets, regularization, experiment.equalities).theta


def both(log: JointLog, controller: Controller | None) -> tuple[Array, TwoStage]:
    """Least squares' coefficients, and what instruments make of them."""
    experiment = of(log, controller)
    theta = least_squares(experiment)
    return theta, two_stage_estimate(experiment, choose_sets(experiment.model.bodies, None), theta, silent)


def in_units(experiment: Experiment, error: Array) -> Array:
    """Errors of the base parameters, shape (..., r), in units of their sizes."""
    base = structural_base_parameters(experiment.model, experiment.equation, experiment.equalities)
    sizes = np.array([c.scale or 1.0 for c in experiment.equation.coefficients])
    return np.asarray(error @ base.B.T / np.linalg.norm(base.B * sizes, axis=1))


@pytest.mark.parametrize("kind", KINDS)
def test_a_coarse_encoder_costs_little(coarse: JointLog, kind: str) -> None:
    theta, found = both(coarse, STIFF if kind == "closed_loop" else None)
    assert found.kind == kind
    truth = runs.true_theta(of(coarse, None))
    errors = [np.linalg.norm(in_units(of(coarse, None), x - truth)) for x in (theta, found.theta)]
    assert errors[0] > 3 * errors[1]
    torque = [
        [np.sqrt(np.square(f.R[:, :-1] @ (x - truth)[columns]).sum() / f.rows) for x in (theta, found.theta)]
        for f, columns in zip(found.full, of(coarse, None).equation.active(), strict=True)
    ]
    assert all(least > 3 * instrumental for least, instrumental in torque)
    assert any("remaining noise" in warning for warning in sentences(found.notices)) == (kind == "smoothed")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_bias_of_ten_runs(kind: str) -> None:
    motion = runs.shell(10.0)
    estimates = []
    for seed in range(10):
        log = run(motion, seed, sensors=COARSE)
        theta, found = both(log, STIFF if kind == "closed_loop" else None)
        assert found.kind == kind
        estimates.append([theta, found.theta])
    experiment = of(log, None)
    errors = in_units(experiment, np.array(estimates) - runs.true_theta(experiment))
    bias, error = errors.mean(axis=0), errors.std(axis=0, ddof=1) / np.sqrt(len(errors))
    visible = (np.abs(bias[0]) > 5 * error[0]) & (np.abs(bias[0]) > 0.03)
    assert np.count_nonzero(visible) > 10
    least, instrumental = np.abs(bias[:, visible])
    assert np.linalg.norm(least) > 10 * np.linalg.norm(instrumental)
    assert np.exp(np.log(least / instrumental).mean()) > 10


def simulated(log: JointLog, controller: Controller, theta: Array | None = None) -> Instruments:
    experiment = of(log, controller)
    theta = runs.true_theta(experiment) if theta is None else theta
    return instruments(experiment, theta, silent)[0]


def test_the_simulation_forgets_the_noise(motion: Motion, coarse: JointLog) -> None:
    other = run(motion, 2, sensors=COARSE)
    q = [simulated(log, STIFF).signals.log.signals["q"] for log in (coarse, other)]
    assert np.abs(coarse.signals["q"] - other.signals["q"])[1000:3900].max() > 1e-3
    assert np.abs(q[0] - q[1])[1000:3900].max() < 1e-6


def test_the_simulation_goes_where_the_leg_goes_across_a_gap_and_to_a_cut(motion: Motion) -> None:
    controller = replace(STIFF, feedforward="none")
    log = run(motion, 1, sensors=runs.PERFECT, controller=controller)
    t = log.t + np.where(np.arange(len(log)) < 1700, 0.0, 0.37)
    signals = {name: x for name, x in log.signals.items() if name != "v"}
    cut = make_log(log.path, t, log.joints, signals)
    assert len(cut.segments) == 2
    experiment = of(cut, controller, holdout=0.2)
    made = instruments(experiment, runs.true_theta(experiment), silent)[0]
    measured = made.run.signals
    pairs = list(zip(measured.batches(made.run.train), made.signals.batches(made.run.train), strict=True))
    assert len(pairs) > 1
    for batch, free in pairs:
        assert (batch.before, batch.after) == (free.before, free.after)
        np.testing.assert_allclose(free.motion.t, batch.motion.t, atol=1e-9)
        assert np.abs(free.motion.q - batch.motion.q).max() < 0.02
        assert np.corrcoef(free.motion.a.ravel(), batch.motion.a.ravel())[0, 1] > 0.99


def test_rows_without_noise_are_their_own_instruments(motion: Motion) -> None:
    experiment = of(run(motion, 1, sensors=runs.PERFECT), None)
    made = instruments(experiment, np.zeros(1), silent)[0]
    assert np.isinf(made.cutoff_hz).all()
    stacked = stack(experiment, [made], silent)
    rng = np.random.default_rng(1)
    for projected, full in zip(project(stacked), unprojected(stacked), strict=True):
        best = np.linalg.lstsq(full.R[:, :-1], full.R[:, -1], rcond=1e-12)[0]
        for step in rng.normal(size=(3, len(best))):
            assert projected.squared_error(step) == pytest.approx(
                full.squared_error(step) - full.squared_error(best), rel=1e-6
            )


def test_a_loop_that_runs_away_is_refused(coarse: JointLog) -> None:
    coefficients = of(coarse, None).equation.coefficients
    theta = runs.true_theta(of(coarse, None)) - [100.0 * (c.name == "viscous") for c in coefficients]
    with pytest.raises(ModelError, match=r"diverges.*method ls"):
        simulated(coarse, STIFF, theta)


def test_a_model_that_cannot_move_is_refused(coarse: JointLog) -> None:
    theta = np.zeros(len(runs.true_theta(of(coarse, None))))
    with pytest.raises(ModelError, match=r"cannot be simulated.*method ls"):
        simulated(coarse, STIFF, theta)


def test_a_cut_off_is_above_the_motion_and_below_the_noise(rng: np.random.Generator) -> None:
    t = np.arange(20_000) / 1000
    q = np.sin(2 * np.pi * 1.3 * t) + 0.02 * np.sin(2 * np.pi * 6 * t)
    assert 6 < smoothing(q + 1e-3 * rng.normal(size=len(t)), 1e-3, 40.0) < 12
    assert 1.3 < smoothing(q + 0.1 * rng.normal(size=len(t)), 1e-3, 40.0) < 4
    assert smoothing(q, 1e-3, 40.0) == np.inf
