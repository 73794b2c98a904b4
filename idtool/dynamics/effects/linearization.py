"""`Linearization`: a model along a motion and how its torque changes, as the effects need it; see `LinearizedModel`."""

from __future__ import annotations

from typing import Protocol

from idtool.common.arrays import Array
from idtool.data.signals import Motion


class Linearization(Protocol):
    """A model with its coefficients along a motion."""

    @property
    def measured_motion(self) -> Motion:
        """The motion that the sensors gave."""

    @property
    def true_motion(self) -> Motion:
        """The motion as the effects correct it."""

    @property
    def residual(self) -> Array:
        """Measured torque less the model's, unfiltered, shape (nv, N) [N·m or N]."""

    @property
    def contact_forces(self) -> Array:
        """Components of the unknown contact forces, shape (k, N) [N or N·m]."""

    @property
    def contact_torque(self) -> Array:
        """Generalized force of the unknown contact forces, shape (nv, N) [N·m or N]."""

    @property
    def predicted_torque(self) -> Array:
        """Torque that the model predicts, shape (nv, N) [N·m or N]."""

    def torque_change_by_motion(self, joint: int, dq: Array, dv: Array, da: Array) -> Array:
        """First-order change of the torque where a joint's link moves by dq, dv and da, shape (N,) each.

        Returns
        -------
        Shape (nv, N) [N·m or N].
        """

    def torque_change_by_gravity(self, change: Array) -> Array:
        """Change of the torque with a change of gravity [m/s²], shape (3,); shape (nv, N) [N·m or N]."""

    def torque_change_by_ball_radius(self) -> Array:
        """Change of the torque per change of the radius of all balls of the contacts [m], shape (nv, N)."""

    def link_load(self, motion: Motion, joint: int) -> tuple[Array, Array]:
        """Torque and inertia of what a joint's link carries, without the rotors; shape (N,) each."""

    def friction_torque(self, joint: int) -> Array:
        """Friction torque of a joint, shape (N,) [N·m or N]."""

    def dry_friction(self, joint: int) -> tuple[Array, Array]:
        """Torque of a joint's dry friction, and its level, which it has in motion; shape (N,) each [N·m or N]."""

    def added_rotor_inertia(self, joint: int) -> float:
        """Inertia of a joint's rotors that are not bodies [kg·m² or kg]."""
