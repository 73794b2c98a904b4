"""`ConstraintSet`: the inertia parameters that a body may have, as linear matrix inequalities.

A set is given once, as inequalities Σ_k pi_k G_k ⪰ 0; the form for the solver, the numeric check and the certificate of
the optimum all come from these matrices. A new set is one new file in this folder.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idtool.ellipsoid import Ellipsoid

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Inequality:
    """Σ_k pi_k G_k ⪰ 0.

    Attributes
    ----------
    label
        What it demands, in words for an error message.
    G
        Symmetric matrices, shape (10, n, n).
    lengths
        Power of length in the unit of each row, shape (n,): the entry i, j is in kg·m^(lengths[i] + lengths[j]).
    """

    label: str
    G: Array
    lengths: Array

    def scaled(self, scales: Array) -> Array:
        """The matrices for pi in units of ``scales``, shape (10,), themselves without unit: shape (10, n, n)."""
        mass, length = scales[0], scales[1] / scales[0]
        row = length**-self.lengths
        return np.asarray(self.G * (scales / mass)[:, None, None] * row[:, None] * row)

    def margin(self, pi: Array, scales: Array) -> float:
        """The least eigenvalue for parameters pi, shape (10,), in units of ``scales``; negative: violated."""
        return float(np.linalg.eigvalsh(np.tensordot(pi / scales, self.scaled(scales), axes=1))[0])


class ConstraintSet(ABC):
    """A convex cone of inertia parameters.

    Attributes
    ----------
    name
        As in the configuration.
    tightness
        Order among the sets: a tighter set lies within a looser one.
    bounded
        Whether it needs a bounding ellipsoid.
    """

    name: str
    tightness: int
    bounded: bool = False

    @abstractmethod
    def inequalities(self, ellipsoid: Ellipsoid | None) -> tuple[Inequality, ...]:
        """What parameters of a body must fulfil; all together represent the set exactly.

        Parameters
        ----------
        ellipsoid
            The bounding ellipsoid in the body's frame; not None where `bounded`.
        """

    def parts(self, ellipsoids: tuple[Ellipsoid, ...]) -> tuple[tuple[Inequality, ...], ...]:
        """Inequalities of each part of a body, pi = Σ_l pi_l, one part an ellipsoid of the union (Cor. 2)."""
        if self.bounded and ellipsoids:
            return tuple(self.inequalities(ellipsoid) for ellipsoid in ellipsoids)
        return (self.inequalities(None),)
