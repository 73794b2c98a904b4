"""Sensors of force and moment at fixed joints."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import BeforeValidator

from idtool.robot.config.base import ConfigRecord, Finite, Name

Wrench = tuple[Finite, Finite, Finite, Finite, Finite, Finite]

_AXES = ("x", "y", "z")
_WRENCH_SIZE = 6


def _is_finite(number: object) -> bool:
    return isinstance(number, int | float) and not isinstance(number, bool) and math.isfinite(number)


def _offset(data: object) -> object:
    is_wrench = isinstance(data, list | tuple) and len(data) == _WRENCH_SIZE and all(map(_is_finite, data))
    if not is_wrench and data not in ("fit", "none"):
        raise ValueError(f"{data} is not an offset; give fit, none, or six numbers in N and N·m")
    return data


class WrenchSensor(ConfigRecord):
    """A sensor that measures the force and the moment that a fixed joint transmits.

    ``joint`` is the fixed joint. ``channel`` is the log's name of the sensor, by default the joint's: its channels are
    ``force_<channel>_x`` to ``force_<channel>_mz``; in MCAP, ``topic`` names it. ``frame`` is the link along whose axes
    and about whose origin it measures, by default the joint's child link. With ``sign`` 1, it measures the wrench on
    the child link; with −1, that on the parent. ``offset`` is its reading without load, which a fit determines; numbers
    are the first guess [N, N·m]. It changes from log to log, so that each log has its own, unless ``common_offset``.
    With ``drift``, it also changes slowly along a log; with ``auto``, if the logs that are fitted show that it does.
    """

    joint: Name
    topic: Name | None = None
    channel: Name | None = None
    frame: Name | None = None
    sign: Literal[1, -1] = 1
    offset: Annotated[Literal["fit", "none"] | Wrench, BeforeValidator(_offset)] = "fit"
    common_offset: bool = False
    drift: bool | Literal["auto"] = "auto"

    @property
    def logged_channels(self) -> tuple[str, ...]:
        """Channels of the log with its force and its moment."""
        name = self.channel or self.joint
        if self.topic is not None:
            name = self.topic.strip("/").replace("/", "_").removeprefix("force_")
        return tuple(f"force_{name}_{part}" for part in (*_AXES, *(f"m{axis}" for axis in _AXES)))

    @property
    def has_offset(self) -> bool:
        """True if the reading without load is not 0."""
        return self.offset != "none"

    @property
    def has_offset_by_log(self) -> bool:
        """True if the reading without load may differ between logs."""
        return self.has_offset and not self.common_offset

    @property
    def has_drift(self) -> bool:
        """True if the reading without load changes along a log."""
        return self.has_offset and self.drift is True

    @property
    def first_offset(self) -> Wrench:
        """The reading without load before any data [N, N·m]."""
        return self.offset if isinstance(self.offset, tuple) else (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
