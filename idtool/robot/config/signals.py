"""Reading and filtering of logs, and the controller that commanded the joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, field_validator, model_validator

from idtool.common.names import suggestion
from idtool.robot.config.base import ConfigRecord, Finite, NonNegative, Positive, joint_mapping_tag
from idtool.robot.config.terms import UncertainValue
from idtool.robot.message_fields import JOINT_NAME, PRESETS, parse_field


def _nonzero(factor: float) -> float:
    if factor == 0:
        raise ValueError("a scale of 0 removes the signal; to leave out a joint, remove it from joints")
    return factor


Factor = Annotated[Finite, AfterValidator(_nonzero)]
Factors = Annotated[
    Annotated[dict[str, Factor], Tag("by joint")] | Annotated[Factor, Tag("alike")], Discriminator(joint_mapping_tag)
]


def _gain(data: Any) -> Any:
    if isinstance(data, str) and data != "fit":
        raise ValueError(f"{data} is not a gain; give a number, or fit")
    return data


def _gain_tag(data: Any) -> str:
    """Tag of the form in which a gain is given, for messages that name its key alone."""
    return "[fit]" if data == "fit" else "[number]"


Gain = Annotated[
    Annotated[Literal["fit"], Tag("[fit]")] | Annotated[NonNegative, Tag("[number]")],
    Discriminator(_gain_tag),
    BeforeValidator(_gain),
]
Gains = Annotated[
    Annotated[dict[str, Gain], Tag("by joint")] | Annotated[Gain, Tag("alike")], Discriminator(joint_mapping_tag)
]


class Scale(ConfigRecord):
    """Factors from logged units to SI units, by joint or one for all joints of the log."""

    q: Factors = Field(default_factory=dict)
    v: Factors = Field(default_factory=dict)
    tau: Factors = Field(default_factory=dict)
    qcmd: Factors = Field(default_factory=dict)
    vcmd: Factors = Field(default_factory=dict)


def _preset(name: str) -> str:
    if name not in PRESETS:
        raise ValueError(f"{name} is not a preset; {suggestion(name, PRESETS)}")
    return name


def _joint_list(joints: tuple[str | None, ...]) -> tuple[str | None, ...]:
    names = [name for name in joints if name is not None]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name} is listed twice; list each joint once")
    return joints


class LogOptions(ConfigRecord):
    """Options for reading the logs.

    ``fields`` are the paths of the signals in messages that are not joint states, and ``field_joints`` the joints in
    the order of their index; null: no joint. ``preset`` names a robot for which both are known.
    """

    topic: str | None = None
    columns: dict[str, str] = Field(default_factory=dict)
    scale: Scale = Scale()
    preset: Annotated[str, AfterValidator(_preset)] | None = None
    fields: dict[str, str] = Field(default_factory=dict)
    field_joints: Annotated[tuple[str | None, ...], AfterValidator(_joint_list)] = ()

    @field_validator("fields")
    @classmethod
    def _usable_fields(cls, fields: dict[str, str]) -> dict[str, str]:
        for key, path in fields.items():
            try:
                parse_field(key, path)
            except ValueError as error:
                raise ValueError(f"{key}: {error}") from None
        if {"imu.orientation", "imu.orientation_wxyz"} <= fields.keys():
            raise ValueError("has the orientation twice; keep imu.orientation (xyzw) or imu.orientation_wxyz")
        return fields

    @model_validator(mode="after")
    def _complete(self) -> LogOptions:
        if self.fields and self.preset is None:
            if "q" not in self.fields:
                raise ValueError("fields has no position of the joints; add q, or set preset")
            if not self.field_joints and JOINT_NAME not in self.fields:
                what = "fields needs the joints' names"
                raise ValueError(f"{what}: list them in field_joints in the order of {{i}}, or add the path name")
        if JOINT_NAME in self.fields and self.field_joints:
            raise ValueError("the joints are named twice; remove field_joints, or name from fields")
        return self


class Filter(ConfigRecord):
    """The zero-phase low-pass. Default cut-off: 40 Hz, or less with a low sampling rate or a noisy gyroscope."""

    kind: Literal["butterworth"] = "butterworth"
    cutoff_hz: Positive | None = None
    order: Annotated[int, Field(ge=1, le=8)] = 4


def _delay(data: Any) -> str | float | UncertainValue:
    if data == "auto":
        return "auto"
    if isinstance(data, str | bool):
        raise ValueError(f"{data} is not a delay; give auto, or a number in s")
    delay = data if isinstance(data, UncertainValue) else UncertainValue.model_validate(data)
    if delay.value < 0:
        raise ValueError(f"a delay of {delay.value:g} s is negative; give 0 or more, or auto")
    return delay if isinstance(data, UncertainValue | Mapping) else delay.value


Delay = Annotated[Literal["auto"] | float | UncertainValue, BeforeValidator(_delay)]


class Controller(ConfigRecord):
    """A joint PD controller: kp [N·m/rad], kd [N·m·s/rad] at the joint, delay from command to torque [s].

    The gains are by joint, or one for all joints. Gains of ``fit`` are fitted, relative to the masses, and a delay of
    ``auto`` as well.
    """

    kp: Gains
    kd: Gains = Field(default_factory=dict)
    delay: Delay = "auto"

    def kp_of(self, joint: str) -> float | None:
        """Position gain of a joint [N·m/rad or N/m]; NaN: to be fitted. None: the joint has no controller."""
        kp = self.kp.get(joint) if isinstance(self.kp, Mapping) else self.kp
        return np.nan if kp == "fit" else kp

    def kd_of(self, joint: str) -> float:
        """Velocity gain of a joint [N·m·s/rad or N·s/m]; NaN: to be fitted."""
        kd = self.kd.get(joint, 0.0) if isinstance(self.kd, Mapping) else self.kd
        return np.nan if kd == "fit" else kd

    @property
    def known_delay(self) -> UncertainValue | None:
        """The delay as given [s]; None: to be fitted."""
        if self.delay == "auto":
            return None
        return UncertainValue.model_validate(self.delay)


class SimulationOptions(ConfigRecord):
    """Rollouts restart from the measured state every window [s]; null: never."""

    window: Positive | None = 1.0
