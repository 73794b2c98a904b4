"""Base of the configuration's records, the types of its numbers, and errors that name a key."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from idtool.common.exceptions import ConfigError
from idtool.robot.config.unknown_keys import UnknownKeyError, missing_name_message, unknown_key_message

MAX_VALUE = 1e12  # SI, of any number: powers of what is larger are not finite
MIN_LENGTH = 1e-6  # m: the inverse square of what is smaller is not finite


def _length(x: float) -> float:
    if x < MIN_LENGTH:
        raise ValueError(f"input should be at least {MIN_LENGTH:g} m")
    return x


def _refuse_truth_value(data: Any) -> Any:
    if isinstance(data, bool):
        raise ValueError(f"{str(data).lower()} is not a number")
    return data


def _name(text: str) -> str:
    if not text.strip():
        raise ValueError("is empty; give a name, or leave it out")
    return text


# beside the bounds of a number, not around them: pydantic merges bounds with those of the type alone
NoTruthValue = BeforeValidator(_refuse_truth_value)
Finite = Annotated[float, Field(ge=-MAX_VALUE, le=MAX_VALUE, allow_inf_nan=False), NoTruthValue]
Positive = Annotated[float, Field(gt=0, le=MAX_VALUE, allow_inf_nan=False), NoTruthValue]
Length = Annotated[Positive, AfterValidator(_length)]
NonNegative = Annotated[float, Field(ge=0, le=MAX_VALUE, allow_inf_nan=False), NoTruthValue]
Name = Annotated[str, AfterValidator(_name)]
Vector = tuple[Finite, Finite, Finite]


def joint_mapping_tag(data: Any) -> str:
    """Tag of the form in which numbers of joints are given: by joint, or one for all joints alike."""
    return "by joint" if isinstance(data, Mapping) else "alike"


class ConfigRecord(BaseModel):
    """Base of the configuration's records: frozen, strict about its keys.

    Attributes
    ----------
    example
        A whole with every key, YAML, for messages; empty: there is none.
    free_keys
        Key under which any keys may stand; empty: there is none.
    """

    example: ClassVar[str] = ""
    free_keys: ClassVar[str] = ""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)  # the whole holds its parts

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if isinstance(data, Mapping):
            for key in data:
                if key not in cls.model_fields:
                    raise UnknownKeyError(cls, str(key), data[key], cls.free_keys)
        return data


R = TypeVar("R", bound=ConfigRecord)

_TAGS = ("by joint", "alike", "[key]", "[auto]", "[fit]", "[number]")  # of the forms that a value can have, not of keys


def validate_record(record: type[R], data: Any, where: str) -> R:
    """A record of the given class from plain data.

    Raises
    ------
    ConfigError
        If a key is unknown or a value does not fit; the message names the key.
    """
    try:
        return record.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"] if part not in _TAGS)
        if first["type"] == "value_error":  # in our own words, which may begin with a name
            cause = first["ctx"]["error"]
            if isinstance(cause, UnknownKeyError):
                message = unknown_key_message(record, cause, record.example)
                raise ConfigError(f"{where}: {key}" if key else where, message) from None
            raise ConfigError(f"{where}: {key}" if key else where, first["msg"].removeprefix("Value error, ")) from None
        if first["type"] == "model_type" and key:
            hint = missing_name_message(record, first["ctx"]["class_name"], first["loc"][-1], record.example)
            if hint is not None:
                raise ConfigError(f"{where}: {key}", hint) from None
        message = first["msg"].split(" or instance of ")[0]
        message = message.replace("valid tuple", "list; write it in brackets, or each item after a dash")
        message = message.replace("valid dictionary", "mapping of keys to values; write it as key: value")
        message = message[0].lower() + message[1:]
        raise ConfigError(f"{where}: {key}" if key else where, message) from None
