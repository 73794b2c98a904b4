"""`DataSummary`: ranges of the logged motion and torque, on which the search for a missing effect depends."""

from __future__ import annotations

from dataclasses import dataclass

from idtool.common.arrays import Array
from idtool.robot.model import RobotModel


@dataclass(frozen=True)
class DataSummary:
    """Ranges of all training data.

    Attributes
    ----------
    model
        The robot.
    effect_keys
        Keys of the effects in the torque equation.
    q_min, q_max
        Least and greatest position, shape (nv,) [rad or m].
    rms_velocity
        Shape (nv,) [rad/s or m/s].
    peak_torque
        Shape (nv,) [N·m or N].
    velocity_deadband
        Speed below which the sign of a velocity is lost in its noise, shape (nv,) [rad/s or m/s].
    dt
        Sample time [s].
    duration
        Duration of the longest log [s].
    band_hz
        The filter's cut-off [Hz].
    bursts
        Time intervals in which the residual is unusually large [s], shape (k, 2).
    fixed_inertia
        True if the URDF's inertia is taken as true.
    """

    model: RobotModel
    effect_keys: frozenset[tuple[str | float, ...]]
    q_min: Array
    q_max: Array
    rms_velocity: Array
    peak_torque: Array
    velocity_deadband: Array
    dt: float
    duration: float
    band_hz: float
    bursts: tuple[tuple[float, float], ...] = ()
    fixed_inertia: bool = False

    @property
    def q_range(self) -> Array:
        """Difference between the greatest and the least position, shape (nv,) [rad or m]."""
        return self.q_max - self.q_min

    def has_effect(self, effect: str, owner: str) -> bool:
        """True if the torque equation has the effect on a joint or link."""
        return any(key[:2] == (effect, owner) for key in self.effect_keys)
