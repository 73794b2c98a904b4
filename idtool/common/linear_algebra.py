"""Linear algebra that numpy lacks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from idtool.common.arrays import Array, Indices

_TRIANGLE_BLOCK = 32  # columns that tpqrt eliminates together
_MAX_ROWS_PER_COLUMN = 4  # above which rows are replaced by their triangular factor
_EQUAL_GAP = 1e-10  # of the largest eigenvalue, by which equal ones may differ
_MAX_EQUAL_GAP = 1e-3  # the same, where the matrix has large errors
_TIE = 1e-6  # relative difference of squared cosines that are equal but for rounding
_RANK = 1e-9  # ratio to the largest singular value, up to which one counts as 0


def svd(matrix: ArrayLike) -> tuple[Array, Array, Array]:
    """Singular value decomposition U diag(s) Vᵀ of any finite matrix.

    LAPACK's fast routine, gesdd, gives up on some matrices with entries as small as rounding errors; its slow one,
    gesvd, does not.

    Parameters
    ----------
    matrix
        Shape (n, m).

    Returns
    -------
    U (n, k), s (k,), the largest first, and Vᵀ (k, m) with k = min(n, m).
    """
    return _svd(np.asarray(matrix, dtype=np.float64), full=False)


def right_svd(matrix: ArrayLike) -> tuple[Array, Array]:
    """Singular values and right singular vectors of any finite matrix, those of its null space included.

    Parameters
    ----------
    matrix
        Shape (n, m). It may be tall: nothing of size (n, n) is computed.

    Returns
    -------
    s (k,), the largest first, with k = min(n, m), and Vᵀ (m, m).
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    is_wide = matrix.shape[0] < matrix.shape[1]
    _, s, Vt = _svd(matrix, full=is_wide)
    return s, Vt


def _svd(matrix: Array, full: bool) -> tuple[Array, Array, Array]:
    """As in `svd`; U (n, n) and Vᵀ (m, m) in full."""
    try:
        U, s, Vt = np.linalg.svd(matrix, full_matrices=full)
    except np.linalg.LinAlgError:
        U, s, Vt = scipy.linalg.svd(matrix, full_matrices=full, lapack_driver="gesvd")
    return np.asarray(U), np.asarray(s), np.asarray(Vt)


def least_squares(matrix: Array, right: Array, rcond: float) -> tuple[Array, int]:
    """Least-squares solution of smallest norm for any finite matrix, and the matrix's rank.

    LAPACK's fast routine, gelsd, gives up on the same matrices as gesdd; its slow one, gelss, does not.

    Parameters
    ----------
    matrix, right
        Shape (n, m), and (n,) or (n, k).
    rcond
        Ratio to the largest singular value, up to which one counts as 0.

    Returns
    -------
    Shape (m,) or (m, k), and the rank.
    """
    try:
        solution, _, rank, _ = np.linalg.lstsq(matrix, right, rcond=rcond)
        return np.asarray(solution, dtype=np.float64), int(rank)
    except np.linalg.LinAlgError:
        robust_solution, _, robust_rank, _ = scipy.linalg.lstsq(matrix, right, cond=rcond, lapack_driver="gelss")
        return np.asarray(robust_solution), int(robust_rank)


def nonnegative_least_squares(matrix: Array, right: Array) -> tuple[Array, float]:
    """Least squares with x ≥ 0, and the norm of what it leaves of the right-hand side.

    Where the solution without bounds keeps them, it is the result. scipy.optimize, which takes a tenth of a second to
    import, is then not needed.

    Parameters
    ----------
    matrix
        Shape (n, m).
    right
        Right-hand side, shape (n,).

    Returns
    -------
    x, shape (m,), and the norm.
    """
    is_used = matrix.any(axis=0)
    x = np.zeros(matrix.shape[1])
    x[is_used], rank = least_squares(matrix[:, is_used], right, np.finfo(np.float64).eps)
    if rank == np.count_nonzero(is_used) and (x >= 0).all():
        return x, float(np.linalg.norm(right - matrix @ x))
    from scipy.optimize import nnls

    x, rest = nnls(matrix, right)
    return x, float(rest)


def append_rows(R: Array, rows: Array) -> None:
    """Update the triangular factor R of a QR decomposition by further rows, in place: RᵀR becomes RᵀR + rowsᵀ rows.

    It takes a third of the operations of a QR decomposition of all rows if the further ones are a triangle too, and
    even less if their first columns are zero: LAPACK's tpqrt, as in Golub & Van Loan, Matrix Computations, 6.5.

    Parameters
    ----------
    R
        Upper triangle, shape (m, m).
    rows
        Shape (k, m). It is fastest if both are in the order of Fortran.
    """
    is_involved = rows.any(axis=0)
    if not is_involved.any():
        return
    first = int(is_involved.argmax())
    further = rows[:, first:]
    count, width = further.shape
    is_triangle = count <= width and not np.tril(further[:, :count], -1).any()
    block = min(_TRIANGLE_BLOCK, width)
    R[first:, first:] = lapack.dtpqrt(count if is_triangle else 0, block, R[first:, first:], further)[0]


def compressed_rows(parts: Sequence[tuple[Array, Indices]], width: int) -> Array:
    """Rows of several matrices, stacked, or their triangular QR factor, which has the same Gram matrix.

    The factor takes the place of the rows if these are more than four times as many as the columns.

    Parameters
    ----------
    parts
        Matrices, shape (k, m), and the columns of the result that their columns become, shape (m,). The widest should
        come first, for speed.
    width
        Number of columns.

    Returns
    -------
    Shape (rows, width).
    """

    def on_all_columns(rows: Array, columns: Indices) -> Array:
        expanded = np.zeros((len(rows), width), order="F")
        expanded[:, columns] = rows
        return expanded

    if sum(len(rows) for rows, _ in parts) <= _MAX_ROWS_PER_COLUMN * width:
        return np.concatenate([np.zeros((0, width)), *(on_all_columns(*part) for part in parts)])
    R = np.zeros((width, width), order="F")
    for part in reversed(parts):
        append_rows(R, on_all_columns(*part))
    return np.ascontiguousarray(R)


def reproducible_eigh(matrix: Array, tolerance: float | None = None) -> tuple[Array, Array]:
    """Eigenvalues, ascending, and eigenvectors of a symmetric matrix, chosen so that rounding does not change them.

    Eigenvectors may have either sign. Those of equal eigenvalues may be any basis of their eigenspace. One basis is
    chosen here: the coordinate axis that is nearest to the eigenspace is projected onto it, and gives an eigenvector.
    If several axes are as near, it is the first. The same is done with what is left of the eigenspace.

    The choice is uncertain only if two eigenvalues differ by about the tolerance, or if the squared cosines of two axes
    differ by about a millionth. Within a group of equal eigenvalues, vectors and values match to the tolerance.

    Parameters
    ----------
    matrix
        Shape (n, n).
    tolerance
        Difference up to which neighbouring eigenvalues count as equal. No more than a thousandth of the largest
        eigenvalue is used. Default: 1e-10 of the largest.

    Returns
    -------
    Eigenvalues, shape (n,), and orthonormal eigenvectors as columns, shape (n, n).
    """
    values, vectors = np.linalg.eigh(matrix)
    largest = np.abs(values).max()
    equal_gap = _EQUAL_GAP * largest if tolerance is None else min(tolerance, _MAX_EQUAL_GAP * largest)
    starts_group = np.diff(values) > equal_gap
    group_starts = 1 + np.flatnonzero(starts_group)
    chosen = []
    for basis in np.split(vectors, group_starts, axis=1):
        projector = basis @ basis.T
        for _ in range(basis.shape[1]):
            squared_cosines = np.diagonal(projector)  # of the angles between the coordinate axes and the space
            is_nearest = squared_cosines > (1 - _TIE) * squared_cosines.max()
            nearest = int(np.argmax(is_nearest))
            eigenvector = projector[:, nearest] / np.sqrt(squared_cosines[nearest])
            projector = projector - np.outer(eigenvector, eigenvector)
            chosen.append(eigenvector)
    return values, np.column_stack(chosen)


def null_space(matrix: ArrayLike) -> Array:
    """Basis N of the null space of a matrix: orthonormal columns with matrix @ N = 0.

    Variables that no row involves have unit vectors, so that their scales do not mix.

    Parameters
    ----------
    matrix
        Shape (n, m).

    Returns
    -------
    N, shape (m, f).
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    is_involved = matrix.any(axis=0)
    involved = matrix[:, is_involved]
    s, Vt = right_svd(involved)
    rank = int(np.count_nonzero(s > _RANK * s.max(initial=0.0)))
    rest = Vt[rank:].T
    free_count = int(np.count_nonzero(~is_involved))
    N = np.zeros((matrix.shape[1], free_count + rest.shape[1]))
    N[~is_involved, :free_count] = np.eye(free_count)
    N[is_involved, free_count:] = rest
    return N
