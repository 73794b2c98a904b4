"""Rotors as simulators have them: inertia on joints, and dead weight in the link that carries the motor.

A rotor of inertia I about its axis turns at s + w: s = ratios · v against its stator, w with the link that carries it.
Its energy ½ I (s + w)² makes a coupling of the joint with the carrier's own rotation, I s w, a gear ratio smaller than
the reflected inertia ½ I s². Where the axes stand so that w, like s, is a constant combination of joint velocities,
the whole is a constant part of the mass matrix, I c cᵀ with c v = s + w; else that holds for s alone.

Letters: nv joints, pi inertia parameters (10,), v joint velocities (nv,).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.reporting.export.base import Part
from idtool.reporting.export.identified import IdentifiedModel
from idtool.reporting.export.inertia_check import unrealizable_error
from idtool.robot.body import Body
from idtool.robot.inertia import parameter_transform, symmetric_entries, symmetric_matrix
from idtool.robot.kinematics import body_jacobians, body_motions

_POSES = 256  # in which w is looked at; a function of the pose that is the same in all of them is constant
_MAX_VARIATION = (
    1e-3  # of w per unit of joint velocity, in all poses: angles written as 1.571 are meant to be right ones
)
_ROUNDING = 1e-9  # relative
_MIN_VALUE = 1e-12  # kg, kg·m²


@dataclass(frozen=True, eq=False)
class Rotor:
    """A rotor, averaged over its own angle.

    Attributes
    ----------
    body
        How it is mounted and driven.
    own_pi
        Its parameters in its own frame, shape (10,).
    inertia
        About its axis [kg·m²].
    carrier
        w = carrier · v where that does not depend on the pose, shape (nv,); None where it does.
    largest_carrier_ratio
        The largest coefficient of w found in any pose.
    pi
        Parameters in the frame of the body that carries it, shape (10,).
    without_spin
        The same without the inertia about its axis: a rod's.
    unbalance
        Left out by averaging: first moment across the axis [kg·m], and the largest change of the inertia [kg·m²].
    """

    body: Body
    own_pi: Array
    inertia: float
    carrier: Array | None
    largest_carrier_ratio: float
    pi: Array
    without_spin: Array
    unbalance: tuple[float, float]

    @property
    def ratios(self) -> Array:
        """Rotor angle per joint angle, shape (nv,)."""
        return self.body.ratios

    @property
    def largest_ratio(self) -> float:
        """Rotor angle per joint angle, of the joint that moves it most."""
        return float(np.abs(self.ratios).max())

    def part(self, detail: str, value: float, unit: str = "kg·m²") -> Part:
        """A part of the export for this rotor."""
        return Part("rotor", self.body.name, detail, value, unit)

    def coupling(self) -> Part:
        """The part for a coupling with the carrier's rotation that is left out."""
        size = self.inertia * self.largest_ratio * self.largest_carrier_ratio
        return self.part("the coupling with the rotation of its carrier in the mass matrix", size)

    def imbalance(self, gravity: Array) -> list[Part]:
        """Parts for what averaging leaves out, if it is more than rounding."""
        mass = max(self.pi[0], _MIN_VALUE)
        size = max(float(np.trace(symmetric_matrix(self.pi[4:]))), _MIN_VALUE)
        moment, change = self.unbalance
        torque = moment * self.largest_ratio * float(np.linalg.norm(gravity))
        parts = []
        if moment > _ROUNDING * np.sqrt(mass * size):
            parts.append(self.part("its unbalance, as gravity torque at the joint", torque, "N·m"))
        if change > _ROUNDING * size:
            parts.append(self.part("the part of its inertia that changes with its angle", change))
        return parts


def averaged_rotors(identified: IdentifiedModel) -> tuple[Rotor, ...]:
    """The model's rotors.

    Raises
    ------
    ModelError
        If one has a negative inertia about its axis.
    """
    model = identified.model
    if all(body.kind == "link" for body in model.bodies):
        return ()
    q = np.random.default_rng(0).uniform(-3, 3, (len(model.joints), _POSES))
    motions = body_motions(model, q, np.zeros_like(q), np.zeros_like(q))
    jacobians = body_jacobians(model, motions)
    rotors = []
    for body, pi, jacobian in zip(model.bodies, identified.pi, jacobians, strict=True):
        if body.kind == "rotor":
            if body.axis @ symmetric_matrix(pi[4:]) @ body.axis < 0:
                raise unrealizable_error(identified.robot, f"rotor {body.name}")
            turning = np.zeros((len(q), _POSES))
            turning[jacobian.coordinates] = np.tensordot(body.axis, jacobian.S_w, axes=1)
            for sensor in range(len(model.wrench_sensors)):
                turning[model.sensor_coordinates(sensor)] = 0.0  # at which nothing moves
            rotor = _average_rotor(body, pi, turning - body.ratios[:, None])
            if model.has_floating_base:  # which turns every carrier, and has no coordinate that a tendon could name
                rotor = replace(rotor, carrier=None)
            rotors.append(rotor)
    return tuple(rotors)


def _average_rotor(body: Body, pi: Array, w: Array) -> Rotor:
    """A rotor from its parameters in its own frame and the coefficients of w in some poses, shape (nv, poses)."""
    a = body.axis
    h, inertia = pi[1:4], symmetric_matrix(pi[4:])
    axial = float(a @ inertia @ a)
    across = 0.5 * (np.trace(inertia) - axial)
    along = np.outer(a, a)
    mean = _pi(pi[0], a * (a @ h), axial * along + across * (np.eye(3) - along))
    spun = _pi(0.0, np.zeros(3), axial * along)
    constant = w.mean(axis=1)
    constant[np.abs(constant) < _MAX_VARIATION] = 0.0
    is_constant = np.abs(w - constant[:, None]).max() < _MAX_VARIATION
    to_carrier = parameter_transform(body.mount.R, body.mount.p)
    return Rotor(
        body=body,
        own_pi=pi,
        inertia=axial,
        carrier=constant if is_constant else None,
        largest_carrier_ratio=float(np.abs(w).max()),
        pi=to_carrier @ mean,
        without_spin=to_carrier @ (mean - spun),
        unbalance=(
            float(np.linalg.norm(h - a * (a @ h))),
            float(np.abs(np.linalg.eigvalsh(inertia - symmetric_matrix(mean[4:]))).max()),
        ),
    )


def _pi(mass: float, h: Array, inertia: Array) -> Array:
    """Parameters from mass, first moment and inertia about the origin, shape (10,)."""
    return np.concatenate([[mass], h, symmetric_entries(inertia)])
