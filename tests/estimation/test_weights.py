"""Rows of all joints together, in units of their noise."""

from __future__ import annotations

import numpy as np
import pytest

from idtool.common import linear_algebra
from idtool.dynamics.effects import Coefficient
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.reduction import Factor
from idtool.estimation.dataset.weights import free_fit, weighted_rows

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


def test_copies_whose_columns_cancel_have_no_part_in_the_noise(rng: np.random.Generator) -> None:
    """A mirrored body may lose a parameter that its original gains: what rounding leaves of it is no direction."""
    chain = Chain(1)  # of three columns of bodies and one of friction
    K = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    first, third = rng.normal(size=(2, 500))
    second = first / 49 * 49  # equal but for rounding
    assert 0 < np.abs(first - second).max() < 1e-15
    torque = 2 * third + rng.normal(size=500)
    reduction = (Factor.from_columns(np.stack([first, second, third, np.zeros(500), torque])),)
    copies = EqualityConstraints(K, np.array([0, 2]))
    np.testing.assert_array_equal(copies.free_columns(reduction[0].R[:, :4])[:, 0], 0)
    fit = free_fit(chain, reduction, copies)  # type: ignore[arg-type]
    alone = third @ torque / (third @ third)
    np.testing.assert_allclose(fit.theta, [0, 0, alone, 0], atol=1e-12)
    assert fit.noise[0] == pytest.approx(np.std(torque - alone * third), rel=0.01)


def test_columns_of_some_coefficients_are_substituted_as_all_are(rng: np.random.Generator) -> None:
    rows = rng.normal(size=(8, 4))
    copies = EqualityConstraints(np.array([[1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [1.0, 0.0]]), np.array([0, 1]))
    some = np.array([0, 2])
    only_some = np.zeros_like(rows)
    only_some[:, some] = rows[:, some]
    np.testing.assert_allclose(copies.free_columns(rows[:, some], some), copies.free_columns(only_some), atol=1e-15)
