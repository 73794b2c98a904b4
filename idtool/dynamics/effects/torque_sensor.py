"""Torque sensors, and what is used as one, that give another torque than the true one.

Several on a joint lie one behind the other: the first in the configuration is nearest to the log.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.held_effect import HeldJointEffect, only
from idtool.dynamics.effects.joint_effect import Held
from idtool.dynamics.effects.survey import Present, Survey
from idtool.dynamics.mechanism import Mechanism, TorqueSensor

_LEAST, _MOST = 0.2, 5.0  # gains that are believed
_LEVELS = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)  # of the greatest torque, where it may begin to bend


class Sensor(HeldJointEffect):
    """A one-to-one map between the true and the measured torque of a joint."""

    @abstractmethod
    def given(self, tau: Array) -> Array:
        """The measured torque of the joint, from the true one; elementwise."""

    @abstractmethod
    def meant(self, tau: Array) -> Array:
        """The true torque of the joint, from the measured one; elementwise."""

    def true(self, motion: Motion) -> Motion:
        """See `Effect.true`."""
        tau = motion.tau.copy()
        tau[self.joint] = self.meant(tau[self.joint])
        return replace(motion, tau=tau)

    def measured(self, tau: Array, motion: Motion) -> Array:
        """See `Effect.measured`."""
        tau = tau.copy()
        tau[..., self.joint, :] = self.given(tau[..., self.joint, :])
        return tau

    def join(self, theta: Array, mechanism: Mechanism) -> None:
        """See `Effect.join`."""
        own, nearer = TorqueSensor(self.given, self.meant), mechanism.sensors.get(self.joint)
        mechanism.sensors[self.joint] = own if nearer is None else _behind(own, nearer)


class TorqueGain(Sensor):
    """Measured = gain × true: a torque constant, gear ratio or efficiency taken for another."""

    id = "torque_gain"
    means = "the measured torque is a multiple of the true one"
    shows = "a known mass on the last link, logged with and without"
    held = (Held("gain", positive=True),)

    @classmethod
    def slopes(cls, survey: Survey, joint: int, shape: Mapping[str, float], motion: Motion, present: Present) -> Array:
        """See `HeldJointEffect.slopes`: in units of the measured torque, or scaling it to nothing would explain all."""
        return only(joint, present.predicted(motion)[joint], motion)

    @classmethod
    def solved(cls, c: float, shape: Mapping[str, float]) -> Mapping[str, float] | None:
        """See `HeldJointEffect.solved`."""
        return {"gain": 1 + c} if _LEAST < 1 + c < _MOST else None

    def given(self, tau: Array) -> Array:
        """See `Sensor.given`."""
        return np.asarray(self.shape["gain"] * tau)

    def meant(self, tau: Array) -> Array:
        """See `Sensor.meant`."""
        return np.asarray(tau / self.shape["gain"])


class TorqueSaturation(Sensor):
    """Measured torque that bends away from the true one beyond a level.

    With x and y what the true and the measured torque have above the level in size:

    - bend ≥ 0: x = y + bend y²/2. The measured torque falls behind, as that of a strain gauge at the end of its range
      does; its slope is 1 at the level and half of that where y = 1 / bend.
    - bend < 0: y = x − bend x²/2. The measured torque runs ahead, as that from the current of a motor whose iron
      saturates does.

    So it is one to one over all torques, its slope has no jump, both directions are polynomials or square roots of
    them, which noise and wrong values cannot drive to infinity, and bend = 0 is no saturation. The level is in N·m or
    N, the bend in the inverse of that.
    """

    id = "torque_saturation"
    means = "the measured torque bends away from the true one at high load"
    shows = "standstill and slow motion at high and at low load"
    contains = ("torque_gain",)
    held = (Held("level", positive=True), Held("bend"))

    @classmethod
    def tried(cls, survey: Survey, joint: int) -> Iterator[Mapping[str, float]]:
        """See `JointEffect.tried`: levels that the torque exceeds."""
        for share in _LEVELS:
            yield {"level": share * float(survey.torque[joint])}

    @classmethod
    def slopes(cls, survey: Survey, joint: int, shape: Mapping[str, float], motion: Motion, present: Present) -> Array:
        """See `HeldJointEffect.slopes`: by the bend."""
        tau = present.predicted(motion)[joint]
        above = np.maximum(np.abs(tau) - shape["level"], 0.0)
        return only(joint, -np.sign(tau) * np.square(above) / 2, motion)

    @classmethod
    def solved(cls, c: float, shape: Mapping[str, float]) -> Mapping[str, float] | None:
        """See `HeldJointEffect.solved`."""
        return {**shape, "bend": c}

    def given(self, tau: Array) -> Array:
        """See `Sensor.given`."""
        return self._bent(tau, -self.shape["bend"])

    def meant(self, tau: Array) -> Array:
        """See `Sensor.meant`."""
        return self._bent(tau, self.shape["bend"])

    def _bent(self, tau: Array, bend: float) -> Array:
        """Torque whose size above the level grows by bend/2 times its square, or falls by the inverse of that."""
        above = np.maximum(np.abs(tau) - self.shape["level"], 0.0)
        # (√(1 + 2bx) − 1) / b, without the difference of like numbers
        other = above + bend / 2 * above**2 if bend >= 0 else 2 * above / (1 + np.sqrt(1 - 2 * bend * above))
        return np.asarray(tau + np.sign(tau) * (other - above))


def _behind(farther: TorqueSensor, nearer: TorqueSensor) -> TorqueSensor:
    """Two sensors as one."""
    return TorqueSensor(lambda tau: nearer.measured(farther.measured(tau)), lambda tau: farther.true(nearer.true(tau)))
