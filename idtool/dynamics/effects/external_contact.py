"""Contact of a link with its surroundings during part of a log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.entry_parameters import entry_location, read_rows, read_vector
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.link_effect import LinkEffect
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.body import Frame
from idtool.robot.config import EffectEntry
from idtool.robot.kinematics import cross
from idtool.robot.model import RobotModel

_RAMP = 0.005  # s in which a contact comes or goes


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
        Name of the link.
    frame
        Pose of its frame in the body that carries it.
    windows
        Shape (windows, 2), ascending [s].
    wrench
        Shape (6,) [N, N·m].
    """

    id = "external_contact"
    description = "an external force or moment acts on the link"
    excitation_hint = "the same motion with and without contact"
    cause = "time"
    acts_in_bursts = True
    parameter_names = ("windows", "wrench")

    def __init__(self, model: RobotModel, link: str, frame: Frame, windows: Array, wrench: Array) -> None:
        super().__init__(model, link, frame)
        self._edges = windows.ravel()
        self._force = wrench[:3]
        self._moment = wrench[3:]

    @classmethod
    @override
    def from_checked_entry(cls, entry: EffectEntry, model: RobotModel, frame: Frame) -> Self:
        windows = read_rows(entry, "windows", 2)
        wrench = read_vector(entry, "wrench", 6)
        if (np.diff(windows.ravel()) < _RAMP).any():
            problem = f"windows must be in ascending order, at least {_RAMP:g} s long and at least {_RAMP:g} s apart"
            advice = "sort them, and merge windows that touch"
            raise ConfigError(entry_location(entry), f"{problem}; {advice}")
        return cls(model, str(entry.link), frame, windows, wrench)

    @property
    @override
    def key(self) -> tuple[str | float, ...]:
        return *super().key, float(self._edges[0])

    @classmethod
    @override
    def gradient_parameters(cls) -> tuple[str, ...]:
        return tuple(f"wrench.{k}" for k in range(6))

    @classmethod
    @override
    def probes(cls, summary: DataSummary) -> Iterator[Probe]:
        """One probe per link: one wrench in all time intervals with an unusually large residual."""
        if not summary.bursts:
            return
        for body in summary.model.bodies:
            if body.kind == "link":
                yield cls._probe(summary, body.name)

    @classmethod
    def _probe(cls, summary: DataSummary, link: str) -> Probe:
        """Probe of the six components of the wrench on a link."""
        windows = [[float(start), float(end)] for start, end in summary.bursts]
        unit_contacts = []
        for unit_wrench in np.eye(6).tolist():
            parameters = {"windows": windows, "wrench": unit_wrench}
            entry = EffectEntry(effect=cls.id, link=link, parameters=parameters)
            unit_contacts.append(cls.from_entry(entry, summary.model))

        def columns(motion: Motion, linearized: Linearization) -> Mapping[int, Array]:
            rows = np.stack([contact.fixed_torque(motion) for contact in unit_contacts])
            return {j: rows[:, j] for j in range(len(motion.q))}

        def to_entry(c: Array, information: Array) -> EffectEntry | None:
            parameters = {"windows": windows, "wrench": [float(x) for x in c]}
            return EffectEntry(effect=cls.id, link=link, parameters=parameters)

        chain = unit_contacts[0].chain
        joint_count = np.count_nonzero(np.any([body.ratios for body in chain.bodies], axis=0))
        return Probe(
            effect=cls.id,
            joint=None,
            link=link,
            columns=columns,
            coefficient_count=6,
            to_entry=to_entry,
            is_local=True,
            parameter_count=2 * len(windows) + int(joint_count),
        )

    @override
    def parameter_units(self) -> dict[str, str]:
        return {"windows": "s", "wrench": "N and N·m"}

    @override
    def fixed_torque(self, motion: Motion) -> Array:
        share = self._acting_share(motion.t)
        active = share > 0
        tau = np.zeros_like(motion.q)
        if active.any():
            tau[:, active] = -share[active] * self._wrench_torque(motion.q[:, active])
        return tau

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.extra_torques.append(self.fixed_torque)

    def _wrench_torque(self, q: Array) -> Array:
        """Jᵀ wrench, shape (nv, N)."""
        # Along the axes of the root link, samples first:
        R = np.broadcast_to(np.eye(3), (q.shape[1], 3, 3))
        p = np.zeros((q.shape[1], 3))
        axes = []
        for body in self.chain.bodies:
            p = p + R @ body.mount.p
            R = R @ body.mount.R
            axis = R @ body.axis
            axes.append((body, axis, p))
            position = (body.ratios @ q + body.offset)[:, None]
            if body.prismatic:
                p = p + position * axis
            else:
                R = R @ Rotation.from_rotvec(position * body.axis).as_matrix()
        contact_point = p + R @ self.frame.p

        force = self._force[:, None]
        tau = np.zeros_like(q)
        for body, axis, p in axes:
            push = force
            if not body.prismatic:
                push = self._moment[:, None] + cross((contact_point - p).T, force)
            tau += np.outer(body.ratios, np.sum(axis.T * push, axis=0))
        return tau

    def _acting_share(self, t: Array) -> Array:
        """Share of the wrench that acts, shape (N,): rising around the even edges, falling around the odd ones."""
        edges = self._edges
        nearest = np.searchsorted((edges[1:] + edges[:-1]) / 2, t)
        x = np.clip((t - edges[nearest]) / _RAMP, -0.5, 0.5)
        rise = 0.5 + x + np.sin(2 * np.pi * x) / (2 * np.pi)
        is_start = nearest % 2 == 0
        return np.asarray(np.where(is_start, rise, 1 - rise))
