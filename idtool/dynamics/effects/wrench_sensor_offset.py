"""`WrenchSensorOffset`: readings of the wrench sensors without load, which change from log to log and with temperature.

A coordinate of the wrench that a sensor measures is off by a constant. Since a sensor is zeroed, and warms up, between
logs, each log has a constant of its own. A drift is a sum of rates r_k times max(t − t_k, 0): the rate changes at times
t_k that are far apart, so that no motion of the robot is as slow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.effect import Coefficient, Effect
from idtool.dynamics.effects.torque_offset import TorqueOffset
from idtool.dynamics.mechanism import Mechanism
from idtool.robot.config import Config, WrenchSensor
from idtool.robot.model import WRENCH_SIZE, RobotModel

_SECONDS_PER_RATE = 30.0  # for which the rate of a drift is constant, or longer
_MOST_RATES = 20  # in a log


class WrenchSensorOffset(Effect):
    """Offset of one coordinate of the wrench that a sensor measures.

    Attributes
    ----------
    row
        Index of the coordinate.
    recordings
        Logs with an offset of their own, one coefficient each; ("",): one coefficient for all logs.
    drift
        By log, times after which the rate of its drift is another one [s], one coefficient each.

    Parameters
    ----------
    model
        The robot.
    row, recordings, drift
        As above.
    prior
        The offset before any data [N or N·m].
    """

    def __init__(
        self,
        model: RobotModel,
        row: int,
        prior: float,
        recordings: Sequence[str] = ("",),
        drift: Mapping[str, Sequence[float]] | None = None,
    ) -> None:
        self.row = row
        self.recordings = tuple(recordings)
        self.drift = dict(drift or {})
        joint = model.joints[row]
        unit = TorqueOffset.units[joint.kind == "prismatic"]
        coefficients = []
        for recording in self.recordings:
            name = f"offset in {recording}" if recording else "offset"
            coefficients.append(Coefficient(TorqueOffset.id, joint.name, name, unit, prior))
        for recording, times in self.drift.items():
            for time in times:
                name = f"drift in {recording} after {time:g} s"
                coefficients.append(Coefficient(TorqueOffset.id, joint.name, name, f"{unit}/s", 0.0))
        self.coefficients = tuple(coefficients)
        self.active = tuple(np.arange(len(coefficients) if j == row else 0) for j in range(len(model.joints)))

    def shares(self, recording: str, t: Array) -> Array:
        """Offset per coefficient at times of a log [s], shape (m, N); without a name, of the first log."""
        recording = recording or self.recordings[0]
        shares = np.zeros((len(self.coefficients), len(t)))
        for share, name in zip(shares, self.recordings, strict=False):
            if name in ("", recording):
                share[:] = 1.0
        index = len(self.recordings)
        for name, times in self.drift.items():
            for time in times:
                if name == recording:
                    shares[index] = np.maximum(t - time, 0.0)
                index += 1
        return shares

    @override
    def columns(self, motion: Motion, out: Sequence[Array]) -> None:
        out[self.row][:] = self.shares(motion.recording, motion.t)

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        """Add nothing: a sensor exerts no torque."""


def wrench_sensor_offsets(model: RobotModel, config: Config) -> list[WrenchSensorOffset]:
    """Offsets of all wrench sensors, along the logs of a model; one of one log, or of none, holds for every log."""
    effects = []
    for i, sensor in enumerate(config.wrench_sensors):
        if not sensor.has_offset:
            continue
        has_several = sensor.has_offset_by_log and len(model.offset_logs) > 1
        recordings = tuple(model.offset_logs) if has_several else ("",)
        drift = model.offset_logs if sensor.has_drift else {}
        for row, offset in _rows(model, i, sensor):
            effects.append(WrenchSensorOffset(model, row, offset, recordings, drift))
    return effects


def further_offsets(
    model: RobotModel, sensors: Mapping[int, WrenchSensor], recording: str, seconds: float
) -> list[WrenchSensorOffset]:
    """Offsets of some sensors, by index, in one log, in addition to those of the model.

    Parameters
    ----------
    model
        The robot.
    sensors
        Index of a sensor among those of the model, and its configuration.
    recording
        The log.
    seconds
        Its length [s].
    """
    effects = []
    for i, sensor in sensors.items():
        drift = {recording: drift_times(seconds)} if sensor.has_drift else {}
        effects += [WrenchSensorOffset(model, row, 0.0, (recording,), drift) for row, _ in _rows(model, i, sensor)]
    return effects


def drift_times(seconds: float) -> tuple[float, ...]:
    """Times after which the rate of a drift is constant in a log of a length [s]."""
    count = int(np.clip(seconds / _SECONDS_PER_RATE, 1, _MOST_RATES))
    return tuple((seconds / count * np.arange(count)).tolist())


def _rows(model: RobotModel, index: int, sensor: WrenchSensor) -> list[tuple[int, float]]:
    """Coordinates of a sensor by its index, each with its offset before any data [N or N·m]."""
    to_body = model.wrench_sensors[sensor.joint]
    first = model.sensor_coordinates(index).start
    offsets = to_body @ np.asarray(sensor.first_offset)
    return list(zip(range(first, first + WRENCH_SIZE), offsets.tolist(), strict=True))
