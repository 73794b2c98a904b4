"""`Effect`: a term of the torque equation, linear in its coefficients.

tau = Σ over effects of columns(q, v, a) · coefficients. A new effect is one new file in this folder: a subclass with an
``id`` is found by itself.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from functools import cached_property

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.data.signals import Motion
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.model import RobotModel


@dataclass(frozen=True)
class Coefficient:
    """One unknown of the linear model.

    Attributes
    ----------
    effect
        Id of the effect that it belongs to.
    owner
        The body or joint that it describes.
    name
        Its name within the effect, as in docs/pages/effects.md.
    unit
        SI.
    prior
        The value before any data.
    scale
        Typical size in its unit, by which deviations from the prior are measured; None: no prior on it.
    lower, upper
        Physical bounds.
    even
        True if its sign does not change when the joint's axis is reversed.
    instance
        Values that distinguish effects of one kind on one owner, such as the positions of two end stops.
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
    instance: tuple[float, ...] = ()

    @property
    def key(self) -> tuple[str, str, str, tuple[float, ...]]:
        """Identifier that is unique within a model."""
        return self.effect, self.owner, self.name, self.instance


class Effect(ABC):
    """A term of the torque equation.

    Attributes
    ----------
    order
        Effects are evaluated in ascending order. Torque sensors come first, because they determine the true torque;
        effects that need the true torque or the whole inertia come last.
    uses_measured_torque
        True if the measured torque, and with it its noise, also enters elsewhere than as the torque to be explained.
    coefficients
        The m unknowns.
    active
        Per joint, the coefficients that appear in its equation, ascending; nv arrays of indices.
    """

    order: int = 0
    uses_measured_torque: bool = False
    coefficients: tuple[Coefficient, ...]
    active: tuple[Indices, ...]

    @property
    def column_key(self) -> Hashable | None:
        """Key of the columns: along the same q, v and a, effects of one key have the same columns; None: not known."""
        return None

    @abstractmethod
    def columns(self, motion: Motion, out: Sequence[Array]) -> None:
        """Evaluate the active columns of every joint.

        Parameters
        ----------
        motion
            N samples.
        out
            Per joint, the array to write to, shape (len(active[joint]), N).
        """

    def filtered_columns(self, motion: Motion, low_pass: Callable[[Array], Array], out: Sequence[Array]) -> None:
        """Evaluate the active columns of every joint through a filter.

        Parameters
        ----------
        motion
            N samples.
        low_pass
            Filter of columns, shape (..., N) to (..., n).
        out
            Per joint, the array to write to, shape (len(active[joint]), n).
        """
        columns = self.empty_columns(len(motion.t))
        self.columns(motion, columns)
        for joint in self.active_joints:
            out[joint][:] = low_pass(columns[joint])

    def empty_columns(self, count: int) -> list[Array]:
        """Arrays for the active columns of every joint, shape (len(active[joint]), count); not set to any value."""
        columns = [np.empty((0, count))] * len(self.active)
        for joint in self.active_joints:
            columns[joint] = np.empty((len(self.active[joint]), count))
        return columns

    @cached_property
    def active_joints(self) -> tuple[int, ...]:
        """Joints in whose equations any of the coefficients appears."""
        return tuple(joint for joint, active in enumerate(self.active) if len(active))

    @abstractmethod
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        """Add the effect to a forward model.

        Parameters
        ----------
        theta
            Its coefficients, shape (m,).
        mechanism
            The forward model.
        """

    def set_operating_point(self, model: Callable[[Motion], Linearization], theta: Array) -> None:  # noqa: B027
        """Set what the columns depend on beyond the motion: for effects of the load on a joint.

        Parameters
        ----------
        model
            The model without the effects of this kind, along a motion.
        theta
            The effect's own coefficients, shape (m,).
        """

    def invalid_mask(self, motion: Motion) -> dict[int, Mask]:
        """Samples at which the columns cannot be known from the true motion: joint index to a mask of shape (N,)."""
        return {}

    def modify_model(self, model: RobotModel) -> RobotModel:
        """Tree of bodies with what the effect changes in it."""
        return model

    def correct_motion(self, motion: Motion) -> Motion:
        """True motion, from the motion that the sensors gave."""
        return motion

    def apply_sensor(self, tau: Array, motion: Motion) -> Array:
        """Measured torque, from the true one; shape (..., nv, N)."""
        return tau

    @property
    def compares_true_torque(self) -> bool:
        """True if errors are those of the true torque, since the motion does not tell what is measured."""
        return False

    def fixed_torque(self, motion: Motion) -> Array | None:
        """Torque on the link side that has no coefficient, shape (nv, N)."""
        return None
