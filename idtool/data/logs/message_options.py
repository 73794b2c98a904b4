"""`MessageOptions`: which fields to read from messages that are not joint states."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import field
from typing import TYPE_CHECKING

from idtool.common.dataclass import dataclass
from idtool.common.names import join_names, printable
from idtool.data.logs.payloads import field_decoders_for
from idtool.data.logs.payloads.base import FieldDecoders, FieldError, MessageFields
from idtool.data.logs.payloads.ros2_definition import short_type_name
from idtool.robot.config.signals import LogOptions
from idtool.robot.message_fields import JOINT_NAME, KNOWN_MESSAGES, PRESETS, parse_field

if TYPE_CHECKING:
    from mcap.records import Schema


@dataclass(frozen=True)
class MessageOptions:
    """Which fields to read from messages that are not joint states.

    Without ``preset`` and ``fields``, messages of known types are read if there are not joint states.

    Attributes
    ----------
    preset
        The robot that wrote them; see `idtool.robot.message_fields`.
    fields
        Path of each field by key; they supplement those of the preset.
    joints
        Names of the joints, in the order of their index; None: no joint. They replace those of the preset.
    robot_joints
        Joints of the URDF, by which the robot is recognized; empty: there is no URDF.
    """

    preset: str | None = None
    fields: Mapping[str, str] = field(default_factory=dict)
    joints: tuple[str | None, ...] = ()
    robot_joints: Collection[str] = ()

    @property
    def are_given(self) -> bool:
        """True if other messages than joint states are asked for."""
        return self.preset is not None or bool(self.fields)


DEFAULT_MESSAGES = MessageOptions()


@dataclass(frozen=True)
class FieldSource:
    """Decoders of a channel's messages by their fields, and the preset that names their joints.

    Attributes
    ----------
    decoders
        The decoders.
    preset
        The robot whose joints they are; None: the messages or the configuration name them.
    """

    decoders: FieldDecoders
    preset: str | None


def message_options(options: LogOptions, robot_joints: Collection[str] = ()) -> MessageOptions:
    """The options of a configuration, for a robot with some joints."""
    return MessageOptions(options.preset, options.fields, options.field_joints, robot_joints)


def find_field_source(encoding: str, schema: Schema | None, options: MessageOptions) -> FieldSource | None:
    """Source of the fields in a channel's messages; None if nothing is known of messages of their type.

    Raises
    ------
    FieldError
        If they lack a field, or the names of their joints are not known.
    """
    type_name = short_type_name(schema.name) if schema else ""
    preset = options.preset
    tables = KNOWN_MESSAGES.get(type_name, ())
    if preset is not None and PRESETS[preset].message != type_name:
        raise FieldError(f"its messages are not {PRESETS[preset].message}, which preset {preset} reads")
    if preset is None and options.fields:
        tables = ({},)
    if not tables:
        return None
    names_joints = JOINT_NAME in {**tables[0], **options.fields}
    if preset is None and not options.joints and not names_joints:
        preset = _recognized_preset(type_name, options.robot_joints)
    joints = options.joints
    if not joints and preset is not None:
        joints = PRESETS[preset].joints
    errors = []
    for table in tables:
        entries = {key: parse_field(key, text) for key, text in {**table, **options.fields}.items()}
        try:
            decoders = field_decoders_for(encoding, schema, MessageFields(entries, joints))
        except FieldError as error:
            is_known_type = type_name in KNOWN_MESSAGES
            errors.append(FieldError(str(error), error.closeness + is_known_type))
        else:
            return FieldSource(decoders, None if options.joints else preset)
    raise max(errors, key=lambda error: error.closeness)


def _recognized_preset(type_name: str, robot_joints: Collection[str]) -> str:
    """The preset for a type whose joints the robot has; without a robot, the first one for the type."""
    candidates = [name for name, preset in PRESETS.items() if preset.message == type_name]
    for name in candidates:
        if not robot_joints or set(_joint_names(name)) <= set(robot_joints):
            return name
    first = next(_joint_names(candidates[0]))
    what = f"{printable(type_name)} has no names of the joints"
    why = f"the URDF's are not those of {join_names(candidates)} (such as {first})"
    advice = "set log.preset, or list them in log.field_joints in the order of the message"
    raise FieldError(f"{what}, and {why}; {advice}", closeness=1.0)


def _joint_names(preset: str) -> Iterator[str]:
    return (joint for joint in PRESETS[preset].joints if joint is not None)
