"""Logs in CDR as JSON and protobuf: the messages as mcap_ros2 decodes them, encoded by json and google.protobuf."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from maker_messages import parse_types
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory

Types = Mapping[str, list[tuple[str, str]]]  # fields of each type: kind and name

ENCODINGS = ("json", "bare json", "protobuf")

_PROTO_NUMBERS = {"float64": 1, "float32": 2, "bool": 8, "string": 9, "int64": 3, "uint64": 4}
_SMALL = {"int8": 5, "int16": 5, "int32": 5, "byte": 13, "char": 13, "uint8": 13, "uint16": 13, "uint32": 13}
_NUMBER, _TEXT, _TRUTH = {"type": "number"}, {"type": "string"}, {"type": "boolean"}


def reencode(path: Path, output: Path, encoding: str) -> Path:
    """Write a log's messages in another encoding.

    Parameters
    ----------
    encoding
        ``json`` with a schema of all fields, ``bare json`` with one that only says that messages are objects, or
        ``protobuf``, in which types have a package and slashes become underscores.
    """
    with path.open("rb") as source, output.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels: dict[str, tuple[int, Any]] = {}
        reader = make_reader(source, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            assert schema is not None
            if channel.topic not in channels:
                types = parse_types(schema.name, schema.data.decode())
                name = schema.name.replace("/msg/", "/")
                register = _register_protobuf if encoding == "protobuf" else _register_json
                channels[channel.topic] = register(writer, channel.topic, name, types, encoding)
            number, encode = channels[channel.topic]
            writer.add_message(number, message.log_time, encode(decoded), message.publish_time)
        writer.finish()  # type: ignore[no-untyped-call]
    return output


def _register_json(writer: Writer, topic: str, name: str, types: Types, encoding: str) -> tuple[int, Any]:
    schema = {"type": "object"} if encoding == "bare json" else json_schema(name, types)
    number = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())

    def encode(decoded: Any) -> bytes:
        return json.dumps(_plain(name, decoded, types)).encode()

    return writer.register_channel(topic, "json", number), encode


def _register_protobuf(writer: Writer, topic: str, name: str, types: Types, encoding: str) -> tuple[int, Any]:
    files = proto_files(types)
    proto_name = f"robot.{name.replace('/', '_')}"
    number = writer.register_schema(proto_name, "protobuf", files.SerializeToString())
    pool = descriptor_pool.DescriptorPool()
    pool.Add(files.file[0])  # type: ignore[no-untyped-call]
    message_class = message_factory.GetMessageClass(pool.FindMessageTypeByName(proto_name))

    def encode(decoded: Any) -> bytes:
        return message_class(**_plain(name, decoded, types)).SerializeToString()

    return writer.register_channel(topic, "protobuf", number), encode


def json_schema(kind: str, types: Types) -> dict[str, Any]:
    """JSON schema of a type, those within it as references or in place."""
    base, bracket, _ = kind.partition("[")
    if bracket:
        return {"type": "array", "items": json_schema(base, types)}
    if base in types:
        properties = {name: json_schema(inner, types) for inner, name in types[base]}
        return {"type": ["object", "null"], "properties": properties}
    return _TEXT if base == "string" else _TRUTH if base == "bool" else _NUMBER


def proto_files(types: Types) -> descriptor_pb2.FileDescriptorSet:
    """All types as protobuf."""
    files = descriptor_pb2.FileDescriptorSet()
    file = files.file.add(name="robot.proto", package="robot", syntax="proto3")
    for name, fields in types.items():
        message = file.message_type.add(name=name.replace("/", "_"))
        for number, (kind, field) in enumerate(fields, 1):
            base, bracket, _ = kind.partition("[")
            label = 3 if bracket else 1
            if base in types:
                type_name = f".robot.{base.replace('/', '_')}"
                message.field.add(name=field, number=number, label=label, type=11, type_name=type_name)
            else:
                message.field.add(name=field, number=number, label=label, type={**_PROTO_NUMBERS, **_SMALL}[base])
    return files


def _plain(kind: str, value: Any, types: Types) -> Any:
    """A decoded value as dictionaries, lists and numbers."""
    base, bracket, _ = kind.partition("[")
    if bracket:
        return [_plain(base, element, types) for element in value]
    if base in types:
        return {name: _plain(inner, getattr(value, name), types) for inner, name in types[base]}
    return value
