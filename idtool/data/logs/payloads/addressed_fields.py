"""`AddressedFields`: the fields that are read of messages of a type, each found and of a kind that can be used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from idtool.common.dataclass import dataclass
from idtool.common.names import printable
from idtool.data.logs.payloads.base import FieldError, MessageFields
from idtool.data.logs.payloads.message_type import Kind, MessageType
from idtool.robot.message_fields import EACH, JOINT_NAME, STAMP, MessageField, Path, Step

COMPONENTS = ("x", "y", "z", "w")


@dataclass(frozen=True)
class SensorField:
    """A field of a sensor, and the channel of each of its numbers, with the step from the field to the number."""

    field: MessageField
    steps: tuple[Step, ...]  # none for a field that is the number itself

    @property
    def paths(self) -> list[tuple[str, Path]]:
        """Path of the number of each channel."""
        if not self.steps:
            return [(self.field.channels[0], self.field.path)]
        pairs = zip(self.field.channels, self.steps, strict=True)
        return [(channel, (*self.field.path, step)) for channel, step in pairs]


@dataclass(frozen=True)
class AddressedFields:
    """The fields that are read of messages of a type.

    Attributes
    ----------
    states
        Fields of the joints by key, the names among them.
    sensors
        Fields of the sensors.
    stamp
        Path of the stamp; None: the usual one.
    """

    states: Mapping[str, MessageField]
    sensors: Sequence[SensorField]
    stamp: Path | None

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of the sensors."""
        return tuple(channel for sensor in self.sensors for channel in sensor.field.channels)

    @property
    def thresholds(self) -> dict[str, float]:
        """Value of each channel with a threshold, above which a contact is closed."""
        fields = [sensor.field for sensor in self.sensors]
        return {field.channels[0]: field.threshold for field in fields if field.threshold is not None}


def find_fields(message_type: MessageType, fields: MessageFields) -> AddressedFields:
    """The fields of a type.

    Raises
    ------
    FieldError
        If there is no such field, or it is of another kind.
    """
    states: dict[str, MessageField] = {}
    sensors: list[SensorField] = []
    for i, (key, entry) in enumerate(fields.entries.items()):
        try:
            kind = message_type.kind_at(entry.path)
            if entry.channels:
                sensors.append(SensorField(entry, _steps(message_type, entry, kind)))
            elif key == STAMP:
                _check_stamp(message_type, entry, kind)
            else:
                _check_joint_field(key, entry, kind)
                _check_joint_count(message_type, entry, fields.joints)
                states[key] = entry
        except FieldError as error:
            raise FieldError(f"log.fields.{printable(key)}: {error}", i + error.closeness) from None
    stamp = fields.stamp.path if fields.stamp else None
    return AddressedFields(states, sensors, stamp)


def _steps(message_type: MessageType, entry: MessageField, kind: Kind) -> tuple[Step, ...]:
    """Step from a field to the number of each of its channels."""
    channels = entry.channels
    if len(channels) == 1:
        if not kind.is_single_number:
            raise FieldError(f"{entry.text} is not a number")
        return ()
    indices: tuple[Step, ...] = tuple(range(len(channels)))
    components = COMPONENTS[: len(channels)]
    if kind.is_unknown or (kind.is_collection and kind.is_number and kind.length in (None, len(channels))):
        return indices
    fields = (not kind.is_collection and message_type.fields_of(kind)) or {}
    if not all(name in fields and fields[name].is_single_number for name in components):
        raise FieldError(f"{entry.text} is neither {len(channels)} numbers nor {', '.join(components)}")
    return tuple(channel[-1] for channel in channels)


def _check_stamp(message_type: MessageType, entry: MessageField, kind: Kind) -> None:
    if not message_type.is_stamp(kind):
        of_kind = f" ({', '.join(message_type.stamps)})" if message_type.stamps else ""
        raise FieldError(f"{entry.text} is not a stamp{of_kind}")


def _check_joint_field(key: str, entry: MessageField, kind: Kind) -> None:
    if key == JOINT_NAME and not kind.is_single_text:
        raise FieldError(f"{entry.text} is not a text")
    if key != JOINT_NAME and not kind.is_single_number:
        raise FieldError(f"{entry.text} is not a number")


def _check_joint_count(message_type: MessageType, entry: MessageField, joints: Sequence[str | None]) -> None:
    """Raise FieldError if an array is shorter than the list of joints."""
    array = entry.path[: entry.path.index(EACH)]
    length = message_type.kind_at(array).length
    if length is not None and length < len(joints):
        where = entry.text.partition(f"[{EACH}]")[0]
        raise FieldError(f"{where} has {length} elements, but {len(joints)} joints are listed (log.field_joints)")
