"""Torque that is recorded late or early relative to the position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Self

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Mask
from idtool.common.exceptions import ConfigError
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.delayed_series import beyond_samples, delayed, read_delay
from idtool.dynamics.effects.entry_parameters import (
    check_parameter_names,
    entry_location,
    read_joint_index,
    read_number,
)
from idtool.dynamics.effects.fixed_effect import FixedEffect
from idtool.dynamics.effects.init_trial import InitSearch
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel

_MIN_DELAY_SAMPLES = 0.9  # a command acts until the next sample, so that half a sample of delay is in every log
_MAX_PROBED_DELAY = 0.1  # s


class TimeDelay(FixedEffect):
    """The measured torque is the true one a delay earlier, or later if the delay is negative.

    Parameters
    ----------
    model
        The robot.
    delay
        The delay [s].
    joint
        Index of the joint whose torque it is; None: all.
    """

    id = "time_delay"
    is_countable = True
    may_act_on_all_joints = True
    is_screened_to_first_order = True
    description = "the torque is recorded with a delay relative to the position (earlier if the delay is negative)"
    excitation_hint = "quick motion with sharp changes of torque"
    cause = "torque_rate"
    init_trial = InitSearch(
        name="a delay",
        heading="torque delay",
        comment="the torque is logged {value} later than the position (earlier if negative)",
        needs_measured_torque=True,  # a controller's torque is its own, in time with its command
        parameter="delay",
        step=0.05,  # the error is a parabola within
        maximum=_MAX_PROBED_DELAY,
        at_maximum=(
            "the best fit delays the torque by {maximum} or more, which is too long for a recording delay",
            "the best fit advances the torque by {maximum} or more, which is too long for a recording delay",
        ),
        display_unit="ms",
        display_factor=1e3,
    )

    def __init__(self, model: RobotModel, delay: float, joint: int | None = None) -> None:
        super().__init__(model)
        self.delay = delay
        self.joints = np.arange(model.joint_count) if joint is None else np.array([joint])
        self._owner = "all joints" if joint is None else model.names[joint]

    @classmethod
    @override
    def from_entry(cls, entry: EffectEntry, model: RobotModel) -> Self:
        if entry.link is not None:
            raise ConfigError(
                entry_location(entry), "acts on one joint, or on all joints if `joint` is omitted; remove `link`"
            )
        check_parameter_names(entry, ("delay",))
        joint = None if entry.joint is None else read_joint_index(entry, entry.joint, model)
        return cls(model, read_delay(entry), joint)

    @classmethod
    @override
    def probes(cls, summary: DataSummary) -> Iterator[Probe]:
        """A probe of all joints together, and one of each joint."""
        names = summary.model.joint_names
        if not summary.has_effect(cls.id, "all joints"):
            yield _probe(None, range(len(names)), summary.dt)
        if len(names) == 1:
            return
        for j, name in enumerate(names):
            if not summary.has_effect(cls.id, name):
                yield _probe(name, [j], summary.dt)

    @classmethod
    @override
    def gradient_parameters(cls) -> tuple[str, ...]:
        return ("delay",)

    @classmethod
    @override
    def background_entry(cls) -> EffectEntry:
        """A delay of all joints: torque that is held over a sample is recorded half of one early."""
        return EffectEntry(effect=cls.id, parameters={"delay": 0.0})

    @classmethod
    @override
    def is_background(cls, entry: EffectEntry, dt: float) -> bool:
        return abs(read_number(entry, "delay")) <= _MIN_DELAY_SAMPLES * dt

    @override
    def parameter_units(self) -> dict[str, str]:
        return {"delay": "s"}

    @property
    @override
    def key(self) -> tuple[str | float, ...]:
        return self.id, self._owner

    @override
    def correct_motion(self, motion: Motion) -> Motion:
        """Motion with the torque shifted back; torque beyond the samples is taken as at their ends."""
        return replace(motion, tau=self._shifted(motion.tau, -self.delay / motion.dt))

    @override
    def apply_sensor(self, tau: Array, motion: Motion) -> Array:
        return self._shifted(tau, self.delay / motion.dt)

    @override
    def invalid_mask(self, motion: Motion) -> dict[int, Mask]:
        """Samples whose torque lies beyond the batch."""
        mask = beyond_samples(motion, self.delay)
        return {int(joint): mask for joint in self.joints}

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        mechanism.torque_delay[self.joints] += self.delay

    def _shifted(self, tau: Array, samples: float) -> Array:
        """Torque of the joints delayed by a number of samples, shape (..., nv, N)."""
        if not samples:
            return tau
        tau = tau.copy()
        tau[..., self.joints, :] = delayed(tau[..., self.joints, :], samples)
        return tau


def _probe(joint: str | None, indices: Sequence[int], dt: float) -> Probe:
    """Probe of a delay of some joints' torque."""

    def columns(motion: Motion, linearized: Linearization) -> Mapping[int, Array]:
        tau = linearized.predicted_torque
        return {j: -np.gradient(tau[j], motion.dt)[None] for j in indices}

    def to_entry(c: Array, information: Array) -> EffectEntry | None:
        delay = float(c[0])
        if not _MIN_DELAY_SAMPLES * dt < abs(delay) < _MAX_PROBED_DELAY:
            return None
        return EffectEntry(effect=TimeDelay.id, joint=joint, parameters={"delay": delay})

    return Probe(effect=TimeDelay.id, joint=joint, link=None, columns=columns, coefficient_count=1, to_entry=to_entry)
