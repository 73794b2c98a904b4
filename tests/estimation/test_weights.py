"""Rows of all joints together, in units of their noise."""

from __future__ import annotations

import numpy as np
import pytest

from idtool.common import linear_algebra
from idtool.dynamics.effects import Coefficient
from idtool.estimation.dataset.reduction import Factor
from idtool.estimation.dataset.weights import weighted_rows

Array = np.ndarray


class Chain:
    """A torque equation in which joint j feels the bodies from j on, and a friction of its own."""

    def __init__(self, joints: int) -> None:
        names = [f"c{i}" for i in range(4 * joints)]
        self.coefficients = tuple(Coefficient("rigid_body", name, "m", "kg", 1.0) for name in names)
        bodies = 3 * joints
        self._active = tuple(np.append(np.arange(3 * j, bodies), bodies + j) for j in range(joints))

    def active(self) -> tuple[Array, ...]:
        return self._active


@pytest.mark.parametrize("samples", [5, 400])
@pytest.mark.parametrize("most", [1, 100])
def test_their_products_are_those_of_all_samples(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, samples: int, most: int
) -> None:
    """Whether they are merged into a triangle or not, of factors with fewer rows than columns and of triangles."""
    monkeypatch.setattr(linear_algebra, "_MAX_ROWS_PER_COLUMN", most)
    chain = Chain(7)
    noise = rng.uniform(0.5, 2.0, 7)
    p = len(chain.coefficients)
    products = np.zeros((p + 1, p + 1))
    factors = []
    for columns, sigma in zip(chain.active(), noise, strict=True):
        block = rng.normal(size=(len(columns) + 1, samples))
        factors.append(Factor.from_columns(block))
        own = [*columns, p]
        products[np.ix_(own, own)] += block @ block.T / sigma**2 / samples
    rows = weighted_rows(chain, tuple(factors), noise)  # type: ignore[arg-type]  # all that it takes of an equation
    np.testing.assert_allclose(rows.T @ rows, products, atol=1e-11)
    all_rows = sum(len(factor.R) for factor in factors)
    assert len(rows) == (p + 1 if all_rows > most * (p + 1) else all_rows)
