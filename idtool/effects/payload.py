"""What a link carries and the model has not."""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import NDArray

from idtool.body import Frame
from idtool.config import EffectEntry
from idtool.effects.link_effect import LinkEffect
from idtool.effects.named import number, place, vector
from idtool.exceptions import ConfigError
from idtool.inertia import from_mass_com_inertia, pseudo_inertia, symmetric, transformation
from idtool.kinematics import body_motions, cross
from idtool.mechanism import Mechanism
from idtool.model import Model
from idtool.signals import Motion

Array = NDArray[np.float64]

_ROUNDING = 1e-9  # of the inertia's size


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
