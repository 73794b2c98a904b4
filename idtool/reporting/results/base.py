"""Base of all result records: immutable, complete, and dumped as JSON in the order of their fields."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Annotated, Any, Self, TypeVar, cast, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, GetPydanticSchema
from pydantic_core import core_schema

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.notice import Notice, Severity, unique
from idtool.common.provenance import InputFile as ProvenanceSource
from idtool.common.provenance import provenance
from idtool.common.version import VERSION

T_co = TypeVar("T_co", covariant=True)

SCHEMA_VERSION = 1  # version of the JSON files' form


class ReadOnly(Mapping[str, T_co]):
    """A dictionary that cannot be changed and, unlike `types.MappingProxyType`, can be copied and pickled."""

    __slots__ = ("_data",)

    def __init__(self, data: Mapping[str, T_co]) -> None:
        self._data = dict(data)

    def __getitem__(self, key: str) -> T_co:
        return self._data[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._data)

    def __len__(self) -> int:
        return len(self._data)

    def __repr__(self) -> str:
        return repr(self._data)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._data)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        """The schema of a dictionary of its values' type."""
        arguments = get_args(source)
        values = handler(arguments[0]) if arguments else core_schema.any_schema()
        dictionary = core_schema.dict_schema(core_schema.str_schema(), values)
        return core_schema.no_info_after_validator_function(
            cls,
            core_schema.no_info_before_validator_function(_plain_dictionary, dictionary),
            serialization=core_schema.wrap_serializer_function_ser_schema(
                lambda value, serialize: serialize(dict(value)), schema=dictionary
            ),
        )


def _plain_dictionary(value: Any) -> Any:
    """A mapping as a dictionary; anything else as it is, which the schema then refuses."""
    return dict(value) if isinstance(value, Mapping) else value


def _vector(values: Sequence[float | None]) -> Array:
    """Numbers as an array that cannot be written to, NaN for None."""
    array = np.array([np.nan if value is None else value for value in values], dtype=float)
    array.flags.writeable = False
    return array


def _numbers(array: Array) -> list[float | None]:
    """The numbers of an array, None for those that are not finite."""
    return [value if np.isfinite(value) else None for value in array.tolist()]


def _vector_schema(_source: Any, _handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
    numbers = core_schema.list_schema(core_schema.nullable_schema(core_schema.float_schema()))
    serialization = core_schema.plain_serializer_function_ser_schema(_numbers, return_schema=numbers)
    return core_schema.no_info_after_validator_function(_vector, numbers, serialization=serialization)


#: An array of numbers, shape (n,), that cannot be written to; NaN where the JSON has null.
Vector = Annotated[Array, GetPydanticSchema(_vector_schema)]


@dataclass(frozen=True)
class Keys:
    """Name of a dictionary's keys, for the reference."""

    name: str


ByJoint = Annotated[ReadOnly[float], Keys("joint")]
ByJointOrNone = Annotated[ReadOnly[float | None], Keys("joint")]
ByKindOrNone = Annotated[ReadOnly[float | None], Keys("kind")]
Units = Annotated[ReadOnly[str], Keys("joint")]
OffsetsByLog = Annotated[ReadOnly[Annotated[ReadOnly[list[float]], Keys("joint")]], Keys("log")]
ByParameter = Annotated[ReadOnly[Any], Keys("parameter")]
Interval = tuple[float, float]
Sentences = tuple[str, ...]


def field(description: str) -> Any:
    """A field that must be given, and what the reference says of it."""
    return Field(description=description)


class Record(BaseModel):
    """A part of a result, which cannot be changed."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", populate_by_name=True, serialize_by_alias=True, defer_build=True
    )

    def __str__(self) -> str:
        return repr(self)


class NoticeReport(Record):
    """A notice about a log, a model or a result."""

    code: str = field("What it is; [Notices](notices.md) lists all codes.")
    severity: Severity = field(
        "`note`: no action is needed; `warning`: the result may be worse because of it; `problem`: the log, model or "
        "result cannot be used as it is."
    )
    subject: str | None = field("The joint, link, file or setting that it is about; null: several, or all.")
    message: str = field("What was found about the subject, with numbers.")
    advice: str = field("What it means and what to do; empty if the message is enough.")

    @property
    def sentence(self) -> str:
        """Subject and message."""
        return f"{self.subject}: {self.message}" if self.subject else self.message


class Result(Record):
    """The whole of what one command found, the content of its JSON file."""

    idtool: str = Field(VERSION, description="Version of idtool.")
    schema_version: int = Field(SCHEMA_VERSION, alias="schema", description="Version of this schema.")
    notices: tuple[NoticeReport, ...] = Field((), description="Notices about the input and the result.")
    warnings: Sentences = Field((), description="The same notices, each as one text: subject, message and advice.")

    __eq__ = object.__eq__  # by identity: arrays in it have no truth value
    __hash__ = object.__hash__

    @classmethod
    def from_result(cls, result: Result) -> Self:
        """A result of this class, which only adds methods, with the fields of another; they are not checked again."""
        fields = {name: getattr(result, name) for name in type(result).model_fields}
        return cast(Self, cls.model_construct(**fields))

    def to_json(self) -> dict[str, Any]:
        """The content of the JSON file, as plain data; a copy. Notices come last."""
        content = self.model_dump(mode="json")
        return content | {name: content.pop(name) for name in ("notices", "warnings")}


class Source(Record):
    """A file that was read."""

    kind: str = field(
        "`URDF`, `configuration`, `mesh` (of a `hull` in `bounding_shapes`), `log`, `bag metadata` or `report` (of a "
        "fit that was compared); of `--prior` with `prior's` in front, as in `prior's URDF`; of `--against` with "
        "`simulator's` in front: `simulator's log`."
    )
    path: str = field("Path as given; for a rosbag2 folder, each of its files.")
    sha256: str | None = field("SHA-256 of its bytes; null for a log that was created from arrays.")


class ReproducibleResult(Result):
    """A result that names what it was computed from, and with which versions."""

    versions: Annotated[ReadOnly[str], Keys("library")] = field("Versions of Python and of the main libraries.")
    inputs: tuple[Source, ...] = field("All files that were read.")


def notice_fields(notices: Iterable[Notice]) -> dict[str, Any]:
    """``notices`` and ``warnings`` of a `Result`, as keyword arguments; every notice once."""
    each = unique(notices)
    return {
        "notices": [NoticeReport(**asdict(notice)) for notice in each],
        "warnings": [notice.text for notice in each],
    }


def provenance_fields(sources: Sequence[ProvenanceSource]) -> dict[str, Any]:
    """``versions`` and ``inputs`` of a `ReproducibleResult`, as keyword arguments."""
    return provenance(sources)


class SampleCounts(Record):
    """Number of samples of all logs together."""

    train: int = field("Samples used for the fit.")
    validation: int = field("Samples that were held out.")


class LinkEllipsoid(Record):
    """A solid ellipsoid in the link's frame."""

    center: tuple[float, float, float] = field("Centre [m].")
    semi_axes: tuple[float, float, float] = field("Semi-axes [m].")
    rpy: tuple[float, float, float] = field("Roll, pitch and yaw of its axes [rad].")


class CombinationTerm(Record):
    """A term of a combination of coefficients."""

    of: str = field("Body or joint that the coefficient belongs to.")
    what: str = field("The coefficient's name.")
    share: float = field("Factor of the coefficient.")


def plain_data(value: Any) -> Any:
    """Numbers, arrays and what holds them as plain data; None for what is not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain_data(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray):
        return plain_data(value.tolist())
    if isinstance(value, list | tuple):
        return [plain_data(inner) for inner in value]
    if isinstance(value, np.generic):
        return plain_data(value.item())
    return None if isinstance(value, float) and not math.isfinite(value) else value
