"""Cut-off of the low-pass where the configuration has none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.notice import Notice
from idtool.data.base_sensors import band_limit, sensor_step
from idtool.data.gyroscope_band import gyroscope_band
from idtool.data.logs import JointLog
from idtool.data.signals import default_cutoff
from idtool.robot.config import Config


def with_band_of_logs(config: Config, logs: Sequence[JointLog]) -> tuple[Config, list[Notice]]:
    """The configuration with one band for all logs, or their errors could not be added up; and notices about it.

    Parameters
    ----------
    config
        The configuration; a cut-off that it has stays.
    logs
        The logs, with the sensors of the base.
    """
    if config.filter.cutoff_hz is not None:
        return config, []
    by_rate = with_default_band(config, max(max(log.dt, sensor_step(log, config)) for log in logs))
    has_gyroscope = config.base.kind == "floating" and not config.base.uses_pose
    clear_hz = np.floor(gyroscope_band(logs)) if has_gyroscope else np.inf
    if clear_hz >= (by_rate.filter.cutoff_hz or np.inf):
        return by_rate, []
    message = f"the filter's cut-off is {clear_hz:.0f} Hz: above, the gyroscope's noise disturbs what is identified"
    notice = Notice("band_by_gyroscope", "note", "imu", message, "set filter.cutoff_hz for another one")
    return _with_cutoff(config, clear_hz), [notice]


def with_default_band(config: Config, dt: float) -> Config:
    """The configuration, with the default cut-off of the low-pass if it has none, for samples of a time [s]."""
    if config.filter.cutoff_hz is not None:
        return config
    return _with_cutoff(config, min(band_limit(config), default_cutoff(dt)))


def _with_cutoff(config: Config, cutoff_hz: float) -> Config:
    return config.model_copy(update={"filter": config.filter.model_copy(update={"cutoff_hz": float(cutoff_hz)})})
