"""IMU of a floating base that is recorded late or early relative to the joints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Self

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Mask
from idtool.common.exceptions import ConfigError
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.delayed_series import beyond_samples, delayed, read_delay
from idtool.dynamics.effects.entry_parameters import check_parameter_names, entry_location
from idtool.dynamics.effects.fixed_effect import FixedEffect
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel

_MIN_DELAY_SAMPLES = 0.9  # as of the torque's delay: less is in every log
_MAX_PROBED_DELAY = 0.05  # s: beyond, a first-order estimate means nothing


class ImuDelay(FixedEffect):
    """Delay of a floating base's measured motion against the joints: measured(t) = true(t − delay).

    Parameters
    ----------
    model
        The robot, with a floating base.
    delay
        The delay [s].
    """

    id = "imu_delay"
    label = "IMU delay"
    is_countable = True
    whole_robot_owner = "the base"
    is_screened_to_first_order = True
    description = "the IMU is recorded with a delay relative to the joints (earlier if the delay is negative)"
    excitation_hint = "quick turns of the base"
    cause = "time"

    def __init__(self, model: RobotModel, delay: float) -> None:
        super().__init__(model)
        self.delay = delay
        self._base = model.base_coordinates

    @classmethod
    @override
    def from_entry(cls, entry: EffectEntry, model: RobotModel) -> Self:
        if entry.joint is not None or entry.link is not None:
            raise ConfigError(entry_location(entry), "acts on the base; give neither joint nor link")
        check_parameter_names(entry, ("delay",))
        if not model.has_floating_base:
            raise ConfigError(entry_location(entry), "needs a floating base; set base.kind, or remove it")
        return cls(model, read_delay(entry))

    @classmethod
    @override
    def probes(cls, summary: DataSummary) -> Iterator[Probe]:
        """One probe on a floating base."""
        if not summary.model.has_floating_base or summary.has_effect(cls.id, "base"):
            return
        coordinates = summary.model.base_coordinates
        base = range(coordinates.start, coordinates.stop)

        # without the turn of the contacts by the late orientation, which matters little
        def columns(motion: Motion, linearized: Linearization) -> Mapping[int, Array]:
            zero = np.zeros_like(motion.t)
            change = np.zeros_like(motion.q)
            for row in base:
                acceleration = np.gradient(motion.v[row], motion.dt)
                jerk = np.gradient(motion.a[row], motion.dt)
                change += linearized.torque_change_by_motion(row, zero, acceleration, jerk)
            return {row: own[None] for row, own in enumerate(change)}

        def to_entry(c: Array, information: Array) -> EffectEntry | None:
            delay = float(c[0])
            if not _MIN_DELAY_SAMPLES * summary.dt < abs(delay) < _MAX_PROBED_DELAY:
                return None
            return EffectEntry(effect=cls.id, parameters={"delay": delay})

        yield Probe(effect=cls.id, joint=None, link=None, columns=columns, coefficient_count=1, to_entry=to_entry)

    @classmethod
    @override
    def gradient_parameters(cls) -> tuple[str, ...]:
        return ("delay",)

    @override
    def parameter_units(self) -> dict[str, str]:
        return {"delay": "s"}

    @property
    @override
    def key(self) -> tuple[str | float, ...]:
        return self.id, "base"

    @override
    def correct_motion(self, motion: Motion) -> Motion:
        """Motion with that of the base shifted back; beyond the samples it is taken as at their ends."""
        if not self.delay or not motion.is_log:
            return motion
        samples = -self.delay / motion.dt
        v = motion.v.copy()
        a = motion.a.copy()
        v[self._base] = delayed(motion.v[self._base], samples)
        a[self._base] = delayed(motion.a[self._base], samples)
        contacts = motion.contacts
        if contacts is not None:
            contacts = replace(contacts, world_to_base=delayed(contacts.world_to_base, samples))
        return replace(motion, v=v, a=a, contacts=contacts)

    @override
    def invalid_mask(self, motion: Motion) -> dict[int, Mask]:
        """Samples at which the motion of the base lies beyond the batch; it is in the rows of all joints."""
        if not self.delay or not motion.is_log:
            return {}
        mask = beyond_samples(motion, self.delay)
        return dict.fromkeys(range(len(motion.q)), mask)

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.imu_delay += self.delay
