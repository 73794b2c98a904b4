"""The bodies' pieces among the variables of the problem, and their inequalities, in units of each body.

Letters as in `problem`: z (p',) coefficients that are no copies, x (m,) variables.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.dynamics.effects.rigid_body import typical_length
from idtool.robot.body import Body
from idtool.robot.inequality import Piece
from idtool.robot.inertia import LENGTH_POWERS, PI_SIZE
from idtool.robot.sets import ConstraintSet

INTERIOR = 1e-9  # how far inside its set a body is kept, in units of its own mass and size: survives rounding


@dataclass(frozen=True)
class PieceVariables:
    """A piece of a body among the variables.

    Attributes
    ----------
    body
        Index of the body.
    first
        Index of the body's first coefficient in z.
    start
        Index of its first variable in x.
    piece
        Its inequalities.
    length
        The body's typical size [m].
    """

    body: int
    first: int
    start: int
    piece: Piece
    length: float

    @property
    def stop(self) -> int:
        """Index after the piece's last variable in x."""
        return self.start + len(self.piece.powers)

    @property
    def z_slice(self) -> slice:
        """The body's ten coefficients in z."""
        return slice(self.first, self.first + PI_SIZE)

    @property
    def x_slice(self) -> slice:
        """The piece's K variables in x."""
        return slice(self.start, self.stop)

    @property
    def basis(self) -> Array:
        """Share of z per unit of x, shape (10, K)."""
        return np.asarray(self.piece.basis * self.length ** (self.piece.powers - LENGTH_POWERS[:, None]))


@dataclass(frozen=True)
class ConicInequality:
    """One inequality on x: Σ_k x[first + k] G_k ⪰ interior · 1, entry by entry where it is on a vector.

    Attributes
    ----------
    first
        Index in x of the first of the K variables.
    G
        Symmetric matrices, shape (K, n, n), or vectors, shape (K, n), without unit.
    label
        The body and its inequality.
    interior
        How far inside x is kept.
    """

    first: int
    G: Array
    label: str
    interior: float = INTERIOR

    @property
    def x_slice(self) -> slice:
        """The K variables in x."""
        return slice(self.first, self.first + len(self.G))

    def value(self, x: Array) -> Array:
        """The matrix or vector at x, shape (n, n) or (n,)."""
        return np.asarray(np.tensordot(x[self.x_slice], self.G, axes=1))


def piece_variables(bodies: Sequence[Body], sets: Sequence[ConstraintSet], free: Indices) -> tuple[PieceVariables, ...]:
    """Variables of all pieces of the bodies that are no copies of others, whose pieces they share.

    Parameters
    ----------
    bodies, sets
        The bodies, one set each.
    free
        Index of each z among the coefficients, shape (p',).
    """
    variables: list[PieceVariables] = []
    place = {int(k): i for i, k in enumerate(free)}
    start = 0
    for i, (body, constraint_set) in enumerate(zip(bodies, sets, strict=True)):
        first = place.get(PI_SIZE * i)
        if first is None:
            continue
        for piece in constraint_set.pieces(body):
            variables.append(PieceVariables(i, first, start, piece, typical_length(body)))
            start = variables[-1].stop
    return tuple(variables)
