"""`Mechanism`: the sum of a model's effects as a forward model.

M(q) dv/dt = tau − smooth_torque(t, q, v) − h(q, v) − s friction_level(t, q, v): the direction s of the dry friction is
sign(v) where a joint slides, and the value in [−1, 1] that holds it where it rests.

Shapes: nv joints, W rollouts that advance together. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import field
from typing import Any, Protocol, TypeVar

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.data.signals import Motion
from idtool.robot.inertia import PI_SIZE
from idtool.robot.model import RobotModel

TorqueFunction = Callable[[Motion], Array]


class TorqueTerm(Protocol):
    """One coefficient times a function of the motion, on one joint; with an array of joints, on each of them."""

    joint: int | Indices
    nonlinear_values: dict[str, Any]
    is_friction: bool


class HysteresisTerm(Protocol):
    """Torque by a state in [−1, 1] that depends on the path of one joint, or of several."""

    joint: int | Indices
    nonlinear_values: dict[str, Any]
    is_friction: bool

    def torque(self, state: Array, v: Array) -> Array:
        """Torque per unit of the coefficient, from the state and the velocity, shape (k, W) each."""
        ...

    def next_state(self, state: Array, path: Array) -> Array:
        """State after the joints have moved by a path [rad or m] in one direction, shape (k, W) each."""
        ...


@dataclass(frozen=True)
class Transmission:
    """A compliant transmission: a joint is measured and driven on its motor side, and its rotors turn there.

    Attributes
    ----------
    stiffness
        Torque per deflection [N·m/rad or N/m]; infinite: nearly rigid, motor and link would swing on it at 200 Hz.
    damping_ratio
        Share of the critical damping of the motor side; if nearly rigid, of motor and link against each other.
    backlash
        Deflection without torque, from one end to the other [rad or m].
    motor_friction
        Share of the joint's friction that acts on the motor side.
    """

    stiffness: float
    damping_ratio: float
    backlash: float = 0.0
    motor_friction: float = 0.0


@dataclass(frozen=True)
class TorqueSensor:
    """Maps between the true torque of a joint and the measured one; elementwise."""

    to_measured: Callable[[Array], Array]
    to_true: Callable[[Array], Array]


_Term = TypeVar("_Term", TorqueTerm, HysteresisTerm)


@dataclass
class Mechanism:
    """A forward model, to which every effect adds its part.

    Attributes
    ----------
    model
        The tree of bodies.
    pi
        Inertia parameters of its bodies, shape (bodies, 10).
    armature
        Further inertia on the joints, shape (nv,) [kg·m² or kg].
    smooth_terms
        Terms whose torque is a smooth function of the state, with their coefficients.
    dry_friction_terms
        Terms whose torque is a level times the direction of motion, with their coefficients.
    hysteresis_terms
        Terms whose torque depends on the path, with their coefficients.
    extra_torques
        Torque on the link side as functions of the motion, shape (nv, W), besides the terms.
    breakpoints
        Joints and positions at which a torque begins or ends; a step of time should not straddle one.
    gravity
        In the root link's frame, shape (3,) [m/s²].
    transmissions
        By joint, where motor and link can move apart.
    torque_sensors
        By joint, where the measured torque is not the true one.
    torque_delay
        Delay of the measured torque relative to the position, shape (nv,) [s].
    position_offset
        True less measured position, shape (nv,) [rad or m].
    imu_delay
        Delay of the IMU of a floating base relative to the position [s].
    differs_by_log
        True if a torque acts during some logs only.
    """

    model: RobotModel
    pi: Array = field(init=False)
    armature: Array = field(init=False)
    smooth_terms: list[tuple[TorqueTerm, float]] = field(default_factory=list)
    dry_friction_terms: list[tuple[TorqueTerm, float]] = field(default_factory=list)
    hysteresis_terms: list[tuple[HysteresisTerm, float]] = field(default_factory=list)
    extra_torques: list[TorqueFunction] = field(default_factory=list)
    breakpoints: list[tuple[int, float]] = field(default_factory=list)
    gravity: Array = field(init=False)
    transmissions: dict[int, Transmission] = field(default_factory=dict)
    torque_sensors: dict[int, TorqueSensor] = field(default_factory=dict)
    torque_delay: Array = field(init=False)
    position_offset: Array = field(init=False)
    imu_delay: float = 0.0
    differs_by_log: bool = False

    def __post_init__(self) -> None:
        nv = self.model.joint_count
        self.pi = np.zeros((len(self.model.bodies), PI_SIZE))
        self.armature = np.zeros(nv)
        self.torque_delay = np.zeros(nv)
        self.position_offset = np.zeros(nv)
        self.gravity = self.model.gravity

    def link_and_motor_sides(self) -> tuple[Mechanism, Mechanism]:
        """The mechanism on the link side of its transmissions, and the friction on the motor side as another."""
        link = copy.copy(self)
        motor = Mechanism(self.model)
        link.smooth_terms, motor.smooth_terms = self._split_friction(self.smooth_terms)
        link.dry_friction_terms, motor.dry_friction_terms = self._split_friction(self.dry_friction_terms)
        link.hysteresis_terms, motor.hysteresis_terms = self._split_friction(self.hysteresis_terms)
        return link, motor

    def _split_friction(
        self, terms: Sequence[tuple[_Term, float]]
    ) -> tuple[list[tuple[_Term, float]], list[tuple[_Term, float]]]:
        """Terms with the share of their coefficients on the link side, and those with a share on the motor side."""
        link, motor = [], []
        for term, coefficient in terms:
            share = 0.0
            if term.is_friction and term.joint in self.transmissions:
                share = self.transmissions[int(term.joint)].motor_friction
            link.append((term, (1 - share) * coefficient))
            if share:
                motor.append((term, share * coefficient))
        return link, motor

    @property
    def has_dry_friction(self) -> Mask:
        """True for joints with dry friction, shape (nv,)."""
        mask = np.zeros(self.model.joint_count, dtype=bool)
        for term, coefficient in self.dry_friction_terms:
            mask[term.joint] |= coefficient != 0
        return mask

    def smooth_torque(self) -> TorqueFunction:
        """Torque of the smooth terms, shape (nv, W), as a function of the motion."""
        terms = _sum(self.smooth_terms, self.model.joint_count, "column")
        if not self.extra_torques:
            return terms
        functions = (terms, *self.extra_torques)
        return lambda motion: np.sum([function(motion) for function in functions], axis=0)

    def friction_level(self) -> TorqueFunction:
        """Level of the dry friction, at least 0, shape (nv, W), as a function of the motion."""
        total = _sum(self.dry_friction_terms, self.model.joint_count, "level")
        return lambda motion: np.maximum(total(motion), 0.0)

    def grouped_hysteresis_terms(self) -> list[tuple[HysteresisTerm, Indices, Array]]:
        """Hysteresis terms of one kind as one: term, k joints, coefficients (k, 1)."""
        return _grouped(self.hysteresis_terms)


def _grouped(terms: Sequence[tuple[_Term, float]]) -> list[tuple[_Term, Indices, Array]]:
    """Terms of one kind as one term on several different joints, with the joints and a column of coefficients."""
    groups: dict[tuple[type, int], list[tuple[_Term, float]]] = {}
    counts: dict[tuple[type, int], int] = {}  # of terms of a kind on a joint so far
    nonzero = [(term, coefficient) for term, coefficient in terms if coefficient]
    for term, coefficient in sorted(nonzero, key=lambda pair: int(pair[0].joint)):
        kind_on_joint = (type(term), int(term.joint))
        repetition = counts.get(kind_on_joint, 0)
        counts[kind_on_joint] = repetition + 1
        groups.setdefault((type(term), repetition), []).append((term, coefficient))

    grouped = []
    for group in groups.values():
        first_term = group[0][0]
        joints = np.array([term.joint for term, _ in group])
        coefficients = np.array([[coefficient] for _, coefficient in group])
        nonlinear_values = {}
        for name in first_term.nonlinear_values:
            nonlinear_values[name] = np.array([[term.nonlinear_values[name]] for term, _ in group])
        together = copy.copy(first_term)
        together.joint = joints
        together.nonlinear_values = nonlinear_values
        grouped.append((together, joints, coefficients))
    return grouped


def _sum(terms: Sequence[tuple[TorqueTerm, float]], nv: int, method: str) -> TorqueFunction:
    """Sum over terms of a method of theirs times the coefficient, by joint."""
    parts = [(getattr(term, method), joints, coefficients) for term, joints, coefficients in _grouped(terms)]

    def evaluate(motion: Motion) -> Array:
        out = np.zeros((nv, len(motion.t)))
        for function, joints, coefficients in parts:
            if len(joints) == nv:
                out += coefficients * function(motion)
            else:
                out[joints] += coefficients * function(motion)
        return out

    return evaluate
