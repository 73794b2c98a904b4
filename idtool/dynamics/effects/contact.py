"""Contact of a link with its surroundings during part of a log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.data.signals import Motion
from idtool.dynamics.effects.link_effect import LinkEffect
from idtool.dynamics.effects.named import place, rows, vector
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.effects.survey import Present, Survey
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.body import Frame
from idtool.robot.config import EffectEntry
from idtool.robot.kinematics import cross
from idtool.robot.model import Model

_COMES = 0.005  # s in which a contact comes or goes


class ExternalContact(LinkEffect):
    """A constant wrench on a link during windows of time: the joints need −Jᵀ wrench more torque.

    The wrench [fx, fy, fz, nx, ny, nz] is what the surroundings do to the link: a force [N] at the origin of its
    frame and a moment [N·m], both along the axes of the root link. The windows [[from, to], …] count from the first
    sample of each log [s]; at their ends the wrench comes and goes within 5 ms, as half a cosine. A link may have
    several, with other first windows.

    Parameters
    ----------
    model
        The robot.
    link
        The link.
    frame
        Where it is.
    windows
        Shape (windows, 2), ascending.
    wrench
        Shape (6,).
    """

    id = "external_contact"
    means = "something pushes against the link"
    shows = "the same motion without contact"
    names = ("windows", "wrench")

    def __init__(self, model: Model, link: str, frame: Frame, windows: Array, wrench: Array) -> None:
        super().__init__(model, link, frame)
        self._edges = windows.ravel()
        self._force, self._moment = wrench[:3], wrench[3:]

    @classmethod
    def read(cls, entry: EffectEntry, model: Model, frame: Frame) -> Self:
        """See `LinkEffect.read`."""
        windows, wrench = rows(entry, "windows", 2), vector(entry, "wrench", 6)
        if (np.diff(windows.ravel()) < _COMES).any():
            what = f"windows must ascend, each, and the time between two, being {_COMES:g} s or longer"
            raise ConfigError(place(entry), f"{what}; put them in order, and make one of those that touch")
        return cls(model, str(entry.link), frame, windows, wrench)

    @property
    def key(self) -> tuple[str | float, ...]:
        """See `NamedEffect.key`."""
        return *super().key, float(self._edges[0])

    @classmethod
    def shapes(cls) -> tuple[str, ...]:
        """See `NamedEffect.shapes`."""
        return tuple(f"wrench.{k}" for k in range(6))

    @classmethod
    def probes(cls, survey: Survey) -> Iterator[Probe]:
        """See `NamedEffect.probes`: one wrench whenever the residual is out of the ordinary."""
        if survey.bursts:
            for body in survey.model.bodies:
                if body.kind == "link":
                    yield cls._probe(survey, body.name)

    @classmethod
    def _probe(cls, survey: Survey, link: str) -> Probe:
        """Of the six components by themselves."""
        windows = [[float(a), float(b)] for a, b in survey.bursts]
        entries = [
            EffectEntry(effect=cls.id, link=link, parameters={"windows": windows, "wrench": one})
            for one in np.eye(6).tolist()
        ]
        pushes = [cls.of(one, survey.model) for one in entries]

        def columns(motion: Motion, present: Present) -> Mapping[int, Array]:
            rows = np.stack([push.known(motion) for push in pushes])
            return {j: rows[:, j] for j in range(len(motion.q))}

        def entry(c: Array, information: Array) -> EffectEntry | None:
            given = {"windows": windows, "wrench": [float(x) for x in c]}
            return EffectEntry(effect=cls.id, link=link, parameters=given)

        felt = sum(bool(x) for x in np.any([body.ratios for body in pushes[0].chain.bodies], axis=0))
        return Probe(cls.id, None, link, columns, 6, entry, local=True, count=2 * len(windows) + felt)

    def known(self, motion: Motion) -> Array:
        """See `Effect.known`."""
        share = self._share(motion.t)
        tau = np.zeros_like(motion.q)
        now = share > 0
        if now.any():
            tau[:, now] = -share[now] * self._torque(motion.q[:, now])
        return tau

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        mechanism.torques.append(self.known)

    def _torque(self, q: Array) -> Array:
        """Jᵀ wrench, shape (nv, N); R, p and axis along the axes of the root link, samples first."""
        R, p = np.broadcast_to(np.eye(3), (q.shape[1], 3, 3)), np.zeros((q.shape[1], 3))
        moved = []
        for body in self.chain.bodies:
            p, R = p + R @ body.mount.p, R @ body.mount.R
            way, axis = (body.ratios @ q + body.offset)[:, None], R @ body.axis
            moved.append((body, axis, p))
            if body.prismatic:
                p = p + way * axis
            else:
                R = R @ Rotation.from_rotvec(way * body.axis).as_matrix()
        at, force = p + R @ self.frame.p, self._force[:, None]
        tau = np.zeros_like(q)
        for body, axis, p in moved:
            push = force if body.prismatic else self._moment[:, None] + cross((at - p).T, force)
            tau += np.outer(body.ratios, np.sum(axis.T * push, axis=0))
        return tau

    def _share(self, t: Array) -> Array:
        """Of the wrench that acts, shape (N,): from 0 to 1 around the first edge, back around the second, and so on."""
        edges = self._edges
        nearest = np.searchsorted((edges[1:] + edges[:-1]) / 2, t)
        x = np.clip((t - edges[nearest]) / _COMES, -0.5, 0.5)
        risen = 0.5 + x + np.sin(2 * np.pi * x) / (2 * np.pi)
        return np.asarray(np.where(nearest % 2 == 0, risen, 1 - risen))
