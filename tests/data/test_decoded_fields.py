"""Sensors and addressed fields in JSON and protobuf: the same as in CDR, which is tested against mcap_ros2."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground.logs import write_mcap
from maker_messages import GO, Topic, definition, encoded, random_messages, write_topics
from mcap.reader import make_reader
from mcap.records import Schema
from quadruped_recordings import TRUTH, record_quadruped
from recordings import Channel, json_channel, states
from recordings import write_mcap as write_channels
from reencoded import ENCODINGS, proto_files, reencode

from idtool.common.exceptions import LogError
from idtool.data.logs import JointLog, read_log
from idtool.data.logs.mcap_records import _BATCH
from idtool.data.logs.message_options import MessageOptions
from idtool.data.logs.payloads import sensor_decoder_for
from idtool.data.logs.sensor_channels import SensorOptions, with_sensors
from idtool.data.logs.state_topics import imu_topics, state_topics
from idtool.robot.message_fields import PRESETS

COUNT = 30
TIMES = [10**18 + 2_000_000 * i for i in range(COUNT)]
FIELDS = {
    "name": "legs[{i}].name",
    "q": "legs[{i}].q",
    "tau": "legs[{i}].tau",
    "qcmd": "commands[{i}]",
    "t": "clock.now",
    "imu.gyro": "gyro",
    "imu.accel": "raw",
    "imu.orientation_wxyz": "attitude",
    "contact.left": "touches[1]",
    "contact.right": "legs[0].load > 40",
}
ROBOT = "acme_msgs/msg/Robot"
TEXT = definition(
    "acme_msgs/Clock clock\nacme_msgs/Leg[] legs\nfloat64[] commands\nacme_msgs/Vector gyro\nfloat32[3] raw\n"
    "acme_msgs/Quaternion attitude\nbool[] touches\n",
    {
        "acme_msgs/Clock": "builtin_interfaces/Time now\n",
        "acme_msgs/Leg": "string name\nfloat32 q\nfloat64 tau\nint16 load\n",
        "acme_msgs/Vector": "float64 x\nfloat64 y\nfloat64 z\n",
        "acme_msgs/Quaternion": "float64 w\nfloat64 x\nfloat64 y\nfloat64 z\n",
    },
)


def robot_message(i: int) -> dict[str, Any]:
    rng = np.random.default_rng(i)
    legs = [{"name": name, "q": k + 0.25, "tau": rng.normal(), "load": 30 + i % 20} for k, name in enumerate("abc")]
    return {
        "clock": {"now": {"sec": 3, "nanosec": 5_000_000 * i}},
        "legs": legs,
        "commands": rng.normal(size=3).tolist(),
        "gyro": dict(zip("xyz", rng.normal(size=3), strict=True)),
        "raw": [0.5, float(i), 1.0],
        "attitude": dict(zip("wxyz", rng.normal(size=4), strict=True)),
        "touches": [False, i % 3 == 0],
    }


def robot_log(path: Path) -> Path:
    data = encoded(ROBOT, [robot_message(i) for i in range(COUNT)], TEXT)
    return write_topics(path, [Topic(ROBOT, data, text=TEXT)], TIMES)


def read(path: Path, **options: Any) -> JointLog:
    return read_log(path, sensors=SensorOptions(), messages=MessageOptions(**options))


def check_equal(log: JointLog, expected: JointLog) -> None:
    """Bit by bit."""
    assert log.joints == expected.joints
    np.testing.assert_array_equal(log.t, expected.t)
    assert log.signals.keys() == expected.signals.keys()
    for name, values in expected.signals.items():
        np.testing.assert_array_equal(log.signals[name], values)
    assert log.channels.keys() == expected.channels.keys()
    for name, channel in expected.channels.items():
        np.testing.assert_array_equal(log.channels[name].t, channel.t)
        np.testing.assert_array_equal(log.channels[name].x, channel.x)


@pytest.fixture(scope="module")
def ground_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Joint states, an IMU, flags and wrenches of the feet, and one message of the rope's flag."""
    path = tmp_path_factory.mktemp("ground") / "log.mcap"
    write_mcap(path, TRUTH, record_quadruped("hang", 0.2))
    return path


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_sensors(ground_log: Path, tmp_path: Path, encoding: str) -> None:
    path = reencode(ground_log, tmp_path / "log.mcap", encoding)
    log = read(path)
    check_equal(log, read(ground_log))
    assert {"imu_qw", "imu_az", "force_FL_foot_mz", "contact_rope"} <= log.channels.keys()
    assert imu_topics(path) == ("/imu",)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_fields(tmp_path: Path, encoding: str) -> None:
    source = robot_log(tmp_path / "cdr.mcap")
    expected = read(source, fields=FIELDS)
    assert set(expected.channels["contact_right"].x) == {0.0, 1.0}
    path = reencode(source, tmp_path / "log.mcap", encoding)
    check_equal(read(path, fields=FIELDS), expected)
    listed = {key: text for key, text in FIELDS.items() if key != "name"}
    joints = ("hip", None, "knee")
    check_equal(read(path, fields=listed, joints=joints), read(source, fields=listed, joints=joints))
    assert state_topics(path, MessageOptions(fields=FIELDS)) == ("/lowstate",)


@pytest.mark.parametrize("encoding", ["json", "bare json"])
def test_preset(tmp_path: Path, encoding: str) -> None:
    messages = random_messages(GO, COUNT, lambda i, message: None)
    source = write_topics(tmp_path / "cdr.mcap", [Topic(GO, encoded(GO, messages))], TIMES)
    path = reencode(source, tmp_path / "log.mcap", encoding)
    log, expected = read(path), read(source)
    assert (log.preset, log.joints) == ("unitree_go", PRESETS["unitree_go"].joints)
    for name, values in expected.signals.items():  # float32 in CDR
        np.testing.assert_array_equal(log.signals[name], values)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(
    ("key", "text", "closed_schema", "open_schema"),
    [
        ("tau", "legs[{i}].torque", "has no field torque; ", "its messages have no legs[{i}].torque"),
        ("tau", "gyro[{i}].x", "gyro is not an array", "its messages have no gyro[{i}].x"),
        ("imu.accel", "touched", "has no field touched", "has no touched"),
        ("imu.accel", "touches", "", "has a touches that is neither 3 numbers nor x, y, z"),
        ("imu.accel", "legs", "legs is neither 3 numbers nor x, y, z", "has values that are not numbers"),
        ("contact.left", "touches[7]", "", "has no touches[7]"),
        ("tau", "commands[{i}].x", "a float64 has no fields", "its messages have no commands[{i}].x"),
        ("t", "legs[0].name", "legs[0].name is not a stamp", "its messages have no stamp at log.fields.t"),
        ("qcmd", "touches[{i}]", "", "has 2 values of touches[{i}] for 3 joints"),
    ],
)
def test_wrong_path(tmp_path: Path, encoding: str, key: str, text: str, closed_schema: str, open_schema: str) -> None:
    path = reencode(robot_log(tmp_path / "cdr.mcap"), tmp_path / "log.mcap", encoding)
    with pytest.raises(LogError) as error:
        read(path, fields={**FIELDS, key: text})
    assert (open_schema if encoding == "bare json" else closed_schema) in error.value.what


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_topic_without_the_fields_is_not_read(tmp_path: Path, encoding: str) -> None:
    """Another topic comes first, and joint states are on a third one."""
    other = Topic(GO, encoded(GO, random_messages(GO, COUNT, lambda i, message: None)), name="/other")
    data = encoded(ROBOT, [robot_message(i) for i in range(COUNT)], TEXT)
    source = write_topics(tmp_path / "cdr.mcap", [other, Topic(ROBOT, data, text=TEXT, name="/robot")], TIMES)
    path = reencode(source, tmp_path / "log.mcap", encoding)
    check_equal(read(path, fields=FIELDS), read(source, fields=FIELDS))
    with pytest.raises(LogError, match=r"topic /other: log\.fields\.name: |topic /other: its messages have no legs"):
        read_log(path, topic="/other", messages=MessageOptions(fields=FIELDS))


def json_log(path: Path, messages: list[Any], name: str = "acme/Robot", schema: object = None) -> Path:
    payloads = [message if isinstance(message, bytes) else json.dumps(message).encode() for message in messages]
    times = [10**18 + 2_000_000 * i for i in range(len(messages))]
    channel = Channel("/robot", times, payloads, "json", (name, "jsonschema", json.dumps(schema or {}).encode()))
    return write_channels(path, channel)


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (b"{", "message 3 of /robot is not JSON"),
        (b"[" * 100_000, "message 3 of /robot is not JSON"),
        ({"q": "abc"}, "message 3 of /robot has values that are not numbers"),
        ({"q": {"0": 1.0}}, "message 3 of /robot has no q[{i}]"),
        ({"q": [[1.0], [2.0]]}, "message 3 of /robot has values that are not numbers"),
        ({"q": [10**400, 1]}, "message 3 of /robot has values that are not numbers"),
        ({"q": [1.0]}, "message 3 of /robot has 1 value of q[{i}] for 2 joints"),
        ({}, "message 3 of /robot has no q[{i}]"),
        (7, "message 3 of /robot has no q[{i}]"),
    ],
)
def test_damaged_json(tmp_path: Path, message: object, expected: str) -> None:
    path = json_log(tmp_path / "log.mcap", [{"q": [1.0, 2.0]}, {"q": [1.0, 3.0]}, message])
    with pytest.raises(LogError) as error:
        read(path, fields={"q": "q[{i}]"}, joints=("hip", "knee"))
    assert expected in error.value.what


def test_null_is_missing(tmp_path: Path) -> None:
    messages = [{"q": [float(i), None if i == 5 else 1.0], "gyro": None if i == 3 else [1, 2, 3]} for i in range(9)]
    path = json_log(tmp_path / "log.mcap", messages)
    log = read(path, fields={"q": "q[{i}]", "imu.gyro": "gyro"}, joints=("hip", "knee"))
    assert np.isnan(log.signals["q"][5, 1])
    assert np.flatnonzero(np.isnan(log.channels["imu_wx"].x)).tolist() == [3]


def test_json_stamps_that_are_numbers(tmp_path: Path) -> None:
    """Microseconds of a clock of the robot's own, for joints and sensors alike."""
    messages = [{"q": [float(i)], "us": 10**9 + 2000 * i, "gyro": [i, 2, 3]} for i in range(50)]
    path = json_log(tmp_path / "log.mcap", messages)
    log = read(path, fields={"q": "q[{i}]", "imu.gyro": "gyro", "t": "us"}, joints=("hip",))
    np.testing.assert_allclose(log.t, 1000 + 2e-3 * np.arange(50), rtol=1e-15)
    np.testing.assert_array_equal(log.channels["imu_wx"].t, log.t)


REFERENCES = {
    "type": "object",
    "properties": {"q": {"$ref": "#/$defs/list"}, "imu": {"$ref": "#/$defs/imu"}, "tree": {"$ref": "#/$defs/tree"}},
    "$defs": {
        "list": {"type": "array", "items": {"type": "number"}},
        "imu": {"properties": {"gyro": {"type": "array", "items": {"type": ["number", "null"]}}}},
        "tree": {"properties": {"inner": {"$ref": "#/$defs/tree"}, "other": {"$ref": "elsewhere.json"}}},
    },
}


def test_references_of_a_schema(tmp_path: Path) -> None:
    messages = [{"q": [1.0], "imu": {"gyro": [1, 2, i]}} for i in range(9)]
    path = json_log(tmp_path / "log.mcap", messages, schema=REFERENCES)
    log = read(path, fields={"q": "q[{i}]", "imu.gyro": "imu.gyro"}, joints=("hip",))
    assert log.channels["imu_wz"].x.tolist() == list(range(9))
    with pytest.raises(LogError, match=r"acme/Robot.imu has no field gyros; did you mean gyro"):
        read(path, fields={"q": "q[{i}]", "imu.gyro": "imu.gyros"}, joints=("hip",))


def deep_schema(depth: int) -> str:
    return '{"properties": {"a": ' * depth + "{}" + "}}" * depth


@pytest.mark.parametrize(
    "schema",
    [
        {"$ref": "#/a", "a": {"$ref": "#/b"}, "b": {"$ref": "#/a"}},
        {"properties": {"q": {"$ref": 7}}},
        {"properties": {"q": {"type": {}}}},
        {"properties": {"q": {"type": ["array"], "items": [{}, {}]}}},
        {"properties": {"q": {"type": "array", "items": {"type": "array", "items": {"type": "array"}}}}},
        [1, 2],
        json.loads(deep_schema(100)) | {"properties": {"q": True}},
    ],
)
def test_odd_schemas_leave_it_to_the_messages(tmp_path: Path, schema: object) -> None:
    path = json_log(tmp_path / "log.mcap", [{"q": [1.0]}, {"q": [2.0]}], schema=schema)
    assert read(path, fields={"q": "q[{i}]"}, joints=("hip",)).signals["q"].tolist() == [[1.0], [2.0]]


def proto_log(path: Path, types: dict[str, list[tuple[str, str]]], payloads: list[bytes]) -> Path:
    """Messages of the first of some types in protobuf."""
    name = f"robot.{next(iter(types)).replace('/', '_')}"
    times = [10**18 + 2_000_000 * i for i in range(len(payloads))]
    channel = Channel("/robot", times, payloads, "protobuf", (name, "protobuf", proto_files(types).SerializeToString()))
    return write_channels(path, channel)


def test_protobuf_message_within_that_is_left_out_is_missing(tmp_path: Path) -> None:
    """As the wrappers of google.protobuf: without a value, it is not 0."""
    types = {"Robot": [("Value[]", "q"), ("Value", "load")], "Value": [("float64", "value")]}
    one = b"\x0a\x09\x09" + np.float64(1.5).tobytes()  # q[0]
    payloads = [one + b"\x12\x09\x09" + np.float64(i).tobytes() if i % 2 else one for i in range(6)]
    path = proto_log(tmp_path / "log.mcap", types, payloads)
    log = read(path, fields={"q": "q[{i}].value", "contact.foot": "load.value > 2"}, joints=("hip",))
    assert log.signals["q"].tolist() == [[1.5]] * 6
    np.testing.assert_array_equal(log.channels["contact_foot"].x, [np.nan, 0, np.nan, 1, np.nan, 1])


def test_damaged_protobuf(tmp_path: Path) -> None:
    types = {"Robot": [("float64[]", "q")]}
    good = b"\x0a\x10" + np.array([1.0, 2.0]).tobytes()
    for bad, expected in ((b"\x0a\x7f", "does not match its schema"), (good[:10], "does not match its schema")):
        path = proto_log(tmp_path / "log.mcap", types, [good, good, bad])
        with pytest.raises(LogError, match=f"message 3 of /robot {expected}"):
            read(path, fields={"q": "q[{i}]"}, joints=("hip", "knee"))
    with pytest.raises(LogError, match=r"topic /robot: the definition of robot\.Robot cannot be read"):
        read(
            write_channels(
                tmp_path / "x.mcap", Channel("/robot", [1], [b""], "protobuf", ("robot.Robot", "protobuf", b"x"))
            ),
            fields={"q": "q[{i}]"},
            joints=("hip",),
        )


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_messages_with_random_bytes_are_read_or_refused(ground_log: Path, tmp_path: Path, encoding: str) -> None:
    """Every message of a log but the first has one byte that is another."""
    rng = np.random.default_rng(0)
    robot = reencode(robot_log(tmp_path / "cdr.mcap"), tmp_path / "robot.mcap", encoding)
    sensors = reencode(ground_log, tmp_path / "ground.mcap", encoding)
    refused = 0
    for source, options in ((robot, {"fields": FIELDS}), (sensors, {})):
        with source.open("rb") as file:
            messages = list(make_reader(file).iter_messages())
        for _ in range(40):
            schema, channel, message = messages[rng.integers(1, len(messages))]
            data = bytearray(message.data)
            if data:
                data[rng.integers(len(data))] = rng.integers(256)
            assert schema is not None
            schema_fields = (schema.name, schema.encoding, schema.data)
            log_time = message.log_time
            kept = [message.data, bytes(data), message.data]
            damaged = Channel(channel.topic, [log_time, log_time, log_time + 1], kept, encoding, schema_fields)
            try:
                read(write_channels(tmp_path / "log.mcap", damaged, json_channel(states(3))), **options)
            except LogError:
                refused += 1
    assert 0 < refused < 80


def test_too_many_joints_are_refused(tmp_path: Path) -> None:
    legs = [{"name": str(i), "q": 1.0} for i in range(600)]
    path = json_log(tmp_path / "log.mcap", [{"legs": legs}] * 2)
    with pytest.raises(LogError, match="names more than 512 joints"):
        read(path, fields={"name": "legs[{i}].name", "q": "legs[{i}].q"})


def sensor_channels_of(schema: object, name: str = "x", encoding: str = "json") -> tuple[str, ...] | None:
    data = schema if isinstance(schema, bytes) else json.dumps(schema).encode()
    decoder = sensor_decoder_for(encoding, Schema(id=1, name=name, encoding="jsonschema", data=data))
    return None if decoder is None else decoder.channels("foot")


def vector(*names: str) -> dict[str, Any]:
    return {"type": "object", "properties": {name: {"type": "number"} for name in names}}


XYZ = vector("x", "y", "z")


@pytest.mark.parametrize(
    ("properties", "first"),
    [
        ({"angular_velocity": XYZ, "linear_acceleration": XYZ}, "imu_wx"),
        ({"angular_velocity": XYZ, "linear_acceleration": XYZ, "orientation": vector(*"xyzw")}, "imu_qx"),
        ({"angular_velocity": XYZ, "linear_acceleration": vector("x", "y")}, None),
        ({"wrench": {"properties": {"force": XYZ, "torque": XYZ}}}, "force_foot_x"),
        ({"force": XYZ, "torque": XYZ}, "force_foot_x"),
        ({"force": XYZ}, None),
        ({"data": {"type": "boolean"}}, "contact_foot"),
        ({"data": {"type": "boolean"}, "header": {}}, "contact_foot"),
        ({"data": {"type": "number"}}, None),
        ({"data": {"type": "boolean"}, "voltage": {"type": "number"}}, None),
    ],
)
def test_shape_of_a_sensor(properties: dict[str, Any], first: str | None) -> None:
    channels = sensor_channels_of({"properties": properties})
    assert (channels and channels[0]) == first


def test_names_of_sensors_without_a_schema() -> None:
    assert sensor_channels_of({}, "sensor_msgs/msg/Imu") is not None
    assert sensor_channels_of({}, "std_msgs.Bool") == ("contact_foot",)
    assert sensor_channels_of(b"", "geometry_msgs/WrenchStamped") is not None
    assert sensor_channels_of({}, "tf2_msgs/TFMessage") is None
    assert sensor_channels_of(b"angular_velocity", "robot.Imu", "protobuf") is None


def test_imu_by_its_name_only_is_ignored_if_it_is_none(tmp_path: Path) -> None:
    items = states(5)
    imu = Channel("/imu", [1], [b'{"roll": 1}'], "json", ("acme.Imu", "jsonschema", b"{}"))
    log = read(write_channels(tmp_path / "log.mcap", json_channel(items), imu))
    assert not log.channels
    (notice,) = log.notices
    assert notice.code == "sensor_topic_ignored"
    assert notice.message == "topic /imu was ignored: its messages have no orientation"


def test_ignored_topic_stays_ignored(tmp_path: Path) -> None:
    """Though later messages, which are decoded apart from the first ones, have the fields of an IMU."""
    count = _BATCH + 10
    value = dict.fromkeys("xyz", 1.0)
    quaternion = {**value, "w": 1.0}
    message = {"orientation": quaternion, "angular_velocity": value, "linear_acceleration": value}
    payloads = [json.dumps(message).encode()] * count
    payloads[0] = b'{"roll": 1}'
    times = [10**18 + 1000 * i for i in range(count)]
    imu = Channel("/imu", times, payloads, "json", ("acme.Imu", "jsonschema", b"{}"))
    log = read(write_channels(tmp_path / "log.mcap", json_channel(states(5)), imu))
    assert [notice.code for notice in log.notices] == ["sensor_topic_ignored"]
    assert not log.channels


# -- topics without messages, and with a single one --

QUIET: dict[str, tuple[str, bytes]] = {
    "cdr": ("ros2msg", b""),
    "json": ("jsonschema", b"{}"),
}


def quiet(topic: str, name: str, encoding: str = "cdr") -> Channel:
    return Channel(topic, [], [], encoding, (name, *QUIET[encoding]))


@pytest.mark.parametrize("encoding", QUIET)
def test_flag_without_messages_counts_as_closed(tmp_path: Path, encoding: str) -> None:
    path = write_channels(
        tmp_path / "log.mcap", json_channel(states(50)), quiet("/contact/foot", "std_msgs/msg/Bool", encoding)
    )
    log = read(path)
    assert [(one.code, one.message) for one in log.notices] == [
        ("sensor_topic_empty", "no messages on topic /contact/foot")
    ]
    used = with_sensors(log, ["contact_foot"])
    assert used.channels["contact_foot"].is_set(log.t).all()
    assert [one.code for one in used.notices] == ["sensor_topic_empty", "contact_flag_empty"]


def test_wrench_without_messages_is_named(tmp_path: Path) -> None:
    empty = quiet("/force/foot", "geometry_msgs/msg/WrenchStamped")
    path = write_channels(tmp_path / "log.mcap", json_channel(states(50)), empty)
    with pytest.raises(LogError, match="channel force_foot_x has no values; log this sensor, or leave it out"):
        with_sensors(read(path), ["force_foot_x"])


def test_imu_without_messages_does_not_compete(ground_log: Path, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    reencode(ground_log, path, "json")
    joints = json_channel(states(20))
    imu = {"angular_velocity": dict.fromkeys("xyz", 1.0), "linear_acceleration": dict.fromkeys("xyz", 2.0)}
    schema = {"properties": {"angular_velocity": XYZ, "linear_acceleration": XYZ}}
    own = Channel(
        "/imu", [1, 2], [json.dumps(imu).encode()] * 2, "json", ("x", "jsonschema", json.dumps(schema).encode())
    )
    empty = quiet("/torso/imu", "sensor_msgs/msg/Imu")
    log = read(write_channels(path, joints, own, empty))
    assert log.channels["imu_wx"].x.tolist() == [1.0, 1.0]
    with pytest.raises(LogError, match=r"base\.imu\.topic: no messages on topic /torso/imu"):
        read_log(path, sensors=SensorOptions("/torso/imu"))


@pytest.mark.parametrize("is_closed", [False, True])
def test_a_single_flag_holds_through_the_log(tmp_path: Path, is_closed: bool) -> None:
    """Latched: published once, before the first joint state."""
    items = states(500)
    data = json.dumps({"data": is_closed}).encode()
    flag = Channel("/contact/foot", [items[0].stamp - 10**7], [data], "json", ("std_msgs/Bool", "jsonschema", b"{}"))
    log = with_sensors(read(write_channels(tmp_path / "log.mcap", json_channel(items), flag)), ["contact_foot"])
    assert (log.channels["contact_foot"].is_set(log.t) == is_closed).all()
    assert not log.notices
