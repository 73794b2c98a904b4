"""Reflected inertia of a rotor that the model lacks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.init_trial import InitTrial
from idtool.dynamics.effects.joint_term import JointTerm
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.kinematics import body_jacobians, body_motions, cross
from idtool.robot.model import RobotModel


class RotorInertia(JointTerm):
    """I_a a: a rotor's inertia about its axis times its gear ratio squared.

    With the inverse of the gear ratio, which may be left out, the rotor also reacts on the link that carries it. A
    rotor on the axis u of a joint, carried by a link that turns with ω, has the angular momentum I_a / n² (n v + u · ω)
    about u. The part u · ω is the carrier's own; the others give I_a (a + u · dω/dt / n) on the joint and
    (I_a / n) (a u + v ω × u) on the carrier.
    """

    id = "rotor_inertia"
    description = "a rotor is missing from the model"
    excitation_hint = "quick motion of the joint in several postures"
    cause = "acceleration"
    coefficient_name = "inertia"
    is_commonplace = True
    is_rotor_inertia = True
    init_trial = InitTrial(
        name="rotor inertia",
        heading="rotor inertia",
        comment="reflected rotor inertia {value} (inertia of the rotor × gear ratio²)",
    )
    units = ("kg·m²", "kg")
    nonlinear_parameters = (NonlinearParameter("inverse_gear_ratio", optional_maximum=1.0),)

    def __init__(
        self, model: RobotModel, joint: int, prior: float = 0.0, nonlinear_values: Mapping[str, float] | None = None
    ) -> None:
        super().__init__(model, joint, prior, nonlinear_values)
        self._model = model
        urdf_joint = model.joints[joint]
        carrier = model.frames.get(urdf_joint.parent)
        self._carrier = -1 if carrier is None else carrier.body
        self._reacts = self._carrier >= 0 and bool(self.nonlinear_values["inverse_gear_ratio"])
        if carrier is not None and self._reacts:
            self._axis = carrier.R @ urdf_joint.R @ urdf_joint.axis  # in the carrier's frame
            rows = model.support()[self._carrier] | (np.arange(len(model.joints)) == joint)
            self.active = tuple(np.arange(int(is_active)) for is_active in rows)

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        is_revolute = summary.model.joints[joint].kind != "prismatic"
        may_react_on_base = summary.model.has_floating_base and is_revolute
        yield {"inverse_gear_ratio": 0.0} if may_react_on_base else {}

    @override
    def columns(self, motion: Motion, out: Sequence[Array]) -> None:
        own_row = out[int(self.joint)][0]
        if not self._reacts:
            own_row[:] = self.column(motion)
            return
        for row in out:
            row[:] = 0.0
        self._add_reaction(motion, out)
        own_row += self.column(motion)

    def _add_reaction(self, motion: Motion, out: Sequence[Array]) -> None:
        """Add the torques that couple the rotor and its carrier, per unit of the reflected inertia."""
        motions = body_motions(self._model, motion.q, motion.v, motion.a)
        jacobian = body_jacobians(self._model, motions)[self._carrier]
        carrier = motions[self._carrier]
        inverse_ratio = float(self.nonlinear_values["inverse_gear_ratio"])
        axis = self._axis[:, None]
        count = len(motion.t)
        gyroscopic = motion.v[int(self.joint)] * cross(carrier.w, axis)
        moment = self.column(motion) * axis + gyroscopic  # on the carrier
        S_w = np.broadcast_to(jacobian.S_w, (*jacobian.S_w.shape[:2], count))
        rows = np.einsum("ikn,in->kn", S_w, moment)
        for coordinate, row in zip(jacobian.coordinates, rows, strict=True):
            out[coordinate][0] += inverse_ratio * row
        alpha = np.broadcast_to(carrier.alpha, (3, count))
        out[int(self.joint)][0] += inverse_ratio * (self._axis @ alpha)

    @override
    def column(self, motion: Motion) -> Array:
        """Acceleration of the motor, with which the rotor turns, shape (N,)."""
        joint = int(self.joint)
        acceleration = motion.a[joint]
        if joint in motion.motor_minus_link:
            acceleration = acceleration + motion.motor_minus_link[joint][2]
        return np.asarray(acceleration)

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.armature[int(self.joint)] += theta[0]
