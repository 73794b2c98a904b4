"""JSON schemas: the fields of a message and of the objects within it, as far as the schema tells them.

Source: json-schema.org, draft 2020-12; mcap.dev/spec/registry, jsonschema
"""

from __future__ import annotations

import json
from typing import Any

from idtool.data.logs.payloads.message_type import MAX_DEFINITION_BYTES, UNKNOWN, Fields, Kind, MessageType

_MAX_DEPTH = 32  # of objects within objects
_TYPES = {
    "number": Kind("float64"),
    "integer": Kind("float64"),
    "boolean": Kind("bool"),
    "string": Kind("string"),
}


def parse_schema(name: str, data: bytes) -> MessageType:
    """The type of a schema's messages, of unknown fields if the schema cannot be read.

    Parameters
    ----------
    name
        Name of the type.
    data
        The schema.
    """
    try:
        document = json.loads(data) if len(data) <= MAX_DEFINITION_BYTES else None
    except (ValueError, RecursionError):
        document = None
    parser = _Parser(document)
    parser.kind(document, name, depth=0)
    return MessageType(name, parser.types)


class _Parser:
    def __init__(self, document: Any) -> None:
        self.types: dict[str, Fields] = {}
        self._document = document
        self._references: dict[str, Kind] = {}

    def kind(self, node: Any, name: str, depth: int) -> Kind:
        """Kind of the values that a part of the schema describes; ``name`` is that of their type."""
        if depth > _MAX_DEPTH or not isinstance(node, dict):
            return UNKNOWN
        reference = node.get("$ref")
        if isinstance(reference, str):
            if reference not in self._references:
                self._references[reference] = UNKNOWN  # for a reference to it within itself
                self._references[reference] = self.kind(self._target(reference), name, depth + 1)
            return self._references[reference]
        properties = node.get("properties")
        if isinstance(properties, dict) and properties:
            fields = {}
            for field, inner in properties.items():
                fields[field] = self.kind(inner, f"{name}.{field}", depth + 1)
            self.types[name] = fields
            return Kind(name)
        declared = node.get("type")
        type_names = declared if isinstance(declared, list) else [declared]
        allowed = [type_name for type_name in type_names if type_name != "null"]
        if allowed == ["array"]:
            element = self.kind(node.get("items"), f"{name}[]", depth + 1)
            single = UNKNOWN if element.is_collection else element  # arrays of arrays are not read
            return Kind(single.type_name, is_collection=True)
        if len(allowed) == 1 and isinstance(allowed[0], str):
            return _TYPES.get(allowed[0], UNKNOWN)
        return UNKNOWN

    def _target(self, reference: str) -> Any:
        """The part of the schema that a reference names; None if it is not within the schema."""
        if not reference.startswith("#/"):
            return None
        target = self._document
        for step in reference[2:].split("/"):
            target = target.get(step.replace("~1", "/").replace("~0", "~")) if isinstance(target, dict) else None
        return target
