"""Messages of sensors in JSON and protobuf, recognized by their fields, which are those of the ROS 2 types.

Source: the ROS 2 packages sensor_msgs, geometry_msgs and std_msgs; gz.msgs (IMU, Wrench, Boolean).
"""

from __future__ import annotations

import re

from idtool.data.logs.payloads.base import FieldError, MessageFields, SensorDecoder
from idtool.data.logs.payloads.field_values import MessageReader, field_decoders
from idtool.data.logs.payloads.message_type import MessageType
from idtool.robot.message_fields import parse_field

_MOTION = {"imu.gyro": "angular_velocity", "imu.accel": "linear_acceleration"}
_IMU = {"imu.orientation": "orientation", **_MOTION}
_WRENCH = {"force.{}": "wrench.force", "moment.{}": "wrench.torque"}
_FLAG = {"contact.{}": "data"}
_SHAPES = (_IMU, _MOTION, _WRENCH, {"force.{}": "force", "moment.{}": "torque"})
_BY_NAME = {"Imu": _IMU, "WrenchStamped": _WRENCH, "Bool": _FLAG}  # of messages whose fields are not known
_BESIDE_FLAG = {"header", "stamp", "timestamp", "data"}


def find_sensor(message_type: MessageType, reader: MessageReader) -> SensorDecoder | None:
    """Decoder of a type's messages if they are of a sensor; None if they are not."""
    if message_type.root.is_unknown:
        last_name = re.split(r"[/.]", message_type.name)[-1]
        shape = _BY_NAME.get(last_name)
        return None if shape is None else _decoder(message_type, reader, shape)
    if _is_flag(message_type):
        return _decoder(message_type, reader, _FLAG)
    for shape in _SHAPES:
        found = _decoder(message_type, reader, shape)
        if found is not None:
            return found
    return None


def _is_flag(message_type: MessageType) -> bool:
    """True if the only number of a type is a truth value called data."""
    fields = message_type.types[message_type.name]
    is_truth = "data" in fields and fields["data"].type_name == "bool" and not fields["data"].is_collection
    return is_truth and fields.keys() <= _BESIDE_FLAG


def _decoder(message_type: MessageType, reader: MessageReader, shape: dict[str, str]) -> SensorDecoder | None:
    """Decoder of messages with the fields of a shape; None if they lack one."""
    entries = {key: parse_field(key, path) for key, path in shape.items()}
    try:
        decoders = field_decoders(reader, message_type, MessageFields(entries, joints=()))
    except FieldError:
        return None
    return None if decoders.sensors is None else SensorDecoder(decoders.sensors, decoders.channels)
