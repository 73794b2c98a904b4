"""Fields of messages that are not joint states, addressed by path, and the messages of makers whose fields are known.

A path is the names of nested fields with dots, and the index of an element in brackets, as in ``motor_state[3].q`` or
``imu_state.gyroscope``. The index ``{i}`` stands for every joint.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from idtool.common.dataclass import dataclass

SIGNAL_KEYS = ("q", "v", "tau", "qcmd", "vcmd")
JOINT_NAME = "name"  # key of the joints' names
STAMP = "t"
EACH = "{i}"

Step = str | int  # name of a field, index of an element, or `EACH`
Path = tuple[Step, ...]

_NAME = r"[A-Za-z]\w*"
_STEP = rf"{_NAME}(?:\[(?:\d{{1,6}}|\{{i\}})\])?"
_PATH = re.compile(rf"{_STEP}(?:\.{_STEP})*")
_PART = re.compile(rf"{_NAME}|\d+|\{{i\}}")
_ABOVE = re.compile(r"(.+?)\s*>\s*(\S+)")
_AXES = ("x", "y", "z")
_CHANNELS = {
    "imu.orientation": ("imu_qx", "imu_qy", "imu_qz", "imu_qw"),
    "imu.orientation_wxyz": ("imu_qw", "imu_qx", "imu_qy", "imu_qz"),
    "imu.gyro": ("imu_wx", "imu_wy", "imu_wz"),
    "imu.accel": ("imu_ax", "imu_ay", "imu_az"),
}
_OF_PLACE = {  # prefix of a key that ends in a name of the user's
    "contact.": ("contact_{}",),
    "force.": tuple(f"force_{{}}_{axis}" for axis in _AXES),
    "moment.": tuple(f"force_{{}}_m{axis}" for axis in _AXES),
}


@dataclass(frozen=True)
class MessageField:
    """A field that is read.

    Attributes
    ----------
    text
        Its path as it was written.
    path
        Its steps.
    channels
        The channels of its numbers; empty for signals and names of joints and for the stamp.
    threshold
        Value above which a contact is closed; None: the value is the flag.
    """

    text: str
    path: Path
    channels: tuple[str, ...] = ()
    threshold: float | None = None


def parse_field(key: str, text: str) -> MessageField:
    """A field from its key and its path.

    Raises
    ------
    ValueError
        If one of them cannot be used.
    """
    channels = channels_of(key)
    path_text, threshold = text, None
    match = _ABOVE.fullmatch(text)
    if match:
        if not key.startswith("contact."):
            raise ValueError("only the field of a contact has a threshold")
        path_text, limit = match.groups()
        try:
            threshold = float(limit)
        except ValueError:
            raise ValueError(f"the threshold {limit} is not a number") from None
    path = _parse_path(path_text)
    of_joints = not channels and key != STAMP
    if path.count(EACH) != int(of_joints):
        raise ValueError(
            f"{path_text} needs one index {EACH}, which stands for the joint, as in motor_state[{EACH}].q"
            if of_joints
            else f"{path_text} is not of a joint, so that {EACH} has no meaning; give the index"
        )
    return MessageField(path_text, path, channels, threshold)


def channels_of(key: str) -> tuple[str, ...]:
    """Channels of the numbers of a key's field; empty for the signals and names of joints and for the stamp.

    Raises
    ------
    ValueError
        If there is no such key.
    """
    if key in (*SIGNAL_KEYS, JOINT_NAME, STAMP):
        return ()
    if key in _CHANNELS:
        return _CHANNELS[key]
    for prefix, channels in _OF_PLACE.items():
        place = key.removeprefix(prefix)
        if place and place != key:
            return tuple(channel.format(place) for channel in channels)
    known = ", ".join((*SIGNAL_KEYS, JOINT_NAME, STAMP, *_CHANNELS))
    places = ", ".join(f"{prefix}<name>" for prefix in _OF_PLACE)
    raise ValueError(f"unknown field; give one of {known}, {places}")


def _parse_path(text: str) -> Path:
    if not _PATH.fullmatch(text):
        raise ValueError(f"{text} is not a path such as motor_state[{EACH}].q or imu_state.gyroscope")
    parts = _PART.findall(text)
    return tuple(int(part) if part.isdigit() else part for part in parts)


# Fields of the makers' messages, by type; several tables where the field names differ between versions.
# Sources: github.com/unitreerobotics/unitree_ros2; frankarobotics/franka_ros and franka_ros2 (franka_msgs); for ANYmal,
# the definitions of anymal_msgs, any_msgs and series_elastic_actuator_msgs in the bags of public data sets.
_UNITREE = {
    "q": "motor_state[{i}].q",
    "v": "motor_state[{i}].dq",
    "tau": "motor_state[{i}].tau_est",
    "imu.orientation_wxyz": "imu_state.quaternion",
    "imu.gyro": "imu_state.gyroscope",
    "imu.accel": "imu_state.accelerometer",
}
_JOINT_STATE = {JOINT_NAME: "name[{i}]", "q": "position[{i}]", "v": "velocity[{i}]", "tau": "effort[{i}]"}
_ACTUATOR = {
    JOINT_NAME: "name",
    "q": "joint_position",
    "v": "joint_velocity",
    "tau": "joint_torque",
}


def _within(outer: str, fields: Mapping[str, str]) -> dict[str, str]:
    return {key: f"{outer}.{path}" for key, path in fields.items()}


KNOWN_MESSAGES: Mapping[str, Sequence[Mapping[str, str]]] = {
    "unitree_go/LowState": (_UNITREE,),
    "unitree_hg/LowState": (_UNITREE,),
    "franka_msgs/FrankaState": (
        {"q": "q[{i}]", "v": "dq[{i}]", "tau": "tau_J[{i}]"},
        {"q": "q[{i}]", "v": "dq[{i}]", "tau": "tau_j[{i}]"},
    ),
    "franka_msgs/FrankaRobotState": (_within("measured_joint_state", _JOINT_STATE),),
    "anymal_msgs/AnymalState": (_within("joints", _JOINT_STATE),),
    "series_elastic_actuator_msgs/SeActuatorReadings": (
        {STAMP: "readings[0].state.header.stamp", **_within("readings[{i}].state", _ACTUATOR)},
    ),
}


@dataclass(frozen=True)
class Preset:
    """A robot whose messages are known but do not name its joints.

    Attributes
    ----------
    message
        Type of the messages.
    joints
        Names of the joints in the maker's URDF, in the order of the messages; None where there is no joint.
    """

    message: str
    joints: tuple[str | None, ...]


def _named(pattern: str, *parts: str) -> tuple[str, ...]:
    return tuple(pattern.format(part) for part in parts)


_SEVEN = ("1", "2", "3", "4", "5", "6", "7")
_QUADRUPED_LEG = ("hip", "thigh", "calf")
_G1_LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
_H1_2_LEG = ("hip_yaw", "hip_pitch", "hip_roll", "knee", "ankle_pitch", "ankle_roll")
_SHORT_ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow")
_ARM = (*_SHORT_ARM, "wrist_roll", "wrist_pitch", "wrist_yaw")

# Source of the order: the joint indices in the examples of unitree_sdk2.
PRESETS: Mapping[str, Preset] = {
    "unitree_go": Preset(
        "unitree_go/LowState",
        tuple(f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in _QUADRUPED_LEG),
    ),
    "unitree_h1": Preset(
        "unitree_go/LowState",
        (
            *_named("right_{}_joint", "hip_roll", "hip_pitch", "knee"),
            *_named("left_{}_joint", "hip_roll", "hip_pitch", "knee"),
            "torso_joint",
            "left_hip_yaw_joint",
            "right_hip_yaw_joint",
            None,
            "left_ankle_joint",
            "right_ankle_joint",
            *_named("right_{}_joint", *_SHORT_ARM),
            *_named("left_{}_joint", *_SHORT_ARM),
        ),
    ),
    "unitree_g1": Preset(
        "unitree_hg/LowState",
        (
            *_named("left_{}_joint", *_G1_LEG),
            *_named("right_{}_joint", *_G1_LEG),
            *_named("waist_{}_joint", "yaw", "roll", "pitch"),
            *_named("left_{}_joint", *_ARM),
            *_named("right_{}_joint", *_ARM),
        ),
    ),
    "unitree_h1_2": Preset(
        "unitree_hg/LowState",
        (
            *_named("left_{}_joint", *_H1_2_LEG),
            *_named("right_{}_joint", *_H1_2_LEG),
            "torso_joint",
            *_named("left_{}_joint", *_ARM),
            *_named("right_{}_joint", *_ARM),
        ),
    ),
    "franka_panda": Preset("franka_msgs/FrankaState", _named("panda_joint{}", *_SEVEN)),
    "franka_fr3": Preset("franka_msgs/FrankaState", _named("fr3_joint{}", *_SEVEN)),
}
