"""Criteria and expected errors against their textbook formulas."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from idtool.estimation.uncertainty.base_parameters import BaseParameters
from idtool.excitation.criteria import CRITERIA, Criterion, DesignCriterion, expected_standard_errors

Array = NDArray[np.float64]

R = 5


def information(rng: np.random.Generator, r: int = R) -> Array:
    W = rng.normal(size=(4 * r, r)) * rng.uniform(0.2, 5, r)
    return np.asarray(W.T @ W)


def every(criterion: Criterion = "d", r: int = R) -> DesignCriterion:
    return DesignCriterion(criterion, np.arange(r))


def test_criteria_are_the_textbooks(rng: np.random.Generator) -> None:
    M = information(rng)
    C = np.linalg.inv(M)
    assert every().value(M, "d") == pytest.approx(np.linalg.det(C) ** (1 / (2 * R)))
    assert every().value(M, "a") == pytest.approx(np.sqrt(np.trace(C) / R))
    assert every().value(M, "e") == pytest.approx(np.linalg.eigvalsh(M)[0] ** -0.5)
    assert every().value(M, "condition") == pytest.approx(np.linalg.cond(np.linalg.cholesky(M)))


def test_d_does_not_depend_on_units_up_to_their_product(rng: np.random.Generator) -> None:
    M, S = information(rng), np.diag(np.geomspace(1e-6, 1e6, R))  # beyond the rounding of a single eigenvalue
    change = np.exp(np.log(np.diag(S)).mean())
    assert every().value(S @ M @ S) == pytest.approx(every().value(M) / change)


def test_favoured_parameters_have_the_others_as_nuisance(rng: np.random.Generator) -> None:
    M, some, others = information(rng), [0, 3], [1, 2, 4]
    # What is left of the information when the nuisance has been eliminated: the Schur complement.
    left = M[np.ix_(some, some)] - M[np.ix_(some, others)] @ np.linalg.solve(
        M[np.ix_(others, others)], M[np.ix_(others, some)]
    )
    for criterion in CRITERIA:
        assert DesignCriterion(criterion, np.array(some)).value(M) == pytest.approx(every(criterion, 2).value(left))


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("favoured", [range(R), [1, 4]])
def test_the_stand_in_is_near_and_its_derivative_is_right(
    rng: np.random.Generator, criterion: Criterion, favoured: list[int]
) -> None:
    aim, M = DesignCriterion(criterion, np.array(list(favoured))), information(rng)
    value, by_M = aim.smooth_log(M)
    assert value == pytest.approx(np.log(aim.value(M)), abs=0.1)
    D = information(rng)
    h = 1e-5
    assert np.sum(by_M * D) == pytest.approx(
        (aim.smooth_log(M + h * D)[0] - aim.smooth_log(M - h * D)[0]) / (2 * h), rel=1e-5
    )


def test_more_data_are_never_worse(rng: np.random.Generator) -> None:
    M = information(rng)
    for criterion in ("d", "a", "e"):
        aim = every(criterion)
        assert aim.value(M + information(rng)) < aim.value(M)
        assert aim.value(4 * M) == pytest.approx(aim.value(M) / 2)


def test_what_is_not_seen_is_infinite() -> None:
    M = np.diag([1.0, 2.0, 0.0])
    assert every("d", 3).value(M) == np.inf
    assert DesignCriterion("d", np.array([0])).value(np.diag([4.0, 1e-30])) == pytest.approx(0.5)


def test_expected_errors_are_those_of_least_squares(rng: np.random.Generator) -> None:
    W, B = rng.normal(size=(40, 3)), np.array([[1.0, 0, 0.5, 0], [0, 1, 0, 0], [0, 0, 0, 2.0]])
    found = expected_standard_errors(W, BaseParameters(np.array([0, 1, 3]), B))
    C = np.linalg.inv(W.T @ W)
    assert found.base == pytest.approx(np.sqrt(np.diag(C)))
    # beta = (x0 + x2 / 2, x1, 2 x3): x1 and x3 are told by themselves, x0 and x2 are not.
    assert found.coefficients == pytest.approx([np.inf, np.sqrt(C[1, 1]), np.inf, np.sqrt(C[2, 2]) / 2])


def test_expected_errors_are_the_scatter_of_estimates(rng: np.random.Generator) -> None:
    W = rng.normal(size=(30, 3)) * [1, 20, 0.05]
    estimates = np.linalg.lstsq(W, rng.normal(size=(30, 4000)), rcond=None)[0]
    found = expected_standard_errors(W, BaseParameters(np.arange(3), np.eye(3)))
    assert found.base == pytest.approx(estimates.std(axis=1), rel=0.05)


def test_a_base_parameter_without_data_is_told_from_the_others(rng: np.random.Generator) -> None:
    W = rng.normal(size=(30, 3))
    W[:, 2] = 0
    found = expected_standard_errors(W, BaseParameters(np.arange(3), np.eye(3)))
    assert np.isinf(found.base).tolist() == [False, False, True]
    assert found.base[:2] == pytest.approx(np.sqrt(np.diag(np.linalg.inv(W[:, :2].T @ W[:, :2]))))
    W[:, 2] = W[:, 1]  # only their sum is seen
    assert np.isinf(expected_standard_errors(W, BaseParameters(np.arange(3), np.eye(3))).base).tolist() == [
        False,
        True,
        True,
    ]
