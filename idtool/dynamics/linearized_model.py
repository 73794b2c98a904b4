"""`LinearizedModel`: a torque equation with its coefficients along a motion, and how its torque changes with it.

The partial derivatives of the rigid bodies' torque vary no faster than the motion, so that they are evaluated at some
samples and interpolated linearly.

Shapes: nv joints, N samples. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Protocol

import numpy as np

from idtool.common.arrays import Array
from idtool.data.column_cache import KeptColumns
from idtool.data.signals import Batch, Motion
from idtool.dynamics.contact_model import ContactModel
from idtool.dynamics.effects import Coefficient, Effect, NamedEffect, RigidBodies
from idtool.dynamics.effects.joint_term import DryFriction
from idtool.dynamics.effects.linearization import Linearization
from idtool.robot.inertia import PI_SIZE

_RATE = 150.0  # Hz, of the samples at which derivatives are evaluated
_STEP = 1e-5  # rad, rad/s: of a finite difference
_MAX_ROTOR_CHANGE = 0.1  # of a rotor's inertia by its prior: data sheets are no worse
_ACCELERATION_STEP = 1.0  # rad/s²: the torque is linear in a


class TorqueEquation(Protocol):
    """A torque equation; see `LinearModel`."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The terms."""

    @property
    def contacts(self) -> ContactModel | None:
        """Contacts; None: the base is fixed, and there are none."""

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """The unknowns."""

    def effect_slices(self) -> Iterator[tuple[Effect, slice]]:
        """Each term with the range of its coefficients among the unknowns."""

    def true_motion(self, motion: Motion) -> Motion:
        """Motion as the effects correct it."""

    def residual(self, motion: Motion, theta: Array) -> Array:
        """Torque less columns · theta, unfiltered, shape (nv, N)."""

    def torque_left_for_bodies(self, true_motion: Motion, theta: Array) -> Array:
        """Measured torque less that of all effects but the rigid bodies, unfiltered, shape (nv, N)."""

    def undefined_shares(self, batch: Batch) -> tuple[Array, Array]:
        """Shares of each filtered sample's weight that come from samples where a column is undefined."""


class LinearizedModel:
    """A torque equation with its coefficients along a motion; see `Linearization`.

    Attributes
    ----------
    measured_motion, true_motion
        As the sensors gave it, and as the effects correct it.

    Parameters
    ----------
    equation
        The torque equation.
    theta
        Its coefficients, shape (p,).
    motion
        As measured.
    with_contacts_of
        Model whose unknown contact forces act here too; None: those that explain most of the residual.
    """

    def __init__(
        self, equation: TorqueEquation, theta: Array, motion: Motion, with_contacts_of: Linearization | None = None
    ) -> None:
        self.equation = equation
        self.theta = theta
        self.measured_motion = motion
        self.true_motion = equation.true_motion(motion)
        self._with_contacts_of = with_contacts_of
        self._stride = max(1, int(1 / (_RATE * motion.dt)))
        self._friction_torques: dict[int, Array] = {}
        self._derivatives: dict[tuple[str, int], Array] = {}

    @cached_property
    def residual(self) -> Array:
        """Measured torque less the model's, both as the equation has them, unfiltered; shape (nv, N).

        The torque of unknown contact forces is the model's.
        """
        if self.equation.contacts is None:
            return self._residual_without_contacts
        return self._residual_without_contacts + self.contact_torque

    @property
    def contact_forces(self) -> Array:
        """Components of the unknown contact forces, shape (k, N) [N or N·m]; k is 0 without any."""
        forces, _ = self._contacts
        return forces

    @property
    def contact_torque(self) -> Array:
        """Generalized force of the unknown contact forces, shape (nv, N) [N·m or N]."""
        _, torque = self._contacts
        return torque

    @cached_property
    def _contacts(self) -> tuple[Array, Array]:
        """Unknown contact forces, and their generalized force."""
        contacts = self.equation.contacts
        motion = self.true_motion
        if contacts is None:
            return np.zeros((0, len(motion.t))), np.zeros_like(motion.q)
        given = self._with_contacts_of
        if given is not None and motion.q is given.true_motion.q and motion.contacts is given.true_motion.contacts:
            return given.contact_forces, given.contact_torque
        directions = contacts.unknown_directions(motion)
        if given is not None:
            forces = given.contact_forces
        else:
            forces = contacts.unknown_forces(directions, self._residual_without_contacts)
        return forces, np.einsum("kin,kn->in", directions, forces)

    @cached_property
    def _residual_without_contacts(self) -> Array:
        """Measured torque less the model's, but for the unknown contact forces, shape (nv, N)."""
        return self.equation.residual(self.measured_motion, self.theta)

    @cached_property
    def predicted_torque(self) -> Array:
        """Torque that the model predicts, shape (nv, N)."""
        return self.true_motion.tau - self.residual

    def torque_change_by_motion(self, joint: int, dq: Array, dv: Array, da: Array) -> Array:
        """First-order change of the torque where a joint's link, without its rotors, moves by dq, dv and da."""
        rotor_torque = np.outer(self._rotor_inertia[joint], da)  # rotors stay with the motor
        return self._rigid_body_torque_change(joint, dq, dv, da) - rotor_torque

    def _rigid_body_torque_change(self, joint: int, dq: Array, dv: Array, da: Array) -> Array:
        """First-order change of the torque of bodies and contacts where a joint moves by dq, dv and da, (nv, N)."""
        change = np.zeros_like(self.true_motion.q)
        for name, displacement in zip("qva", (dq, dv, da), strict=True):
            if displacement.any():
                change += self._derivative(name, joint) * displacement
        return change

    def residual_change_by_noise(self, noise: Array) -> Array:
        """Change of the residual with noise in the measured torque, shape (nv, N).

        The motion changes so little with it that the rigid bodies' torque is taken to first order.

        Parameters
        ----------
        noise
            Noise of each joint's torque, shape (nv, N) [N·m or N].
        """
        measured = self.measured_motion
        noisy_measured = replace(measured, tau=measured.tau + noise, kept_columns=None)  # needed only once
        noisy = self.equation.true_motion(noisy_measured)
        true = self.true_motion
        change = self.equation.torque_left_for_bodies(noisy, self.theta) - self._torque_left_for_bodies
        for joint in range(len(true.q)):
            dq, dv, da = (getattr(noisy, name)[joint] - getattr(true, name)[joint] for name in "qva")
            change -= self._rigid_body_torque_change(joint, dq, dv, da)
        return change

    def torque_change_by_gravity(self, change: Array) -> Array:
        """Change of the torque with a change of gravity [m/s²], shape (3,); shape (nv, N)."""
        model = self._bodies.model
        changed = RigidBodies(replace(model, gravity=model.gravity + change))
        samples = self._some_samples
        difference = self._rigid_body_torque(samples, changed) - self._torque_at_some_samples
        return self._at_all_samples(difference)

    def torque_change_by_ball_radius(self) -> Array:
        """Change of the torque per change of the radius of all balls [m], shape (nv, N); it is linear in the radius."""
        samples = self._some_samples
        if samples.contacts is None:
            return np.zeros_like(self.true_motion.q)
        larger = replace(samples.contacts, radius_change=samples.contacts.radius_change + 1.0)
        of_larger = self._contact_torque(replace(samples, contacts=larger))
        return -self._at_all_samples(of_larger - self._contact_torque_at_some_samples)

    @cached_property
    def _torque_left_for_bodies(self) -> Array:
        """Measured torque less that of all effects but the rigid bodies, shape (nv, N)."""
        return self.equation.torque_left_for_bodies(self.true_motion, self.theta)

    def link_load(self, motion: Motion, joint: int) -> tuple[Array, Array]:
        """Torque and inertia of what a joint's link carries, without the rotors; shape (N,) each."""
        rotor_torque = self._rotor_inertia[joint] @ self.true_motion.a
        rotor_torque = rotor_torque + self.added_rotor_inertia(joint) * motion.a[joint]
        inertia = self._derivative("a", joint)[joint] - self._rotor_inertia[joint, joint]
        return self.predicted_torque[joint] - rotor_torque, inertia

    def friction_torque(self, joint: int) -> Array:
        """Friction torque of a joint, shape (N,)."""
        if joint not in self._friction_torques:
            total = np.zeros(len(self.true_motion.t))
            for effect, theta in self._frictions_of(joint):
                total += theta @ kept_effect_columns(effect, self.true_motion)[joint]
            self._friction_torques[joint] = total
        return self._friction_torques[joint]

    def dry_friction(self, joint: int) -> tuple[Array, Array]:
        """Torque of a joint's dry friction, and its level, which it has in motion; shape (N,) each."""
        torque = np.zeros(len(self.true_motion.t))
        level = np.zeros(len(self.true_motion.t))
        for effect, theta in self._frictions_of(joint):
            if isinstance(effect, DryFriction):
                torque += theta @ kept_effect_columns(effect, self.true_motion)[joint]
                level += theta[0] * effect.level(self.true_motion)
        return torque, np.maximum(level, 0.0)

    def friction_level(self, joint: int) -> Array:
        """Largest friction torque of a joint at each sample, whatever its direction, shape (N,)."""
        level = np.zeros(len(self.true_motion.t))
        for effect, theta in self._frictions_of(joint):
            if isinstance(effect, DryFriction):
                level += np.abs(theta[0] * effect.level(self.true_motion))
            else:
                level += np.abs(theta @ kept_effect_columns(effect, self.true_motion)[joint])
        return level

    def added_rotor_inertia(self, joint: int) -> float:
        """Inertia of a joint's rotors that are not bodies."""
        inertia = 0.0
        for effect, part in self.equation.effect_slices():
            theta = self.theta[part]
            if isinstance(effect, NamedEffect) and effect.is_rotor_inertia:
                inertia += float(theta[effect.active[joint]].sum())
        return inertia

    def _frictions_of(self, joint: int) -> Iterator[tuple[Effect, Array]]:
        """Effects of a joint's friction, each with the coefficients that act on the joint."""
        for effect, part in self.equation.effect_slices():
            active = effect.active[joint]
            if isinstance(effect, NamedEffect) and effect.is_friction and len(active):
                yield effect, self.theta[part][active]

    @cached_property
    def _bodies(self) -> RigidBodies:
        return next(effect for effect in self.equation.effects if isinstance(effect, RigidBodies))

    @cached_property
    def _rotor_inertia(self) -> Array:
        """Torque that the rotors' spin takes on each joint per acceleration of each, shape (nv, nv).

        On the first joints of a chain, motion does not tell a rotor's inertia from that of the link that it turns. An
        identified one that is far from its prior is taken for such a case, and the prior is used.
        """
        bodies = self._bodies.model.bodies
        identified = self.theta[: PI_SIZE * len(bodies)].reshape(-1, PI_SIZE)
        nv = len(self.equation.joints)
        inertia = np.zeros((nv, nv))
        for body, pi in zip(bodies, identified, strict=True):
            if body.kind == "rotor":
                prior = body.axial_inertia(body.pi)
                axial = body.axial_inertia(pi)
                is_near = abs(axial - prior) < _MAX_ROTOR_CHANGE * prior
                inertia += (axial if is_near else prior) * np.outer(body.ratios, body.ratios)
        return inertia

    @cached_property
    def _some_samples(self) -> Motion:
        """The true motion at the n samples at which derivatives are evaluated."""
        m = self.true_motion
        stride = self._stride
        return replace(
            m,
            t=m.t[::stride],
            q=m.q[:, ::stride],
            v=m.v[:, ::stride],
            a=m.a[:, ::stride],
            tau=m.tau[:, ::stride],
            logged_tau=m.logged_tau[:, ::stride],
            dt=m.dt * stride,
            contacts=None if m.contacts is None else m.contacts.every(stride),
        )

    def _at_all_samples(self, rows: Array) -> Array:
        """Linear interpolation of rows, shape (k, n), at all samples, shape (k, N)."""
        t = self._some_samples.t
        return np.stack([np.interp(self.true_motion.t, t, row) for row in rows])

    def _rigid_body_torque(self, motion: Motion, bodies: RigidBodies) -> Array:
        """Torque of the rigid bodies, shape (nv, N)."""
        theta = self.theta[: len(bodies.coefficients)]  # the bodies' coefficients come first
        return bodies.torque(theta, motion)

    def _derivative(self, name: str, joint: int) -> Array:
        """Derivative of all joints' torque of bodies and contacts by q, v or a of one joint, shape (nv, N)."""
        key = name, joint
        if key not in self._derivatives:
            self._derivatives[key] = self._at_all_samples(self._finite_difference(name, joint))
        return self._derivatives[key]

    def _finite_difference(self, name: str, joint: int) -> Array:
        """Derivative by q, v or a of one joint at some samples, shape (nv, n)."""
        stepped = getattr(self._some_samples, name).copy()
        step = _ACCELERATION_STEP if name == "a" else _STEP
        stepped[joint] += step
        stepped_motion = replace(self._some_samples, **{name: stepped})
        difference = self._rigid_body_torque(stepped_motion, self._bodies) - self._torque_at_some_samples
        if name == "q":
            difference -= self._contact_torque(stepped_motion) - self._contact_torque_at_some_samples
        return np.asarray(difference / step)

    def _contact_torque(self, motion: Motion) -> Array:
        """Generalized force of the contacts at some samples, which depends on the position alone, shape (nv, n)."""
        contacts = self.equation.contacts
        if contacts is None:
            return np.zeros_like(motion.q)
        forces = self.contact_forces[:, :: self._stride]
        of_unknown = np.einsum("kin,kn->in", contacts.unknown_directions(motion), forces)
        return np.asarray(contacts.measured_force(motion) + of_unknown)

    @cached_property
    def _contact_torque_at_some_samples(self) -> Array:
        """Generalized force of the contacts at some samples, shape (nv, n)."""
        return self._contact_torque(self._some_samples)

    @cached_property
    def _torque_at_some_samples(self) -> Array:
        """Torque of the rigid bodies at some samples, shape (nv, n)."""
        return self._rigid_body_torque(self._some_samples, self._bodies)


def effect_columns(effect: Effect, motion: Motion) -> list[Array]:
    """Columns of an effect along a true motion of N samples, by joint, shape (coefficients of the joint, N)."""
    columns = effect.empty_columns(len(motion.t))
    effect.columns(motion, columns)
    return columns


def kept_effect_columns(effect: Effect, motion: Motion) -> Sequence[Array]:
    """`effect_columns`, which must not be changed: they are kept for other models."""
    kept = kept_columns_of(effect, motion)
    evaluate = partial(effect_columns, effect, motion)
    return evaluate() if kept is None else kept.get(("unfiltered", effect.column_key), evaluate)


def kept_columns_of(effect: Effect, motion: Motion) -> KeptColumns | None:
    """Store for columns of an effect along a motion; None if they depend on more than its q, v and a."""
    kept = motion.kept_columns
    if kept is None or effect.column_key is None or not kept.are_along(motion.q, motion.v, motion.a):
        return None
    return kept
