"""Addressed fields of messages that are decoded one by one, such as JSON and protobuf."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.names import count_text, printable
from idtool.data.logs.payloads.addressed_fields import COMPONENTS, AddressedFields, SensorField, find_fields
from idtool.data.logs.payloads.base import (
    FieldDecoders,
    JointState,
    MessageFields,
    MissingFieldError,
    PayloadError,
    group_states,
    number_array,
)
from idtool.data.logs.payloads.message_type import MessageType
from idtool.data.logs.sample_buffer import MAX_JOINTS, Samples
from idtool.robot.message_fields import EACH, JOINT_NAME, STAMP, MessageField, Path, Step


class MessageReader(ABC):
    """Decoding of messages of a type, and access to their fields."""

    @abstractmethod
    def parse(self, buffer: bytes, starts: Indices, lengths: Indices) -> list[Any]:
        """Messages as objects; PayloadError if one cannot be decoded."""

    @abstractmethod
    def value(self, outer: Any, step: Step) -> Any:
        """Value of a field of an object, or of an element of an array; None if it is left open.

        Raises LookupError, AttributeError or TypeError if there is no such field or element.
        """

    @abstractmethod
    def is_object(self, value: Any) -> bool:
        """True for a value with named fields."""

    @abstractmethod
    def stamp_seconds(self, stamp: Any) -> float:
        """The time of a stamp [s]; TypeError if it is none."""

    @abstractmethod
    def default_seconds(self, index: int, message: Any) -> float:
        """The time of a message [s] by the usual names of stamps, 0 without any; PayloadError if it is none."""

    def value_at(self, message: Any, path: Path) -> Any:
        """Value at a path; errors are those of `value`."""
        value = message
        for step in path:
            if value is None:
                return None
            value = self.value(value, step)
        return value


def field_decoders(reader: MessageReader, message_type: MessageType, fields: MessageFields) -> FieldDecoders:
    """Decoders of the addressed fields of a type's messages.

    Raises
    ------
    FieldError
        If the type has no such field.
    """
    addressed = find_fields(message_type, fields)
    decoder = _FieldDecoder(reader, addressed, fields.joints)
    return FieldDecoders(decoder.states, decoder.sensors if addressed.sensors else None, addressed.channels)


class _FieldDecoder:
    def __init__(self, reader: MessageReader, addressed: AddressedFields, joints: Sequence[str | None]) -> None:
        self._reader = reader
        self._addressed = addressed
        self._joints = joints
        self._signals = [key for key in addressed.states if key != JOINT_NAME]
        self._keys = list(addressed.states)

    def states(self, buffer: bytes, starts: Indices, lengths: Indices) -> list[Samples]:
        """The joints' signals in messages."""
        messages = self._reader.parse(buffer, starts, lengths)
        states = [self._state(i, message) for i, message in enumerate(messages)]
        return group_states(states, {self._addressed.states[key].text: key for key in self._signals})

    def sensors(self, buffer: bytes, starts: Indices, lengths: Indices) -> list[Samples]:
        """The numbers of the sensors' channels in messages."""
        messages = self._reader.parse(buffer, starts, lengths)
        if not messages:
            return []
        rows = [self._numbers(i, message) for i, message in enumerate(messages)]
        times = np.array([self._seconds(i, message) for i, message in enumerate(messages)])
        channels = self._addressed.channels
        values = number_array(rows, range(len(rows)))
        for channel, threshold in self._addressed.thresholds.items():
            column = values[:, channels.index(channel)]
            is_closed: Array = (column > threshold).astype(np.float64)
            values[:, channels.index(channel)] = np.where(np.isnan(column), np.nan, is_closed)
        return [Samples(np.arange(len(rows)), times, channels, {"sensor": values})]

    def _state(self, i: int, message: Any) -> JointState:
        listed: Sequence[str | None] = self._joints or self._names(i, message)
        values = []
        for key in self._signals:
            of_joints = self._elements(i, message, key)
            is_short = len(of_joints) < len(listed)
            is_long = not self._joints and len(of_joints) > len(listed)
            if is_short or is_long:
                path = self._addressed.states[key].text
                what = f"has {count_text(len(of_joints), 'value')} of {path} for {len(listed)} joints"
                raise PayloadError(i, what)
            values.append([x for name, x in zip(listed, of_joints, strict=False) if name is not None])
        joints = tuple(name for name in listed if name is not None)
        return JointState(self._seconds(i, message), joints, tuple(values))

    def _names(self, i: int, message: Any) -> list[str]:
        names = self._elements(i, message, JOINT_NAME)
        if len(names) > MAX_JOINTS:
            raise PayloadError(i, f"names more than {MAX_JOINTS} joints")
        for name in names:
            if not isinstance(name, str):
                raise PayloadError(i, f"has a joint name that is not a text: {printable(str(name))}")
        return names

    def _elements(self, i: int, message: Any, key: str) -> list[Any]:
        """Values of a field of every joint, of some more than are allowed at most."""
        field = self._addressed.states[key]
        place = field.path.index(EACH)
        try:
            array = self._reader.value_at(message, field.path[:place])
            if self._reader.is_object(array):
                raise TypeError
            elements = array[: len(self._joints) or MAX_JOINTS + 1]
            return [self._reader.value_at(element, field.path[place + 1 :]) for element in elements]
        except (LookupError, AttributeError, TypeError):
            raise self._missing(i, key, field) from None

    def _numbers(self, i: int, message: Any) -> list[Any]:
        """The number of each channel."""
        numbers: list[Any] = []
        for sensor in self._addressed.sensors:
            numbers += self._numbers_of(i, message, sensor)
        return numbers

    def _numbers_of(self, i: int, message: Any, sensor: SensorField) -> list[Any]:
        field = sensor.field
        try:
            value = self._reader.value_at(message, field.path)
            if len(field.channels) == 1:
                return [value]
            if value is None:
                return [None] * len(field.channels)
            if self._reader.is_object(value):
                return [self._reader.value(value, channel[-1]) for channel in field.channels]
            if len(value) == len(field.channels):
                return list(value)
        except (LookupError, AttributeError, TypeError):
            raise self._missing(i, field.channels[0], field) from None
        components = ", ".join(COMPONENTS[: len(field.channels)])
        raise PayloadError(i, f"has a {field.text} that is neither {len(field.channels)} numbers nor {components}")

    def _seconds(self, i: int, message: Any) -> float:
        path = self._addressed.stamp
        if path is None:
            return self._reader.default_seconds(i, message)
        try:
            return self._reader.stamp_seconds(self._reader.value_at(message, path))
        except (LookupError, AttributeError, TypeError, OverflowError):
            raise MissingFieldError(i, f"stamp at log.fields.{STAMP}", len(self._keys)) from None

    def _missing(self, i: int, key: str, field: MessageField) -> MissingFieldError:
        found_before = self._keys.index(key) if key in self._keys else len(self._keys)
        return MissingFieldError(i, field.text, found_before)
