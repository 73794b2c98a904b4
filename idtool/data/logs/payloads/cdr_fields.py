"""Fields of any CDR message, found by its definition. Only the addressed fields are decoded.

One message is read from front to back up to the last addressed field, which tells the offset of each number. All
messages of the same layout are then decoded together.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.names import count_text, printable, suggestion
from idtool.data.logs.payloads.base import STAMP_PATHS, Decoder, FieldDecoders, FieldError, MessageFields, check_names
from idtool.data.logs.payloads.cdr_cursor import Cursor, no_stamp, stamp_seconds
from idtool.data.logs.payloads.layout import Bytes, Layout, decode_by_layout
from idtool.data.logs.payloads.ros2_definition import NUMBERS, TIME, Fields, Kind, parse_definition, short_type_name
from idtool.data.logs.sample_buffer import MAX_JOINTS, Samples
from idtool.robot.message_fields import EACH, JOINT_NAME, STAMP, MessageField, Path, Step

if TYPE_CHECKING:
    from mcap.records import Schema

_MAX_VISITS = 1 << 14  # fields and elements of a message that are passed one by one
_MAX_DEPTH = 32  # of types within types
_COMPONENTS = ("x", "y", "z", "w")
_TIME_SIZE, _TIME_ALIGNMENT = 8, 4  # bytes


def field_decoders(schema: Schema, fields: MessageFields) -> FieldDecoders:
    """Decoders of the addressed fields of a schema's messages.

    Raises
    ------
    FieldError
        If the schema has no such field, or cannot be read.
    """
    try:
        types = parse_definition(schema)
    except ValueError as error:
        raise FieldError(str(error)) from None
    message_type = _MessageType(short_type_name(schema.name), types)
    stamp = fields.stamp.path if fields.stamp else message_type.default_stamp()
    state_paths: list[tuple[str, Path]] = []
    sensor_paths: list[tuple[str, Path]] = []
    thresholds: dict[str, float] = {}
    for i, (key, entry) in enumerate(fields.entries.items()):
        try:
            kind = message_type.kind_at(entry.path)
            if entry.channels:
                sensor_paths += _channel_paths(message_type, entry, kind)
            elif key == STAMP:
                _check_stamp(entry, kind)
            else:
                _check_joint_field(key, entry, kind)
                _check_joint_count(message_type, entry, fields.joints)
                state_paths.append((key, entry.path))
        except FieldError as error:
            raise FieldError(f"log.fields.{printable(key)}: {error}", i + error.closeness) from None
        if entry.threshold is not None:
            thresholds[entry.channels[0]] = entry.threshold
    channels = tuple(name for name, _ in sensor_paths)
    if stamp is not None:
        state_paths.append((STAMP, stamp))
        sensor_paths.append((STAMP, stamp))
    states = _state_decoder(message_type.reader(state_paths), fields)
    sensors = _sensor_decoder(message_type.reader(sensor_paths), channels, thresholds)
    return FieldDecoders(states, sensors, channels)


@dataclass
class _PathNode:
    """Node of the tree of addressed fields: the labels of those that end here, and the nodes within it, by step."""

    labels: list[str] = field(default_factory=list)
    children: dict[Step, _PathNode] = field(default_factory=dict)

    def add(self, label: str, path: Path) -> None:
        node = self
        for step in path:
            node = node.children.setdefault(step, _PathNode())
        node.labels.append(label)


@dataclass(frozen=True)
class _MessageType:
    """A message type: its name, and the fields of it and of all types within it."""

    name: str
    types: Mapping[str, Fields]

    def kind_at(self, path: Path) -> Kind:
        """Kind of the field at a path; FieldError if there is no such field."""
        kind = Kind(self.name)
        written = ""
        for step in path:
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

    def default_stamp(self) -> Path | None:
        """Path of the stamp, if there is one."""
        for path in STAMP_PATHS:
            try:
                if self.kind_at(path) == Kind(TIME):
                    return path
            except FieldError:
                pass
        return None

    def fields_of(self, kind: Kind) -> Fields | None:
        """The fields of a type; None if it is a number or a text, or not defined."""
        return self.types.get(kind.type_name)

    def reader(self, paths: Iterable[tuple[str, Path]]) -> _Reader:
        """Reader of the fields at some paths, by label."""
        root = _PathNode()
        for label, path in paths:
            root.add(label, path)
        return _Reader(self, root)


def _channel_paths(message_type: _MessageType, entry: MessageField, kind: Kind) -> list[tuple[str, Path]]:
    """Path of the number of each channel of a field."""
    channels = entry.channels
    if len(channels) == 1:
        if not kind.is_single_number:
            raise FieldError(f"{entry.text} is not a number")
        return [(channels[0], entry.path)]
    steps: Sequence[Step] = range(len(channels))
    components = _COMPONENTS[: len(channels)]
    if kind.is_collection:
        is_usable = kind.is_number and kind.length in (None, len(channels))
    else:
        fields = message_type.fields_of(kind) or {}
        is_usable = all(name in fields and fields[name].is_single_number for name in components)
        steps = [channel[-1] for channel in channels]
    if not is_usable:
        raise FieldError(f"{entry.text} is neither {len(channels)} numbers nor {', '.join(components)}")
    return [(channel, (*entry.path, step)) for channel, step in zip(channels, steps, strict=True)]


def _check_stamp(entry: MessageField, kind: Kind) -> None:
    if kind != Kind(TIME):
        raise FieldError(f"{entry.text} is not a stamp ({TIME})")


def _check_joint_field(key: str, entry: MessageField, kind: Kind) -> None:
    if key == JOINT_NAME and kind != Kind("string"):
        raise FieldError(f"{entry.text} is not a text")
    if key != JOINT_NAME and not kind.is_single_number:
        raise FieldError(f"{entry.text} is not a number")


def _check_joint_count(message_type: _MessageType, entry: MessageField, joints: Sequence[str | None]) -> None:
    """Raise FieldError if an array is shorter than the list of joints."""
    array = entry.path[: entry.path.index(EACH)]
    length = message_type.kind_at(array).length
    if length is not None and length < len(joints):
        where = entry.text.partition(f"[{EACH}]")[0]
        raise FieldError(f"{where} has {length} elements, but {len(joints)} joints are listed (log.field_joints)")


@dataclass
class _Found:
    """Addressed fields of one message: offsets and type of the numbers by label, names, and the stamp's offset."""

    offsets: dict[str, list[int]] = field(default_factory=dict)
    type_codes: dict[str, str] = field(default_factory=dict)
    joint_names: list[str] = field(default_factory=list)
    stamp_offset: int | None = None
    visit_count: int = 0


@dataclass(frozen=True)
class _Reader:
    """Finds addressed fields in a message."""

    message_type: _MessageType
    root: _PathNode

    def find(self, cursor: Cursor) -> _Found:
        """The addressed fields; ValueError if the message does not match its definition."""
        found = _Found()
        fields = self.message_type.types[self.message_type.name]
        remaining = set(self.root.children)
        for name, kind in fields.items():
            if not remaining:  # what follows is not read
                break
            self._visit(cursor, kind, _children_at([self.root], name), found, depth=0)
            remaining.discard(name)
        return found

    def _visit(self, cursor: Cursor, kind: Kind, nodes: Sequence[_PathNode], found: _Found, depth: int) -> None:
        """Move over a field or an element, and note what is addressed."""
        found.visit_count += 1
        if found.visit_count > _MAX_VISITS or depth > _MAX_DEPTH:
            raise ValueError("has too many nested fields; is this a message of a robot's state?")
        if kind.is_collection:
            self._visit_collection(cursor, kind, nodes, found, depth)
        elif kind.is_number:
            size = np.dtype(NUMBERS[kind.type_name]).itemsize
            offset = cursor.skip(size, size)
            _record_offset(nodes, offset, kind, found)
        elif kind.type_name == "string":
            if any(JOINT_NAME in node.labels for node in nodes):
                if len(found.joint_names) == MAX_JOINTS:
                    raise ValueError(f"names more than {MAX_JOINTS} joints")
                found.joint_names.append(cursor.string())
            else:
                length = cursor.count()
                cursor.skip(length)
        else:
            self._visit_message(cursor, kind, nodes, found, depth)

    def _visit_collection(
        self, cursor: Cursor, kind: Kind, nodes: Sequence[_PathNode], found: _Found, depth: int
    ) -> None:
        if not kind.is_number:
            cursor.skip_collection_size()
        count = cursor.count() if kind.length is None else kind.length
        if not kind.is_number:
            for i in range(count):
                self._visit(cursor, kind.element, _children_at(nodes, i), found, depth + 1)
            return
        if not count:  # then there is no padding either
            return
        size = np.dtype(NUMBERS[kind.type_name]).itemsize
        start = cursor.skip(count * size, size)
        for node in nodes:
            for step, child in node.children.items():
                if isinstance(step, int):
                    elements = [step] if step < count else []
                else:
                    elements = list(range(min(count, MAX_JOINTS)))
                for i in elements:
                    _record_offset([child], start + i * size, kind, found)

    def _visit_message(self, cursor: Cursor, kind: Kind, nodes: Sequence[_PathNode], found: _Found, depth: int) -> None:
        fields = self.message_type.fields_of(kind)
        if fields is None:
            raise ValueError(f"contains {printable(kind.type_name)}, which cannot be read")
        if kind.type_name == TIME and any(STAMP in node.labels for node in nodes):
            found.stamp_offset = cursor.skip(_TIME_SIZE, _TIME_ALIGNMENT)
            return
        if not fields:
            cursor.skip(1)  # ROS 2 fills a message without fields with a byte
        for name, inner in fields.items():
            self._visit(cursor, inner, _children_at(nodes, name), found, depth + 1)


def _children_at(nodes: Sequence[_PathNode], step: Step) -> list[_PathNode]:
    """Nodes within some nodes, at the field or element of a step."""
    inner = [node.children[step] for node in nodes if step in node.children]
    if isinstance(step, int):
        inner += [node.children[EACH] for node in nodes if EACH in node.children]
    return inner


def _record_offset(nodes: Sequence[_PathNode], offset: int, kind: Kind, found: _Found) -> None:
    for node in nodes:
        for label in node.labels:
            found.offsets.setdefault(label, []).append(offset)
            found.type_codes[label] = NUMBERS[kind.type_name]


def _state_decoder(reader: _Reader, fields: MessageFields) -> Decoder:
    layout = partial(_state_layout, reader=reader, fields=fields)

    def decode(buffer: bytes, starts: Indices, lengths: Indices) -> list[Samples]:
        samples, _ = decode_by_layout(buffer, starts, lengths, layout)
        return samples

    return decode


def _state_layout(message: bytes, reader: _Reader, fields: MessageFields) -> Layout:
    """Layout of the joints' signals in a message."""
    cursor = Cursor(message)
    found = reader.find(cursor)
    listed: Sequence[str | None] = fields.joints or found.joint_names
    is_listed = [name is not None for name in listed]
    joints = tuple(name for name in listed if name is not None)
    check_names(joints)
    signals = {}
    for signal, offsets in found.offsets.items():
        is_short = len(offsets) < len(listed)
        is_long = not fields.joints and len(offsets) > len(listed)
        if is_short or is_long:
            path = fields.entries[signal].text
            raise ValueError(f"has {count_text(len(offsets), 'value')} of {path} for {len(listed)} joints")
        of_listed = np.array(offsets[: len(listed)])
        used = of_listed[is_listed]
        signals[signal] = (used, _number_type(found, signal, cursor))
    return Layout(joints, cursor.mask, signals, _stamp_function(found, cursor))


def _sensor_decoder(reader: _Reader, channels: Sequence[str], thresholds: Mapping[str, float]) -> Decoder | None:
    if not channels:
        return None
    layout = partial(_sensor_layout, reader=reader, channels=channels)

    def decode(buffer: bytes, starts: Indices, lengths: Indices) -> list[Samples]:
        samples, _ = decode_by_layout(buffer, starts, lengths, layout)
        return [_with_one_signal(piece, channels, thresholds) for piece in samples]

    return decode


def _sensor_layout(message: bytes, reader: _Reader, channels: Sequence[str]) -> Layout:
    """Layout of the channels' numbers in a message, each of which is a signal."""
    cursor = Cursor(message)
    found = reader.find(cursor)
    signals = {}
    for channel in channels:
        if channel not in found.offsets:
            raise ValueError(f"lacks the number of channel {printable(channel)}: its sequence is too short")
        signals[channel] = (np.array(found.offsets[channel]), _number_type(found, channel, cursor))
    return Layout(("",), cursor.mask, signals, _stamp_function(found, cursor))


def _with_one_signal(piece: Samples, channels: Sequence[str], thresholds: Mapping[str, float]) -> Samples:
    """The samples with all channels in the signal ``sensor``; a contact with a threshold is 1 if closed, 0 if open."""
    columns = []
    for channel in channels:
        x = piece.signals[channel][:, 0]
        columns.append(x > thresholds[channel] if channel in thresholds else x)
    return Samples(piece.index, piece.t, tuple(channels), {"sensor": np.column_stack(columns).astype(np.float64)})


def _number_type(found: _Found, label: str, cursor: Cursor) -> np.dtype[np.floating]:
    return np.dtype(f"{cursor.order}{found.type_codes[label]}")


def _stamp_function(found: _Found, cursor: Cursor) -> Callable[[Bytes], Array]:
    return (
        no_stamp
        if found.stamp_offset is None
        else partial(stamp_seconds, offset=found.stamp_offset, order=cursor.order)
    )
