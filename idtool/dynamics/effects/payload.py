"""A body on a link that the model lacks."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Self

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.common.number_text import number
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.entry_parameters import entry_location, read_number, read_vector
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.link_effect import LinkEffect
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.body import Frame
from idtool.robot.config import EffectEntry
from idtool.robot.inertia import (
    PI_SIZE,
    from_mass_com_inertia,
    from_pseudo_inertia,
    mass_com_inertia,
    parameter_transform,
    pseudo_inertia,
    symmetric_entries,
    symmetric_matrix,
)
from idtool.robot.inverse_dynamics import inverse_dynamics
from idtool.robot.model import RobotModel

_MAX_MASS_ERROR = 0.25  # of the mass: a standard error with which it is still named
_ROUNDING = 1e-9  # of the inertia's size
_MIN_MASS = 1e-9  # kg: less is no payload
_MIN_INFORMATION = 1e-9  # of the largest eigenvalue, that every other is taken to have at least
_START_INERTIA = 1e-3  # m²: inertia over mass at the start of a search
_MAX_START_DISTANCE = 1.0  # m: from the link's frame to the centre of mass at the start of a search
_PARAMETER_COUNT = 4  # mass and centre count; the inertia about it follows within narrow bounds


class Payload(LinkEffect):
    """A body fixed to a link: mass, centre, and inertia about it [ixx, ixy, iyy, ixz, iyz, izz], in the link's frame.

    Some mass density must have these; a point mass, with no inertia, is one. A fit identifies the link without it.

    Parameters
    ----------
    model
        The robot.
    link
        Name of the link.
    frame
        Pose of its frame in the body that carries it.
    pi
        The payload's parameters in the link's frame, shape (10,).
    """

    id = "payload"
    is_countable = True
    description = "the link carries a mass that the model does not have"
    excitation_hint = "quick and slow motion in many postures"
    cause = "position"
    parameter_names = ("mass", "com", "inertia")
    nonlinear_parameters = (
        NonlinearParameter("mass", ("kg", "kg"), positive=True, max_relative_error=_MAX_MASS_ERROR),
    )

    def __init__(self, model: RobotModel, link: str, frame: Frame, pi: Array) -> None:
        super().__init__(model, link, frame)
        self.pi = parameter_transform(frame.R, frame.p) @ pi  # in the body's frame

    @classmethod
    @override
    def from_checked_entry(cls, entry: EffectEntry, model: RobotModel, frame: Frame) -> Self:
        mass = read_number(entry, "mass")
        com = read_vector(entry, "com", 3)
        inertia = symmetric_matrix(read_vector(entry, "inertia", 6))
        if not mass > 0:
            raise ConfigError(entry_location(entry), f"mass of {mass:g} is not possible; give a value above 0")
        about_com = pseudo_inertia(from_mass_com_inertia(mass, np.zeros(3), inertia))[:3, :3]
        if np.linalg.eigvalsh(about_com)[0] < -_ROUNDING * np.abs(inertia).max():
            problem = "inertia is not realizable: its principal moments violate a triangle inequality or are negative"
            advice = "give [ixx, ixy, iyy, ixz, iyz, izz] of a real body"
            raise ConfigError(entry_location(entry), f"{problem}; {advice}")
        return cls(model, str(entry.link), frame, from_mass_com_inertia(mass, com, inertia))

    @classmethod
    @override
    def gradient_parameters(cls) -> tuple[str, ...]:
        return "mass", "com.0", "com.1", "com.2"

    @classmethod
    @override
    def coefficients_of(cls, entry: EffectEntry, model: RobotModel) -> tuple[Probe, Array]:
        """Probe of a payload on its link, and its ten parameters in the link's frame."""
        mass = read_number(entry, "mass")
        com = read_vector(entry, "com", 3)
        inertia = symmetric_matrix(read_vector(entry, "inertia", 6))
        return cls._probe(model, str(entry.link)), from_mass_com_inertia(mass, com, inertia)

    @classmethod
    @override
    def probes(cls, summary: DataSummary) -> Iterator[Probe]:
        """One probe per link if the URDF's inertia is fixed; else a payload is part of the link's own inertia."""
        if not summary.fixed_inertia:
            return
        for body in summary.model.bodies:
            if body.kind == "link" and not summary.has_effect(cls.id, body.name):
                yield cls._probe(summary.model, body.name)

    @classmethod
    @override
    def implausibility(cls, values: Mapping[str, Any], joint: str | None, summary: DataSummary) -> str:
        """One payload that outweighs the bodies of the model."""
        mass = float(values["mass"])
        of_model = sum(float(body.pi[0]) for body in summary.model.bodies)
        if mass <= of_model:
            return ""
        return f"its mass, {number(mass)} kg, is more than that of all bodies of the model, {number(of_model)} kg"

    @classmethod
    @override
    def doubt(cls, entries: Sequence[EffectEntry], model: RobotModel) -> str:
        """Payloads that together outweigh the bodies of the model."""
        mass = sum(read_number(entry, "mass") for entry in entries)
        of_model = sum(float(body.pi[0]) for body in model.bodies)
        if mass <= of_model:
            return ""
        links = " and ".join(str(entry.link) for entry in entries)
        return (
            f"the payload on {links}, {number(mass)} kg, is heavier than all bodies of the model, {number(of_model)} "
            "kg: it may compensate for something the model lacks, such as rotors, or for wrong masses of the URDF; "
            "weigh the moving parts and diagnose with known.total_mass and --inertia refit, or log motion that lifts "
            "the load in other postures"
        )

    @classmethod
    def _probe(cls, model: RobotModel, link: str) -> Probe:
        """Probe of the ten parameters in the link's frame."""
        parameters = {"mass": 1.0, "com": [0.0] * 3, "inertia": [0.0] * 6}
        payload = cls.from_entry(EffectEntry(effect=cls.id, link=link, parameters=parameters), model)
        unit_payloads = [with_parameters(payload, pi) for pi in np.eye(PI_SIZE)]

        def columns(motion: Motion, linearized: Linearization) -> Mapping[int, Array]:
            rows = np.stack([unit_payload.fixed_torque(motion) for unit_payload in unit_payloads])
            return {j: rows[:, j] for j in range(len(motion.q)) if rows[:, j].any()}

        def to_entry(c: Array, information: Array) -> EffectEntry | None:
            pi = nearest_realizable(c, information)
            if pi is None:
                return None
            mass, com, inertia = mass_com_inertia(pi)
            parameters = {"mass": float(mass), "com": com.tolist(), "inertia": symmetric_entries(inertia).tolist()}
            return EffectEntry(effect=cls.id, link=link, parameters=parameters)

        return Probe(
            effect=cls.id,
            joint=None,
            link=link,
            columns=columns,
            coefficient_count=PI_SIZE,
            to_entry=to_entry,
            parameter_count=_PARAMETER_COUNT,
        )

    @override
    def parameter_units(self) -> dict[str, str]:
        return {"mass": "kg", "com": "m", "inertia": "kg·m²"}

    @override
    def fixed_torque(self, motion: Motion) -> Array:
        """Joint torque that the payload's motion takes, with all bodies before it massless."""
        pi = np.zeros((len(self.chain.bodies), PI_SIZE))
        pi[-1] = self.pi
        return inverse_dynamics(self.chain, pi, motion.q, motion.v, motion.a)

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.pi[self.frame.body] += self.pi


def with_parameters(payload: Payload, pi: Array) -> Payload:
    """Payload with other parameters in the link's frame, shape (10,)."""
    other = copy.copy(payload)
    other.pi = parameter_transform(payload.frame.R, payload.frame.p) @ pi
    return other


def nearest_realizable(c: Array, information: Array) -> Array | None:
    """Parameters of the body nearest to c, shape (10,), in the metric of the information; None if it has no mass.

    With J = L Lᵀ, every L is a body (Rucker & Wensing 2022), so that the search is unconstrained.
    """
    from scipy.optimize import least_squares

    largest = information.diagonal().max()
    if not (c[0] > _MIN_MASS and largest > 0):
        return None
    size = np.sqrt(np.maximum(information.diagonal(), np.finfo(float).eps ** 2 * largest))
    values, vectors = np.linalg.eigh(information / size[:, None] / size)
    values = np.maximum(values, _MIN_INFORMATION * values[-1])
    root = (vectors * np.sqrt(values)).T * size  # rootᵀ root is the information
    lower = np.tril_indices(4)

    def parameters(x: Array) -> Array:
        L = np.zeros((4, 4))
        L[lower] = x
        return from_pseudo_inertia(L @ L.T)

    def residual(x: Array) -> Array:
        return np.asarray(root @ (parameters(x) - c))

    mass = float(c[0])
    com = c[1:4] / c[0]
    if com.any():
        com *= min(1.0, _MAX_START_DISTANCE / np.linalg.norm(com))
    start = from_mass_com_inertia(mass, com, np.eye(3) * _START_INERTIA * mass)
    x = np.linalg.cholesky(pseudo_inertia(start))[lower]
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        solution = least_squares(residual, x, method="lm")
    pi = parameters(solution.x)
    return pi if pi[0] > 0 else None
