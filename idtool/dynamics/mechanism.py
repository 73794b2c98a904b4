"""`Mechanism`: what the effects of a model add up to when it is run forwards.

M(q) dv/dt = tau − h(q, v) − resisting(t, q, v) − s level(t, q, v): the dry friction's direction s is sign(v) where a
joint slides, and whatever in [−1, 1] holds it where it rests.

Shapes: nv joints, W rollouts that advance together. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.data.signals import Motion
from idtool.robot.inertia import SIZE
from idtool.robot.model import Model

Evaluated = Callable[[Motion], Array]


class Term(Protocol):
    """One coefficient times a function of the motion, on one joint; with an array of joints, on each of them."""

    joint: int | Indices
    shape: dict[str, Any]
    friction: bool


class Loop(Protocol):
    """Hysteresis: torque by a state in [−1, 1] that depends on the path of one joint; or of several."""

    joint: int | Indices
    shape: dict[str, Any]
    friction: bool

    def torque(self, state: Array, v: Array) -> Array:
        """By the state and the joints' velocities, shape (k, W) each, per unit of the coefficient."""
        ...

    def after(self, state: Array, way: Array) -> Array:
        """The state when the joints have gone a way [rad or m] since it was ``state``, shape (k, W) each."""
        ...


@dataclass(frozen=True)
class Gear:
    """Between a joint's motor side, where it is measured and driven and its rotors turn, and its link side.

    Attributes
    ----------
    stiffness
        Torque per deflection [N·m/rad or N/m]; infinite: as good as rigid, motor and link would swing on it at 200 Hz.
    damping
        As a ratio of what is critical for the motor's side; on a rigid gear, for motor and link against each other.
    play
        Deflection that takes no torque, from one end to the other [rad or m].
    rubbing
        Share of the joint's friction that acts on the motor's side.
    """

    stiffness: float
    damping: float
    play: float = 0.0
    rubbing: float = 0.0


@dataclass(frozen=True)
class TorqueSensor:
    """What a joint's torque sensor makes of the true torque, and back; elementwise."""

    measured: Callable[[Array], Array]
    true: Callable[[Array], Array]


_Any = TypeVar("_Any", Term, Loop)


@dataclass
class Mechanism:
    """What effects contribute to; each adds to the part that is its own.

    Attributes
    ----------
    model
        The tree of bodies.
    pi
        Inertia parameters of its bodies, shape (bodies, 10).
    armature
        Inertia on the joints beside them, shape (nv,) [kg·m² or kg].
    smooth
        Terms whose torque is a smooth function of the state, with their coefficients.
    dry
        Terms whose torque is a level times the direction of motion, with their coefficients.
    loops
        Terms whose torque depends on the path, with their coefficients.
    torques
        Torque on the load's side as a function of the motion, shape (nv, W), that no joint term gives.
    stops
        Joint and position where a torque begins or ends, which a step should not straddle.
    gravity
        In the root link's frame, shape (3,) [m/s²].
    gears
        Of joints whose motor and link can move apart.
    sensors
        Of joints whose measured torque is not the true one.
    torque_late
        By how much measured torque comes after the position, shape (nv,) [s].
    position_offset
        True less measured position, shape (nv,) [rad or m].
    """

    model: Model
    pi: Array = field(init=False)
    armature: Array = field(init=False)
    smooth: list[tuple[Term, float]] = field(default_factory=list)
    dry: list[tuple[Term, float]] = field(default_factory=list)
    loops: list[tuple[Loop, float]] = field(default_factory=list)
    torques: list[Evaluated] = field(default_factory=list)
    stops: list[tuple[int, float]] = field(default_factory=list)
    gravity: Array = field(init=False)
    gears: dict[int, Gear] = field(default_factory=dict)
    sensors: dict[int, TorqueSensor] = field(default_factory=dict)
    torque_late: Array = field(init=False)
    position_offset: Array = field(init=False)

    def __post_init__(self) -> None:
        self.pi = np.zeros((len(self.model.bodies), SIZE))
        self.armature, self.torque_late, self.position_offset = np.zeros((3, len(self.model.joints)))
        self.gravity = self.model.gravity

    def sides(self) -> tuple[Mechanism, Mechanism]:
        """What acts on the links' side of gears that give way, and the friction that acts on the motors'."""
        link, motor = copy.copy(self), Mechanism(self.model)
        link.smooth, motor.smooth = self._shared(self.smooth)
        link.dry, motor.dry = self._shared(self.dry)
        link.loops, motor.loops = self._shared(self.loops)
        return link, motor

    def _shared(self, terms: Sequence[tuple[_Any, float]]) -> tuple[list[tuple[_Any, float]], list[tuple[_Any, float]]]:
        shares = [self.gears[int(x.joint)].rubbing if x.friction and x.joint in self.gears else 0.0 for x, _ in terms]
        return (
            [(term, (1 - share) * c) for (term, c), share in zip(terms, shares, strict=True)],
            [(term, share * c) for (term, c), share in zip(terms, shares, strict=True) if share],
        )

    @property
    def rubbing(self) -> Mask:
        """Which joints have dry friction, shape (nv,)."""
        rubbing = np.zeros(len(self.model.joints), dtype=bool)
        for term, coefficient in self.dry:
            rubbing[term.joint] |= coefficient != 0
        return rubbing

    def resisting(self) -> Evaluated:
        """The smooth terms' torque, shape (nv, W), as a function of the motion."""
        terms = _sum(self.smooth, len(self.model.joints), "column")
        if not self.torques:
            return terms
        return lambda motion: np.sum([torque(motion) for torque in (terms, *self.torques)], axis=0)

    def level(self) -> Evaluated:
        """The dry terms' level, at least 0, shape (nv, W), as a function of the motion."""
        total = _sum(self.dry, len(self.model.joints), "level")
        return lambda motion: np.maximum(total(motion), 0.0)

    def hysteresis(self) -> list[tuple[Loop, Indices, Array]]:
        """The terms that depend on the path, those of one kind together: term, k joints, coefficients (k, 1)."""
        return _gathered(self.loops)


def _gathered(terms: Sequence[tuple[_Any, float]]) -> list[tuple[_Any, Indices, Array]]:
    """Terms of one kind as one term on several joints, each once, the joints, and the coefficients as a column."""
    groups: dict[tuple[type, int], list[tuple[_Any, float]]] = {}
    for term, coefficient in sorted((pair for pair in terms if pair[1]), key=lambda pair: int(pair[0].joint)):
        again = sum(other.joint == term.joint and type(other) is type(term) for g in groups.values() for other, _ in g)
        groups.setdefault((type(term), again), []).append((term, coefficient))
    gathered = []
    for group in groups.values():
        one = copy.copy(group[0][0])
        one.joint = joints = np.array([term.joint for term, _ in group])
        one.shape = {name: np.array([[term.shape[name]] for term, _ in group]) for name in one.shape}
        gathered.append((one, joints, np.array([[coefficient] for _, coefficient in group])))
    return gathered


def _sum(terms: Sequence[tuple[Term, float]], joints: int, method: str) -> Evaluated:
    """The sum of terms by joint."""
    parts = [(getattr(term, method), indices, factors) for term, indices, factors in _gathered(terms)]

    def evaluate(motion: Motion) -> Array:
        out = np.zeros((joints, len(motion.t)))
        for function, indices, factors in parts:
            if len(indices) == joints:
                out += factors * function(motion)
            else:
                out[indices] += factors * function(motion)
        return out

    return evaluate
