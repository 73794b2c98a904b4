"""`Effect`: a term of the torque equation, linear in its coefficients.

tau = Σ over effects of columns(q, v, a) · coefficients. A new effect is one new file in this folder: a subclass with an
``id`` is found by itself.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.data.signals import Motion
from idtool.dynamics.effects.survey import Present
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.model import Model


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
    even
        Whether it stays as it is when the joint's direction is turned round.
    among
        What tells it from others of the same name and owner, such as the place of one of two end stops.
    """

    effect: str
    owner: str
    name: str
    unit: str
    prior: float
    scale: float | None = None
    lower: float = -np.inf
    upper: float = np.inf
    even: bool = False
    among: tuple[float, ...] = ()

    @property
    def key(self) -> tuple[str, str, str, tuple[float, ...]]:
        """What it is called; no two of a model are called the same."""
        return self.effect, self.owner, self.name, self.among


class Effect(ABC):
    """A term of the torque equation.

    Attributes
    ----------
    rank
        Effects come in this order, from the log to the truth: sensors before what follows from true torque and all of
        the inertia.
    coefficients
        Its m unknowns.
    active
        Per joint, which of them appear in that joint's equation, ascending; nv arrays of indices.
    by_torque
        Whether it takes the measured torque, and so its noise, for something else too.
    """

    rank: int = 0
    by_torque: bool = False
    coefficients: tuple[Coefficient, ...]
    active: tuple[Indices, ...]

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

    @abstractmethod
    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """Add the effect's forward form.

        Parameters
        ----------
        theta
            Its coefficients, shape (m,).
        mechanism
            What it is added to.
        """

    def refer(self, model: Callable[[Motion], Present], theta: Array) -> None:  # noqa: B027
        """Take note of the model without it and of its own coefficients there, shape (m,).

        For effects whose columns depend on what a joint carries.
        """

    def undefined(self, motion: Motion) -> dict[int, Mask]:
        """Where the columns cannot be known from the motion: joint index to a mask of shape (N,)."""
        return {}

    def alter(self, model: Model) -> Model:
        """The tree of bodies as the effect says that it is."""
        return model

    def true(self, motion: Motion) -> Motion:
        """The motion as it was, from the motion as the sensors gave it."""
        return motion

    def measured(self, tau: Array, motion: Motion) -> Array:
        """Torque of samples as the sensors give it, from the true one, shape (..., nv, N)."""
        return tau

    def known(self, motion: Motion) -> Array | None:
        """Torque that takes no coefficient, on the load's side, shape (nv, N)."""
        return None
