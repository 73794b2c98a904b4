"""Fields of any CDR message, found by its definition. Only the addressed fields are decoded.

One message is read from front to back up to the last addressed field, which tells the offset of each number. All
messages of the same layout are then decoded together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.names import count_text, printable
from idtool.data.logs.payloads.addressed_fields import AddressedFields, find_fields
from idtool.data.logs.payloads.base import Decoder, FieldDecoders, FieldError, MessageFields, check_names
from idtool.data.logs.payloads.cdr_cursor import Cursor, no_stamp, stamp_seconds
from idtool.data.logs.payloads.layout import Bytes, Layout, LayoutDecoder
from idtool.data.logs.payloads.message_type import NUMBERS, Kind, MessageType
from idtool.data.logs.payloads.ros2_definition import TIME, parse_definition, short_type_name
from idtool.data.logs.sample_buffer import MAX_JOINTS, Samples
from idtool.robot.message_fields import EACH, JOINT_NAME, STAMP, Path, Step

if TYPE_CHECKING:
    from mcap.records import Schema

_MAX_VISITS = 1 << 14  # fields and elements of a message that are passed one by one
_MAX_DEPTH = 32  # of types within types
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
    message_type = MessageType(short_type_name(schema.name), types, stamps=(TIME,))
    found = find_fields(message_type, fields)
    stamp = found.stamp or message_type.default_stamp()
    stamp_paths = [] if stamp is None else [(STAMP, stamp)]
    state_paths = [(key, field.path) for key, field in found.states.items()]
    sensor_paths = [path for sensor in found.sensors for path in sensor.paths]
    states = _state_decoder(_reader(message_type, state_paths + stamp_paths), fields)
    sensors = _sensor_decoder(_reader(message_type, sensor_paths + stamp_paths), found)
    return FieldDecoders(states, sensors, found.channels)


def _reader(message_type: MessageType, paths: Iterable[tuple[str, Path]]) -> _Reader:
    """Reader of the fields at some paths, by label."""
    root = _PathNode()
    for label, path in paths:
        root.add(label, path)
    return _Reader(message_type, root)


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

    message_type: MessageType
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
    return LayoutDecoder(partial(_state_layout, reader=reader, fields=fields))


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


def _sensor_decoder(reader: _Reader, addressed: AddressedFields) -> Decoder | None:
    channels, thresholds = addressed.channels, addressed.thresholds
    if not channels:
        return None
    decode_numbers = LayoutDecoder(partial(_sensor_layout, reader=reader, channels=channels))

    def decode(buffer: bytes, starts: Indices, lengths: Indices) -> list[Samples]:
        samples = decode_numbers(buffer, starts, lengths)
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
