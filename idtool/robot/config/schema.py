"""JSON schema of the configuration, with which editors complete and check it."""

from __future__ import annotations

import json

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema
from typing_extensions import override

from idtool.robot.config.config import Config

SCHEMA_FILE = "idtool.schema.json"


class _ConfigSchema(GenerateJsonSchema):
    """Forms of a value overlap: an empty mapping is both by joint and alike."""

    @override
    def tagged_union_schema(self, schema: core_schema.TaggedUnionSchema) -> JsonSchemaValue:
        union = super().tagged_union_schema(schema)
        return {"anyOf": union["oneOf"]} if "oneOf" in union else union


def config_schema() -> str:
    """The JSON schema of the configuration, of draft 2020-12, as the text of a file."""
    schema = Config.model_json_schema(schema_generator=_ConfigSchema)
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"
