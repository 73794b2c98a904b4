"""Correlation of the noise between rows: from a part of them, and as the noise of accelerations makes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ground.logs import Sensors, config_text, record, write_csv
from ground.quadruped import FEET, FOOT_RADIUS, GEAR, true_quadruped
from ground.robot import Array, urdf_text
from prescribed_motions import silent
from standing_quadruped import BASE, PinocchioQuadruped

import idtool
from idtool.api.data import load_experiment
from idtool.common.safe_yaml import parse_yaml
from idtool.data.signals import Motion
from idtool.estimation.row_correlation import most_likely_covariance, shrunk_correlation, with_row_correlation
from idtool.estimation.row_noise import with_row_noise

TRUTH = true_quadruped(0)
ROTOR_INERTIA = 8e-5  # kg m^2, about its axis
CUTOFF = 18.0  # Hz
SENSORS = Sensors()


def random_covariance(rng: np.random.Generator, size: int) -> Array:
    factor = rng.normal(size=(size, size)) + 2 * np.eye(size)
    return factor @ factor.T / size


def test_covariance_is_found_though_only_a_part_of_the_rows_is_seen(rng: np.random.Generator) -> None:
    covariance = random_covariance(rng, 5)
    rows = rng.multivariate_normal(np.zeros(5), covariance, size=20_000)
    seen = np.empty((len(rows), 5, 5))
    for projector, unseen in zip(seen, rng.normal(size=(len(rows), 5, 2)), strict=True):
        Q, _ = np.linalg.qr(unseen)
        projector[:] = np.eye(5) - Q @ Q.T
    residuals = np.einsum("nij,nj->ni", seen, rows)
    found = most_likely_covariance(residuals, seen)
    np.testing.assert_allclose(found, covariance, atol=0.03 * np.diag(covariance).max())


def test_covariance_of_rows_that_are_seen_is_that_of_the_samples(rng: np.random.Generator) -> None:
    residuals = rng.normal(size=(50, 3))
    found = most_likely_covariance(residuals, np.broadcast_to(np.eye(3), (50, 3, 3)))
    np.testing.assert_allclose(found, residuals.T @ residuals / 50, atol=1e-3)


def test_row_that_is_never_seen_is_uncorrelated(rng: np.random.Generator) -> None:
    seen = np.diag([1.0, 1.0, 0.0])
    residuals = rng.normal(size=(50, 3)) @ seen
    found = most_likely_covariance(residuals, np.broadcast_to(seen, (50, 3, 3)))
    np.testing.assert_allclose(found[2], [0, 0, 1], atol=1e-2)


@pytest.mark.parametrize("factors", [[1.0, 2.0, -1.0], [1.0, 0.0, 0.0], [1e-3, 2e-3, 0.0], [0.0, 0.0, 0.0]])
def test_rows_that_always_err_together_or_not_at_all_have_a_correlation(
    rng: np.random.Generator, factors: list[float]
) -> None:
    residuals = rng.normal(size=(40, 1)) * factors
    seen = np.broadcast_to(np.eye(3), (40, 3, 3))
    correlation = shrunk_correlation(most_likely_covariance(residuals, seen), 40)
    assert np.linalg.eigvalsh(correlation).min() > 0.009


def test_correlation_of_few_samples_is_shrunk_to_none(rng: np.random.Generator) -> None:
    """Uncorrelated rows seem correlated by chance; what is left of that is much less."""
    by_chance = np.cov(rng.normal(size=(12, 40)))
    np.testing.assert_allclose(shrunk_correlation(by_chance, 40), np.eye(12), atol=0.15)
    assert np.abs(np.corrcoef(by_chance) - np.eye(12)).max() > 0.3

    covariance = random_covariance(rng, 12)
    deviations = np.sqrt(np.diag(covariance))
    of_many = shrunk_correlation(covariance, 1e9)
    np.testing.assert_allclose(of_many, covariance / np.outer(deviations, deviations), atol=1e-2)


def test_no_combination_of_rows_is_taken_for_exact() -> None:
    eigenvalues = np.linalg.eigvalsh(shrunk_correlation(np.ones((3, 3)), 1e9))
    assert eigenvalues.min() == pytest.approx(0.01)
    assert shrunk_correlation(np.array([[4.0]]), 10) == pytest.approx(1.0)


@pytest.mark.slow
def test_rows_are_correlated_by_the_inertia_that_noisy_accelerations_move(tmp_path: Path) -> None:
    """The covariance from the sensors' noise and Pinocchio's inertia matrix, on a trot with measured forces."""
    (tmp_path / "true.urdf").write_text(urdf_text(TRUTH))
    write_csv(tmp_path / "walk.csv", record(TRUTH, "walk", seconds=10.0, seed=0))
    content = parse_yaml(tmp_path, config_text(TRUTH, "measured").encode())
    model = idtool.Model(tmp_path / "true.urdf", config={**content, "filter": {"cutoff_hz": CUTOFF}})
    experiment = load_experiment(model, [tmp_path / "walk.csv"])
    experiment = with_row_correlation(with_row_noise(experiment, silent), silent)
    assert experiment.equation.contacts is not None
    found = experiment.equation.contacts.correlation
    assert found is not None

    (run,) = experiment.runs
    batch = next(iter(experiment.batches(run, held_out=False)))
    motion = experiment.equation.true_motion(batch.motion)
    expected = correlation_by_sensors(PinocchioQuadruped(tmp_path / "true.urdf"), motion)
    pairs = np.triu_indices(18, 1)
    assert np.corrcoef(found[pairs], expected[pairs])[0, 1] > 0.7
    forward_force, pitch_moment, left_force, roll_moment = 12, 16, 13, 15
    assert found[forward_force, pitch_moment] < -0.4
    assert found[left_force, roll_moment] > 0.4


def correlation_by_sensors(reference: PinocchioQuadruped, motion: Motion) -> Array:
    """Correlation of the rows' noise that white noise of the sensors makes, mean along a motion, shape (18, 18)."""
    derivative_gain = 2 * np.pi * CUTOFF / np.sqrt(3)  # of white noise in the band
    of_accelerations = np.concatenate(
        [
            np.full(12, SENSORS.v * derivative_gain),
            np.full(3, SENSORS.accelerometer),
            np.full(3, SENSORS.gyroscope * derivative_gain),
        ]
    )
    to_origin = np.eye(18)
    to_origin[BASE, BASE][:3, 3:] = np.cross(np.eye(3), TRUTH.imu.position, axisa=0, axisc=0)
    covariance = np.zeros((18, 18))
    for k in range(100, len(motion.t), 100):
        H = inertia_matrix(reference, motion, k)
        through_inertia = H @ to_origin * of_accelerations
        covariance += through_inertia @ through_inertia.T
        covariance[:12, :12] += SENSORS.tau**2 * np.eye(12)
        for foot in FEET:
            J = reference.contact_jacobian(motion, k, foot, FOOT_RADIUS)[:3]
            covariance += SENSORS.force**2 * J.T @ J
    deviations = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(deviations, deviations))


def inertia_matrix(reference: PinocchioQuadruped, motion: Motion, k: int) -> Array:
    """Inertia matrix of a sample with the rotors, shape (18, 18)."""
    at_rest = replace(motion, v=np.zeros_like(motion.v), a=np.zeros_like(motion.a))
    gravity = reference.torque(at_rest, k)
    H = np.empty((18, 18))
    for i, unit in enumerate(np.eye(18)):
        accelerated = replace(at_rest, a=np.broadcast_to(unit[:, None], motion.a.shape))
        H[:, i] = reference.torque(accelerated, k) - gravity
    H[:12, :12] += GEAR**2 * ROTOR_INERTIA * np.eye(12)
    return H
