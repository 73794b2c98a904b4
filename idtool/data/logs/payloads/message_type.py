"""`MessageType`: the fields of a type of messages by name, whatever the language of its definition."""

from __future__ import annotations

import difflib
from collections.abc import Mapping

from idtool.common.dataclass import dataclass
from idtool.common.names import printable, suggestion
from idtool.data.logs.payloads.base import NANOSECONDS, SECONDS, STAMP_PATHS, FieldError
from idtool.robot.message_fields import EACH, Path

NUMBERS = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
TEXTS = ("string", "wstring")
MAX_DEFINITION_BYTES = 1 << 20
_UNKNOWN = "unknown"


@dataclass(frozen=True)
class Kind:
    """Kind of a field: its type, and whether it is a single value, an array or a sequence.

    Attributes
    ----------
    type_name
        A key of `NUMBERS`, ``string``, ``wstring``, or the name of a message type with its package.
    is_collection
        True for arrays and sequences of it.
    length
        Length of an array; None for a sequence, whose length is in the message, and for a single value.
    """

    type_name: str
    is_collection: bool = False
    length: int | None = None

    @property
    def is_number(self) -> bool:
        """True for numbers, alone or in a collection."""
        return self.type_name in NUMBERS

    @property
    def is_single_number(self) -> bool:
        """True for a number that is in no array, or a value of unknown kind."""
        return (self.is_number and not self.is_collection) or self.is_unknown

    @property
    def is_text(self) -> bool:
        """True for texts, alone or in a collection."""
        return self.type_name in TEXTS

    @property
    def is_single_text(self) -> bool:
        """True for a text that is in no array, or a value of unknown kind."""
        return self == Kind("string") or self.is_unknown

    @property
    def is_unknown(self) -> bool:
        """True if the definition does not tell the kind."""
        return self == UNKNOWN

    @property
    def element(self) -> Kind:
        """An element of the collection."""
        return Kind(self.type_name)


UNKNOWN = Kind(_UNKNOWN)
Fields = Mapping[str, Kind]  # by name, in order


@dataclass(frozen=True)
class MessageType:
    """A message type: its name, and the fields of it and of all types within it.

    Attributes
    ----------
    name
        Its name.
    types
        The fields of each type by its name. A type that is not here has unknown fields if its kind is `UNKNOWN`, and
        is not defined otherwise.
    stamps
        Names of the types that are stamps; None: every number, and every type with a field of seconds.
    """

    name: str
    types: Mapping[str, Fields]
    stamps: tuple[str, ...] | None = None

    def kind_at(self, path: Path) -> Kind:
        """Kind of the field at a path; FieldError if there is no such field."""
        kind = self.root
        written = ""
        for step in path:
            if kind.is_unknown:
                return kind
            if kind.is_collection:
                if isinstance(step, str) and step != EACH:
                    raise FieldError(f"{written} is an array; give an index, as in {written}[0]")
                if isinstance(step, int) and kind.length is not None and step >= kind.length:
                    raise FieldError(f"{written} has {kind.length} elements, so that there is no index {step}")
                kind = kind.element
                written += f"[{step}]"
            elif isinstance(step, int) or step == EACH:
                raise FieldError(f"{written} is not an array")
            else:
                kind = self._field(kind, step)
                written = f"{written}.{step}" if written else step
        return kind

    @property
    def root(self) -> Kind:
        """Kind of the whole message."""
        return Kind(self.name) if self.name in self.types else UNKNOWN

    def fields_of(self, kind: Kind) -> Fields | None:
        """The fields of a type; None if it is a number or a text, or not defined."""
        return self.types.get(kind.type_name)

    def is_stamp(self, kind: Kind) -> bool:
        """True for a kind that tells a time."""
        if self.stamps is not None:
            return not kind.is_collection and kind.type_name in self.stamps
        return kind.is_single_number or self._has_seconds(kind)

    def default_stamp(self) -> Path | None:
        """Path of the stamp, if there is one."""
        for path in STAMP_PATHS:
            try:
                kind = self.kind_at(path)
            except FieldError:
                continue
            if self.is_stamp(kind) and not kind.is_number:
                return path
        return None

    def _has_seconds(self, kind: Kind) -> bool:
        fields = {} if kind.is_collection else self.fields_of(kind) or {}
        return any(name in fields for name in (*SECONDS, *NANOSECONDS))

    def _field(self, kind: Kind, name: str) -> Kind:
        fields = self._fields(kind)
        if name not in fields:
            is_similar = bool(difflib.get_close_matches(name, fields, n=1, cutoff=0.5))
            what = f"{printable(kind.type_name)} has no field {name}; {suggestion(name, fields)}"
            raise FieldError(what, closeness=0.5 if is_similar else 0.0)
        return fields[name]

    def _fields(self, kind: Kind) -> Fields:
        if kind.is_number or kind.is_text:
            raise FieldError(f"a {kind.type_name} has no fields")
        if kind.type_name not in self.types:
            raise FieldError(f"the definition of {printable(self.name)} lacks {printable(kind.type_name)}")
        return self.types[kind.type_name]
