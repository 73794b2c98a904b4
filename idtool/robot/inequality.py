"""Linear matrix inequalities on a body's parameters, and the pieces whose sum a body is.

A set of parameters is given once, as matrices; the form for the solver, the numeric check and the certificate of the
optimum all come from these.

Letters: pi (10,) a body's parameters; x (K,) the unknowns of a piece, pi = basis x.
"""

from __future__ import annotations

from dataclasses import field

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.robot.inertia import J_BASIS, LENGTH_POWERS, PI_SIZE, from_pseudo_inertia


@dataclass(frozen=True)
class Inequality:
    """Σ_k x_k G_k ⪰ 0 or, where the G_k are vectors, every entry of that sum ≥ 0.

    Attributes
    ----------
    label
        The condition in words, for messages.
    G
        Symmetric matrices, shape (K, n, n), or vectors, shape (K, n).
    lengths
        Powers of length in the rows' units, shape (n,): the matrix entry i, j is in kg·m^(lengths[i] + lengths[j]), the
        vector entry i in kg·m^(2 lengths[i]).
    strict
        True if a solution is kept off the boundary by a margin that survives rounding.
    """

    label: str
    G: Array
    lengths: Array
    strict: bool = True

    def scaled(self, length: float, powers: Array = LENGTH_POWERS) -> Array:
        """Dimensionless G for x_k in units of mass · length^powers[k], shape (K,)."""
        row_units = length**-self.lengths
        units = row_units[:, None] * row_units if self.G.ndim == 3 else row_units**2
        return np.asarray((self.G.T * length**powers).T * units)

    def margin(self, x: Array, mass: float, length: float, powers: Array = LENGTH_POWERS) -> float:
        """Smallest eigenvalue or entry at x, in units of a mass [kg] and a length [m]; negative: violated."""
        x_scaled = x / (mass * length**powers)
        return smallest_value(np.tensordot(x_scaled, self.scaled(length, powers), axes=1))


def smallest_value(value: Array) -> float:
    """Smallest eigenvalue of a symmetric matrix, or smallest entry of a vector."""
    if value.ndim == 2:
        return float(np.linalg.eigvalsh(value)[0])
    return float(value.min(initial=np.inf))


@dataclass(frozen=True)
class Piece:
    """A convex cone of parameters; a body's parameters are a sum of one vector from each of its pieces (Cor. 2).

    Attributes
    ----------
    inequalities
        Inequalities on its unknowns x.
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
    """Tr(J(pi) Q) ≥ 0, which holds for a density that is zero where [x; 1]ᵀ Q [x; 1] < 0 (Thm 4, (25)).

    Parameters
    ----------
    Q
        One dimensionless matrix, shape (4, 4), or several, shape (n, 4, 4).
    label
        The condition in words, for messages.
    """
    trace = np.einsum("kij,nji->kn", J_BASIS, Q.reshape(-1, 4, 4))
    return Inequality(label, trace, np.zeros(trace.shape[1]))


def point_masses(points: Array) -> Piece:
    """Point masses x ≥ 0 at points, shape (K, 3) [m]: pi = Σ_k x_k pi(point_k) (Ayusawa et al.)."""
    lifted = np.column_stack([points, np.ones(len(points))])  # [point; 1]
    J = lifted[:, :, None] * lifted[:, None, :]
    basis = from_pseudo_inertia(J).T
    zero = np.zeros(len(points))
    positive = Inequality("no negative mass", np.eye(len(points)), zero, strict=False)
    density = Inequality(REALIZABLE.label, np.tensordot(basis.T, J_BASIS, axes=1), REALIZABLE.lengths)
    return Piece((positive, density), basis, zero)
