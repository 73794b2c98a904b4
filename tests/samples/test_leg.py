"""The sample robots against the truth that their logs were simulated with: only the injected noise may be left.

A single inertia parameter is seldom determined by the data; combinations of them are. With W the R-factors of the
training data in units of each joint's noise, worth one row an independent sample, and D the parameters' typical sizes
(a body's mass times powers of its length, as the regularization measures them; a friction coefficient's own true
value), the singular value decomposition W D = U s Vᵀ gives them: z = Vᵀ (theta / D), with standard errors 1 / s and
uncorrelated. Those with a standard error below 1 % of their true value are called well determined.

Letters: p coefficients theta; z (p,) combinations; s (p,) one over their standard errors, 0 where there is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import SAMPLES, fitted
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.evaluation.rollouts import HORIZONS, evaluate_rollouts
from idtool.estimation.fit import Fit, fit
from idtool.robot.config import read_config
from idtool.robot.inertia import PARAMETER_NAMES, from_mass_com_inertia, symmetric_matrix
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

TRUTH = yaml.safe_load((SAMPLES / "truth.yaml").read_text())
ROBOTS = {"leg": 12, "belt_arm": 9}  # and how many well-determined combinations there are at least
RATE, BAND, ORDER = 1000, 40.0, 4


def log(robot: str, part: str) -> Path:
    """One of a robot's logs."""
    return SAMPLES / f"{robot}_{part}.mcap"


def true_coefficients(robot: str, experiment: Experiment) -> Array:
    """What truth.yaml says of the coefficients, shape (p,)."""
    truth = TRUTH[robot]
    bodies = {
        name: from_mass_com_inertia(body["mass"], body["com"], symmetric_matrix(body["inertia"]))
        for name, body in truth["bodies"].items()
    }
    friction = truth["friction"]
    return np.array(
        [
            bodies[c.owner][PARAMETER_NAMES.index(c.name)] if c.owner in bodies else friction[c.owner][c.name]
            for c in experiment.equation.coefficients
        ]
    )


@dataclass(frozen=True)
class Comparison:
    """Combinations of coefficients: in the truth, found, and before any data; shape (p,) each, and s."""

    true: Array
    found: Array
    prior: Array
    s: Array

    @property
    def well_determined(self) -> NDArray[np.bool_]:
        """Those with a standard error below 1 %."""
        return np.asarray(self.s * np.abs(self.true) > 100)


def compare(robot: str, result: Fit) -> Comparison:
    """The combinations that the training data determine, the best first."""
    equation = result.experiment.equation
    theta = true_coefficients(robot, result.experiment)
    inertial = np.array([c.effect == "rigid_body" for c in equation.coefficients])
    size = np.where(inertial, [c.scale or np.nan for c in equation.coefficients], theta)
    rows = []
    reduction = result.experiment.reduce(lambda stage, share: None)
    for factor, columns, noise in zip(reduction, equation.active(), result.estimate.noise, strict=True):
        W = np.zeros((len(factor.R), len(theta)))
        W[:, columns] = factor.R[:, :-1] * np.sqrt(factor.independent / factor.rows) / noise
        rows.append(W)
    _, s, Vt = np.linalg.svd(np.concatenate(rows) * size, full_matrices=True)
    s = np.pad(s, (0, len(theta) - len(s)))
    true, found, prior = (Vt @ (x / size) for x in (theta, result.estimate.theta, equation.prior))
    return Comparison(true, found, prior, s)


@pytest.fixture(scope="module", params=ROBOTS)
def case(request: pytest.FixtureRequest) -> tuple[str, Fit, Comparison]:
    """A robot, a fit to its training log, and its comparison with the truth."""
    robot: str = request.param
    urdf, config = SAMPLES / f"{robot}.urdf", read_config(SAMPLES / f"{robot}.yaml")
    experiment = prepare(read_robot(urdf), config, [log(robot, "train")], [log(robot, "validate")])
    result = fit(experiment, lambda stage, share: None)
    return robot, result, compare(robot, result)


def noise_floor(robot: str) -> float:
    """What the filter, there and back, leaves of the white noise that was put on the torque [N·m]: sigma ‖h‖."""
    impulse = sosfilt(butter(ORDER, BAND, fs=RATE, output="sos"), np.eye(1, RATE)[0])
    kernel = np.correlate(impulse, impulse, mode="full")
    return float(TRUTH[robot]["sensors"]["torque_noise"] * np.linalg.norm(kernel))


@pytest.mark.parametrize("robot", ROBOTS)
def test_only_the_noise_is_left(tmp_path: Path, robot: str) -> None:
    urdf = SAMPLES / f"{robot}.urdf"
    report = fitted(tmp_path, urdf, log(robot, "train"), "--validate", log(robot, "validate"))
    rms, floor = report["rms"]["validation"], noise_floor(robot)
    assert rms["overall"] == pytest.approx(floor, rel=0.03)
    for joint in report["joints"]:
        assert rms[joint] <= 1.05 * floor
    assert report["rms"]["prior_validation"]["overall"] > 2 * floor


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_optimum_is_certified(tmp_path: Path, robot: str) -> None:
    report = fitted(tmp_path, SAMPLES / f"{robot}.urdf", log(robot, "train"))
    assert abs(report["solver"]["duality_gap"]) < 1e-6
    assert report["warnings"] == []
    for body in report["bodies"].values():
        assert body["realizable"]
        assert body["ellipsoid_margin"] >= 0


def test_well_determined_combinations_are_the_truths(case: tuple[str, Fit, Comparison]) -> None:
    robot, _, z = case
    well = z.well_determined
    assert np.count_nonzero(well) >= ROBOTS[robot]
    error, prior_error = (np.abs(x / z.true - 1)[well] for x in (z.found, z.prior))
    assert error.max() < 0.03
    assert np.median(prior_error) > 0.1  # the prior does not know them


def test_standard_errors_are_honest(case: tuple[str, Fit, Comparison]) -> None:
    """Of all that the data determine to within typical sizes, no combination is off by four standard errors."""
    _, _, z = case
    determined = z.s > 10
    off = ((z.found - z.true) * z.s)[determined]
    assert len(off) > 15
    assert np.abs(off).max() < 4
    assert 0.6 < np.sqrt(np.mean(off**2)) < 1.4


def test_coulomb_friction_is_the_truths(case: tuple[str, Fit, Comparison]) -> None:
    robot, result, _ = case
    equation, theta = result.experiment.equation, result.estimate.theta
    found: dict[tuple[str, str], Any] = {(c.owner, c.name): theta[i] for i, c in enumerate(equation.coefficients)}
    for joint, friction in TRUTH[robot]["friction"].items():
        assert found[joint, "coulomb"] == pytest.approx(friction["coulomb"], rel=0.03)
        assert found[joint, "viscous"] == pytest.approx(friction["viscous"], rel=0.1)


def test_a_simulation_departs_as_one_with_the_true_parameters_does(case: tuple[str, Fit, Comparison]) -> None:
    """Under the logged torque, noise and all, even the truth departs from the log; that is the floor."""
    robot, result, _ = case
    experiment = result.experiment
    models = {
        "identified": result.estimate.theta,
        "true": true_coefficients(robot, experiment),
        "prior": experiment.equation.prior,
    }
    outcome = evaluate_rollouts(experiment, models, held_out=True, progress=lambda stage, share: None)
    errors = {
        name: [departure.rmse(experiment.equation.joints, "position")["overall"]]
        + [(departure.horizon(experiment.equation.joints, seconds) or {})["overall"] for seconds in HORIZONS]
        for name, departure in outcome.errors.items()
    }
    assert (outcome.kind, outcome.windows >= 8, outcome.diverged["identified"]) == ("open_loop", True, 0)
    for found, true, prior, still in zip(
        *(errors[n] for n in ("identified", "true", "prior", "baseline")), strict=True
    ):
        assert found <= 1.1 * true
        assert found <= 0.4 * prior < still
