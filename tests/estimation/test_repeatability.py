"""Logs of one robot against each other: drawn from one truth, or with a mass, a friction or a motion that differs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest
from numpy.typing import NDArray
from robots import random_urdf
from synthetic import Synthetic, point_parameters, synthetic

from idtool.common.processes import no_progress
from idtool.estimation.dataset.blocks import Blocks, merge_reductions
from idtool.estimation.dataset.reduction import Factor, Reduction
from idtool.estimation.uncertainty.base_parameters import BaseParameters, structural_base_parameters
from idtool.estimation.uncertainty.repeatability import Repeatability, repeatability
from idtool.robot.inertia import PI_SIZE
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]

ROWS, LENGTH = 400, 20  # of a log, of a block
SIGMA = np.array([0.5, 2.0])


@dataclass(frozen=True)
class Arm:
    """An arm of two joints, with rows enough for four logs."""

    s: Synthetic

    @cached_property
    def base(self) -> BaseParameters:
        return structural_base_parameters(self.s.model, self.s.linear)

    def of(self, name: str, owner: str | None = None) -> int:
        """A coefficient's index."""
        found = [k for k, c in enumerate(self.s.linear.coefficients) if c.name == name and owner in (None, c.owner)]
        return found[0]

    def log(self, number: int, noise: Array, theta: Array | None = None, still: Sequence[int] = ()) -> Blocks:
        """A log with a noise (2, ROWS); ``still`` are coefficients that its motion does not feel."""
        Y = self.s.Y[:, number * ROWS : (number + 1) * ROWS].copy()
        Y[:, :, list(still)] = 0.0
        tau = Y @ (self.s.theta if theta is None else theta) + noise
        joints = []
        for y, columns, row in zip(Y, self.s.linear.active(), tau, strict=True):
            rows = np.column_stack([y[:, columns], row]).reshape(-1, LENGTH, len(columns) + 1)
            joints.append([Factor(R, LENGTH, float(LENGTH)) for R in np.linalg.qr(rows, mode="r")])
        return Blocks(f"log{number}", tuple(zip(*joints, strict=True)), 0.1)

    def logs(self, count: int, seed: int, **changed: Array) -> list[Blocks]:
        """Logs of the truth, some of another: ``log2=theta``."""
        noise = SIGMA[:, None] * np.random.default_rng(seed).normal(size=(count, 2, ROWS))
        return [self.log(i, noise[i], changed.get(f"log{i}")) for i in range(count)]

    def compared(self, data: Sequence[Blocks], theta: Array | None = None) -> Repeatability:
        start = self.s.theta if theta is None else theta
        rng = np.random.default_rng(0)
        return repeatability(
            self.s.linear, data, SIGMA, start, self.s.equalities, self.base, self.alone, rng, no_progress
        )

    def rows(self, data: Reduction) -> tuple[Array, Array]:
        """In units of the noise."""
        W, b = [], []
        for factor, columns, sigma in zip(data, self.s.linear.active(), SIGMA, strict=True):
            own = np.zeros((len(factor.R), len(self.s.theta)))
            own[:, columns] = factor.R[:, :-1] / sigma
            W.append(own)
            b.append(factor.R[:, -1] / sigma)
        return np.concatenate(W), np.concatenate(b)

    def alone(self, data: Reduction) -> Array:
        """Least squares."""
        W, b = self.rows(data)
        size = np.linalg.norm(W, axis=0)
        size[size == 0] = 1.0
        return np.asarray(np.linalg.lstsq(W / size, b, rcond=1e-9)[0] / size)


@pytest.fixture
def arm(robot_of: Callable[[str], Robot]) -> Arm:
    rng = np.random.default_rng(3)
    robot = robot_of(random_urdf(rng, size=2, kinds=("revolute",), mimic=0, massless=0))
    return Arm(synthetic(rng, robot, 4 * ROWS))


def test_an_estimate_is_that_of_the_log_alone(arm: Arm) -> None:
    """By least squares, and its standard error by the classical formula to within what 20 blocks scatter."""
    data = arm.logs(3, 1)
    found = arm.compared(data)
    assert found.logs == ("log0", "log1", "log2")
    assert found.value.shape == found.standard_error.shape == (len(arm.base), 3)
    apart = []
    for k, log in enumerate(data):
        np.testing.assert_allclose(found.value[:, k], arm.base.B @ arm.alone(log.total), rtol=1e-6, atol=1e-7)
        W, _ = arm.rows(log.total)
        covariance = np.linalg.pinv(W, rcond=1e-9)
        expected = np.linalg.norm(arm.base.B @ covariance, axis=1)
        apart.append(np.log(found.standard_error[:, k] / expected))
    assert np.abs(apart).max() < 0.9
    assert abs(np.mean(apart)) < 0.15


@pytest.mark.slow
def test_logs_of_one_truth_agree_nineteen_times_in_twenty(arm: Arm) -> None:
    """Where all agree, that anything at all is said to differ has a chance of 5 % at most (Benjamini & Hochberg 1995).

    Parameters whose errors go together make it less. The scatter is what the standard errors predict.
    """
    draws = 100
    alarms, odd, ratios = 0, 0, []
    for seed in range(draws):
        found = arm.compared(arm.logs(3, seed))
        alarms += not found.agrees.all()
        odd += found.outlier is not None
        ratios.append(np.square(found.ratio))
    assert alarms <= 0.05 * draws + 2 * np.sqrt(0.05 * draws)
    assert odd <= alarms
    # F-distributed with 2 and about 19 degrees of freedom, whose mean is 19 / 17.
    assert np.mean(ratios) == pytest.approx(19 / 17, rel=0.15)
    assert (np.abs(np.mean(ratios, axis=0) - 19 / 17) < 0.5).all()


@pytest.mark.parametrize("which", [0, 1, 2])
def test_a_log_with_other_friction_is_the_odd_one(arm: Arm, which: int) -> None:
    """It alone, and the joint's friction alone."""
    place = arm.of("viscous", arm.s.linear.joints[1])
    other = arm.s.theta.copy()
    other[place] += 1.0
    found = arm.compared(arm.logs(3, 5, **{f"log{which}": other}))
    np.testing.assert_array_equal(~found.agrees, arm.base.own == place)
    assert found.outlier == which
    assert found.ratio[arm.base.own == place] > 5
    assert (found.ratio[arm.base.own != place] < 3).all()


def test_a_small_difference_is_seen_more_often_than_not(arm: Arm) -> None:
    """One of about five standard errors, in joint friction; what is said to differ is hardly ever anything else."""
    place = arm.of("viscous", arm.s.linear.joints[1])
    other = arm.s.theta.copy()
    other[place] += 0.3
    compared = [arm.compared(arm.logs(3, 20 + seed, log2=other)) for seed in range(12)]
    sizes = [0.3 / np.sqrt(1.5 * np.square(found.standard_error[arm.base.own == place]).mean()) for found in compared]
    assert 3 < np.mean(sizes) < 7
    seen = np.array([~found.agrees for found in compared])
    assert seen[:, arm.base.own == place].mean() > 0.5
    assert seen[:, arm.base.own != place].mean() < 0.05


def test_a_log_with_a_payload_is_the_odd_one(arm: Arm) -> None:
    """What differs is what B says of the payload's ten parameters; what B says nothing of agrees."""
    payload = np.zeros(len(arm.s.theta))
    payload[PI_SIZE : 2 * PI_SIZE] = point_parameters(np.array([0.8]), np.array([[0.3, 0.2, -0.25]]))
    found = arm.compared(arm.logs(4, 6, log2=arm.s.theta + payload))
    assert found.outlier == 2
    change = np.abs(arm.base.B @ payload)
    error = found.standard_error.max(axis=1)
    assert not found.agrees[change > 12 * error].any()
    assert found.agrees[change < 0.5 * error].all()
    assert (change > 12 * error).sum() >= 3
    assert (change == 0).sum() >= 4  # friction at least


def test_of_two_logs_none_is_the_odd_one(arm: Arm) -> None:
    other = arm.s.theta.copy()
    place = arm.of("coulomb")
    other[place] += 3.0
    found = arm.compared(arm.logs(2, 7, log1=other))
    np.testing.assert_array_equal(~found.agrees, arm.base.own == place)
    assert found.outlier is None


def test_where_every_log_says_another_none_is_the_odd_one(arm: Arm) -> None:
    place = arm.of("coulomb")
    truths = [arm.s.theta + step * np.eye(len(arm.s.theta))[place] for step in (-3.0, 0.0, 3.0)]
    found = arm.compared(arm.logs(3, 8, **{f"log{i}": truth for i, truth in enumerate(truths)}))
    assert not found.agrees[arm.base.own == place]
    assert found.outlier is None


def test_the_start_does_not_matter(arm: Arm) -> None:
    data = arm.logs(3, 9)
    one, other = arm.compared(data), arm.compared(data, arm.s.theta + 1.0)
    np.testing.assert_allclose(one.value, other.value, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(one.ratio, other.ratio, rtol=1e-4)
    np.testing.assert_array_equal(one.agrees, other.agrees)


def test_logs_that_determine_different_parameters(arm: Arm) -> None:
    """One whose second joint's friction does not show: it has no value there, and no say; two such: no ratio."""
    place = arm.of("viscous", arm.s.linear.joints[1])
    row = int(np.flatnonzero(arm.base.own == place)[0])
    noise = SIGMA[:, None] * np.random.default_rng(10).normal(size=(3, 2, ROWS))
    for blind in ((1,), (0, 1), (0, 1, 2)):
        data = [arm.log(i, noise[i], still=[place] if i in blind else []) for i in range(3)]
        found = arm.compared(data)
        hidden = np.isin(np.arange(3), blind)
        np.testing.assert_array_equal(np.isnan(found.value[row]), hidden)
        np.testing.assert_array_equal(np.isinf(found.standard_error[row]), hidden)
        assert np.isnan(found.ratio[row]) == (len(blind) > 1)
        assert found.agrees[row]
        rest = np.arange(len(arm.base)) != row
        assert np.isfinite(found.value[rest]).all()
        assert np.isfinite(found.ratio[rest]).all()


def test_disagreement_shows_among_those_that_determine_it(arm: Arm) -> None:
    place = arm.of("viscous", arm.s.linear.joints[1])
    other = arm.s.theta.copy()
    other[place] += 1.0
    noise = SIGMA[:, None] * np.random.default_rng(11).normal(size=(4, 2, ROWS))
    data = [arm.log(i, noise[i], other if i == 3 else None, [place] if i == 0 else []) for i in range(4)]
    found = arm.compared(data)
    np.testing.assert_array_equal(~found.agrees, arm.base.own == place)
    assert found.outlier == 3


def test_ratio_is_birges(arm: Arm) -> None:
    """√(χ² / (L − 1)) about the weighted mean, by NumPy's weighted average."""
    found = arm.compared(arm.logs(4, 12))
    for value, error, ratio in zip(found.value, found.standard_error, found.ratio, strict=True):
        mean = np.average(value, weights=error**-2)
        assert ratio == pytest.approx(np.sqrt(np.sum(np.square((value - mean) / error)) / 3), rel=1e-9)


def test_the_cross_error_is_least_on_ones_own_log(arm: Arm) -> None:
    """It is the root mean square of all joints' errors in units of their noise; nothing beats least squares at home."""
    data = arm.logs(3, 13)
    found = arm.compared(data)
    for i, fitted in enumerate(data):
        theta = arm.alone(fitted.total)
        for j, log in enumerate(data):
            W, b = arm.rows(merge_reductions(log.parts))
            assert found.cross_error[i, j] == pytest.approx(np.linalg.norm(W @ theta - b) / np.sqrt(2 * ROWS), rel=1e-9)
    off = ~np.eye(3, dtype=bool)
    for k in range(3):
        assert (found.cross_error[k, k] < found.cross_error[off[:, k], k]).all()
    np.testing.assert_allclose(found.cross_error, 1, atol=0.1)


def test_a_log_that_differs_is_predicted_badly_and_predicts_badly(arm: Arm) -> None:
    other = arm.s.theta.copy()
    other[arm.of("coulomb")] += 3.0
    cross = arm.compared(arm.logs(3, 14, log1=other)).cross_error
    alike, differ = [cross[0, 2], cross[2, 0], *np.diag(cross)], [cross[0, 1], cross[1, 0], cross[1, 2], cross[2, 1]]
    assert min(differ) > 2 * max(alike)


def test_a_log_too_short_for_blocks_takes_part(arm: Arm) -> None:
    """With its standard errors from the number of its rows."""
    data = arm.logs(3, 15)
    short = replace(data[2], parts=data[2].parts[:8])
    found = arm.compared([data[0], data[1], short])
    assert found.agrees.all()
    W, _ = arm.rows(short.total)
    expected = np.linalg.norm(arm.base.B @ np.linalg.pinv(W, rcond=1e-9), axis=1)
    np.testing.assert_allclose(found.standard_error[:, 2], expected, rtol=1e-5)
