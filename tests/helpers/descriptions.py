"""Robots on a bag's topic, encoded by others."""

from __future__ import annotations

import json
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from commands import LEG
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from mcap_ros2.writer import Writer as Ros2Writer
from recordings import Channel, ros2, states, write_mcap

from idtool.robot.urdf.reading import Robot

TEXT = LEG.read_text()
OTHER = TEXT.replace('<mass value="1.5"/>', '<mass value="1.6"/>')
NAME = "std_msgs/msg/String"
SCHEMAS = {
    "cdr": (NAME, "ros2msg", b"string data"),
    "json": ("robot.Text", "jsonschema", b'{"type": "object", "properties": {"data": {"type": "string"}}}'),
    "bare json": ("std_msgs/msg/String", "", b""),
}


def cdr(texts: Sequence[str]) -> list[bytes]:
    """Texts as mcap_ros2 encodes them."""
    stream = BytesIO()
    writer = Ros2Writer(stream)
    schema = writer.register_msgdef(NAME, "string data")
    for i, text in enumerate(texts):
        writer.write_message("/x", schema, {"data": text}, log_time=i)
    writer.finish()  # type: ignore[no-untyped-call]
    return [message.data for _, _, message in make_reader(BytesIO(stream.getvalue())).iter_messages()]


def protobuf(text: str) -> tuple[tuple[str, str, bytes], bytes]:
    """A schema of one string, whose number is not that of others, and a message."""
    described = descriptor_pb2.FileDescriptorSet()
    file = described.file.add(name="text.proto", package="robot", syntax="proto3")
    message = file.message_type.add(name="Text")
    message.field.add(name="stamp", number=1, label=1, type=3)
    message.field.add(name="data", number=7, label=1, type=9)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    kind: Any = message_factory.GetMessageClass(pool.FindMessageTypeByName("robot.Text"))
    schema = ("robot.Text", "protobuf", described.SerializeToString())
    return schema, kind(stamp=5, data=text).SerializeToString()


def described(*texts: str, topic: str = "/robot_description", encoding: str = "cdr") -> Channel:
    """A topic with texts."""
    if encoding == "protobuf":
        schema = protobuf(TEXT)[0]
        payloads = [protobuf(text)[1] for text in texts]
    else:
        schema = SCHEMAS[encoding]
        payloads = cdr(texts) if encoding == "cdr" else [json.dumps({"data": text}).encode() for text in texts]
    return Channel(topic, range(len(texts)), payloads, encoding.removeprefix("bare "), schema)


def recorded(folder: Path, *channels: Channel, name: str = "run1.mcap") -> Path:
    """A log of the leg with more topics."""
    return write_mcap(folder / name, *channels, ros2(states(20)))


def same(robot: Robot, other: Robot) -> bool:
    """Whether two robots have the same joints, and links of the same inertia."""
    return list(robot.joints) == list(other.joints) and all(
        np.array_equal(robot.links[name], pi) if pi is not None else robot.links[name] is None
        for name, pi in other.links.items()
    )
