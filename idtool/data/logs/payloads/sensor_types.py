"""Messages in CDR of sensors that are of no joint: the numbers in each, and the channels that they become.

Source: the ROS 2 packages sensor_msgs, geometry_msgs, nav_msgs and std_msgs.
"""

from __future__ import annotations

import numpy as np

from idtool.common.dataclass import dataclass

_AXES = ("x", "y", "z")
_QUATERNION = ("x", "y", "z", "w")
_COVARIANCE = ("",) * 9


@dataclass(frozen=True)
class SensorType:
    """A type of message.

    Attributes
    ----------
    definition
        Its definition.
    has_header
        True if it begins with a stamp and the name of a frame.
    numbers
        Channel of each number, in which {} stands for the name of the topic; empty: the number is not read.
    dtype
        Type of the numbers, without byte order.
    texts
        Number of texts between the header and the numbers.
    """

    definition: str
    has_header: bool
    numbers: tuple[str, ...]
    dtype: str = "f8"
    texts: int = 0

    def number_type(self, order: str) -> np.dtype[np.floating]:
        """Type of the numbers with a byte order."""
        return np.dtype(f"{order}{self.dtype}")


def _named(pattern: str, parts: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{pattern}{part}" for part in parts)


_SEPARATOR = "=" * 80 + "\n"
_HEADER = (
    f"{_SEPARATOR}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_SEPARATOR}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
_VECTOR = f"{_SEPARATOR}MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
_IMU = (
    "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
    "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
    "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n"
    f"{_HEADER}{_SEPARATOR}MSG: geometry_msgs/Quaternion\n"
    f"float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n{_VECTOR}"
)
_WRENCH = (
    f"std_msgs/Header header\ngeometry_msgs/Wrench wrench\n{_HEADER}"
    f"{_SEPARATOR}MSG: geometry_msgs/Wrench\ngeometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n{_VECTOR}"
)
_POSE = (*_named("base_", _AXES), *_named("base_q", _QUATERNION))
_POSE_PARTS = (
    f"{_SEPARATOR}MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
    f"{_SEPARATOR}MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    f"{_SEPARATOR}MSG: geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
)
_POSE_STAMPED = f"std_msgs/Header header\ngeometry_msgs/Pose pose\n{_HEADER}{_POSE_PARTS}"
_ODOMETRY = (
    "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
    f"geometry_msgs/TwistWithCovariance twist\n{_HEADER}{_POSE_PARTS}"
    f"{_SEPARATOR}MSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance\n"
    f"{_SEPARATOR}MSG: geometry_msgs/TwistWithCovariance\ngeometry_msgs/Twist twist\nfloat64[36] covariance\n"
    f"{_SEPARATOR}MSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n{_VECTOR}"
)

SENSOR_TYPES = {
    "sensor_msgs/Imu": SensorType(
        definition=_IMU,
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
        definition=_WRENCH,
        has_header=True,
        numbers=(*_named("force_{}_", _AXES), *_named("force_{}_m", _AXES)),
    ),
    "geometry_msgs/PoseStamped": SensorType(definition=_POSE_STAMPED, has_header=True, numbers=_POSE),
    # the twist is not read
    "nav_msgs/Odometry": SensorType(definition=_ODOMETRY, has_header=True, numbers=_POSE, texts=1),
    "std_msgs/Bool": SensorType(definition="bool data\n", has_header=False, numbers=("contact_{}",), dtype="u1"),
}
