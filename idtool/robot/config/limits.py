"""Joint limits for the design of trajectories; they can only tighten the URDF's limits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator

from idtool.robot.config.base import ConfigRecord, Finite, Positive


def _ascending(limits: tuple[float, float]) -> tuple[float, float]:
    if not limits[0] < limits[1]:
        raise ValueError(f"give the lower limit first: {limits[1]:g} is not above {limits[0]:g}")
    return limits


class JointLimits(ConfigRecord):
    """Position [rad or m], velocity [rad/s or m/s], acceleration [rad/s² or m/s²], torque or force [N·m or N]."""

    position: Annotated[tuple[Finite, Finite], AfterValidator(_ascending)] | None = None
    velocity: Positive | None = None
    acceleration: Positive | None = None
    effort: Positive | None = None


def limits_tag(data: Any) -> str:
    """Tag of the form: limits for all joints alike, or by joint; told by the keys."""
    if not isinstance(data, Mapping):
        return "alike" if isinstance(data, JointLimits) else "by joint"
    own = [value for key, value in data.items() if key in JointLimits.model_fields]
    return "alike" if any(not isinstance(value, Mapping | JointLimits) for value in own) else "by joint"
