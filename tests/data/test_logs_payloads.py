"""JSON and protobuf joint states, encoded by json and google.protobuf."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto
from recordings import JSON, Channel, Proto, check_log, json_channel, proto_channel, ros2, states, write_mcap
from sentences import sentences

from idtool.common.exceptions import LogError
from idtool.data.logs import read_log
from idtool.data.logs.payloads import wire
from idtool.data.logs.payloads.layout import Layout

PROTOS = {
    "doubles": Proto(),
    "google": Proto(parts=("seconds", "nanos"), stamp=(3, 5)),
    "unpacked": Proto(packed=False),
    "zigzag": Proto(stamp=(17, 13)),
    "fixed": Proto(stamp=(15, 7)),
    "more fields": Proto(extra={"count": 13, "gain": 1, "speed": 2, "note": 9}),
}


def extra(proto: Proto, count: int) -> dict[str, Any]:
    made = {"count": range(count), "gain": np.arange(count) / 3, "speed": np.arange(count), "note": ["x"] * count}
    return {name: made[name] for name in proto.extra}


@pytest.mark.parametrize("kind", PROTOS)
def test_protobuf(tmp_path: Path, kind: str) -> None:
    items = states(400, ("a", "bcd", "ü"), step=3_000_001)  # whose nanoseconds take 1 to 5 bytes
    channel = proto_channel(items, PROTOS[kind], **extra(PROTOS[kind], 400))
    assert len({len(payload) for payload in channel.payloads}) > 1
    check_log(read_log(write_mcap(tmp_path / "log", channel)), items)


def test_protobuf_floats(tmp_path: Path) -> None:
    items = [replace(s, position=np.array(s.position, np.float32).tolist(), velocity=(), effort=()) for s in states(30)]
    check_log(read_log(write_mcap(tmp_path / "log", proto_channel(items, Proto(number=2)))), items)


def test_protobuf_is_read_in_groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    laid_out = []

    def counted(message: bytes, plan: wire.FieldPlan) -> Layout | None:
        laid_out.append(message)
        return wire.layout_of(message, plan)

    monkeypatch.setattr("idtool.data.logs.payloads.protobuf.layout_of", counted)
    items = states(2000, step=1_000_003)
    proto = PROTOS["more fields"]
    check_log(read_log(write_mcap(tmp_path / "log", proto_channel(items, proto, **extra(proto, 2000)))), items)
    assert 0 < len(laid_out) < 30  # a layout for each number of bytes in the stamp and the counter


def test_protobuf_before_1970_and_at_zero(tmp_path: Path) -> None:
    items = states(10, start=-5_000_000)
    log = read_log(write_mcap(tmp_path / "log", proto_channel([replace(s, logged=7) for s in items], Proto())))
    assert log.t[:5].tolist() == [s.stamp // 10**9 + s.stamp % 10**9 / 1e9 for s in items[:5]]
    assert log.t[5] == 7e-9


def test_protobuf_mixed_shapes(tmp_path: Path) -> None:
    items = [
        replace(s, names=s.names if i % 2 else s.names[::-1], velocity=s.velocity if i % 3 else ())
        for i, s in enumerate(states(60))
    ]
    check_log(read_log(write_mcap(tmp_path / "log", proto_channel(items, Proto()))), items)


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (b"\x3a\x7f", "message 3 of /joint_states does not match its schema"),
        (b"\x3a\x01\xff", "message 3 of /joint_states does not match its schema"),
        (b"\x3a\x01a\xa2\x01\x10" + bytes(16), "has 1 names and 2 values of position"),
        (b"\x3a\x01a\x3a\x01a", "names joint a twice"),
        (b"\x3a\x01\n", "characters that cannot be printed"),
    ],
)
def test_protobuf_that_cannot_be_read(tmp_path: Path, payload: bytes, said: str) -> None:
    channel = proto_channel(states(2), Proto())
    path = write_mcap(tmp_path / "log", replace(channel, times=[1, 2, 3], payloads=[*channel.payloads, payload]))
    with pytest.raises(LogError, match=said):
        read_log(path)


def test_protobuf_without_a_stamp(tmp_path: Path) -> None:
    items, files = states(9), Proto().files()
    del files.file[0].message_type[0].field[0]
    schema = ("robot.JointState", "protobuf", files.SerializeToString())
    log = read_log(write_mcap(tmp_path / "log", replace(proto_channel(items, Proto()), schema=schema)))
    check_log(log, [replace(s, stamp=s.logged) for s in items])


def test_protobuf_of_one_joint_is_none(tmp_path: Path) -> None:
    files = Proto().files()
    files.file[0].message_type[0].field[2].label = FieldDescriptorProto.LABEL_OPTIONAL
    files.file[0].message_type[0].field[2].ClearField("options")
    schema = ("robot.JointState", "protobuf", files.SerializeToString())
    with pytest.raises(LogError, match="no topic carries joint states"):
        read_log(write_mcap(tmp_path / "log", replace(proto_channel(states(3), Proto()), schema=schema)))


def test_unpacked_protobuf_that_cannot_be_read(tmp_path: Path) -> None:
    items = states(9)
    items[5] = replace(items[5], velocity=(1.0, 2.0))
    with pytest.raises(LogError, match="message 6 of /joint_states has 3 names and 2 values of velocity"):
        read_log(write_mcap(tmp_path / "log", proto_channel(items, Proto(packed=False))))


def test_protobuf_fields_that_come_twice(tmp_path: Path) -> None:
    items = states(9, ("a", "b"))
    channel = proto_channel([replace(s, velocity=(), effort=()) for s in items], Proto())
    values = [(np.array(s.position[:1]).tobytes(), np.array(s.position[1:]).tobytes()) for s in items]
    payloads = [
        channel.payloads[i][:-19] + b"\xa2\x01\x08" + first + b"\xa2\x01\x08" + second
        for i, (first, second) in enumerate(values)
    ]
    log = read_log(write_mcap(tmp_path / "log", replace(channel, payloads=payloads)))
    check_log(log, [replace(s, velocity=(), effort=()) for s in items])


@pytest.mark.parametrize(
    "schema", [b"", b"position", b"\n\x0c\n\nposition.x", Proto().files().file[0].SerializeToString()]
)
def test_schemas_that_are_none(tmp_path: Path, schema: bytes) -> None:
    channel = replace(proto_channel(states(3), Proto()), schema=("robot.JointState", "protobuf", schema))
    with pytest.raises(LogError, match=r"no topic carries joint states .*/joint_states \(robot.JointState, protobuf\)"):
        read_log(write_mcap(tmp_path / "log", channel))


def test_json(tmp_path: Path) -> None:
    items = states(3000, ("a", "bcd", "ü"))
    check_log(read_log(write_mcap(tmp_path / "log", json_channel(items))), items)


def test_json_mixed_shapes(tmp_path: Path) -> None:
    items = [
        replace(s, names=s.names[: 1 + i % 2], position=s.position[: 1 + i % 2], velocity=(), effort=())
        for i, s in enumerate(states(60, ("hip", "knee")))
    ]
    log = read_log(write_mcap(tmp_path / "log", json_channel(items)))
    check_log(log, items[1::2])
    assert sentences(log.notices)[0].endswith("kept: 30 samples of hip, knee; ignored: 30 samples")


@pytest.mark.parametrize(
    ("name", "schema", "reads"),
    [
        ("x", JSON, True),
        ("sensor_msgs/msg/JointState", {"type": "object"}, True),
        ("foxglove.JointState", {"properties": {"name": {"type": "string"}, "position": {"type": "number"}}}, False),
        ("my.JointState", None, True),
        ("x", {"properties": {"name": {}, "position": {"items": {"type": "number"}}}}, True),
        ("JointState", {"properties": {"name": 1, "position": 2}}, False),
        ("JointState", {"properties": [1]}, False),
        ("x", {}, False),
        ("x", [1], False),
    ],
)
def test_json_schemas(tmp_path: Path, name: str, schema: object, reads: bool) -> None:
    items = states(5)
    path = write_mcap(
        tmp_path / "log",
        replace(
            json_channel(items), schema=(name, "jsonschema", json.dumps(schema).encode() if schema is not None else b"")
        ),
    )
    if reads:
        check_log(read_log(path), items)
    else:
        with pytest.raises(LogError, match="no topic carries joint states"):
            read_log(path)


def test_json_stamps_that_are_numbers(tmp_path: Path) -> None:
    """In seconds as they are; what can't be seconds is converted as in CSV."""
    for field, per_second, start in (("stamp", 1.0, 1.5), ("timestamp", 1e9, 1.7e9), ("timestamp", 1e3, 1.7e9)):
        times = [round((start + i / 100) * per_second, 3) for i in range(20)]
        given = [int(t) if per_second > 1 else t for t in times]
        payloads = [json.dumps({"name": ["hip"], "position": [1.0], field: t}).encode() for t in given]
        log = read_log(write_mcap(tmp_path / "log", replace(json_channel(states(20)), payloads=payloads)))
        np.testing.assert_allclose(log.t, [t / per_second for t in given], rtol=1e-15, atol=3e-7)
        unit = {1.0: (), 1e9: ("ns",), 1e3: ("ms",)}[per_second]
        assert sentences(log.notices) == tuple(
            f"its times are in {name}; they were converted to seconds" for name in unit
        )


def test_json_null_is_missing(tmp_path: Path) -> None:
    items = states(5)
    payloads = json_channel(items).payloads
    payloads = [b'{"name":["abad","hip","knee"],"position":[1,null,"NaN"],"velocity":null}', *payloads[1:]]
    log = read_log(write_mcap(tmp_path / "log", replace(json_channel(items), payloads=payloads)))
    np.testing.assert_array_equal(log.signals["q"][0], [1.0, np.nan, np.nan])
    assert log.t[0] == items[0].logged // 10**9 + items[0].logged % 10**9 / 1e9


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (b"{", "message 3 of /joint_states is not JSON"),
        (b"", "is not JSON"),
        (b'{"name":[]},{"name":[]}', "is not JSON"),
        (b"[" * 100_000, "is not JSON"),
        (b"\xff", "is not JSON"),
        (b"[]", "message 3 of /joint_states is not a joint state"),
        (b'{"name":"hip","position":[1,2,3]}', "is not a joint state"),
        (b'{"name":[["hip"]],"position":[1]}', "is not a joint state"),
        (b'{"name":["hip"],"position":1}', "is not a joint state"),
        (b'{"name":["hip"],"header":{"stamp":{"sec":"1"}}}', "has a header.stamp that is neither a number nor"),
        (b'{"name":["hip"],"header":{"stamp":{"sec":1' + b"0" * 400 + b"}}}", "has a header.stamp that is neither"),
        (b'{"name":["hip"],"stamp":{"sec":null,"nanosec":1}}', "has a stamp that is neither a number nor"),
        (b'{"name":["hip"],"stamp":{"t":1}}', "has a stamp that is neither a number nor {sec, nanosec}: {'t': 1}"),
        (
            b'{"name":["hip"],"timestamp":"2024-01-01T00:00:00Z"}',
            "neither a number nor .*: 2024-01-01T00:00:00Z",
        ),
        (b'{"name":["hip"],"timestamp":"sec"}', "has a timestamp that is neither"),
        (b'{"name":["hip"],"position":["x"]}', "message 3 of /joint_states has values that are not numbers"),
        (b'{"name":["hip"],"position":["x"],"velocity":[1],"effort":[1]}', "message 3 of /joint_states has values"),
        (b'{"name":["hip"],"position":[[1]]}', "has values that are not numbers"),
        (b'{"name":["hip"],"position":[1' + b"0" * 400 + b"]}", "has values that are not numbers"),
        (b'{"name":["hip"],"position":[1,2]}', "has 1 names and 2 values of position"),
        (b'{"name":["hip","hip"],"position":[1,2]}', "names joint hip twice"),
        (b'{"name":["\\ud800"],"position":[1]}', "characters that cannot be printed"),
    ],
)
def test_json_that_cannot_be_read(tmp_path: Path, payload: bytes, said: str) -> None:
    items = states(4, ("hip",))
    payloads = [*json_channel(items).payloads[:2], payload, *json_channel(items).payloads[3:]]
    with pytest.raises(LogError, match=said) as error:
        read_log(write_mcap(tmp_path / "log", replace(json_channel(items), payloads=payloads)))
    assert "\n" not in str(error.value)


def test_one_topic_in_two_encodings(tmp_path: Path) -> None:
    items = states(20)
    check_log(read_log(write_mcap(tmp_path / "log", ros2(items[::2]), json_channel(items[1::2]))), items)


def test_encodings_that_are_not_known(tmp_path: Path) -> None:
    channel = Channel("/joint_states", [1], [b"x"], "ros1", ("sensor_msgs/JointState", "ros1msg", b""))
    said = (
        "topic /joint_states carries joint states in the ROS 1 encoding, which is not supported; run 'rosbags-convert "
    )
    with pytest.raises(LogError, match=said):
        read_log(write_mcap(tmp_path / "log", channel))
    name = "a_package_of_a_department_of_a_company/msg/StateOfAllJoints"
    others = [
        replace(channel, topic=f"/robot/left_arm/state_{i}", schema=(name, "ros2msg", b""), encoding=f"own_{i}")
        for i in range(9)
    ]
    with pytest.raises(LogError) as error:
        read_log(write_mcap(tmp_path / "log", *others))
    there = ", ".join(f"/robot/left_arm/state_{i} ({name}, own_{i})" for i in range(6))
    assert str(error.value).endswith(f"available: {there} and 3 more")
