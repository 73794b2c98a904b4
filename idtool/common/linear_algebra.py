"""Linear algebra that numpy lacks."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from idtool.common.arrays import Array


def svd(matrix: ArrayLike, *, full: bool = False) -> tuple[Array, Array, Array]:
    """Singular value decomposition U diag(s) Vᵀ of any finite matrix.

    LAPACK's fast routine, gesdd, gives up on some matrices with entries as small as rounding errors; its slow one,
    gesvd, does not.

    Parameters
    ----------
    matrix
        Shape (n, m).
    full
        True for square U and Vᵀ.

    Returns
    -------
    U (n, k), s (k,), the largest first, and Vᵀ (k, m) with k = min(n, m); U (n, n) and Vᵀ (m, m) in full.
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    try:
        U, s, Vt = np.linalg.svd(matrix, full_matrices=full)
    except np.linalg.LinAlgError:
        U, s, Vt = scipy.linalg.svd(matrix, full_matrices=full, lapack_driver="gesvd")
    return np.asarray(U), np.asarray(s), np.asarray(Vt)
