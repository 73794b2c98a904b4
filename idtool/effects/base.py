"""`Effect`: a term of the torque equation, linear in its coefficients.

tau = Σ over effects of columns(q, v, a) · coefficients. A new effect is one new file in this folder: a subclass with an
``id`` is found by itself.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idtool.signals import Motion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Coefficient:
    """One unknown of the linear model.

    Attributes
    ----------
    effect
        Id of the effect it belongs to.
    owner
        The body or joint it describes.
    name
        Its name within the effect, as in the contract.
    unit
        SI.
    prior
        The value before any data.
    scale
        Typical size in its unit, by which deviations from the prior are measured; None: the prior does not hold it.
    lower, upper
        What physics allows by itself.
    """

    effect: str
    owner: str
    name: str
    unit: str
    prior: float
    scale: float | None = None
    lower: float = -np.inf
    upper: float = np.inf


class Effect(ABC):
    """A term of the torque equation.

    Attributes
    ----------
    coefficients
        Its m unknowns.
    active
        Per joint, which of them appear in that joint's equation, ascending; nv arrays of indices.
    """

    coefficients: tuple[Coefficient, ...]
    active: tuple[NDArray[np.intp], ...]

    @abstractmethod
    def write(self, motion: Motion, out: Sequence[Array]) -> None:
        """Evaluate the active columns of every joint.

        Parameters
        ----------
        motion
            N samples.
        out
            Per joint, where to write them: shape (len(active[joint]), N).
        """

    def undefined(self, motion: Motion) -> dict[int, NDArray[np.bool_]]:
        """Where the columns cannot be known from the motion: joint index to a mask of shape (N,)."""
        return {}
