"""Contact of a link with its surroundings during part of a log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Self

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import Burst, DataSummary
from idtool.dynamics.effects.entry_parameters import entry_location, read_rows, read_vector
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.link_effect import LinkEffect
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.body import Frame
from idtool.robot.config import EffectEntry
from idtool.robot.kinematics import frame_jacobian
from idtool.robot.model import RobotModel

_RAMP = 0.005  # s in which a contact comes or goes
_ROUNDING = 1e-12  # of a wrench


class ExternalContact(LinkEffect):
    """A wrench on a link during windows of time: the joints need −Jᵀ wrench more torque.

    The wrench [fx, fy, fz, nx, ny, nz] is what the surroundings do to the link: a force [N] at a point of it, by
    default the origin of its frame, and a moment [N·m], both along the axes of the root link. The windows
    [[from, to], …] count from the first sample of each log [s]; at their ends the wrench comes and goes within 5 ms,
    as half a cosine. In between it is constant, or has a profile [[time, share], …]: at these times, counted in the
    same way, these shares of the wrench act, and between them, shares on straight lines. It acts in all logs,
    or in the one with a file name. A link may have several contacts, with other first windows.

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
    point
        Point of the link at which the force acts, in the link's frame, shape (3,) [m].
    profile
        Times [s], ascending, and shares of the wrench, shape (k, 2); none: it is constant.
    log
        File name of the log in which it acts; empty: in all.
    """

    id = "external_contact"
    description = "an external force or moment acts on the link"
    excitation_hint = "the same motion with and without contact"
    cause = "time"
    acts_in_bursts = True
    parameter_names = ("windows", "wrench")
    optional_parameter_names = ("point", "profile", "log")

    def __init__(
        self,
        model: RobotModel,
        link: str,
        frame: Frame,
        windows: Array,
        wrench: Array,
        point: Array,
        profile: Array | None = None,
        log: str = "",
    ) -> None:
        super().__init__(model, link, frame)
        last_body = len(self.chain.bodies) - 1
        self._contact_frame = replace(frame.compose(np.eye(3), point), body=last_body)
        self._edges = windows.ravel()
        self._profile = profile
        self._log = log
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
        point = np.zeros(3)
        if "point" in entry.parameters:
            point = read_vector(entry, "point", 3)
        profile = None
        if "profile" in entry.parameters:
            profile = read_rows(entry, "profile", 2)
            if (np.diff(profile[:, 0]) <= 0).any():
                problem = "the times of the profile must be in ascending order; sort them"
                raise ConfigError(entry_location(entry), problem)
        log = entry.parameters.get("log", "")
        if not isinstance(log, str):
            raise ConfigError(entry_location(entry), "log is not text; give the file name of a log")
        return cls(model, str(entry.link), frame, windows, wrench, point, profile, log)

    @property
    @override
    def key(self) -> tuple[str | float, ...]:
        return *super().key, float(self._edges[0]), self._log

    @classmethod
    @override
    def gradient_parameters(cls) -> tuple[str, ...]:
        return tuple(f"wrench.{k}" for k in range(6))

    @classmethod
    @override
    def probes(cls, summary: DataSummary) -> Iterator[Probe]:
        """One probe per link: one wrench in all time intervals with an unusually large residual."""
        for burst in summary.bursts:
            for body in summary.model.bodies:
                if body.kind == "link" and burst.link in ("", body.name):
                    yield cls._probe(summary.model, body.name, burst)

    @classmethod
    def _probe(cls, model: RobotModel, link: str, burst: Burst) -> Probe:
        """Probe of the six components of the wrench on a link."""
        fixed_parameters: dict[str, Any] = {"windows": [list(window) for window in burst.windows]}
        if any(burst.point):
            fixed_parameters["point"] = list(burst.point)
        if burst.profile:
            fixed_parameters["profile"] = [list(row) for row in burst.profile]
        if burst.log:
            fixed_parameters["log"] = burst.log
        unit_contacts = []
        for unit_wrench in np.eye(6).tolist():
            parameters = {**fixed_parameters, "wrench": unit_wrench}
            entry = EffectEntry(effect=cls.id, link=link, parameters=parameters)
            unit_contacts.append(cls.from_entry(entry, model))

        def columns(motion: Motion, linearized: Linearization) -> Mapping[int, Array]:
            rows = np.stack([contact.fixed_torque(motion) for contact in unit_contacts])
            return {j: rows[:, j] for j in range(len(motion.q))}

        def to_entry(c: Array, information: Array) -> EffectEntry | None:
            parameters = {**fixed_parameters, "wrench": [float(x) for x in c]}
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
            log=burst.log,
            parameter_count=burst.parameter_count + int(joint_count),
        )

    @override
    def parameter_units(self) -> dict[str, str]:
        return {"windows": "s", "wrench": "N and N·m", "point": "m", "profile": "s and 1"}

    @override
    def fixed_torque(self, motion: Motion) -> Array:
        if self._log not in ("", motion.log):
            return np.zeros_like(motion.q)
        share = self._acting_share(motion.t)
        active = np.abs(share) > _ROUNDING
        tau = np.zeros_like(motion.q)
        if active.any():
            tau[:, active] = -share[active] * self._wrench_torque(motion.q[:, active])
        return tau

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.extra_torques.append(self.fixed_torque)
        mechanism.differs_by_log |= self._log != ""

    def _wrench_torque(self, q: Array) -> Array:
        """Jᵀ wrench, shape (nv, N)."""
        linear, angular, _ = frame_jacobian(self.chain, self._contact_frame, q)
        return np.asarray(np.einsum("kin,i->kn", linear, self._force) + np.einsum("kin,i->kn", angular, self._moment))

    def _acting_share(self, t: Array) -> Array:
        """Share of the wrench that acts, shape (N,): rising around the even edges, falling around the odd ones."""
        edges = self._edges
        nearest = np.searchsorted((edges[1:] + edges[:-1]) / 2, t)
        x = np.clip((t - edges[nearest]) / _RAMP, -0.5, 0.5)
        rise = 0.5 + x + np.sin(2 * np.pi * x) / (2 * np.pi)
        is_start = nearest % 2 == 0
        share = np.where(is_start, rise, 1 - rise)
        if self._profile is not None:
            share = share * np.interp(t, *self._profile.T)
        return np.asarray(share)
