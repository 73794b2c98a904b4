"""Dry friction as simulators have it: each of `FRICTION_KINDS` is a law from the free velocity to the one after a step.

- ``sign``: Coulomb friction that truly sticks, by Moreau's time stepping with Gauss-Seidel on the impulses.
- ``tanh``: level tanh(v / width), which never sticks.
- ``lugre``: bristles that bend by a small displacement, with micro-damping; Canudas de Wit et al., IEEE Transactions on
  Automatic Control 40 (1995), without their Stribeck term.
- ``frictionloss``: MuJoCo's constraint of that name, by its own solver and with its default parameters.

The level is that of Coulomb friction and of all further dry friction on a coordinate.

Letters: M mass matrix, shape (m, m), in the coordinates of `hidden_effects.plant`; v velocity, shape (m,).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import mujoco  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FRICTION_KINDS = ("sign", "tanh", "lugre", "frictionloss")

_WIDTHS = (0.005, 0.02)  # rad/s, of tanh
_DISPLACEMENTS = (1e-4, 5e-4)  # rad, of the bristles
_DAMPING_RATIOS = (0.2, 0.5)  # of the bristles
_MAX_SETS = 20
_MAX_SWEEPS = 60
_CONVERGED = 1e-9  # rad/s
_SOLVER_TOLERANCE = 1e-10  # of MuJoCo's solver; its default of 1e-8 can be seen in a log without noise


@dataclass(frozen=True)
class Friction:
    """The way in which dry friction is simulated.

    Attributes
    ----------
    kind
        One of `FRICTION_KINDS`.
    width
        Velocity over which ``tanh`` changes its sign [rad/s].
    displacement
        Deflection at which the bristles of ``lugre`` slide [rad].
    damping_ratio
        Of the bristles with the inertia that a joint moves.
    """

    kind: str = "sign"
    width: float = 0.01
    displacement: float = 2e-4
    damping_ratio: float = 0.3

    @property
    def is_stiff(self) -> bool:
        """True if it needs short time steps."""
        return self.kind in ("tanh", "lugre")


def draw_friction(kind: str, seed: int) -> Friction:
    """Friction of a kind, with parameters that are usual in simulators."""
    rng = np.random.default_rng([seed, 17])
    width, displacement = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (_WIDTHS, _DISPLACEMENTS))
    return Friction(kind, width, displacement, float(rng.uniform(*_DAMPING_RATIOS)))


@dataclass(frozen=True)
class FreeStep:
    """A time step of ``dt`` seconds without dry friction: M, its inverse, and v before and after."""

    M: Array
    M_inverse: Array
    v: Array
    v_free: Array
    dt: float


class FrictionLaw(ABC):
    """Dry friction on all coordinates; it may have a state of its own."""

    @abstractmethod
    def velocity_after(self, step: FreeStep, level: Array) -> Array:
        """Velocity after a step with dry friction of these levels [N m], shape (m,)."""


class StickingFriction(FrictionLaw):
    """Coulomb friction that truly sticks."""

    def velocity_after(self, step: FreeStep, level: Array) -> Array:
        """Velocity that Coulomb's law allows."""
        return velocity_with_dry_friction(step.M_inverse, step.v_free, step.dt * level, step.v)


class RoundedFriction(FrictionLaw):
    """Friction that is a smooth function of the velocity."""

    def __init__(self, width: float) -> None:
        self._width = width

    def torque(self, level: Array, v: Array) -> Array:
        """Torque [N m]."""
        return np.asarray(level * np.tanh(v / self._width))

    def velocity_after(self, step: FreeStep, level: Array) -> Array:
        """Velocity with the torque at the beginning of the step."""
        return np.asarray(step.v_free - step.dt * step.M_inverse @ self.torque(level, step.v))


class BristleFriction(FrictionLaw):
    """LuGre's friction.

    Parameters
    ----------
    friction
        Displacement and damping ratio.
    level
        Usual level on each coordinate [N m], shape (m,), for the damping.
    inverse_weights
        Diagonal of the inverse of the mass matrix at q = 0.
    """

    def __init__(self, friction: Friction, level: Array, inverse_weights: Array) -> None:
        self._displacement = friction.displacement
        stiffness = level / friction.displacement
        self._damping = 2 * friction.damping_ratio * np.sqrt(stiffness / inverse_weights)
        self.z = np.zeros(len(level))  # deflection over displacement

    def velocity_after(self, step: FreeStep, level: Array) -> Array:
        """Velocity with the torque at the beginning of the step; the bristles then bend for a step."""
        rate, z = advance_bristle(self.z, step.v, self._displacement, step.dt)
        torque = level * self.z + self._damping * self._displacement * rate
        self.z = z
        return np.asarray(step.v_free - step.dt * step.M_inverse @ torque)


class MujocoFrictionLoss(FrictionLaw):
    """MuJoCo's constraint ``frictionloss``.

    MuJoCo has no ideal gears, so that the robot's rotors can't be part of the model whose constraints it solves. That
    model is a chain of as many hinges as there are coordinates, and it gets the robot's mass matrix and forces: a
    chain's mass matrix has no zeros, and the constraint depends on nothing else.

    Parameters
    ----------
    inverse_weights
        Diagonal of the inverse of the robot's mass matrix at q = 0, by which MuJoCo scales the constraint.
    dt
        Time step [s].
    """

    def __init__(self, inverse_weights: Array, dt: float) -> None:
        spec = mujoco.MjSpec()
        spec.option.timestep = dt
        spec.option.tolerance = _SOLVER_TOLERANCE
        spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_ISLAND
        body = spec.worldbody
        for _ in inverse_weights:
            body = body.add_body(mass=1.0, inertia=[1.0, 1.0, 1.0], ipos=[0.1, 0.2, 0.3])
            body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, frictionloss=1.0)
        self._model = spec.compile()
        self._model.dof_invweight0[:] = inverse_weights
        self._model.stat.meaninertia = float(np.mean(1 / inverse_weights))
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        lengths = self._model.M_rownnz
        self._entries = np.repeat(np.arange(len(lengths)), lengths), self._model.M_colind

    def velocity_after(self, step: FreeStep, level: Array) -> Array:
        """Velocity with the acceleration that MuJoCo's solver finds."""
        model, data = self._model, self._data
        model.dof_frictionloss[:] = level
        data.qvel[:] = step.v
        data.M[:] = step.M[self._entries]
        mujoco.mj_factorM(model, data)
        free_acceleration = (step.v_free - step.v) / step.dt
        data.qacc_smooth[:] = free_acceleration
        data.qfrc_smooth[:] = step.M @ free_acceleration
        mujoco.mj_makeConstraint(model, data)
        mujoco.mj_referenceConstraint(model, data)
        mujoco.mj_fwdConstraint(model, data)
        data.qacc_warmstart[:] = data.qacc
        return np.asarray(step.v + step.dt * data.qacc)


def friction_law(friction: Friction, level: Array, inverse_weights: Array, dt: float) -> FrictionLaw:
    """The law of a kind of friction; the arguments are those of its class."""
    laws: dict[str, Any] = {
        "sign": StickingFriction,
        "tanh": lambda: RoundedFriction(friction.width),
        "lugre": lambda: BristleFriction(friction, level, inverse_weights),
        "frictionloss": lambda: MujocoFrictionLoss(inverse_weights, dt),
    }
    law: FrictionLaw = laws[friction.kind]()
    return law


def advance_bristle(z: Any, v: Any, displacement: float, dt: float) -> tuple[Any, Any]:
    """Rate of Dahl's bristles, and their state after a step, exactly for a constant velocity.

    Parameters
    ----------
    z
        Deflection over displacement, of one coordinate or of several.
    v
        Velocity, same shape.
    displacement, dt
        [rad, s].
    """
    direction = np.sign(v)
    rate = v / displacement * (1 - direction * z)
    return rate, direction + (z - direction) * np.exp(-abs(v) * dt / displacement)


def velocity_with_dry_friction(M_inverse: Array, v_free: Array, max_impulse: Array, v_before: Array) -> Array:
    """Velocity after a step with dry friction, shape (m,).

    Parameters
    ----------
    M_inverse
        Inverse of the mass matrix, shape (m, m).
    v_free
        Velocity after the step without dry friction.
    max_impulse
        Largest impulse of the friction on each coordinate.
    v_before
        Velocity before the step.
    """
    impulse = max_impulse * np.sign(v_before)
    v = v_free - M_inverse @ impulse
    if ((v * v_before > 0) | (max_impulse == 0)).all():
        return np.asarray(v)  # nothing stops or reverses
    v_of_sets = _velocity_by_active_sets(M_inverse, v_free, max_impulse, v_before)
    return velocity_by_sweeps(M_inverse, v_free, max_impulse, v_before) if v_of_sets is None else v_of_sets


def _velocity_by_active_sets(M_inverse: Array, v_free: Array, max_impulse: Array, v_before: Array) -> Array | None:
    """Velocity with those coordinates at rest that friction can hold; None if the choice of these does not settle.

    Sliding coordinates that would reverse are held, and held ones that need more than the largest impulse slide.
    """
    has_friction = max_impulse > 0
    direction = np.where(has_friction, np.sign(v_before), 0.0)
    for _ in range(_MAX_SETS):
        impulse = max_impulse * direction
        v = v_free - M_inverse @ impulse
        held = np.flatnonzero(has_friction & (direction == 0))
        impulse[held] = np.linalg.solve(M_inverse[np.ix_(held, held)], v[held])
        v -= M_inverse[:, held] @ impulse[held]
        v[held] = 0.0
        reverses = v * direction < 0
        slides = np.abs(impulse) > max_impulse
        slides[direction != 0] = False
        if not (reverses | slides).any():
            return np.asarray(v)
        direction[reverses] = 0.0
        direction[slides] = np.sign(impulse[slides])
    return None


def velocity_by_sweeps(M_inverse: Array, v_free: Array, max_impulse: Array, v_before: Array) -> Array:
    """Velocity by one coordinate's impulse after the other, until none changes."""
    impulse = max_impulse * np.sign(v_before)
    v = v_free - M_inverse @ impulse
    columns = np.ascontiguousarray(M_inverse.T)
    diagonal, limits, impulses = (
        np.diagonal(M_inverse).tolist(),
        max_impulse.tolist(),
        impulse.tolist(),
    )  # fast to index
    with_friction = np.flatnonzero(max_impulse).tolist()
    for _ in range(_MAX_SWEEPS):
        change = 0.0
        for j in with_friction:
            own = min(max(impulses[j] + v.item(j) / diagonal[j], -limits[j]), limits[j])
            if own != impulses[j]:
                change = max(change, abs(own - impulses[j]) * diagonal[j])
                v = v - columns[j] * (own - impulses[j])
                impulses[j] = own
        if change < _CONVERGED:
            break
    v[np.abs(impulses) < max_impulse] = 0.0
    return np.asarray(v)
