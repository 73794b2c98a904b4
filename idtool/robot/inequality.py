"""Linear matrix inequalities on a body's parameters, and the pieces that a body is the sum of.

A set of parameters is given once, as matrices; the form for the solver, the numeric check and the certificate of the
optimum all come from these.

Letters: pi (10,) a body's parameters; x (K,) the unknowns of a piece, pi = basis x.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from idtool.common.arrays import Array
from idtool.robot.inertia import J_BASIS, LENGTH_POWERS, PI_SIZE, from_pseudo_inertia


@dataclass(frozen=True)
class Inequality:
    """Σ_k x_k G_k ⪰ 0 or, where the G_k are vectors, every entry of that sum ≥ 0.

    Attributes
    ----------
    label
        What it demands, in words for an error message.
    G
        Symmetric matrices, shape (K, n, n), or vectors, shape (K, n).
    lengths
        Powers of length in the rows' units, shape (n,): the matrix entry i, j is in kg·m^(lengths[i] + lengths[j]), the
        vector entry i in kg·m^(2 lengths[i]).
    strict
        Whether a solution is kept off its boundary by a margin that survives rounding.
    """

    label: str
    G: Array
    lengths: Array
    strict: bool = True

    def scaled(self, length: float, powers: Array = LENGTH_POWERS) -> Array:
        """G for x_k in units of mass · length^powers[k], shape (K,), itself without unit."""
        row = length**-self.lengths
        weight = row[:, None] * row if self.G.ndim == 3 else row**2
        return np.asarray((self.G.T * length**powers).T * weight)

    def margin(self, x: Array, mass: float, length: float, powers: Array = LENGTH_POWERS) -> float:
        """The least eigenvalue or entry at x, in units of a mass [kg] and a length [m]; negative: violated."""
        return smallest_value(np.tensordot(x / (mass * length**powers), self.scaled(length, powers), axes=1))


def smallest_value(value: Array) -> float:
    """The least eigenvalue of a symmetric matrix, or the least entry of a vector."""
    return float(np.linalg.eigvalsh(value)[0] if value.ndim == 2 else value.min(initial=np.inf))


@dataclass(frozen=True)
class Piece:
    """One of the parameter vectors that a body's are the sum of (Cor. 2).

    Attributes
    ----------
    inequalities
        What its unknowns x must fulfil.
    basis
        pi = basis x, shape (10, K).
    powers
        Unit of x: kg·m^powers, shape (K,).
    """

    inequalities: tuple[Inequality, ...]
    basis: Array = field(default_factory=lambda: np.eye(PI_SIZE))
    powers: Array = field(default_factory=lambda: LENGTH_POWERS)


#: J(pi) ⪰ 0: some mass density has these moments (Thm 3).
REALIZABLE = Inequality(
    "positive definite pseudo-inertia (triangle inequalities)", J_BASIS, np.array([1.0, 1.0, 1.0, 0.0])
)


def density_within(Q: Array, label: str) -> Inequality:
    """Tr(J(pi) Q) ≥ 0: what a density has that is zero where [x; 1]ᵀ Q [x; 1] < 0 (Thm 4, (25)).

    Parameters
    ----------
    Q
        One matrix without unit, shape (4, 4), or several, shape (n, 4, 4).
    label
        What it demands.
    """
    trace = np.einsum("kij,nji->kn", J_BASIS, Q.reshape(-1, 4, 4))
    return Inequality(label, trace, np.zeros(trace.shape[1]))


def point_masses(places: Array) -> Piece:
    """Point masses x ≥ 0 at places, shape (K, 3) [m]: pi = Σ_k x_k pi(place_k) (Ayusawa et al.)."""
    points = np.column_stack([places, np.ones(len(places))])
    J = points[:, :, None] * points[:, None, :]
    basis = from_pseudo_inertia(J).T
    zero = np.zeros(len(places))
    positive = Inequality("no negative mass", np.eye(len(places)), zero, strict=False)
    density = Inequality(REALIZABLE.label, np.tensordot(basis.T, J_BASIS, axes=1), REALIZABLE.lengths)
    return Piece((positive, density), basis, zero)
