"""Torque that is recorded late or early against the position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Self

import numpy as np
from scipy import ndimage

from idtool.common.arrays import Array, Mask
from idtool.common.exceptions import ConfigError
from idtool.data.signals import Motion
from idtool.dynamics.effects.held_effect import HeldEffect
from idtool.dynamics.effects.named import check_names, joint_index, number, place
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.effects.survey import Present, Survey
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.config import EffectEntry
from idtool.robot.model import Model

WITHIN = 0.9  # samples: what is commanded acts until the next sample, so that half of one is in every log
_SHIFT = 0.1  # s: no more than that is looked for
_LONGEST = 1.0  # s: what is later belongs to another motion


class TimeDelay(HeldEffect):
    """The measured torque is the true one a delay before; below zero, after.

    Parameters
    ----------
    model
        The robot.
    delay
        In seconds.
    joint
        Index of the joint whose torque it is; None: all.
    """

    id = "time_delay"
    means = "the torque is recorded late against the position (below zero: early)"
    shows = "quick motion with sharp changes of torque"

    def __init__(self, model: Model, delay: float, joint: int | None = None) -> None:
        super().__init__(model)
        self.delay = delay
        self.joints = np.arange(len(model.joints)) if joint is None else np.array([joint])
        self._owner = "all joints" if joint is None else model.names[joint]

    @classmethod
    def of(cls, entry: EffectEntry, model: Model) -> Self:
        """See `NamedEffect.of`."""
        if entry.link is not None:
            raise ConfigError(place(entry), "acts on a joint, or on all without one; give no link")
        check_names(entry, ("delay",))
        joint = None if entry.joint is None else joint_index(entry, entry.joint, model)
        delay = number(entry, "delay")
        if not abs(delay) <= _LONGEST:
            raise ConfigError(place(entry), f"delay of {delay:g} s cannot be told; give one within {_LONGEST:g} s")
        return cls(model, delay, joint)

    @classmethod
    def probes(cls, survey: Survey) -> Iterator[Probe]:
        """See `NamedEffect.probes`: of all joints together, and of each."""
        names = survey.model.names
        if not survey.has(cls.id, "all joints"):
            yield _probe(None, range(len(names)), survey.dt)
        for j, name in enumerate(names):
            if not survey.has(cls.id, name) and len(names) > 1:
                yield _probe(name, [j], survey.dt)

    @classmethod
    def shapes(cls) -> tuple[str, ...]:
        """See `NamedEffect.shapes`."""
        return ("delay",)

    @property
    def key(self) -> tuple[str | float, ...]:
        """See `NamedEffect.key`."""
        return self.id, self._owner

    def true(self, motion: Motion) -> Motion:
        """See `Effect.true`; at the ends of the samples, torque that lies beyond them is as there."""
        return replace(motion, tau=self._late(motion.tau, -self.delay / motion.dt))

    def measured(self, tau: Array, motion: Motion) -> Array:
        """See `Effect.measured`."""
        return self._late(tau, self.delay / motion.dt)

    def undefined(self, motion: Motion) -> dict[int, Mask]:
        """Where the torque lies beyond the samples."""
        mask = np.zeros(len(motion.t), dtype=bool)
        beyond = int(np.ceil(abs(self.delay) / motion.dt))
        mask[: beyond if self.delay < 0 else 0] = True
        mask[len(mask) - (beyond if self.delay > 0 else 0) :] = True
        return {int(joint): mask for joint in self.joints}

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        mechanism.torque_late[self.joints] += self.delay

    def _late(self, tau: Array, samples: float) -> Array:
        """The torque of the joints so many samples before, shape (..., nv, N): on a spline of order 5.

        A straight line between samples would damp what is near the end of the band.
        """
        if not samples:
            return tau
        tau = tau.copy()
        for row in np.ndindex(tau.shape[:-2]):
            for joint in self.joints:
                own = tau[*row, joint]
                own[:] = ndimage.shift(own, samples, order=5, mode="nearest")
        return tau


def _probe(joint: str | None, which: Sequence[int], dt: float) -> Probe:
    """The torque of some joints late, to first order."""

    def columns(motion: Motion, present: Present) -> Mapping[int, Array]:
        tau = present.predicted(motion)
        return {j: -np.gradient(tau[j], motion.dt)[None] for j in which}

    def entry(c: Array, information: Array) -> EffectEntry | None:
        late = {"delay": float(c[0])}
        return (
            EffectEntry(effect=TimeDelay.id, joint=joint, parameters=late) if WITHIN * dt < abs(c[0]) < _SHIFT else None
        )

    return Probe(TimeDelay.id, joint, None, columns, 1, entry)
