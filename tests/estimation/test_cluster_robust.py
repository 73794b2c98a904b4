"""Standard errors from blocks of the residual: closed forms, all unit noises, and the scatter of many estimates."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.signal import lfilter

from idtool.estimation.dataset.blocks import Blocks
from idtool.estimation.dataset.equality_constraints import Constraint, EqualityConstraints
from idtool.estimation.dataset.reduction import Factor
from idtool.estimation.uncertainty.cluster_robust import ClusterRobustEstimate, cluster_robust_estimate
from idtool.estimation.uncertainty.standard_errors import least_squares_uncertainty

Array = NDArray[np.float64]

P = 6
ACTIVE = (np.array([0, 1, 2, 3]), np.array([2, 3, 4, 5]))  # two joints, and what both feel
SIGMA = np.array([0.5, 2.0])
EQUATION = SimpleNamespace(coefficients=(SimpleNamespace(scale=None),) * P, active=lambda: ACTIVE)
NOTHING = EqualityConstraints.none(P)


@dataclass(frozen=True)
class Linear:
    """Two joints' columns (2, n, 6), zero where a coefficient is not felt, and the true coefficients.

    Attributes
    ----------
    redundancy
        Of how many rows one is worth.
    """

    Y: Array
    truth: Array
    redundancy: float = 1.0

    def log(self, noise: Array, length: int, name: str = "log") -> Blocks:
        """The torque with a noise (2, n), in blocks of so many rows."""
        return of_rows(self.Y, self.Y @ self.truth + noise, length, self.redundancy, name)


def of_rows(Y: Array, tau: Array, length: int, redundancy: float = 1.0, name: str = "log") -> Blocks:
    """Rows and torque in blocks of so many rows, or in one; every row counts."""
    each = min(length, Y.shape[1])
    joints = []
    for y, active, row in zip(Y, ACTIVE, tau, strict=True):
        R = np.linalg.qr(np.column_stack([y[:, active], row]).reshape(-1, each, len(active) + 1), mode="r")
        joints.append([Factor(r, each, each / redundancy) for r in R])
    return Blocks(name, tuple(zip(*joints, strict=True)), 0.01 * each)


def linear(n: int, seed: int = 0, correlation: float = 0.0, redundancy: float = 1.0) -> Linear:
    """Random columns of very different sizes, each as slow as an autoregressive series of that correlation."""
    rng = np.random.default_rng(seed)
    Y = np.zeros((2, n, P))
    for j, active in enumerate(ACTIVE):
        Y[j][:, active] = slow(rng, correlation, (4, n)).T * [1.0, 30.0, 0.02, 4.0]
    return Linear(Y, rng.normal(size=P), redundancy)


def slow(rng: np.random.Generator, a: float, shape: tuple[int, ...]) -> Array:
    """Autoregressive noise of unit variance."""
    noise = rng.normal(size=(*shape[:-1], shape[-1] + 400))
    return np.asarray(lfilter([np.sqrt(1 - a * a)], [1, -a], noise, axis=-1)[..., 400:])


def asked(
    data: Sequence[Blocks],
    noise: Array = SIGMA,
    theta: Array | None = None,
    known: EqualityConstraints = NOTHING,
    seed: int = 0,
) -> ClusterRobustEstimate:
    """What `cluster_robust_estimate` says, from zero where no other start is given."""
    start = np.zeros(P) if theta is None else theta
    return cluster_robust_estimate(EQUATION, data, noise, start, known, np.random.default_rng(seed))  # type: ignore[arg-type]


def weighted(Y: Array, tau: Array, sigma: Array = SIGMA) -> tuple[Array, Array]:
    """All rows in units of the joints' noise."""
    return (Y / sigma[:, None, None]).reshape(-1, P), (tau / sigma[:, None]).ravel()


def least_squares(Y: Array, tau: Array, sigma: Array = SIGMA) -> Array:
    W, b = weighted(Y, tau, sigma)
    return np.asarray(np.linalg.lstsq(W, b, rcond=None)[0])


FAR = 10 * np.arange(P) - 20.0


@pytest.mark.parametrize("length", [20, 25, 2000])
@pytest.mark.parametrize("sigma", [SIGMA, np.array([7.0, 0.1])], ids=["its noise", "another"])
def test_the_estimate_is_least_squares_whatever_the_start(length: int, sigma: Array) -> None:
    """With few blocks or many, and the joints weighted as told."""
    s = linear(1000, redundancy=3.0)
    noise = SIGMA[:, None] * np.random.default_rng(1).normal(size=(2, 1000))
    expected = least_squares(s.Y, s.Y @ s.truth + noise, sigma)
    for start in (np.zeros(P), s.truth, FAR):
        found = asked([s.log(noise, length)], sigma, start)
        np.testing.assert_allclose(found.theta, expected, rtol=1e-8, atol=1e-8)


def test_standard_errors_do_not_depend_on_the_start() -> None:
    s = linear(1000)
    noise = SIGMA[:, None] * np.random.default_rng(1).normal(size=(2, 1000))
    log = s.log(noise, 20)
    one, other = (asked([log], theta=start) for start in (s.truth, FAR))
    assert one.bootstrap
    assert other.bootstrap
    np.testing.assert_allclose(one.uncertainty.standard_error, other.uncertainty.standard_error, rtol=1e-5)
    np.testing.assert_allclose(one.bootstrap.standard_error, other.bootstrap.standard_error, rtol=1e-5)


@pytest.mark.parametrize("facts", [0, 2])
def test_the_spread_of_white_residuals_is_without_bias(facts: int) -> None:
    """Bell & McCaffrey 2002. For white noise of unit variance the mean is the sum over all unit noises: exactly I.

    16 blocks of 4 rows each joint, so that no few of them hold the most of a direction. Facts with a standard error are
    measured again each time, and are not part of the blocks.
    """
    rng = np.random.default_rng(4)
    n = 64
    s = linear(n, 4)
    rows = rng.normal(size=(facts, P)) / np.array([1, 30, 0.02, 4, 0.02, 4])
    errors = np.full(facts, 0.5)

    def spread(noise: Array, deviation: Array) -> Array:
        values = rows @ s.truth + errors * deviation
        told = tuple(Constraint("a fact", row, value, 0.5) for row, value in zip(rows, values, strict=True))
        found = asked([s.log(SIGMA[:, None] * noise, 4)], theta=s.truth, known=replace(NOTHING, constraints=told))
        assert found.bootstrap
        assert found.cluster_count == 16
        return found.uncertainty.covariance_y - found.uncertainty.directions.soft

    units = np.eye(2 * n + facts)
    total = sum(spread(unit[: 2 * n].reshape(2, n), unit[2 * n :]) for unit in units)
    W = np.concatenate([weighted(s.Y, s.Y[:, :, 0])[0], rows / 0.5])
    found = asked([s.log(np.ones((2, n)), 4)], known=replace(NOTHING, constraints=tuple(map(fact, rows)))).uncertainty
    np.testing.assert_allclose(total + found.directions.soft, np.eye(P), atol=1e-9)
    V = found.directions.observable
    np.testing.assert_allclose(V @ V.T, np.linalg.inv(W.T @ W), rtol=1e-7)


def fact(row: Array) -> Constraint:
    return Constraint("a fact", row, 0.3, 0.5)


def test_white_residuals_have_the_ordinary_standard_errors() -> None:
    """sigma² (YᵀY)⁻¹ by the mean over 40 noises of 100 blocks: 1.6 % is what chance leaves."""
    s = linear(1000)
    W, _ = weighted(s.Y, s.Y[:, :, 0])
    expected = np.diag(np.linalg.inv(W.T @ W))
    noises = SIGMA[:, None] * np.random.default_rng(2).normal(size=(40, 2, 1000))
    found = [asked([s.log(noise, 10)], theta=s.truth) for noise in noises]
    assert np.median([f.cluster_count for f in found]) == 100
    assert sum(f.correlated_beyond_clusters for f in found) <= 2
    squares = np.array([np.square(f.uncertainty.standard_error) for f in found])
    np.testing.assert_allclose(squares.mean(axis=0) / expected, 1, atol=0.1)
    assert (np.abs(squares / expected - 1) < 0.8).all()
    resampled = np.array([np.square(f.bootstrap.standard_error) for f in found if f.bootstrap])
    np.testing.assert_allclose(resampled.mean(axis=0) / expected, 1, atol=0.15)


def test_weights_that_are_wrong_do_not_spoil_the_standard_errors() -> None:
    """A joint thought of as 40 times as noisy as it is, and one as a fourth: the sandwich's own covariance, by hand."""
    s = linear(1000)
    believed = np.array([20.0, 0.5])
    W, _ = weighted(s.Y, s.Y[:, :, 0], believed)
    bread = np.linalg.inv(W.T @ W)
    scaled = W * np.repeat(SIGMA / believed, 1000)[:, None]
    expected = np.diag(bread @ (scaled.T @ scaled) @ bread)
    noises = SIGMA[:, None] * np.random.default_rng(2).normal(size=(40, 2, 1000))
    found = [asked([s.log(noise, 10)], believed, s.truth).uncertainty.standard_error for noise in noises]
    np.testing.assert_allclose(np.square(found).mean(axis=0) / expected, 1, atol=0.12)
    assert np.abs(np.diag(bread) / expected - 1).max() > 2


def covers(s: Linear, draws: int, seed: int, a: float, length: int) -> tuple[Array, Array, Array]:
    """How often intervals hold the truth: ours, the bootstrap's, and the ordinary ones; (P,) each."""
    rng = np.random.default_rng(seed)
    n = s.Y.shape[1]
    hits = np.zeros((3, P))
    for _ in range(draws):
        log = s.log(SIGMA[:, None] * slow(rng, a, (2, n)), length)
        found = asked([log], theta=s.truth)
        assert found.bootstrap
        reach = found.uncertainty.coverage_factor(np.eye(P))
        ordinary = least_squares_uncertainty(EQUATION, log.total, SIGMA).standard_error  # type: ignore[arg-type]
        off = np.abs(found.theta - s.truth)
        errors = (found.uncertainty.standard_error * reach, found.bootstrap.standard_error * reach, 1.96 * ordinary)
        hits += [off <= half for half in errors]
    return tuple(hits / draws)  # type: ignore[return-value]


@pytest.mark.slow
def test_intervals_of_slow_residuals_hold_the_truth() -> None:
    """Residual and motion are both correlated over 10 rows; ordinary intervals, a row a sample, hold it too seldom."""
    ours, resampled, ordinary = covers(linear(2000, 3, correlation=0.9), 200, 1, 0.9, 20)
    for covered in (ours, resampled):
        assert 0.9 < covered.mean() < 0.98, covered
        assert (covered > 0.88).all(), covered
    assert (ordinary < 0.8).all(), ordinary


def test_intervals_of_white_residuals_hold_the_truth() -> None:
    ours, resampled, ordinary = covers(linear(1000, 3), 120, 1, 0.0, 20)
    for covered in (ours, resampled, ordinary):
        assert 0.92 < covered.mean() < 0.98, covered
        assert (covered > 0.88).all(), covered


def test_blocks_are_as_long_as_the_residual_is_slow() -> None:
    """White: as they come. Slower: longer, and said where the log is too short for it."""
    rng = np.random.default_rng(0)
    seconds = []
    for a in (0.0, 0.8, 0.97):
        s = linear(4000, 1, correlation=a)
        found = asked([s.log(SIGMA[:, None] * slow(rng, a, (2, 4000)), 10)], theta=s.truth)
        assert not found.correlated_beyond_clusters
        assert found.cluster_count == pytest.approx(40 / found.cluster_seconds, rel=0.1)
        seconds.append(found.cluster_seconds)
    assert seconds[0] == pytest.approx(0.1)
    assert seconds[0] < seconds[1] < seconds[2]
    s = linear(800, 1, correlation=0.995)
    found = asked([s.log(SIGMA[:, None] * slow(rng, 0.995, (2, 800)), 10)], theta=s.truth)
    assert found.correlated_beyond_clusters
    assert found.cluster_count >= 16


@pytest.mark.parametrize("blocks", [1, 2, 15])
def test_few_blocks_say_nothing_of_their_scatter(blocks: int) -> None:
    """Then it is the number of independent rows that says it: sigma² redundancy (YᵀY)⁻¹."""
    n = 40 * blocks
    s = linear(n, redundancy=2.5)
    found = asked([s.log(np.ones((2, n)), 40)])
    assert found.cluster_count == blocks
    assert found.bootstrap is None
    W, _ = weighted(s.Y, s.Y[:, :, 0])
    expected = np.sqrt(2.5 * np.diag(np.linalg.inv(W.T @ W)))
    np.testing.assert_allclose(found.uncertainty.standard_error, expected, rtol=1e-8)
    np.testing.assert_array_equal(found.uncertainty.degrees_of_freedom(np.eye(P)), np.inf)
    np.testing.assert_allclose(found.uncertainty.coverage_factor(np.eye(P)), 1.959964, rtol=1e-6)


@pytest.mark.parametrize("ends", [(25,), (13, 40), (1, 2), (17, 32, 33)])
def test_several_logs_are_as_one(ends: tuple[int, ...]) -> None:
    """The same blocks make the same estimate, in logs as short and as long as may be."""
    s = linear(1000)
    noise = SIGMA[:, None] * np.random.default_rng(5).normal(size=(2, 1000))
    whole = s.log(noise, 20)
    one = asked([whole])
    several = asked([replace(whole, parts=whole.parts[i:j]) for i, j in itertools.pairwise((0, *ends, 50))])
    assert one.cluster_count == several.cluster_count == 50
    np.testing.assert_allclose(one.theta, several.theta, rtol=1e-9)
    np.testing.assert_allclose(one.uncertainty.covariance, several.uncertainty.covariance, rtol=1e-8)


def test_the_bootstrap_is_its_seeds_and_near_the_sandwich() -> None:
    s = linear(2000)
    log = s.log(SIGMA[:, None] * np.random.default_rng(6).normal(size=(2, 2000)), 20)
    one, same, other = (asked([log], seed=seed).bootstrap for seed in (1, 1, 2))
    assert one
    assert same
    assert other
    np.testing.assert_array_equal(one.standard_error, same.standard_error)
    assert (one.standard_error != other.standard_error).all()
    sandwich = asked([log]).uncertainty.standard_error
    np.testing.assert_allclose(one.standard_error / sandwich, 1, atol=0.2)


def test_other_units_give_the_same_in_these() -> None:
    """Of the coefficients, and of the torque."""
    s = linear(1000, correlation=0.7)
    tau = s.Y @ s.truth + SIGMA[:, None] * slow(np.random.default_rng(7), 0.7, (2, 1000))
    units, torque = np.array([1e3, 1e-3, 1.0, 40.0, 1e-6, 7.0]), 1e3
    known = replace(NOTHING, constraints=(Constraint("a fact", np.array([1.0, 0, 0, 0, 0.1, 0]), 1.2, 0.05),))
    in_units = replace(NOTHING, constraints=(replace(known.constraints[0], row=known.constraints[0].row / units),))
    one = asked([of_rows(s.Y, tau, 20)], known=known)
    other = asked([of_rows(torque * s.Y / units, torque * tau, 20)], torque * SIGMA, known=in_units)
    assert one.bootstrap
    assert other.bootstrap
    np.testing.assert_allclose(other.theta, one.theta * units, rtol=1e-7)
    assert (other.cluster_count, other.cluster_seconds) == (one.cluster_count, one.cluster_seconds)
    for mine, theirs in ((one.uncertainty, other.uncertainty), (one.bootstrap, other.bootstrap)):
        np.testing.assert_allclose(theirs.standard_error, mine.standard_error * units, rtol=1e-6)
    np.testing.assert_allclose(
        other.uncertainty.degrees_of_freedom(np.eye(P)), one.uncertainty.degrees_of_freedom(np.eye(P)), rtol=1e-6
    )


HARD = (
    Constraint("one", np.array([1.0, 0.02, 0, 0, 0, 0]), 1.5),
    Constraint("two", np.array([0, 0, 0, 0.1, 0, -0.3]), 0.2),
    Constraint("three", np.array([0, 0, 0, 0, 1.0, 0]), 40.0),
)


@pytest.mark.parametrize("length", [10, 1000])
def test_with_exact_facts_the_estimate_is_least_squares_on_their_plane(length: int) -> None:
    """By its Lagrangian's equations; and what a fact fixes has no error."""
    s = linear(600)
    tau = s.Y @ s.truth + SIGMA[:, None] * np.random.default_rng(8).normal(size=(2, 600))
    W, b = weighted(s.Y, tau)
    C, d = np.array([f.row for f in HARD]), np.array([f.value for f in HARD])
    K = np.block([[W.T @ W, C.T], [C, np.zeros((3, 3))]])
    expected = np.linalg.solve(K, np.concatenate([W.T @ b, d]))[:P]
    start = np.linalg.lstsq(C, d, rcond=None)[0]
    found = asked([of_rows(s.Y, tau, length)], theta=start, known=replace(NOTHING, constraints=HARD))
    np.testing.assert_allclose(found.theta, expected, rtol=1e-6, atol=1e-7)
    errors = found.uncertainty.standard_error
    assert errors[4] == pytest.approx(0, abs=1e-12)
    assert (errors[[0, 1, 2, 3, 5]] > 0).all()
    covariance = found.uncertainty.covariance
    np.testing.assert_allclose(C @ covariance @ C.T, 0, atol=1e-9 * np.abs(covariance).max())
    if not found.bootstrap:
        Z = np.linalg.svd(C)[2][3:].T
        np.testing.assert_allclose(covariance, Z @ np.linalg.inv(Z.T @ W.T @ W @ Z) @ Z.T, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("length", [10, 1000])
def test_with_soft_facts_the_estimate_is_least_squares_with_rows_of_theirs(length: int) -> None:
    """A fact counts as one independent sample, of which 2.5 rows of the log make one."""
    s = linear(600, redundancy=2.5)
    tau = s.Y @ s.truth + SIGMA[:, None] * np.random.default_rng(8).normal(size=(2, 600))
    W, b = weighted(s.Y, tau)
    rows = np.array([f.row for f in HARD])
    values, errors = rows @ s.truth + [0.1, -0.2, 3.0], np.array([0.03, 0.01, 1.0])
    facts = tuple(Constraint("", row, v, e) for row, v, e in zip(rows, values, errors, strict=True))
    whole = np.concatenate([W / np.sqrt(2.5), rows / errors[:, None]])
    expected = np.linalg.lstsq(whole, np.concatenate([b / np.sqrt(2.5), values / errors]), rcond=None)[0]
    for start in (np.zeros(P), FAR):
        found = asked([of_rows(s.Y, tau, length, 2.5)], theta=start, known=replace(NOTHING, constraints=facts))
        np.testing.assert_allclose(found.theta, expected, rtol=1e-7, atol=1e-7)
    if not found.bootstrap:
        np.testing.assert_allclose(found.uncertainty.covariance, np.linalg.inv(whole.T @ whole), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("length", [10, 1000])
def test_what_is_known_from_elsewhere_alone_is_as_good_as_told(length: int) -> None:
    """A coefficient that no row feels, measured otherwise: its error is that measurement's, in any resampling."""
    s = linear(600, redundancy=2.5)
    Y = s.Y.copy()
    Y[0][:, 0] = 0.0
    tau = Y @ s.truth + 3 * np.random.default_rng(8).normal(size=(2, 600))
    known = replace(NOTHING, constraints=(Constraint("a fact", np.eye(P)[0], 1.7, 0.4),))
    found = asked([of_rows(Y, tau, length, 2.5)], known=known)
    assert (found.bootstrap is None) == (length == 1000)
    for told in (found.uncertainty, found.bootstrap or found.uncertainty):
        assert told.standard_error[0] == pytest.approx(0.4, rel=1e-6)
        assert told.coverage_factor(np.eye(P)[:1])[0] == pytest.approx(1.96, abs=1e-3)
    assert found.theta[0] == pytest.approx(1.7)


def test_copies_are_estimated_once() -> None:
    """A coefficient that is minus another's: least squares in five."""
    s = linear(600)
    tau = s.Y @ s.truth + np.random.default_rng(8).normal(size=(2, 600))
    K = np.delete(np.eye(P), 4, axis=1)
    K[4, 1] = -1.0
    known = EqualityConstraints(K, np.array([0, 1, 2, 3, 5]))
    W, b = weighted(s.Y, tau)
    expected = K @ np.linalg.lstsq(W @ K, b, rcond=None)[0]
    found = asked([of_rows(s.Y, tau, 10)], known=known)
    np.testing.assert_allclose(found.theta, expected, rtol=1e-7, atol=1e-9)
    assert found.uncertainty.standard_error[4] == pytest.approx(found.uncertainty.standard_error[1], rel=1e-9)


def test_what_no_row_sees_stays_and_has_no_standard_error() -> None:
    """Two columns that are always alike: their sum is found, each by itself is not."""
    s = linear(600)
    Y = s.Y.copy()
    Y[0][:, 1] = 2 * Y[0][:, 0]
    tau = Y @ s.truth + np.random.default_rng(8).normal(size=(2, 600))
    found = asked([of_rows(Y, tau, 10)], theta=s.truth)
    np.testing.assert_array_equal(np.isfinite(found.uncertainty.standard_error), [False, False, True, True, True, True])
    np.testing.assert_allclose(Y @ found.theta, Y @ least_squares(Y, tau), atol=1e-7)
    pair = np.array([[1.0, 2, 0, 0, 0, 0], [1.0, 1, 0, 0, 0, 0]])
    np.testing.assert_array_equal(np.isfinite(found.uncertainty.of(pair)), [True, False])
    W = weighted(Y, tau)[0][:, [0, 2, 3, 4, 5]]
    whole = asked([of_rows(Y, tau, 600)], theta=s.truth).uncertainty
    assert whole.of(pair)[0] == pytest.approx(np.sqrt(np.linalg.inv(W.T @ W)[0, 0]), rel=1e-7)
    np.testing.assert_allclose(whole.standard_error[2:], np.sqrt(np.diag(np.linalg.inv(W.T @ W)))[1:], rtol=1e-7)


def test_a_blocks_influence_is_what_the_estimate_would_be_without_it() -> None:
    """Least squares with the block less least squares without it, to first order."""
    s = linear(1000)
    tau = s.Y @ s.truth + SIGMA[:, None] * np.random.default_rng(1).normal(size=(2, 1000))
    found = asked([of_rows(s.Y, tau, 20)], theta=s.truth)
    assert found.influence.shape == (found.cluster_count, P) == (50, P)
    for b in range(50):
        kept = np.arange(1000) // 20 != b
        moved = found.theta - least_squares(s.Y[:, kept], tau[:, kept])
        size = found.uncertainty.standard_error
        np.testing.assert_allclose(found.influence[b] / size, moved / size, atol=0.03)


def test_blocks_are_joined_as_told() -> None:
    """Whole ones, a rest of more than half by itself; the scatter is that of longer blocks from the start."""
    s = linear(960)
    noise = SIGMA[:, None] * np.random.default_rng(1).normal(size=(2, 960))
    long = asked([s.log(noise, 30)])
    told = cluster_robust_estimate(
        EQUATION, [s.log(noise, 10)], SIGMA, s.truth, NOTHING, np.random.default_rng(0), blocks_per_cluster=3
    )  # type: ignore[arg-type]
    assert (told.cluster_count, told.blocks_per_cluster) == (32, 3)
    assert told.cluster_seconds == pytest.approx(0.3)
    assert long.blocks_per_cluster == 1
    np.testing.assert_allclose(told.uncertainty.covariance, long.uncertainty.covariance, rtol=1e-6)


def test_freedom_is_the_number_of_equal_blocks_less_one() -> None:
    """Of blocks whose information is alike; where one holds all of a coefficient, there is next to none."""
    part = linear(20).Y
    Y = np.tile(part, (1, 30, 1))
    noise = np.random.default_rng(9).normal(size=(2, 600))
    found = asked([of_rows(Y, Y @ np.ones(P) + noise, 20)], theta=np.ones(P)).uncertainty
    np.testing.assert_allclose(found.degrees_of_freedom(np.eye(P)), 29, rtol=1e-6)
    np.testing.assert_allclose(found.coverage_factor(np.eye(P)), stats.t.ppf(0.975, 29), rtol=1e-6)
    Y[0][20:, 0] = 0.0
    found = asked([of_rows(Y, Y @ np.ones(P) + noise, 20)], theta=np.ones(P)).uncertainty
    assert found.degrees_of_freedom(np.eye(P))[0] == pytest.approx(1, abs=1e-6)
    assert found.degrees_of_freedom(np.eye(P))[5] > 28


def test_a_joint_without_rows_that_count_in_a_block_does_no_harm() -> None:
    s = linear(600)
    log = s.log(np.random.default_rng(1).normal(size=(2, 600)), 10)
    empty = Factor(np.zeros((0, 5)), 0, 0.0)
    parts = tuple((empty, part[1]) if i % 3 == 0 else part for i, part in enumerate(log.parts))
    found = asked([replace(log, parts=parts)], theta=s.truth)
    assert found.bootstrap
    assert np.isfinite(found.uncertainty.standard_error).all()
    kept = np.repeat(np.arange(60) % 3 != 0, 10)
    Y = s.Y.copy()
    Y[0][~kept] = 0
    expected = asked([of_rows(Y, np.where([kept, kept | True], log_torque(s), 0), 10)], theta=s.truth)
    np.testing.assert_allclose(found.theta, expected.theta, rtol=1e-7)


def log_torque(s: Linear) -> Array:
    return np.asarray(s.Y @ s.truth + np.random.default_rng(1).normal(size=(2, 600)))
