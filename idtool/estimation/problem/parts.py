"""The bodies' pieces among the variables of the problem, and their inequalities, in units of each body.

Letters as in `problem`: z (p',) coefficients that are no copies, x (m,) variables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.dynamics.effects.rigid_body import typical_length
from idtool.robot.body import Body
from idtool.robot.inequality import Piece
from idtool.robot.inertia import POWERS, SIZE
from idtool.robot.sets import ConstraintSet

INTERIOR = 1e-9  # how far inside its set a body is kept, in units of its own mass and size: survives rounding


@dataclass(frozen=True)
class Part:
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
        What it must fulfil.
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
        """Index after its last variable in x."""
        return self.start + len(self.piece.powers)

    @property
    def basis(self) -> Array:
        """Share of z per unit of x, shape (10, K)."""
        return np.asarray(self.piece.basis * self.length ** (self.piece.powers - POWERS[:, None]))


@dataclass(frozen=True)
class Matrix:
    """One inequality on x: Σ_k x[first + k] G_k ⪰ interior · 1, entry by entry where it is on a vector.

    Attributes
    ----------
    first
        Index in x of the first of the K variables.
    G
        Symmetric matrices, shape (K, n, n), or vectors, shape (K, n), without unit.
    label
        The body and what is demanded of it.
    interior
        How far inside x is kept.
    """

    first: int
    G: Array
    label: str
    interior: float = INTERIOR

    @property
    def own(self) -> slice:
        """The K variables among x."""
        return slice(self.first, self.first + len(self.G))

    def value(self, x: Array) -> Array:
        """The matrix or vector at x, shape (n, n) or (n,)."""
        return np.asarray(np.tensordot(x[self.own], self.G, axes=1))


def parts_of(bodies: Sequence[Body], sets: Sequence[ConstraintSet], free: Indices) -> tuple[Part, ...]:
    """The pieces of the bodies that are no copies of others, whose pieces they share.

    Parameters
    ----------
    bodies, sets
        The bodies, one set each.
    free
        Which coefficients z are, shape (p',).
    """
    parts: list[Part] = []
    place = {int(k): i for i, k in enumerate(free)}
    for i, (body, kind) in enumerate(zip(bodies, sets, strict=True)):
        for piece in kind.pieces(body) if SIZE * i in place else ():
            parts.append(Part(i, place[SIZE * i], parts[-1].stop if parts else 0, piece, typical_length(body)))
    return tuple(parts)
