"""`DataSummary`: ranges of the logged motion and torque, on which the search for a missing effect depends."""

from __future__ import annotations

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.robot.model import RobotModel


@dataclass(frozen=True)
class Burst:
    """Time intervals in which something acts on the robot that does not otherwise.

    Attributes
    ----------
    windows
        Begin and end of each [s], in order.
    link
        Link on which a force with the profile explains them; empty: any may, with a constant wrench.
    point
        Point of that link at which the force acts, in its frame [m].
    profile
        Times [s] and shares of the force, with straight lines between; none: it is constant.
    log
        File name of the log in which it acts; empty: in all.
    """

    windows: tuple[tuple[float, float], ...]
    link: str = ""
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    profile: tuple[tuple[float, float], ...] = ()
    log: str = ""

    @property
    def parameter_count(self) -> int:
        """Count of the numbers that describe it."""
        return 2 * len(self.windows) + len(self.profile) + len(self.point) * any(self.point)


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
        Time intervals in which the residual is unusually large, by what may act in them.
    fixed_inertia
        True if the URDF's inertia is taken as true.
    has_balls
        True if contacts of a floating base are balls.
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
    bursts: tuple[Burst, ...] = ()
    fixed_inertia: bool = False
    has_balls: bool = False

    @property
    def q_range(self) -> Array:
        """Difference between the greatest and the least position, shape (nv,) [rad or m]."""
        return self.q_max - self.q_min

    def has_effect(self, effect: str, owner: str) -> bool:
        """True if the torque equation has the effect on a joint or link."""
        return any(key[:2] == (effect, owner) for key in self.effect_keys)
