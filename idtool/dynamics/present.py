"""The model that is there along a batch of a log, and how its torque changes with its motion.

The partial derivatives of the rigid bodies' torque vary no faster than the motion, so that they are taken at some
samples and a straight line between them.

Shapes: nv joints, N samples. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Protocol

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.data.signals import Motion
from idtool.dynamics.effects import Coefficient, Effect, NamedEffect, RigidBodies
from idtool.robot.inertia import SIZE, symmetric

_RATE = 150.0  # Hz, of the samples at which derivatives are taken
_STEP = 1e-5  # rad, rad/s: of a difference; the torque is linear in a


class Equation(Protocol):
    """A torque equation; see `LinearModel`."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The terms."""

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """The unknowns."""

    def active(self) -> tuple[Indices, ...]:
        """Per joint, which of them appear in its equation."""

    def columns(self, motion: Motion) -> list[Array]:
        """Unfiltered columns and torque, per joint."""


class PresentModel:
    """A torque equation with its coefficients; see `Present`.

    Parameters
    ----------
    equation
        The torque equation.
    theta
        Its coefficients, shape (p,).
    motion
        As measured.
    """

    def __init__(self, equation: Equation, theta: Array, motion: Motion) -> None:
        self.equation, self.theta, self.measured = equation, theta, motion
        self.true = motion
        for effect in equation.effects:
            self.true = effect.true(self.true)
        self._stride = max(1, int(1 / (_RATE * motion.dt)))

    @cached_property
    def _bodies(self) -> RigidBodies:
        return next(effect for effect in self.equation.effects if isinstance(effect, RigidBodies))

    @cached_property
    def columns(self) -> list[Array]:
        """See `LinearModel.columns`."""
        return self.equation.columns(self.measured)

    @cached_property
    def residual(self) -> Array:
        """Measured torque less the model's, as the equation has both, unfiltered; shape (nv, N)."""
        pairs = zip(self.equation.active(), self.columns, strict=True)
        return np.stack([block[-1] - self.theta[active] @ block[:-1] for active, block in pairs])

    def predicted(self, motion: Motion) -> Array:
        """See `Present.predicted`."""
        return self.true.tau - self.residual

    def moved(self, motion: Motion, joint: int, q: Array, v: Array, a: Array) -> Array:
        """See `Present.moved`."""
        change = -np.outer(self._spin[joint], a)  # rotors stay with the motor
        for k, by in enumerate((q, v, a)):
            if by.any():
                change += self._between(self._slopes[k][joint]) * by
        return change

    def pulled(self, motion: Motion, gravity: Array) -> Array:
        """See `Present.pulled`."""
        model = self._bodies.model
        other = RigidBodies(replace(model, gravity=model.gravity + gravity))
        return self._between(self._torque(self._few, other) - self._torque(self._few, self._bodies))

    def carried(self, motion: Motion, joint: int) -> tuple[Array, Array]:
        """See `Present.carried`."""
        rotors = self._spin[joint] @ self.true.a + self._further(joint) * motion.a[joint]
        inertia = self._between(self._slopes[2][joint][joint, None])[0] - self._spin[joint, joint]
        return self.predicted(motion)[joint] - rotors, inertia

    def rubbed(self, joint: int) -> Array:
        """See `Present.rubbed`."""
        total, first = np.zeros(len(self.true.t)), 0
        for effect in self.equation.effects:
            theta = self.theta[first : first + len(effect.coefficients)]
            first += len(effect.coefficients)
            if isinstance(effect, NamedEffect) and effect.friction and len(effect.active[joint]):
                out = [np.empty((len(active), len(self.true.t))) for active in effect.active]
                effect.write(self.true, out)
                total += theta[effect.active[joint]] @ out[joint]
        return total

    @cached_property
    def _spin(self) -> Array:
        """Torque that the rotors' spin takes on each joint per acceleration of each, shape (nv, nv)."""
        spin = np.zeros((len(self.equation.joints),) * 2)
        for i, body in enumerate(self._bodies.model.bodies):
            if body.kind == "rotor":
                own = symmetric(self.theta[SIZE * i : SIZE * (i + 1)][4:])
                spin += float(body.axis @ own @ body.axis) * np.outer(body.ratios, body.ratios)
        return spin

    def _further(self, joint: int) -> float:
        """What rotors that are no bodies add to that of a joint by itself."""
        pairs = zip(self.equation.coefficients, self.theta, strict=True)
        return sum(float(x) for c, x in pairs if c.key[:2] == ("rotor_inertia", self.equation.joints[joint]))

    @cached_property
    def _few(self) -> Motion:
        every = slice(None, None, self._stride)
        m = self.true
        return replace(
            m, t=m.t[every], q=m.q[:, every], v=m.v[:, every], a=m.a[:, every], tau=m.tau[:, every],
            logged=m.logged[:, every], dt=m.dt * self._stride,
        )  # fmt: skip

    def _torque(self, motion: Motion, bodies: RigidBodies) -> Array:
        """The rigid bodies' torque, shape (nv, N)."""
        out = [np.empty((len(active), len(motion.t))) for active in bodies.active]
        bodies.write(motion, out)
        pairs = zip(bodies.active, out, strict=True)
        return np.stack([self.theta[active] @ rows for active, rows in pairs])  # they come first in theta

    @cached_property
    def _slopes(self) -> tuple[list[Array], list[Array], list[Array]]:
        """By q, v and a, and by joint: of all joints' torque, shape (nv, n)."""
        few = self._few
        here = self._torque(few, self._bodies)
        found: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
        for joint in range(len(few.q)):
            for kind, (name, step) in enumerate((("q", _STEP), ("v", _STEP), ("a", 1.0))):
                x = getattr(few, name).copy()
                x[joint] += step
                there = self._torque(replace(few, **{name: x}), self._bodies)
                found[kind].append((there - here) / step)
        return found

    def _between(self, rows: Array) -> Array:
        """Rows at some samples, shape (k, n), at all, shape (k, N)."""
        at, every = self._few.t, self.true.t
        return np.stack([np.interp(every, at, row) for row in rows])
