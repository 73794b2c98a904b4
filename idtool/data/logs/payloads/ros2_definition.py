"""ROS 2 message definitions (``ros2msg``), as bags contain them: the fields of a type and of the types within it.

Source: docs.ros.org, Interfaces; mcap.dev/spec/registry, ros2msg
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from idtool.common.names import printable
from idtool.data.logs.payloads.message_type import MAX_DEFINITION_BYTES, NUMBERS, TEXTS, Fields, Kind

if TYPE_CHECKING:
    from mcap.records import Schema

TIME = "builtin_interfaces/Time"

_SEPARATOR = re.compile(r"^={3,}[ \t\r]*\n", re.MULTILINE)
_TYPE_LINE = re.compile(r"MSG:\s*(\S+)")
_FIELD = re.compile(r"([A-Za-z][\w/]*)(?:<=\d+)?(\[(?:<=)?(\d*)\])?\s+([A-Za-z]\w*)(\s*=)?.*")
_TIME_FIELDS: Fields = {"sec": Kind("int32"), "nanosec": Kind("uint32")}


def short_type_name(name: str) -> str:
    """Name of a type as ``package/Type``."""
    return name.replace("/msg/", "/")


def parse_definition(schema: Schema) -> dict[str, Fields]:
    """Fields of the type of a schema and of the types within it.

    Raises
    ------
    ValueError
        If there is no definition, or it cannot be read.
    """
    name = short_type_name(schema.name)
    if not schema.data.strip():
        package = printable(name.partition("/")[0])
        raise ValueError(
            f"the log has no definition of {printable(name)}; record it where the package {package} is installed"
        )
    if schema.encoding != "ros2msg":
        raise ValueError(f"the definition of {printable(name)} is {printable(schema.encoding)}; only ros2msg is read")
    if len(schema.data) > MAX_DEFINITION_BYTES:
        raise ValueError(f"the definition of {printable(name)} is longer than {MAX_DEFINITION_BYTES >> 20} MiB")
    types: dict[str, Fields] = {TIME: _TIME_FIELDS, "builtin_interfaces/Duration": _TIME_FIELDS}
    for i, text in enumerate(_SEPARATOR.split(schema.data.decode(errors="replace"))):
        type_name, body = name, text
        if i > 0:
            type_line, _, body = text.partition("\n")
            match = _TYPE_LINE.fullmatch(type_line.strip())
            if not match:
                raise ValueError(f"the definition of {printable(name)} has no line MSG: after a separator")
            type_name = short_type_name(match[1])
        types[type_name] = _parse_fields(type_name, body)
    return types


def _parse_fields(type_name: str, body: str) -> Fields:
    package = type_name.rpartition("/")[0]
    fields: dict[str, Kind] = {}
    for line in body.splitlines():
        text = line.partition("#")[0].strip()
        if not text:
            continue
        match = _FIELD.fullmatch(text)
        if not match:
            what = f"has a line that cannot be read: {printable(text)}"
            raise ValueError(f"the definition of {printable(type_name)} {what}")
        written_type, collection, length, name, constant = match.groups()
        if constant:
            continue
        is_sequence = bool(collection) and (not length or "<=" in collection)
        if collection and not is_sequence and int(length) == 0:
            what = f"has an array without elements: {printable(text)}"
            raise ValueError(f"the definition of {printable(type_name)} {what}")
        fields[name] = Kind(
            _full_type_name(written_type, package),
            is_collection=bool(collection),
            length=int(length) if collection and not is_sequence else None,
        )
    return fields


def _full_type_name(written: str, package: str) -> str:
    if written in NUMBERS or written in TEXTS:
        return written
    if written == "Header":
        return "std_msgs/Header"
    return short_type_name(written) if "/" in written else f"{package}/{written}"
