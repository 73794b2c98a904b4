"""`SimulatorElement`: torque on joints of the few kinds that simulators have; an effect says which of them it is.

All are torque that the actuator has to give, in SI. Which of them a simulator has, and how its files spell them, is
known where they are written.
"""

from __future__ import annotations

from idtool.common.dataclass import dataclass


@dataclass(frozen=True)
class SimulatorElement:
    """Torque on one joint.

    Attributes
    ----------
    joint
        Index of the joint.
    """

    joint: int


@dataclass(frozen=True)
class Damping(SimulatorElement):
    """coefficient · v."""

    coefficient: float


@dataclass(frozen=True)
class QuadraticDamping(SimulatorElement):
    """coefficient · v abs(v)."""

    coefficient: float


@dataclass(frozen=True)
class FrictionLoss(SimulatorElement):
    """level · sign(v); a joint at rest holds up to the level."""

    level: float


@dataclass(frozen=True)
class ConstantTorque(SimulatorElement):
    """A constant torque."""

    torque: float


@dataclass(frozen=True)
class Spring(SimulatorElement):
    """stiffness · (q − rest_position)."""

    stiffness: float
    rest_position: float


@dataclass(frozen=True)
class OneSidedSpring(SimulatorElement):
    """stiffness · (q − position) above the position if ``side`` is 1, below it if −1, and nothing elsewhere."""

    stiffness: float
    position: float
    side: float


@dataclass(frozen=True)
class TorqueTransfer(SimulatorElement):
    """The joint is also driven by a share of the actuator torque of another, the joint ``source``."""

    source: int
    share: float
