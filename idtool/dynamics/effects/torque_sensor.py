"""Sensors, or motor currents used as such, whose torque differs from the true one.

Several on a joint act one after the other: the first in the configuration is nearest to the log.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace

from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.fixed_effect import FixedJointEffect
from idtool.dynamics.mechanism import Mechanism, TorqueSensor


class TorqueSensorEffect(FixedJointEffect):
    """A one-to-one map between the true and the measured torque of a joint."""

    @abstractmethod
    def to_measured(self, tau: Array) -> Array:
        """Measured torque of the joint, from the true one; elementwise."""

    @abstractmethod
    def to_true(self, tau: Array) -> Array:
        """True torque of the joint, from the measured one; elementwise."""

    @override
    def correct_motion(self, motion: Motion) -> Motion:
        tau = motion.tau.copy()
        tau[self.joint] = self.to_true(tau[self.joint])
        return replace(motion, tau=tau)

    @override
    def apply_sensor(self, tau: Array, motion: Motion) -> Array:
        tau = tau.copy()
        tau[..., self.joint, :] = self.to_measured(tau[..., self.joint, :])
        return tau

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        sensor = TorqueSensor(self.to_measured, self.to_true)
        nearer = mechanism.torque_sensors.get(self.joint)
        if nearer is not None:
            sensor = _in_series(sensor, nearer)
        mechanism.torque_sensors[self.joint] = sensor


def _in_series(farther: TorqueSensor, nearer: TorqueSensor) -> TorqueSensor:
    """Two sensors as one; the nearer one is next to the log."""
    return TorqueSensor(
        to_measured=lambda tau: nearer.to_measured(farther.to_measured(tau)),
        to_true=lambda tau: farther.to_true(nearer.to_true(tau)),
    )
