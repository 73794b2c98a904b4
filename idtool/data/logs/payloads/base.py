"""Common parts of the payload decoders: their type, their error, and the fields of a joint state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.names import printable
from idtool.data.logs.sample_buffer import Samples
from idtool.robot.message_fields import STAMP, MessageField

SIGNALS = {"position": "q", "velocity": "v", "effort": "tau"}
STAMP_PATHS = (("header", "stamp"), ("stamp",), ("timestamp",))
SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")

# Decodes messages, given a buffer and the start and length of each message; t = 0 for a message without a stamp.
Decoder = Callable[[bytes, Indices, Indices], list[Samples]]
# Decodes the text of a message, in UTF-8; ValueError if that fails.
TextDecoder = Callable[[bytes], bytes]


class PayloadError(Exception):
    """A message that cannot be decoded.

    Parameters
    ----------
    index
        Its index among the messages given to the decoder.
    message
        What is wrong with it.
    """

    def __init__(self, index: int, message: object) -> None:
        self.index = index
        super().__init__(str(message))


class FieldError(ValueError):
    """A path that a message type does not have, or a definition that cannot be read.

    Parameters
    ----------
    message
        What is wrong with it.
    closeness
        Tells the topic that was meant: 1 for a known type, 1 for each path that was found before, 0.5 for a similar
        name.
    """

    def __init__(self, message: str, closeness: float = 0.0) -> None:
        self.closeness = closeness
        super().__init__(message)


class MissingFieldError(PayloadError):
    """A message without an addressed field that its definition, which is incomplete, does not rule out.

    Parameters
    ----------
    index
        Its index among the messages given to the decoder.
    what
        What it has not.
    closeness
        As of a `FieldError`.
    """

    def __init__(self, index: int, what: str, closeness: float) -> None:
        self.field_error = FieldError(f"its messages have no {what}", closeness)
        super().__init__(index, f"has no {what}")


@dataclass(frozen=True)
class MessageFields:
    """Fields to read from messages that are not joint states, and the joints in the order of their index.

    Attributes
    ----------
    entries
        The fields by key.
    joints
        Names of the joints, in the order of their index; None: no joint. Empty if the messages name the joints.
    """

    entries: Mapping[str, MessageField]
    joints: tuple[str | None, ...]

    @property
    def stamp(self) -> MessageField | None:
        """The stamp; None: the usual one, if there is any."""
        return self.entries.get(STAMP)


@dataclass(frozen=True)
class FieldDecoders:
    """Decoders of the addressed fields of messages.

    Attributes
    ----------
    states
        Decoder of the joints' signals.
    sensors
        Decoder of the channels of sensors, whose numbers are the signal ``sensor``; None: there are none.
    channels
        Their names.
    """

    states: Decoder
    sensors: Decoder | None
    channels: tuple[str, ...]


@dataclass(frozen=True)
class SensorDecoder:
    """Decoder of the messages of a sensor.

    Attributes
    ----------
    decode
        The decoder, whose numbers are the signal ``sensor``.
    numbers
        Channel of each number, in which {} stands for the name of the topic; empty: the number is not read.
    """

    decode: Decoder
    numbers: tuple[str, ...]

    def channels(self, topic: str) -> tuple[str, ...]:
        """Channel of each number of a topic's messages; empty: the number is not read."""
        return channel_names(self.numbers, topic)


def channel_names(numbers: Sequence[str], topic: str) -> tuple[str, ...]:
    """Channels of a topic's messages, from names in which {} stands for the name of the topic."""
    return tuple(number.format(topic) for number in numbers)


class JointState(NamedTuple):
    """One message: time [s], joint names, and the values of each signal, empty if missing."""

    t: float
    joints: tuple[str, ...]
    values: tuple[Sequence[float], ...]  # in the order of the signals


def check_names(joints: Sequence[str]) -> None:
    """Raise ValueError for joint names that repeat or cannot be printed."""
    if len(set(joints)) < len(joints):
        repeated = next(name for name in joints if joints.count(name) > 1)
        raise ValueError(f"names joint {printable(repeated)} twice")
    if not "".join(joints).isprintable():
        raise ValueError("has a joint name with characters that cannot be printed")


def check_counts(joints: int, counts: Sequence[int], fields: Sequence[str] = tuple(SIGNALS)) -> None:
    """Raise ValueError if a signal has values, but not one for each joint."""
    for field, count in zip(fields, counts, strict=True):
        if count not in (0, joints):
            raise ValueError(f"has {joints} names and {count} values of {field}")


def group_states(states: Sequence[JointState], fields: Mapping[str, str] = SIGNALS) -> list[Samples]:
    """Joint states as arrays, those with the same joints and signals together.

    Parameters
    ----------
    states
        The joint states.
    fields
        The messages' name of each signal to that of the log, in the order of the values.

    Raises
    ------
    PayloadError
        For the first message with unusable names or values.
    """
    groups: dict[tuple[tuple[str, ...], tuple[int, ...]], list[int]] = {}
    for i, (_, joints, values) in enumerate(states):
        groups.setdefault((joints, tuple(map(len, values))), []).append(i)
    samples = []
    for (joints, counts), index in groups.items():
        try:
            check_names(joints)
            check_counts(len(joints), counts, tuple(fields))
        except ValueError as error:
            raise PayloadError(index[0], error) from None
        signals = {}
        for k, signal in enumerate(fields.values()):
            if counts[k]:
                signals[signal] = number_array([states[i].values[k] for i in index], index)
        samples.append(Samples(np.array(index), np.array([states[i].t for i in index]), joints, signals))
    return samples


def number_array(rows: Sequence[Sequence[float]], index: Sequence[int]) -> Array:
    """Values of several messages, shape (k, nj); PayloadError for the first message whose values are no numbers."""
    try:
        array = np.array(rows, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        array = np.empty(0)
    if array.ndim == 2:
        return array
    if len(rows) == 1:
        raise PayloadError(index[0], "has values that are not numbers")
    return np.concatenate([number_array([row], [i]) for row, i in zip(rows, index, strict=True)])
