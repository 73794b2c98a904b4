"""`Survey`: what a log's motion covers and which model it is judged by, on which the search for an effect depends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.robot.model import Model


class Present(Protocol):
    """The model that is there, with its coefficients, along a motion."""

    @property
    def measured(self) -> Motion:
        """The motion, as sensors gave it."""

    @property
    def residual(self) -> Array:
        """Measured torque less the model's, unfiltered, shape (nv, N)."""

    def predicted(self, motion: Motion) -> Array:
        """Torque that it predicts, shape (nv, N)."""

    def moved(self, motion: Motion, joint: int, q: Array, v: Array, a: Array) -> Array:
        """By how much that changes, to first order, where a joint's link is off by q, v and a, shape (N,) each.

        Returns
        -------
        Shape (nv, N).
        """

    def pulled(self, motion: Motion, gravity: Array) -> Array:
        """By how much it changes with a change of gravity [m/s²], shape (3,); shape (nv, N)."""

    def carried(self, motion: Motion, joint: int) -> tuple[Array, Array]:
        """What a joint's link takes of torque and has of inertia, its rotors not counted; shape (N,) each."""

    def rubbed(self, joint: int) -> Array:
        """What friction on a joint takes of torque, shape (N,)."""


@dataclass(frozen=True)
class Survey:
    """What was logged, over all training data.

    Attributes
    ----------
    model
        The robot.
    taken
        Keys of the effects that the torque equation has.
    low, high
        Least and greatest position, shape (nv,).
    speed
        Rms of the velocity, shape (nv,).
    torque
        Greatest torque, shape (nv,).
    still
        Speed at which the sign of a velocity is lost in its noise, shape (nv,).
    dt
        Sample time [s].
    seconds
        Of the longest log.
    band_hz
        The filter's cut-off [Hz].
    bursts
        Stretches of time in which the residual is out of the ordinary [s], shape (k, 2).
    fixed
        Whether the URDF's inertia is taken as true.
    """

    model: Model
    taken: frozenset[tuple[str | float, ...]]
    low: Array
    high: Array
    speed: Array
    torque: Array
    still: Array
    dt: float
    seconds: float
    band_hz: float
    bursts: tuple[tuple[float, float], ...] = ()
    fixed: bool = False

    @property
    def travel(self) -> Array:
        """From the least to the greatest position, shape (nv,)."""
        return self.high - self.low

    def has(self, effect: str, owner: str) -> bool:
        """Whether the equation has an effect on a joint or link."""
        return any(key[:2] == (effect, owner) for key in self.taken)
