"""Linear algebra that numpy's gives up on."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scipy.optimize import nnls

from idtool.common.linear_algebra import (
    append_rows,
    compressed_rows,
    least_squares,
    nonnegative_least_squares,
    null_space,
    reproducible_eigh,
    right_svd,
    svd,
)


@pytest.mark.parametrize("shape", [(7, 4), (4, 7), (5, 5)])
@pytest.mark.parametrize("gives_up", [False, True])
def test_a_decomposition_is_one(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int], gives_up: bool
) -> None:
    def raises(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    matrix = rng.normal(size=shape)
    if gives_up:
        monkeypatch.setattr(np.linalg, "svd", raises)
    U, s, Vt = svd(matrix)
    n, m = shape
    assert (U.shape, Vt.shape) == ((n, len(s)), (len(s), m))
    np.testing.assert_allclose((U * s) @ Vt, matrix, rtol=0, atol=1e-12)
    assert (np.diff(s) <= 0).all()

    values, V = right_svd(matrix)
    np.testing.assert_allclose(values, s, atol=1e-12)
    np.testing.assert_allclose(V @ V.T, np.eye(m), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(matrix @ V.T, axis=0), np.pad(s, (0, m - len(s))), atol=1e-12)


@pytest.mark.parametrize("gives_up", [False, True])
def test_least_squares_is_the_shortest_solution(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, gives_up: bool
) -> None:
    def raises(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge in Linear Least Squares")

    matrix = rng.normal(size=(9, 3)) @ rng.normal(size=(3, 5))
    right = rng.normal(size=9)
    if gives_up:
        monkeypatch.setattr(np.linalg, "lstsq", raises)
    solution, rank = least_squares(matrix, right, 1e-10)
    assert rank == 3
    np.testing.assert_allclose(solution, np.linalg.pinv(matrix, rcond=1e-10) @ right, atol=1e-12)


def test_a_tall_matrix_takes_memory_in_proportion_to_its_size(rng: np.random.Generator) -> None:
    """Such as the rows of a humanoid with contacts, of which each has all coefficients."""
    matrix = rng.normal(size=(20_000, 20))
    tracemalloc.start()
    right_svd(matrix)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 10 * matrix.nbytes


def test_the_null_space_leaves_variables_that_no_row_involves_as_they_are() -> None:
    matrix = np.array([[0.0, 3.0, 0.0, 4.0], [0.0, 6.0, 0.0, 8.0]])
    N = null_space(matrix)
    np.testing.assert_allclose(matrix @ N, 0, atol=1e-14)
    np.testing.assert_allclose(N.T @ N, np.eye(3), atol=1e-14)
    np.testing.assert_array_equal(N[:, :2], np.eye(4)[:, [0, 2]])


@pytest.mark.parametrize("rows", [0, 1])
def test_the_null_space_of_nothing_is_the_whole_space(rows: int) -> None:
    np.testing.assert_array_equal(null_space(np.zeros((rows, 3))), np.eye(3))


def test_where_everything_is_fixed_the_null_space_is_empty() -> None:
    assert null_space(np.diag([1.0, 1e-6])).shape == (2, 0)


@pytest.mark.parametrize("zeros", [0, 3])
@pytest.mark.parametrize("count", [1, 4, 6, 40])
@pytest.mark.parametrize("is_triangle", [False, True])
def test_a_triangle_takes_up_further_rows(rng: np.random.Generator, zeros: int, count: int, is_triangle: bool) -> None:
    """The Gram matrix tells a triangular factor from any other, but for signs."""
    R = np.triu(rng.normal(size=(9, 9)))
    rows = rng.normal(size=(count, 9))
    rows[:, :zeros] = 0
    if is_triangle:
        rows[:, zeros:] = np.triu(rows[:, zeros:])
    gram = R.T @ R + rows.T @ rows
    before = rows.copy()
    append_rows(R, rows)
    np.testing.assert_allclose(R.T @ R, gram, atol=1e-12)
    np.testing.assert_array_equal(R, np.triu(R))
    np.testing.assert_array_equal(rows, before)


def test_rows_of_zeros_leave_a_triangle_as_it_is(rng: np.random.Generator) -> None:
    R = np.triu(rng.normal(size=(5, 5)))
    before = R.copy()
    append_rows(R, np.zeros((3, 5)))
    append_rows(R, np.zeros((0, 5)))
    np.testing.assert_array_equal(R, before)


@pytest.mark.parametrize(("counts", "rows"), [((3, 2, 4), 9), ((3, 30, 14), 9), ((), 0)])
def test_many_rows_give_a_triangle(rng: np.random.Generator, counts: tuple[int, ...], rows: int) -> None:
    """Its Gram matrix is the sum of theirs; few rows stay as they are. Columns may be shared, and in any order."""
    columns = [np.array([8, 0, 3]), np.array([3, 4, 5, 8]), np.array([1, 8])]
    parts = [(rng.normal(size=(count, len(own))), own) for count, own in zip(counts, columns, strict=False)]
    found = compressed_rows(parts, 9)
    assert found.shape == (rows, 9)
    gram = np.zeros((9, 9))
    for part, own in parts:
        gram[np.ix_(own, own)] += part.T @ part
    np.testing.assert_allclose(found.T @ found, gram, atol=1e-12)
    assert (sum(counts) > 4 * 9) == (rows == 9 and np.array_equal(found, np.triu(found)))


@pytest.mark.parametrize("binds", [False, True])
def test_nonnegative_least_squares_is_that_of_scipy(rng: np.random.Generator, binds: bool) -> None:
    """A bound may bind or not; a column of zeros has no share."""
    matrix = np.insert(rng.normal(size=(50, 4)), 2, 0.0, axis=1)
    truth = np.array([1.0, -0.5 if binds else 0.5, 0.0, 2.0, 0.1])
    right = matrix @ truth + 0.01 * rng.normal(size=50)
    x, rest = nonnegative_least_squares(matrix, right)
    expected, expected_rest = nnls(matrix, right)
    assert (x == 0).sum() == 1 + binds
    np.testing.assert_allclose(x, expected, rtol=1e-9, atol=1e-12)
    assert rest == pytest.approx(expected_rest)


@pytest.mark.parametrize(
    "values", [(1.0, 2.0, 3.0, 4.0), (1.0, 1.0, 2.0, 2.0), (0.0, 1.0, 1.0, 1.0), (5.0,) * 4, (0.0,) * 4]
)
def test_reproducible_eigenvectors_solve_the_problem_and_keep_to_it(
    values: tuple[float, ...], rng: np.random.Generator
) -> None:
    """Even where eigenvalues are equal, rounding changes no vector; those of the unit matrix are the unit vectors."""
    for _ in range(20):
        Q, _ = np.linalg.qr(rng.normal(size=(4, 4)))
        A = Q * values @ Q.T
        found, V = reproducible_eigh(A)
        np.testing.assert_allclose(found, values, atol=1e-12)
        np.testing.assert_allclose(V.T @ V, np.eye(4), atol=1e-12)
        np.testing.assert_allclose(V * found @ V.T, A, atol=1e-9)
        noise = 1e-14 * rng.normal(size=(4, 4))
        _, nearly = reproducible_eigh(A + max(values) * (noise + noise.T))
        np.testing.assert_allclose(nearly, V, atol=1e-7)
    if len(set(values)) == 1:
        np.testing.assert_allclose(V, np.eye(4), atol=1e-12)


def test_eigenvalues_may_differ_by_a_known_error(rng: np.random.Generator) -> None:
    """But not by so much that all of a small matrix are the same."""
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    A = Q * (1.0, 1.0, 3.0) @ Q.T
    noise = 1e-8 * rng.normal(size=(3, 3))
    exact, nearly = (reproducible_eigh(matrix, tolerance=1e-6)[1] for matrix in (A, A + noise + noise.T))
    np.testing.assert_allclose(nearly, exact, atol=1e-7)
    small = 1e-9 * A
    np.testing.assert_allclose(reproducible_eigh(small, tolerance=1e-6)[1], exact, atol=1e-12)
