"""Choice of the low-pass's cut-off where the configuration gives none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.notice import Notice
from idtool.data.base_sensors import band_limit, sensor_step
from idtool.data.gyroscope_cutoff import gyroscope_cutoff
from idtool.data.logs import JointLog
from idtool.data.signals import default_cutoff
from idtool.robot.config import Config


def with_cutoff_for_logs(config: Config, logs: Sequence[JointLog]) -> tuple[Config, list[Notice]]:
    """The configuration with one cut-off for all logs, since errors in different bands cannot be added up.

    Parameters
    ----------
    config
        The configuration; a cut-off that it has stays.
    logs
        The logs, with the sensors of the base.

    Returns
    -------
    The configuration, and a notice if a noisy gyroscope lowers the cut-off.
    """
    if config.filter.cutoff_hz is not None:
        return config, []
    periods = [max(log.dt, sensor_step(log, config)) for log in logs]
    default_hz = _default_hz(config, max(periods))
    uses_gyroscope = config.base.kind == "floating" and not config.base.uses_pose
    clear_hz = np.floor(gyroscope_cutoff(logs)) if uses_gyroscope else np.inf
    if clear_hz >= default_hz:
        return _with_cutoff(config, default_hz), []
    message = f"the filter's cut-off is {clear_hz:.0f} Hz, since the gyroscope's noise would bias what is identified"
    notice = Notice("band_by_gyroscope", "note", "imu", message, "set filter.cutoff_hz for another one")
    return _with_cutoff(config, clear_hz), [notice]


def with_cutoff_for_period(config: Config, period: float) -> Config:
    """The configuration, with the default cut-off for a sampling period [s] if it has none."""
    if config.filter.cutoff_hz is not None:
        return config
    return _with_cutoff(config, _default_hz(config, period))


def _default_hz(config: Config, period: float) -> float:
    return min(band_limit(config), default_cutoff(period))


def _with_cutoff(config: Config, cutoff_hz: float) -> Config:
    """The configuration with a cut-off [Hz]."""
    low_pass = config.filter.model_copy(update={"cutoff_hz": float(cutoff_hz)})
    return config.model_copy(update={"filter": low_pass})
