"""MCAP files with messages of makers' robots, encoded by mcap_ros2 with the makers' definitions.

Sources: github.com/unitreerobotics/unitree_ros2; frankarobotics/franka_ros and franka_ros2; for ANYmal, the definitions
in the bags of public data sets.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.writer import Writer as Ros2Writer

Array = np.ndarray
Message = dict[str, Any]

GO = "unitree_go/msg/LowState"
GO_LEGS = ("FR", "FL", "RR", "RL")  # in the order of the maker
GO_JOINTS = tuple(f"{leg}_{part}_joint" for leg in GO_LEGS for part in ("hip", "thigh", "calf"))

SEPARATOR = "=" * 80
HEADER = """\
builtin_interfaces/Time stamp
string frame_id
"""
TIME = """\
int32 sec
uint32 nanosec
"""
JOINT_STATE = """\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
"""
STANDARD = {"std_msgs/Header": HEADER, "builtin_interfaces/Time": TIME}

GO_LOW_STATE = """\
uint8[2] head
uint8 level_flag
uint8 frame_reserve
uint32[2] sn
uint32[2] version
uint16 bandwidth
IMUState imu_state
MotorState[20] motor_state
BmsState bms_state
int16[4] foot_force
int16[4] foot_force_est
uint32 tick
uint8[40] wireless_remote
uint8 bit_flag
float32 adc_reel
int8 temperature_ntc1
int8 temperature_ntc2
float32 power_v
float32 power_a
uint16[4] fan_frequency
uint32 reserve
uint32 crc
"""
GO_PARTS = {
    "unitree_go/IMUState": """\
float32[4] quaternion
float32[3] gyroscope
float32[3] accelerometer
float32[3] rpy
int8 temperature
""",
    "unitree_go/MotorState": """\
uint8 mode
float32 q
float32 dq
float32 ddq
float32 tau_est
float32 q_raw
float32 dq_raw
float32 ddq_raw
int8 temperature
uint32 lost
uint32[2] reserve
""",
    "unitree_go/BmsState": """\
uint8 version_high
uint8 version_low
uint8 status
uint8 soc
int32 current
uint16 cycle
int8[2] bq_ntc
int8[2] mcu_ntc
uint16[15] cell_vol
""",
}
HG_LOW_STATE = """\
uint32[2] version
uint8 mode_pr
uint8 mode_machine
uint32 tick
IMUState imu_state
MotorState[35] motor_state
uint8[40] wireless_remote
uint32[4] reserve
uint32 crc
"""
HG_PARTS = {
    "unitree_hg/IMUState": """\
float32[4] quaternion
float32[3] gyroscope
float32[3] accelerometer
float32[3] rpy
int16 temperature
""",
    "unitree_hg/MotorState": """\
uint8 mode
float32 q
float32 dq
float32 ddq
float32 tau_est
int16[2] temperature
float32 vol
uint32[2] sensor
uint32 motorstate
uint32[4] reserve
""",
}
_FRANKA_ERRORS = {
    "franka_msgs/Errors": """\
bool joint_position_limits_violation
bool cartesian_position_limits_violation
bool self_collision_avoidance_violation
"""
}
FRANKA_STATE = """\
std_msgs/Header header
float64[6] cartesian_collision
float64[6] cartesian_contact
float64[7] q
float64[7] q_d
float64[7] dq
float64[7] dq_d
float64[7] theta
float64[7] dtheta
float64[7] tau_j
float64[7] dtau_j
float64[7] tau_j_d
float64[6] k_f_ext_hat_k
float64[2] elbow
float64[2] elbow_d
float64[7] joint_collision
float64[7] joint_contact
float64[6] o_f_ext_hat_k
float64[7] tau_ext_hat_filtered
float64 m_ee
float64[3] f_x_cee
float64[9] i_ee
float64 m_load
float64[3] f_x_cload
float64[9] i_load
float64 m_total
float64[3] f_x_ctotal
float64[9] i_total
float64[16] o_t_ee
float64[16] o_t_ee_d
float64[16] f_t_ee
float64[16] ee_t_k
float64 time
float64 control_command_success_rate
uint8 ROBOT_MODE_OTHER=0
uint8 ROBOT_MODE_IDLE=1
uint8 ROBOT_MODE_MOVE=2
uint8 robot_mode
franka_msgs/Errors current_errors
franka_msgs/Errors last_motion_errors
"""
FRANKA_ROBOT_STATE = """\
### Default parts of the message
std_msgs/Header header

### Indicates which dimensions have an active contact/collision flag raised
CollisionIndicators collision_indicators

# The joint state consisting out of position (q), velocity (dq) and effort (tau_J)
sensor_msgs/JointState measured_joint_state
sensor_msgs/JointState desired_joint_state
float64[7] ddq_d
float64 time
uint8 ROBOT_MODE_OTHER=0
uint8 robot_mode
Errors current_errors
"""
_COLLISION_INDICATORS = {
    "franka_msgs/CollisionIndicators": """\
bool[6] is_cartesian_linear_collision
float64[7] is_joint_contact
""",
    "sensor_msgs/JointState": JOINT_STATE,
}
ACTUATOR_READINGS = """\
SeActuatorReading[] readings
"""
ACTUATOR_PARTS = {
    "series_elastic_actuator_msgs/SeActuatorReading": """\
std_msgs/Header header
# State
SeActuatorState state
SeActuatorCommand commanded
""",
    "series_elastic_actuator_msgs/SeActuatorState": """\
std_msgs/Header header
string name
uint32 statusword
float64 current
float64 gear_position
float64 gear_velocity
float64 joint_position
float64 joint_velocity
float64 joint_acceleration
float64 joint_torque
""",
    "series_elastic_actuator_msgs/SeActuatorCommand": """\
std_msgs/Header header
string name
int16 MODE_NA = 0
int16 MODE_FREEZE = 1
int16 mode
float64 current
float64 position
float64 velocity
float64 joint_torque
float32 pid_gains_p
""",
}


def definition(main: str, parts: Mapping[str, str] = MappingProxyType({})) -> str:
    """A definition as bags contain it: that of a message, and those of all types within."""
    texts = [main, *(f"MSG: {name}\n{text}" for name, text in {**parts, **STANDARD}.items())]
    return f"{SEPARATOR}\n".join(texts)


DEFINITIONS = {
    "unitree_go/msg/LowState": definition(GO_LOW_STATE, GO_PARTS),
    "unitree_hg/msg/LowState": definition(HG_LOW_STATE, HG_PARTS),
    "franka_msgs/msg/FrankaState": definition(FRANKA_STATE, _FRANKA_ERRORS),
    "franka_msgs/msg/FrankaRobotState": definition(FRANKA_ROBOT_STATE, {**_FRANKA_ERRORS, **_COLLISION_INDICATORS}),
    "series_elastic_actuator_msgs/msg/SeActuatorReadings": definition(ACTUATOR_READINGS, ACTUATOR_PARTS),
}


@dataclass
class Topic:
    """Messages of one type.

    Attributes
    ----------
    type_name
        Their type.
    data
        The messages as CDR.
    name
        The topic.
    text
        The definition in the file; None: that in `DEFINITIONS`.
    encoding
        The language of the definition.
    every
        Only one of so many messages is written.
    """

    type_name: str
    data: Sequence[bytes]
    name: str = "/lowstate"
    text: str | None = None
    encoding: str = "ros2msg"
    every: int = 1


def encoded(type_name: str, messages: Sequence[Message], text: str | None = None) -> list[bytes]:
    """Messages, given as nested dictionaries, as CDR."""
    stream = BytesIO()
    writer = Ros2Writer(stream)
    schema = writer.register_msgdef(type_name, DEFINITIONS[type_name] if text is None else text)
    for i, message in enumerate(messages):
        writer.write_message("/x", schema, message, log_time=i)
    writer.finish()  # type: ignore[no-untyped-call]
    return [message.data for _, _, message in make_reader(BytesIO(stream.getvalue())).iter_messages()]


def write_topics(path: Path, topics: Sequence[Topic], times: Sequence[int]) -> Path:
    """Write topics, whose messages have the same log times [ns], message by message in turn."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        channels = []
        for topic in topics:
            text = DEFINITIONS[topic.type_name] if topic.text is None else topic.text
            schema = writer.register_schema(topic.type_name, topic.encoding, text.encode())
            channels.append(writer.register_channel(topic.name, "cdr", schema))
        for i, time in enumerate(times):
            for channel, topic in zip(channels, topics, strict=True):
                if i % topic.every:
                    continue
                writer.add_message(channel, time, topic.data[i], time, i)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def random_messages(type_name: str, count: int, fill: Callable[[int, Message], None], seed: int = 0) -> list[Message]:
    """Messages whose numbers are all random, but for what ``fill`` sets in each."""
    rng = np.random.default_rng(seed)
    messages = []
    for i in range(count):
        message = _random(type_name.replace("/msg/", "/"), _types(type_name), rng)
        fill(i, message)
        messages.append(message)
    return messages


def _types(type_name: str) -> dict[str, list[tuple[str, str]]]:
    return parse_types(type_name, DEFINITIONS[type_name])


def parse_types(type_name: str, text: str) -> dict[str, list[tuple[str, str]]]:
    """Kind and name of each field, of a type and of those within it, in a definition."""
    main, *parts = text.split(f"{SEPARATOR}\n")
    texts = {type_name.replace("/msg/", "/"): main}
    for part in parts:
        line, _, body = part.partition("\n")
        texts[line.removeprefix("MSG: ")] = body
    types = {}
    for name, text in texts.items():
        lines = [line.split("#")[0].split() for line in text.splitlines()]
        package = name.partition("/")[0]
        types[name] = []
        for words in lines:
            if len(words) in (2, 3) and "=" not in "".join(words[1:]):  # no constant
                kind = "std_msgs/Header" if words[0] == "Header" else words[0]
                is_own = kind[0].isupper()
                types[name].append((f"{package}/{kind}" if is_own else kind, words[1]))
    return types


def _random(kind: str, types: dict[str, list[tuple[str, str]]], rng: np.random.Generator) -> Any:
    base, bracket, rest = kind.partition("[")
    if bracket:
        length = int(rest[:-1]) if rest != "]" else 0
        return [_random(base, types, rng) for _ in range(length)]
    if base == "string":
        return "text" * int(rng.integers(3))
    if base == "bool":
        return bool(rng.integers(2))
    if base.startswith("float"):
        return float(np.float32(rng.normal()))
    if base.startswith(("int", "uint")):
        return int(rng.integers(0, 100))
    return {name: _random(inner, types, rng) for inner, name in types[base]}


def low_state_topic(columns: Mapping[str, Array], joints: Sequence[str], name: str = "/lowstate") -> Topic:
    """Columns of a table as `unitree_go/LowState`, whose numbers are float32; flags of the feet as a force of 90."""
    messages: list[Message] = []
    for i in range(len(columns["t"])):
        row = {key: float(x[i]) for key, x in columns.items()}
        motors = [{"q": row[f"q_{joint}"], "dq": row[f"v_{joint}"], "tau_est": row[f"tau_{joint}"]} for joint in joints]
        message: Message = {"motor_state": motors, "tick": i}
        if "imu_wx" in row:
            message["imu_state"] = {
                "quaternion": [row[f"imu_q{part}"] for part in "wxyz"],
                "gyroscope": [row[f"imu_w{axis}"] for axis in "xyz"],
                "accelerometer": [row[f"imu_a{axis}"] for axis in "xyz"],
            }
            message["foot_force"] = [int(90 * row[f"contact_{leg}_foot"]) for leg in GO_LEGS]
            message["bit_flag"] = int(row["contact_rope"])
        messages.append(message)
    return Topic(GO, encoded(GO, messages), name)
