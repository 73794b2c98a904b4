"""Findings on the sensors that a configuration names: channels that are missing or empty, gaps, dead sensors."""

from __future__ import annotations

from collections.abc import Iterator

from idtool.common.exceptions import LogError
from idtool.common.notice import Notice
from idtool.data.base_sensors import channels_by_sensor
from idtool.data.logs.log import JointLog
from idtool.data.logs.sensor_channels import is_dead, with_sensors
from idtool.robot.config import Config


def sensor_findings(log: JointLog, config: Config) -> Iterator[Notice]:
    """Notices about the sensors that a fit with a configuration takes from a log."""
    wrench_sensors = {sensor.joint for sensor in config.wrench_sensors}
    for name, channels in channels_by_sensor(config):
        try:
            needed = with_sensors(log, channels)
        except LogError as error:
            yield Notice("sensor_unusable", "problem", name, error.what)
            continue
        for notice in needed.notices:
            if notice not in log.notices:
                yield notice.about(name)
        if name == "pose" and is_dead(log, channels):
            message = "it has a constant reading"
            yield Notice("pose_dead", "problem", name, message, "log it, or remove base.pose")
        if name in wrench_sensors and is_dead(log, channels):
            message = "the wrench sensor has a constant reading"
            yield Notice("wrench_sensor_dead", "problem", name, message, "log it, or remove it from wrench_sensors")
