"""Messages in CDR of sensors that are of no joint: the numbers in each, and the channels that they become.

Source: the ROS 2 packages sensor_msgs, geometry_msgs and std_msgs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_AXES = ("x", "y", "z")
_QUATERNION = ("x", "y", "z", "w")
_COVARIANCE = ("",) * 9


@dataclass(frozen=True)
class SensorType:
    """A type of message.

    Attributes
    ----------
    has_header
        True if it begins with a stamp and the name of a frame.
    numbers
        Channel of each number, in which {} stands for the name of the topic; empty: the number is not read.
    dtype
        Type of the numbers, without byte order.
    """

    has_header: bool
    numbers: tuple[str, ...]
    dtype: str = "f8"

    def number_type(self, order: str) -> np.dtype[np.floating]:
        """Type of the numbers with a byte order."""
        return np.dtype(f"{order}{self.dtype}")


def _named(pattern: str, parts: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{pattern}{part}" for part in parts)


SENSOR_TYPES = {
    "sensor_msgs/Imu": SensorType(
        has_header=True,
        numbers=(
            *_named("imu_q", _QUATERNION),
            *_COVARIANCE,
            *_named("imu_w", _AXES),
            *_COVARIANCE,
            *_named("imu_a", _AXES),
            *_COVARIANCE,
        ),
    ),
    "geometry_msgs/WrenchStamped": SensorType(
        has_header=True, numbers=(*_named("force_{}_", _AXES), *_named("force_{}_m", _AXES))
    ),
    "std_msgs/Bool": SensorType(has_header=False, numbers=("contact_{}",), dtype="u1"),
}
