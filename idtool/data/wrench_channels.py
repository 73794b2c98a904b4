"""`WrenchChannels`: forces and moments that fixed joints transmit, from the channels of a log.

Shapes: N samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.data.logs.log import Channel, JointLog
from idtool.robot.config import Config
from idtool.robot.model import RobotModel


@dataclass(frozen=True)
class WrenchChannels:
    """The wrench sensors of a robot in a log.

    Attributes
    ----------
    channels
        The six channels of each sensor, force and moment, in the order of the model's coordinates.
    to_body
        What turns a sensor's reading into the wrench on the body that it carries, shape (6, 6); see `RobotModel`.
    """

    channels: Sequence[Sequence[Channel]]
    to_body: Sequence[Array]

    @classmethod
    def of_log(cls, log: JointLog, model: RobotModel, config: Config) -> WrenchChannels | None:
        """The wrench sensors of a model in a log; None if it has none."""
        if not config.wrench_sensors:
            return None
        channels = []
        to_body = []
        for sensor in config.wrench_sensors:
            channels.append([log.channels[name] for name in sensor.logged_channels])
            to_body.append(model.wrench_sensors[sensor.joint])
        return cls(channels, to_body)

    @property
    def lookahead(self) -> float:
        """Longest time from a value to the next, between which it is interpolated [s]."""
        return max(channel.step for channels in self.channels for channel in channels)

    def wrenches(self, t: Array, smooth: Callable[[Array], Array]) -> Array:
        """Wrenches on the bodies that the sensors carry, shape (6 per sensor, N) [N, N·m].

        Parameters
        ----------
        t
            Times [s] of the samples and of those about them that ``smooth`` takes.
        smooth
            Low-pass of the signals; it drops the samples that it takes beside those of the motion.
        """
        wrenches = []
        for channels, to_body in zip(self.channels, self.to_body, strict=True):
            reading = smooth(np.stack([channel.at(t) for channel in channels]))
            wrenches.append(to_body @ reading)
        return np.concatenate(wrenches)
