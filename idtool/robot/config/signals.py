"""Reading and filtering of logs, and the controller that commanded the joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from idtool.robot.config.base import ConfigRecord, Finite, NonNegative, Positive
from idtool.robot.config.terms import UncertainValue


def _nonzero(factor: float) -> float:
    if factor == 0:
        raise ValueError("a scale of 0 removes the signal; to leave out a joint, remove it from joints")
    return factor


Factors = dict[str, Annotated[Finite, AfterValidator(_nonzero)]]


class Scale(ConfigRecord):
    """Factors from logged units to SI units, by joint."""

    q: Factors = Field(default_factory=dict)
    v: Factors = Field(default_factory=dict)
    tau: Factors = Field(default_factory=dict)
    qcmd: Factors = Field(default_factory=dict)
    vcmd: Factors = Field(default_factory=dict)


class LogOptions(ConfigRecord):
    """Options for reading the logs."""

    topic: str | None = None
    columns: dict[str, str] = Field(default_factory=dict)
    scale: Scale = Scale()


class Filter(ConfigRecord):
    """The zero-phase low-pass. Default cut-off: 40 Hz, or a fifth of the sampling rate if that is lower."""

    kind: Literal["butterworth"] = "butterworth"
    cutoff_hz: Positive | None = None
    order: Annotated[int, Field(ge=1, le=8)] = 4


def _delay(data: Any) -> str | float | UncertainValue:
    if data == "auto":
        return "auto"
    if isinstance(data, str):
        raise ValueError(f"{data} is not a delay; give auto, or a number in s")
    delay = data if isinstance(data, UncertainValue) else UncertainValue.model_validate(data)
    if delay.value < 0:
        raise ValueError(f"a delay of {delay.value:g} s is negative; give 0 or more, or auto")
    return delay if isinstance(data, UncertainValue | Mapping) else delay.value


Delay = Annotated[Literal["auto"] | float | UncertainValue, BeforeValidator(_delay)]


class Controller(ConfigRecord):
    """A joint PD controller: kp [N·m/rad], kd [N·m·s/rad] at the joint, delay from command to torque [s].

    A delay of ``auto`` is fitted.
    """

    kp: dict[str, NonNegative]
    kd: dict[str, NonNegative] = Field(default_factory=dict)
    delay: Delay = "auto"

    @property
    def known_delay(self) -> UncertainValue | None:
        """The delay as given [s]; None: to be fitted."""
        if self.delay == "auto":
            return None
        return UncertainValue.model_validate(self.delay)


class SimulationOptions(ConfigRecord):
    """Rollouts restart from the measured state every window [s]; null: never."""

    window: Positive | None = 1.0
