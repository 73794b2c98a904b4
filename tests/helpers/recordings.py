"""MCAP files of joint states, encoded by others: mcap_ros2 for CDR, json, and google.protobuf; and rosbag2 folders."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import yaml
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros2.writer import Writer as Ros2Writer

from idtool.data.logs import JointLog

FIELDS = {"q": "position", "v": "velocity", "tau": "effort"}  # of a JointState message
NAME = "sensor_msgs/msg/JointState"
ROS2 = """\
# as ros2 writes it
std_msgs/Header header

string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
JSON = {
    "type": "object",
    "properties": {
        "header": {"type": "object"},
        **{name: {"type": "array"} for name in ("name", "position", "velocity", "effort")},
    },
}
UNINDEXED = {
    "index_types": IndexType.NONE,
    "use_statistics": False,
    "use_summary_offsets": False,
    "repeat_channels": False,
    "repeat_schemas": False,
}
COMPRESSIONS = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}


@dataclass
class State:
    """A joint state; ``stamp`` and ``logged`` in ns."""

    stamp: int
    names: Sequence[str]
    position: Sequence[float]
    velocity: Sequence[float] = ()
    effort: Sequence[float] = ()
    frame: str = ""
    logged: int = 0

    @property
    def fields(self) -> dict[str, Any]:
        """The message's fields, as nested dictionaries."""
        sec, nanosec = divmod(self.stamp, 10**9)
        return {
            "header": {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": self.frame},
            "name": list(self.names),
            "position": list(self.position),
            "velocity": list(self.velocity),
            "effort": list(self.effort),
        }


def states(
    count: int, names: Sequence[str] = ("abad", "hip", "knee"), start: int = 10**18, step: int = 10**6
) -> list[State]:
    """States with random values at a constant rate."""
    values = np.random.default_rng(count).normal(size=(count, 3, len(names))).tolist()
    stamps = range(start, start + count * step, step)
    return [
        State(stamp, names, three[0], three[1], three[2], "", stamp + 5)
        for stamp, three in zip(stamps, values, strict=True)
    ]


def cdr(items: Sequence[State]) -> list[bytes]:
    """States as mcap_ros2 encodes them."""
    stream = BytesIO()
    writer = Ros2Writer(stream)
    schema = writer.register_msgdef(NAME, ROS2)
    for i, state in enumerate(items):
        writer.write_message("/x", schema, _namespace(state.fields), log_time=i)
    writer.finish()  # type: ignore[no-untyped-call]
    return [message.data for _, _, message in make_reader(BytesIO(stream.getvalue())).iter_messages()]


def _namespace(fields: Any) -> Any:
    if isinstance(fields, dict):
        return SimpleNamespace(**{name: _namespace(value) for name, value in fields.items()})
    return fields


def as_json(state: State) -> bytes:
    """A state as JSON."""
    return json.dumps(state.fields).encode()


@dataclass
class Proto:
    """A protobuf type of joint states.

    ``number`` and ``stamp`` are the types' numbers of values and of the stamp's parts, ``parts`` the names of these.
    """

    number: int = 1
    packed: bool = True
    parts: tuple[str, str] = ("sec", "nanosec")
    stamp: tuple[int, int] = (5, 13)
    extra: Mapping[str, int] = field(default_factory=dict)

    def files(self) -> descriptor_pb2.FileDescriptorSet:
        """The type, and that of its header in a file of its own."""
        files = descriptor_pb2.FileDescriptorSet()
        main = files.file.add(name="joint.proto", package="robot", syntax="proto3", dependency=["header.proto"])
        joint = main.message_type.add(name="JointState")
        joint.field.add(name="header", number=4, label=1, type=11, type_name=".robot.Header")
        joint.field.add(name="name", number=7, label=3, type=9)
        for number, name in enumerate(("position", "velocity", "effort"), 20):
            joint.field.add(name=name, number=number, label=3, type=self.number).options.packed = self.packed
        for number, (name, kind) in enumerate(self.extra.items(), 8):
            joint.field.add(name=name, number=number, label=1, type=kind)
        header = files.file.add(name="header.proto", package="robot", syntax="proto3")
        stamp = header.message_type.add(name="Time")
        for number, (name, kind) in enumerate(zip(self.parts, self.stamp, strict=True), 1):
            stamp.field.add(name=name, number=number, label=1, type=kind)
        message = header.message_type.add(name="Header")
        message.field.add(name="stamp", number=1, label=1, type=11, type_name=".robot.Time")
        message.field.add(name="frame_id", number=2, label=1, type=9)
        return files

    def encode(self, items: Sequence[State], **extra: Sequence[Any]) -> Iterator[bytes]:
        """States as protobuf, with the values of the extra fields for each."""
        pool = descriptor_pool.DescriptorPool()
        for file in reversed(self.files().file):
            pool.Add(file)
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("robot.JointState"))
        for i, state in enumerate(items):
            fields = state.fields
            stamp = fields["header"]["stamp"]
            fields["header"]["stamp"] = dict(zip(self.parts, (stamp["sec"], stamp["nanosec"]), strict=True))
            yield kind(**fields, **{name: values[i] for name, values in extra.items()}).SerializeToString()


@dataclass
class Channel:
    """What is on a topic: log times [ns] and payloads."""

    topic: str
    times: Sequence[int]
    payloads: Sequence[bytes]
    encoding: str = "cdr"
    schema: tuple[str, str, bytes] = (NAME, "ros2msg", ROS2.encode())
    metadata: dict[str, str] = field(default_factory=dict)


def ros2(items: Sequence[State], topic: str = "/joint_states") -> Channel:
    """A topic of CDR."""
    return Channel(topic, [state.logged for state in items], cdr(items))


def json_channel(items: Sequence[State], topic: str = "/joint_states") -> Channel:
    """A topic of JSON."""
    schema = ("robot.State", "jsonschema", json.dumps(JSON).encode())
    return Channel(topic, [state.logged for state in items], [as_json(state) for state in items], "json", schema)


def proto_channel(items: Sequence[State], proto: Proto, **extra: Sequence[Any]) -> Channel:
    """A topic of protobuf."""
    schema = ("robot.JointState", "protobuf", proto.files().SerializeToString())
    payloads = list(proto.encode(items, **extra))
    return Channel("/joint_states", [state.logged for state in items], payloads, "protobuf", schema)


def write_mcap(path: Path, *channels: Channel, **options: Any) -> Path:
    """Write channels, their messages in turn."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start()
        ids = [
            writer.register_channel(
                channel.topic, channel.encoding, writer.register_schema(*channel.schema), channel.metadata
            )
            for channel in channels
        ]
        for i in range(max(len(channel.times) for channel in channels)):
            for number, channel in zip(ids, channels, strict=True):
                if i < len(channel.times):
                    writer.add_message(number, channel.times[i], channel.payloads[i], channel.times[i])
        writer.finish()  # type: ignore[no-untyped-call]
    return path


IMU = Channel("/imu", [1, 2], [b"x" * 40, b"y" * 40], schema=("sensor_msgs/msg/Imu", "ros2msg", b"float64 x"))


def metadata(names: Sequence[str], **changes: Any) -> str:
    """The metadata that rosbag2 writes, of version 5."""
    start = {"nanoseconds_since_epoch": 10**18}
    topic = {
        "name": "/joint_states",
        "type": "sensor_msgs/msg/JointState",
        "serialization_format": "cdr",
        "offered_qos_profiles": "- history: 3\n  depth: 0\n" * 500,  # of as many publishers
    }
    information = {
        "version": 5,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": 10**9},
        "starting_time": start,
        "message_count": 1000,
        "topics_with_message_count": [{"topic_metadata": topic, "message_count": 1000}],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": list(names),
        "files": [{"path": name, "starting_time": start, "message_count": 1} for name in names],
        **changes,
    }
    return yaml.safe_dump({"rosbag2_bagfile_information": information})


def bag(folder: Path, *parts: Sequence[State], listed: Sequence[int] | None = None, **changes: Any) -> Path:
    """A folder with a file for each part, in which topics and schemas have other numbers than in the one before."""
    folder.mkdir()
    names = [f"{folder.name}_{i}.mcap" for i in range(len(parts))]
    for i, (name, items) in enumerate(zip(names, parts, strict=True)):
        write_mcap(folder / name, *[IMU] * (i % 2), ros2(items), chunk_size=3000)
    (folder / "metadata.yaml").write_text(metadata([names[i] for i in listed or range(len(names))], **changes))
    return folder


def check_log(log: JointLog, items: Sequence[State]) -> None:
    """The log holds the states, bit by bit."""
    assert len(log) == len(items)
    assert log.t.tolist() == [state.stamp // 10**9 + state.stamp % 10**9 / 1e9 for state in items]
    assert log.joints == tuple(dict.fromkeys(name for state in items for name in state.names))
    for signal, name in FIELDS.items():
        for j, joint in enumerate(log.joints):
            values = [dict(zip(s.names, getattr(s, name), strict=False)).get(joint, np.nan) for s in items]
            np.testing.assert_array_equal(log.signals[signal][:, j] if signal in log.signals else np.nan, values)
