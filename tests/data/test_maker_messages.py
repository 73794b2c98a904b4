"""Logs of makers' robots, whose messages are not joint states, against what mcap_ros2 decodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import idtool
from maker_messages import (
    DEFINITIONS,
    GO,
    GO_JOINTS,
    JOINT_STATE,
    SEPARATOR,
    Message,
    Topic,
    definition,
    encoded,
    random_messages,
    write_topics,
)
from mcap.reader import make_reader
from mcap_ros2._cdr import CdrWriter, EncapsulationKind
from mcap_ros2.decoder import DecoderFactory
from sentences import sentences

from idtool.api.log import Log
from idtool.common.exceptions import ConfigError, LogError
from idtool.data.logs import JointLog, read_log
from idtool.data.logs.message_options import MessageOptions
from idtool.data.logs.sensor_channels import SensorOptions, finite_samples
from idtool.robot.message_fields import KNOWN_MESSAGES, PRESETS, parse_field

Array = np.ndarray
HG = "unitree_hg/msg/LowState"
READINGS = "series_elastic_actuator_msgs/msg/SeActuatorReadings"
ROBOT_STATE = "franka_msgs/msg/FrankaRobotState"
COUNT = 40
TIMES = [10**18 + 2_000_000 * i for i in range(COUNT)]
SIX_FIELDS = {"q": "motor_state[{i}].q", "v": "motor_state[{i}].dq", "tau": "motor_state[{i}].tau_est"}


def nothing(i: int, message: Message) -> None:
    """Leave a message as it is."""


def topic_of(type_name: str, fill: Callable[[int, Message], None] = nothing, **options: Any) -> Topic:
    return Topic(type_name, encoded(type_name, random_messages(type_name, COUNT, fill)), **options)


def write(path: Path, type_name: str, fill: Callable[[int, Message], None] = nothing, **options: Any) -> Path:
    return write_topics(path, [topic_of(type_name, fill, **options)], TIMES)


def decoded(path: Path, topic: str = "/lowstate") -> list[Any]:
    """The messages as mcap_ros2 decodes them."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [message for _, _, _, message in reader.iter_decoded_messages(topics=[topic])]


def read(path: Path, **options: Any) -> JointLog:
    return read_log(path, sensors=SensorOptions(), messages=MessageOptions(**options))


def check_signals(log: JointLog, expected: Mapping[str, Callable[[Any], Sequence[float]]], messages: list[Any]) -> None:
    assert log.signals.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(log.signals[name], [values(message) for message in messages])


def channel_values(log: JointLog, *names: str) -> Array:
    """Values of channels in the order of their times, shape (N, names)."""
    return np.stack([finite_samples(log.channels[name]).x for name in names], axis=1)


@pytest.mark.parametrize(("type_name", "preset"), [(GO, "unitree_go"), (HG, "unitree_g1"), (HG, "unitree_h1_2")])
def test_unitree(tmp_path: Path, type_name: str, preset: str) -> None:
    path = write(tmp_path / "log.mcap", type_name)
    log = read(path, preset=preset)
    joints = PRESETS[preset].joints
    messages = decoded(path)
    motors = [message.motor_state[: len(joints)] for message in messages]
    assert log.joints == joints
    for name, field in {"q": "q", "v": "dq", "tau": "tau_est"}.items():
        expected = [[getattr(motor, field) for motor in row] for row in motors]
        np.testing.assert_array_equal(log.signals[name], expected)
    np.testing.assert_array_equal(log.t, np.array(TIMES) // 10**9 + np.array(TIMES) % 10**9 / 1e9)
    states = [message.imu_state for message in messages]
    orientation = channel_values(log, "imu_qw", "imu_qx", "imu_qy", "imu_qz")
    np.testing.assert_array_equal(orientation, [state.quaternion for state in states])
    gyro = channel_values(log, "imu_wx", "imu_wy", "imu_wz")
    np.testing.assert_array_equal(gyro, [state.gyroscope for state in states])
    accelerometer = channel_values(log, "imu_ax", "imu_ay", "imu_az")
    np.testing.assert_array_equal(accelerometer, [state.accelerometer for state in states])
    np.testing.assert_array_equal(log.channels["imu_wx"].t, log.t)
    assert log.notices == ()


def test_motor_without_a_joint_is_skipped(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", GO)
    log = read(path, preset="unitree_h1")
    assert len(log.joints) == 19
    knee, ankle = log.joints.index("right_knee_joint"), log.joints.index("left_ankle_joint")
    expected = [[message.motor_state[2].q, message.motor_state[10].q] for message in decoded(path)]
    np.testing.assert_array_equal(log.signals["q"][:, [knee, ankle]], expected)


@pytest.mark.parametrize(("torque", "preset"), [("tau_J", "franka_panda"), ("tau_j", "franka_fr3")])
def test_franka_state_of_both_packages(tmp_path: Path, torque: str, preset: str) -> None:
    """The field of the torque has another name in franka_ros2. The stamp in the header is the time."""

    def fill(i: int, message: Message) -> None:
        message["header"]["stamp"] = {"sec": 100, "nanosec": 1_000_000 * i}

    type_name = "franka_msgs/msg/FrankaState"
    text = DEFINITIONS[type_name].replace(" tau_j\n", f" {torque}\n")
    log = read(write(tmp_path / "log.mcap", type_name, fill, text=text), preset=preset)
    expected = {"q": lambda m: m.q, "v": lambda m: m.dq, "tau": lambda m: m.tau_j}
    check_signals(log, expected, decoded(write(tmp_path / "same.mcap", type_name, fill)))
    assert log.joints == PRESETS[preset].joints
    np.testing.assert_allclose(log.t, 100 + 1e-3 * np.arange(COUNT), rtol=0, atol=1e-12)


def test_nested_joint_state(tmp_path: Path) -> None:
    """The joints are named in the message. Frames with names of other lengths move all fields that follow."""

    def fill(i: int, message: Message) -> None:
        message["header"]["stamp"] = {"sec": 100, "nanosec": 1_000_000 * i}
        for part in ("measured_joint_state", "desired_joint_state"):
            values = np.random.default_rng(i).normal(size=(3, 2)).tolist()
            message[part] |= dict(zip(("position", "velocity", "effort"), values, strict=True))
            message[part]["name"] = ["fr3_joint1", "fr3_joint2"]

    path = write(tmp_path / "log.mcap", ROBOT_STATE, fill, name="/franka")
    log = read(path)
    state = [message.measured_joint_state for message in decoded(path, "/franka")]
    expected = {"q": lambda m: m.position, "v": lambda m: m.velocity, "tau": lambda m: m.effort}
    check_signals(log, expected, state)
    assert log.joints == ("fr3_joint1", "fr3_joint2")
    assert log.notices == ()


def test_readings_of_anymal(tmp_path: Path) -> None:
    """A sequence of messages, each with a stamp, texts of its own, and the joint's name."""
    names = ["LF_HAA", "LF_HFE", "LF_KFE"]

    def fill(i: int, message: Message) -> None:
        message["readings"] = []
        rng = np.random.default_rng(i)
        header = {"stamp": {"sec": 7, "nanosec": 2_500_000 * i}, "frame_id": "f" * int(rng.integers(9))}
        for name in names:
            state = {"header": header, "name": name}
            state |= {key: float(rng.normal()) for key in ("joint_position", "joint_velocity", "joint_torque")}
            message["readings"].append({"header": header, "state": state, "commanded": {"header": header}})

    path = write(tmp_path / "log.mcap", READINGS, fill)
    log = read(path)
    rows = [[reading.state for reading in message.readings] for message in decoded(path)]
    expected = {
        "q": lambda row: [state.joint_position for state in row],
        "v": lambda row: [state.joint_velocity for state in row],
        "tau": lambda row: [state.joint_torque for state in row],
    }
    check_signals(log, expected, rows)  # type: ignore[arg-type]
    assert log.joints == tuple(names)
    np.testing.assert_allclose(log.t, 7 + 2.5e-3 * np.arange(COUNT), rtol=0, atol=1e-12)


ROBOT = """\
std_msgs/Header header
string<=20 serial "none"   # a text before the numbers
uint8 MODES=3
Leg[<=4] legs
Leg[2] arms
Empty nothing
bool[3] touches
geometry_msgs/Vector3 gyro
geometry_msgs/Quaternion attitude
float64[] currents
"""
ROBOT_PARTS = {
    "robot_msgs/Leg": "uint8 mode\nstring name\nfloat32 q\nint8 temperature\nfloat64 tau\nint16[3] raw\n",
    "robot_msgs/Empty": "",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
}
ROBOT_TYPE = "robot_msgs/msg/State"
ROBOT_TEXT = definition(ROBOT, ROBOT_PARTS)
ROBOT_FIELDS = {
    "name": "legs[{i}].name",
    "q": "legs[{i}].q",
    "tau": "legs[{i}].tau",
    "imu.gyro": "gyro",
    "imu.orientation": "attitude",
    "imu.accel": "arms[1].raw",
    "contact.left": "touches[1]",
    "contact.right": "legs[0].raw[2] > 40",
    "force.hand": "gyro",
}


def robot_message(i: int) -> Message:
    """A message whose texts, and with them the places of all that follows, differ from one to the next."""
    rng = np.random.default_rng(i)

    def leg(name: str) -> Message:
        numbers = {"mode": 1, "q": float(np.float32(rng.normal())), "temperature": -5, "tau": float(rng.normal())}
        return {**numbers, "name": name, "raw": rng.integers(-9, 90, 3).tolist()}

    def vector(axes: str) -> Message:
        return {axis: float(rng.normal()) for axis in axes}

    return {
        "header": {"stamp": {"sec": 3, "nanosec": 5_000_000 * i}, "frame_id": "x" * (i % 5)},
        "serial": "s" * (i % 3),
        "legs": [leg("hip"), leg("knee"), leg("ankle")],
        "arms": [leg("a" * (i % 7)), leg("")],
        "nothing": {},
        "touches": [True, bool(i % 2), False],
        "gyro": vector("xyz"),
        "attitude": vector("xyzw"),
        "currents": [1.0] * (i % 4),
    }


def robot_topic(**options: Any) -> Topic:
    data = encoded(ROBOT_TYPE, [robot_message(i) for i in range(COUNT)], ROBOT_TEXT)
    return Topic(ROBOT_TYPE, **{"data": data, "text": ROBOT_TEXT, **options})


def test_every_kind_of_field(tmp_path: Path) -> None:
    path = write_topics(tmp_path / "log.mcap", [robot_topic()], TIMES)
    log = read(path, fields=ROBOT_FIELDS)
    messages = decoded(path)
    expected = {"q": lambda m: [leg.q for leg in m.legs], "tau": lambda m: [leg.tau for leg in m.legs]}
    check_signals(log, expected, messages)
    assert log.joints == ("hip", "knee", "ankle")
    np.testing.assert_allclose(log.t, 3 + 5e-3 * np.arange(COUNT), rtol=0, atol=1e-12)
    rows = {
        ("imu_wx", "imu_wy", "imu_wz"): [(m.gyro.x, m.gyro.y, m.gyro.z) for m in messages],
        ("force_hand_x", "force_hand_y", "force_hand_z"): [(m.gyro.x, m.gyro.y, m.gyro.z) for m in messages],
        ("imu_qw", "imu_qx"): [(m.attitude.w, m.attitude.x) for m in messages],
        ("imu_ax", "imu_ay", "imu_az"): [m.arms[1].raw for m in messages],
        ("contact_left", "contact_right"): [(m.touches[1], m.legs[0].raw[2] > 40) for m in messages],
    }
    for names, values in rows.items():
        np.testing.assert_array_equal(channel_values(log, *names), values)
    assert set(log.channels["contact_right"].x) == {0.0, 1.0}


def test_big_endian(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    same = write_topics(tmp_path / "same.mcap", [robot_topic()], TIMES)
    monkeypatch.setattr("mcap_ros2._dynamic.CdrWriter", partial(CdrWriter, kind=EncapsulationKind.CDR_BE))
    path = write_topics(tmp_path / "log.mcap", [robot_topic()], TIMES)
    log, expected = read(path, fields=ROBOT_FIELDS), read(same, fields=ROBOT_FIELDS)
    for name in ("q", "tau"):
        np.testing.assert_array_equal(log.signals[name], expected.signals[name])
    names = tuple(expected.channels)
    np.testing.assert_array_equal(channel_values(log, *names), channel_values(expected, *names))


# -- what the messages are of, if the configuration does not say it --


def joint_states(**options: Any) -> Topic:
    messages = []
    for i, time in enumerate(TIMES):
        header = {"stamp": {"sec": time // 10**9, "nanosec": time % 10**9}, "frame_id": ""}
        messages.append({"header": header, "name": ["hip"], "position": [float(i)], "velocity": [], "effort": [1.0]})
    text = definition(JOINT_STATE)
    type_name = "sensor_msgs/msg/JointState"
    return Topic(type_name, encoded(type_name, messages, text), **{"name": "/joint_states", "text": text, **options})


@pytest.mark.parametrize(
    ("type_name", "preset"),
    [(GO, "unitree_go"), (GO, "unitree_h1"), (HG, "unitree_g1"), (HG, "unitree_h1_2")],
)
def test_robot_is_recognized_by_its_joints(tmp_path: Path, type_name: str, preset: str) -> None:
    path = write(tmp_path / "log.mcap", type_name)
    joints = [name for name in PRESETS[preset].joints if name]
    log = read(path, robot_joints=["head", *joints])
    assert log.preset == preset
    assert set(log.joints) == set(joints)
    assert sentences(log.notices) == (
        f"the messages of topic /lowstate do not name their joints; read by preset {preset}",
    )


def test_without_a_robot_the_first_preset_is_assumed(tmp_path: Path) -> None:
    log = read(write(tmp_path / "log.mcap", GO))
    assert log.joints == GO_JOINTS
    assert [notice.code for notice in log.notices] == ["preset_assumed"]


def test_robot_with_other_joints_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", GO)
    with pytest.raises(LogError) as error:
        read(path, robot_joints=["hip", "knee"])
    assert error.value.what == (
        "topic /lowstate: unitree_go/LowState has no names of the joints, and the URDF's are not those of unitree_go, "
        "unitree_h1 (such as FR_hip_joint); set log.preset, or list them in log.field_joints in the order of the "
        "message"
    )
    log = read(path, robot_joints=["hip", "knee"], joints=("hip", None, "knee"))
    assert log.joints == ("hip", "knee")
    expected = [[message.motor_state[0].q, message.motor_state[2].q] for message in decoded(path)]
    np.testing.assert_array_equal(log.signals["q"], expected)


@pytest.mark.parametrize("is_first", [True, False])
def test_joint_states_come_before_known_messages(tmp_path: Path, is_first: bool) -> None:
    topics = [topic_of(GO), joint_states()]
    path = write_topics(tmp_path / "log.mcap", topics[::-1] if is_first else topics, TIMES)
    log = read(path)
    assert (log.joints, log.preset) == (("hip",), None)
    assert read_log(path, topic="/lowstate").joints == GO_JOINTS
    assert read(path, preset="unitree_go").joints == GO_JOINTS


def test_broken_known_message_does_no_harm_if_it_is_not_needed(tmp_path: Path) -> None:
    broken = topic_of(GO)
    broken.data = [data[:40] for data in broken.data]
    path = write_topics(tmp_path / "log.mcap", [broken, joint_states()], TIMES)
    assert read(path).joints == ("hip",)
    with pytest.raises(LogError, match=r"message 1 of /lowstate is incomplete: it ends within a field, after 40 bytes"):
        read_log(path, topic="/lowstate")


def test_joint_states_are_read_if_no_topic_has_the_fields(tmp_path: Path) -> None:
    """A simulator's log beside those of the robot."""
    path = write_topics(tmp_path / "log.mcap", [joint_states()], TIMES)
    log = read(path, preset="unitree_go")
    assert log.joints == ("hip",)
    assert sentences(log.notices) == (
        "no topic has the fields of log.fields or log.preset; read: joint states of /joint_states",
    )


def test_two_topics_with_the_fields(tmp_path: Path) -> None:
    path = write_topics(tmp_path / "log.mcap", [topic_of(GO), topic_of(GO, name="/lf/lowstate")], TIMES)
    with pytest.raises(LogError, match=r"2 topics carry joint states; set log.topic to one of /lowstate, /lf/lowstate"):
        read(path)


def test_fields_supplement_those_of_a_preset(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", GO)
    fields = {"contact.FL_foot": "foot_force[1] > 50", "tau": "motor_state[{i}].ddq"}
    log = read(path, preset="unitree_go", fields=fields)
    messages = decoded(path)
    closed = [message.foot_force[1] > 50 for message in messages]
    np.testing.assert_array_equal(log.channels["contact_FL_foot"].x, closed)
    expected = [[motor.ddq for motor in message.motor_state[:12]] for message in messages]
    np.testing.assert_array_equal(log.signals["tau"], expected)


def test_imu_of_another_topic(tmp_path: Path) -> None:
    """Without `base.imu.topic`, the IMU is that of the joints' messages."""
    imu = Topic("sensor_msgs/msg/Imu", [imu_message(i) for i in range(COUNT)], name="/imu", text="float64 unused\n")
    path = write_topics(tmp_path / "log.mcap", [imu, topic_of(GO)], TIMES)
    options = MessageOptions(preset="unitree_go")
    own = read_log(path, sensors=SensorOptions(), messages=options)
    assert own.channels["imu_wx"].x[1] == decoded(path)[1].imu_state.gyroscope[0]
    assert read_log(path, sensors=SensorOptions("/lowstate"), messages=options).channels["imu_wx"].x[1] != 1.0
    other = read_log(path, sensors=SensorOptions("/imu"), messages=options)
    assert other.channels["imu_wx"].x.tolist() == list(range(COUNT))


def imu_message(i: int) -> bytes:
    """A `sensor_msgs/Imu` with gyroscope (i, 0, 0)."""
    numbers = np.zeros(37)
    numbers[13] = i
    return b"\0\1\0\0" + bytes(8) + b"\1\0\0\0" + bytes(4) + numbers.astype("<f8").tobytes()


# -- faults --


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (
            {"q": "motor_stat[{i}].q"},
            "log.fields.q: unitree_go/LowState has no field motor_stat; did you mean motor_state?",
        ),
        ({"q": "motor_state[{i}].qq"}, "log.fields.q: unitree_go/MotorState has no field qq; did you mean q?"),
        ({"v": "motor_state[{i}].dq.x"}, "log.fields.v: a float32 has no fields"),
        ({"v": "imu_state[{i}].q"}, "log.fields.v: imu_state is not an array"),
        ({"v": "motor_state.dq[{i}]"}, "log.fields.v: motor_state is an array; give an index, as in motor_state[0]"),
        ({"v": "motor_state[{i}]"}, "log.fields.v: motor_state[{i}] is not a number"),
        ({"name": "motor_state[{i}].q"}, "log.fields.name: motor_state[{i}].q is not a text"),
        ({"t": "tick"}, "log.fields.t: tick is not a stamp (builtin_interfaces/Time)"),
        (
            {"imu.gyro": "imu_state.quaternion"},
            "log.fields.imu.gyro: imu_state.quaternion is neither 3 numbers nor x, y, z",
        ),
        ({"imu.orientation": "bms_state"}, "log.fields.imu.orientation: bms_state is neither 4 numbers nor x, y, z, w"),
        ({"contact.a": "foot_force"}, "log.fields.contact.a: foot_force is not a number"),
        (
            {"contact.a": "foot_force[4] > 3"},
            "log.fields.contact.a: foot_force has 4 elements, so that there is no index 4",
        ),
    ],
)
def test_wrong_field(tmp_path: Path, options: dict[str, str], expected: str) -> None:
    path = write(tmp_path / "log.mcap", GO)
    with pytest.raises(LogError) as error:
        read(path, fields={**SIX_FIELDS, **options}, joints=GO_JOINTS)
    assert error.value.what.startswith(f"topic /lowstate: {expected}")


def test_too_many_joints(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", GO)
    joints = tuple(f"joint{i}" for i in range(21))
    with pytest.raises(LogError, match=r"motor_state has 20 elements, but 21 joints are listed \(log.field_joints\)"):
        read(path, fields=SIX_FIELDS, joints=joints)
    with pytest.raises(LogError, match=r"message 1 of /lowstate has 3 values of legs\[\{i\}\].q for 4 joints"):
        read(
            write_topics(tmp_path / "other.mcap", [robot_topic()], TIMES),
            fields={"q": "legs[{i}].q"},
            joints=("a", "b", "c", "d"),
        )


def test_sequence_that_is_too_short_for_an_index(tmp_path: Path) -> None:
    path = write_topics(tmp_path / "log.mcap", [robot_topic()], TIMES)
    with pytest.raises(LogError, match=r"lacks the number of channel contact_a: its sequence is too short"):
        read(path, fields={**ROBOT_FIELDS, "contact.a": "legs[3].q"})


def test_the_topic_that_was_meant_is_named(tmp_path: Path) -> None:
    path = write_topics(tmp_path / "log.mcap", [robot_topic(name="/robot"), topic_of(GO), joint_states()], TIMES)
    with pytest.raises(LogError, match=r"topic /lowstate: log.fields.v: unitree_go/MotorState has no field dqq"):
        read(path, fields={**SIX_FIELDS, "v": "motor_state[{i}].dqq"}, joints=GO_JOINTS)
    with pytest.raises(LogError, match=r"topic /robot: log.fields.q: robot_msgs/State has no field motor_state"):
        read_log(path, topic="/robot", messages=MessageOptions(fields=SIX_FIELDS, joints=GO_JOINTS))
    only_others = write_topics(tmp_path / "others.mcap", [robot_topic(), robot_topic(name="/b")], TIMES)
    with pytest.raises(LogError, match=r"no topic has messages of preset unitree_go; available: /lowstate"):
        read(only_others, preset="unitree_go")


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"text": ""}, "the log has no definition of unitree_go/LowState; record it where the package unitree_go is"),
        ({"encoding": "ros2idl"}, "the definition of unitree_go/LowState is ros2idl; only ros2msg is read"),
        ({"text": "IMUState imu_state\nMotorState[20] motor_state\n"}, "lacks unitree_go/MotorState"),
        ({"text": "float32 $\n"}, "the definition of unitree_go/LowState has a line that cannot be read: float32 $"),
        ({"text": "float32[0] q\n"}, "has an array without elements: float32[0] q"),
        ({"text": "float32 q\n" + SEPARATOR + "\nfloat32 q\n"}, "has no line MSG: after a separator"),
        ({"text": "float32 q\n" * 200_000}, "the definition of unitree_go/LowState is longer than 1 MiB"),
    ],
)
def test_unusable_definition(tmp_path: Path, options: dict[str, str], expected: str) -> None:
    with pytest.raises(LogError) as error:
        read(write(tmp_path / "log.mcap", GO, **options), preset="unitree_go")
    assert expected in error.value.what


def nested(inner: str, before: str, name: str = "T") -> str:
    """A definition with fields ``before`` q, and that of a type within it."""
    return f"{before}\nfloat32[1] q\n{SEPARATOR}\nMSG: unitree_go/{name}\n{inner}\n"


def doubling(depth: int) -> str:
    """A type with two fields of a type, which has two fields of a type, and so on."""
    text = nested("T1 a\nT1 b", "T0 all", "T0")
    for i in range(1, depth):
        text += f"{SEPARATOR}\nMSG: unitree_go/T{i}\nT{i + 1} a\nT{i + 1} b\n"
    return f"{text}{SEPARATOR}\nMSG: unitree_go/T{depth}\nuint8 a\n"


@pytest.mark.parametrize(
    "text",
    [
        nested("T[] inner", "T[] all"),
        nested("T inner", "T all"),
        nested("uint8 a", "T[60000] all"),
        nested("uint8[4000000000] a", "T[] all"),
        doubling(30),
        "wstring all\nfloat32[1] q\n",
        "string all\nfloat32[1] q\n",
    ],
)
@pytest.mark.parametrize("content", [b"\1", b"\xff"])
def test_hostile_definition_is_refused_soon(tmp_path: Path, text: str, content: bytes) -> None:
    data = [b"\0\1\0\0" + content * 200_000] * 2
    path = write_topics(tmp_path / "log.mcap", [Topic(GO, data, text=text)], TIMES[:2])
    with pytest.raises(LogError, match=r"message 1 of /lowstate (has too many nested|is incomplete|contains wstring)"):
        read(path, fields={"q": "q[{i}]"}, joints=("hip",))


def test_damaged_messages_are_refused(tmp_path: Path) -> None:
    """Whatever a message's bytes are, it is read or refused."""
    good = encoded(ROBOT_TYPE, [robot_message(3)], ROBOT_TEXT)[0]
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(80):
        data = bytearray(good)
        for place in rng.integers(4, len(good), 3):
            data[place] = rng.integers(256)
        path = write_topics(tmp_path / "log.mcap", [robot_topic(data=[good, bytes(data), good])], TIMES[:3])
        try:
            read(path, fields=ROBOT_FIELDS)
        except LogError:
            refused += 1
    assert 0 < refused < 80


def test_every_known_message_can_be_parsed() -> None:
    for tables in KNOWN_MESSAGES.values():
        for table in tables:
            assert all(parse_field(key, text).path for key, text in table.items())
    for preset in PRESETS.values():
        assert preset.message in KNOWN_MESSAGES
    without_names = {kind for kind, tables in KNOWN_MESSAGES.items() if "name" not in tables[0]}
    assert without_names == {preset.message for preset in PRESETS.values()}


def test_log_of_the_library(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", GO)
    expected = read(path, preset="unitree_go")
    log = Log(path, preset="unitree_go", fields={"contact.FL_foot": "foot_force[1] > 50"}, sensors=True)
    np.testing.assert_array_equal(log.q, expected.signals["q"])
    assert set(log.record.channels) - set(expected.channels) == {"contact_FL_foot"}
    listed = Log(path, fields=SIX_FIELDS, field_joints=["hip", None, "knee"])
    np.testing.assert_array_equal(listed.tau, expected.signals["tau"][:, [0, 2]])
    with pytest.raises(ConfigError, match=r"Log: preset: go2 is not a preset"):
        Log(path, preset="go2")


def test_inspect_command(tmp_path: Path) -> None:
    path = write(tmp_path / "log.mcap", GO)
    assert "FR_hip_joint" in idtool("inspect", path).out
    config = tmp_path / "config.yaml"
    config.write_text("log: {preset: unitree_go, fields: {tau: 'motor_state[{i}].tau'}}")
    refused = idtool("inspect", path, "--config", config)
    assert refused.code == 2
    assert refused.err.endswith("log.fields.tau: unitree_go/MotorState has no field tau; did you mean tau_est?\n")


def test_definition_is_missing_among_other_topics(tmp_path: Path) -> None:
    topics = [robot_topic(name="/a"), topic_of(GO, text=""), robot_topic(name="/b")]
    path = write_topics(tmp_path / "log.mcap", topics, TIMES)
    for options in ({}, {"preset": "unitree_go"}):
        with pytest.raises(LogError, match=r"topic /lowstate: the log has no definition of unitree_go/LowState"):
            read(path, **options)


def test_csv_ignores_fields(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,q_hip\n0,0\n0.001,1\n0.002,2\n")
    assert [notice.code for notice in read(path, preset="unitree_go").notices] == ["fields_ignored"]
