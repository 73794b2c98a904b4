"""What a link carries and the model has not."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from typing import Self

import numpy as np
from scipy.optimize import least_squares

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.data.signals import Motion
from idtool.dynamics.effects.link_effect import LinkEffect
from idtool.dynamics.effects.named import number, place, vector
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.effects.survey import Present, Survey
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.body import Frame
from idtool.robot.config import EffectEntry
from idtool.robot.inertia import (
    SIZE,
    from_mass_com_inertia,
    from_pseudo_inertia,
    mass_com_inertia,
    pseudo_inertia,
    six,
    symmetric,
    transformation,
)
from idtool.robot.kinematics import body_motions, cross
from idtool.robot.model import Model

_ROUNDING = 1e-9  # of the inertia's size
_SEEN = 1e-9  # of the largest information, that is taken at the least
_COMPACT = 1e-3  # m²: of a start's inertia over its mass
_FAR = 1.0  # m: from the link's frame, where a search begins at the most
_COUNT = 4  # numbers that speak of it: mass and centre; the inertia about it follows within narrow bounds


def replaced(load: Payload, pi: Array) -> Payload:
    """A payload with other parameters, in the link's frame."""
    other = copy.copy(load)
    other.pi = transformation(load.frame.R, load.frame.p) @ pi
    return other


def realizable(c: Array, information: Array) -> Array | None:
    """The parameters of a body that come nearest to c, shape (10,), in the data's own measure; None: it has no mass.

    With J = L Lᵀ, every L is a body (Rucker & Wensing 2022), so that nothing constrains the search.
    """
    if not c[0] > 0:
        return None
    size = np.sqrt(np.maximum(information.diagonal(), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(information / size[:, None] / size)
    root = (vectors * np.sqrt(np.maximum(values, _SEEN * values[-1]))).T * size
    lower = np.tril_indices(4)

    def body(x: Array) -> Array:
        L = np.zeros((4, 4))
        L[lower] = x
        return from_pseudo_inertia(L @ L.T)

    def off(x: Array) -> Array:
        return np.asarray(root @ (body(x) - c))

    com = c[1:4] / c[0]
    com *= min(1.0, _FAR / np.linalg.norm(com)) if com.any() else 1.0
    start = from_mass_com_inertia(float(c[0]), com, np.eye(3) * _COMPACT * float(c[0]))
    x = np.linalg.cholesky(pseudo_inertia(start))[lower]
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        found = least_squares(off, x, method="lm")
    pi = body(found.x)
    return pi if pi[0] > 0 else None


class Payload(LinkEffect):
    """A body fixed to a link: mass, centre, and inertia about it [ixx, ixy, iyy, ixz, iyz, izz], in the link's frame.

    Some mass density must have these; a point mass, with no inertia, is one. A fit identifies the link without it.

    Parameters
    ----------
    model
        The robot.
    link
        The link.
    frame
        Where it is.
    pi
        The payload's parameters in the link's frame, shape (10,).
    """

    id = "payload"
    means = "the link carries what the model has not"
    shows = "quick and slow motion in many postures"
    names = ("mass", "com", "inertia")

    def __init__(self, model: Model, link: str, frame: Frame, pi: Array) -> None:
        super().__init__(model, link, frame)
        self.pi = transformation(frame.R, frame.p) @ pi  # in the body's frame

    @classmethod
    def read(cls, entry: EffectEntry, model: Model, frame: Frame) -> Self:
        """See `LinkEffect.read`."""
        mass, com, inertia = number(entry, "mass"), vector(entry, "com", 3), symmetric(vector(entry, "inertia", 6))
        if not mass > 0:
            raise ConfigError(place(entry), f"mass of {mass:g} cannot be; give one above 0")
        about_com = pseudo_inertia(from_mass_com_inertia(mass, np.zeros(3), inertia))[:3, :3]
        if np.linalg.eigvalsh(about_com)[0] < -_ROUNDING * np.abs(inertia).max():
            what = "no body has this inertia about its centre: its moments break a triangle inequality or are negative"
            raise ConfigError(place(entry), f"{what}; give [ixx, ixy, iyy, ixz, iyz, izz] of one that can be")
        return cls(model, str(entry.link), frame, from_mass_com_inertia(mass, com, inertia))

    @classmethod
    def shapes(cls) -> tuple[str, ...]:
        """See `NamedEffect.shapes`."""
        return "mass", *(f"com.{k}" for k in range(3))

    @classmethod
    def probes(cls, survey: Survey) -> Iterator[Probe]:
        """See `NamedEffect.probes`: on links whose inertia is taken as true; else it is the link's own."""
        if survey.fixed:
            for body in survey.model.bodies:
                if body.kind == "link" and not survey.has(cls.id, body.name):
                    yield cls._probe(survey.model, body.name)

    @classmethod
    def _probe(cls, model: Model, link: str) -> Probe:
        """Of the ten parameters in the link's frame, each by itself."""
        nothing = EffectEntry(
            effect=cls.id, link=link, parameters={"mass": 1.0, "com": [0.0] * 3, "inertia": [0.0] * 6}
        )
        loads = [replaced(cls.of(nothing, model), pi) for pi in np.eye(SIZE)]

        def columns(motion: Motion, present: Present) -> Mapping[int, Array]:
            rows = np.stack([load.known(motion) for load in loads])
            return {j: rows[:, j] for j in range(len(motion.q)) if rows[:, j].any()}

        def entry(c: Array, information: Array) -> EffectEntry | None:
            pi = realizable(c, information)
            if pi is None:
                return None
            mass, com, inertia = mass_com_inertia(pi)
            given = {"mass": float(mass), "com": com.tolist(), "inertia": six(inertia).tolist()}
            return EffectEntry(effect=cls.id, link=link, parameters=given)

        return Probe(cls.id, None, link, columns, SIZE, entry, count=_COUNT)

    def known(self, motion: Motion) -> Array:
        """See `Effect.known`: force and moment about the body's origin that its motion takes (4), on the joints."""
        body = body_motions(self.chain, motion.q, motion.v, motion.a)[-1]
        mass, h, inertia = self.pi[0], self.pi[1:4], symmetric(self.pi[4:])
        force = mass * body.acc + np.einsum("ijn,j->in", body.M, h)
        moment = cross(h[:, None], body.acc) + inertia @ body.alpha + cross(body.w, inertia @ body.w)
        tau = np.zeros_like(motion.q)
        tau[body.coordinates] = np.einsum("ikn,in->kn", body.S_v, force) + np.einsum("ikn,in->kn", body.S_w, moment)
        return tau

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        mechanism.pi[self.frame.body] += self.pi
