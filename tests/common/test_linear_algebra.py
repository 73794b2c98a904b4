"""Linear algebra that numpy's gives up on."""

from __future__ import annotations

import numpy as np
import pytest

from idtool.common.linear_algebra import svd


@pytest.mark.parametrize("shape", [(7, 4), (4, 7), (5, 5)])
@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("gives_up", [False, True])
def test_a_decomposition_is_one(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int], full: bool, gives_up: bool
) -> None:
    def raises(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    matrix = rng.normal(size=shape)
    if gives_up:
        monkeypatch.setattr(np.linalg, "svd", raises)
    U, s, Vt = svd(matrix, full=full)
    n, m = shape
    assert (U.shape, Vt.shape) == (((n, n), (m, m)) if full else ((n, len(s)), (len(s), m)))
    np.testing.assert_allclose((U[:, : len(s)] * s) @ Vt[: len(s)], matrix, rtol=0, atol=1e-12)
    assert (np.diff(s) <= 0).all()
