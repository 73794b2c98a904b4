"""A base that moves freely, its IMU, and contacts."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from idtool.robot.config.base import ConfigRecord, Name, NonNegative, NoTruthValue, Positive, Vector

_MAX_WIDENING = 10.0  # s
_MAX_DELAY = 1.0  # s
_MAX_COMPLIANCE = 0.01  # m/N

Delay = Annotated[float, Field(ge=-_MAX_DELAY, le=_MAX_DELAY, allow_inf_nan=False)]


def _delay(data: object) -> object:
    is_number = isinstance(data, int | float) and not isinstance(data, bool) and abs(data) <= _MAX_DELAY
    if data != "auto" and not is_number:
        raise ValueError(f"{data} is not a delay; give auto, or a number in s of at most {_MAX_DELAY:g}")
    return data


def _compliance(data: object) -> object:
    is_number = isinstance(data, int | float) and not isinstance(data, bool) and 0 <= data <= _MAX_COMPLIANCE
    if data not in ("fit", "none") and not is_number:
        raise ValueError(
            f"{data} is not a compliance; give fit, none, or a number in m/N from 0 to {_MAX_COMPLIANCE:g}"
        )
    return data


class Imu(ConfigRecord):
    """The inertial measurement unit.

    ``link`` is by default the base's; ``topic`` is needed if an MCAP log has several; ``delay`` is how late it is
    against the joints [s], which ``auto`` determines.
    """

    link: Name | None = None
    topic: Name | None = None
    delay: Annotated[Literal["auto"] | Delay, BeforeValidator(_delay)] = "auto"

    @property
    def known_delay(self) -> float:
        """The delay [s]; 0 as long as ``auto`` has not determined it."""
        return 0.0 if self.delay == "auto" else float(self.delay)


class Pose(ConfigRecord):
    """Position and orientation of the base by motion capture or odometry.

    ``link`` is the link whose pose it is, by default the base's; ``topic`` is needed if an MCAP log has several;
    ``delay`` is how late it is against the joints [s], which ``auto`` determines.
    """

    link: Name | None = None
    topic: Name | None = None
    delay: Annotated[Literal["auto"] | Delay, BeforeValidator(_delay)] = "auto"

    @property
    def known_delay(self) -> float:
        """The delay [s]; 0 as long as ``auto`` has not determined it."""
        return 0.0 if self.delay == "auto" else float(self.delay)


class Base(ConfigRecord):
    """The root link: fixed to the ground, or floating, its motion measured by an IMU or by a pose.

    ``link`` names it, by default the URDF's root. A ``pose`` is used if no ``imu`` is given, and else compared with it.
    ``noise`` is that of the joints' torques and of the base's force and moment [N·m or N], by which unknown contact
    forces are eliminated; a fit determines it.
    """

    kind: Literal["fixed", "floating"] = "fixed"
    link: Name | None = None
    imu: Imu = Imu()
    pose: Pose | None = None
    noise: dict[str, Positive] = Field(default_factory=dict)

    @property
    def uses_pose(self) -> bool:
        """True if the motion follows from the pose alone."""
        return self.pose is not None and "imu" not in self.model_fields_set

    @property
    def sensor(self) -> Imu | Pose:
        """The sensor that the motion follows from."""
        return self.pose if self.pose is not None and self.uses_pose else self.imu

    @property
    def sensor_name(self) -> str:
        """Key of that sensor."""
        return "pose" if self.uses_pose else "imu"

    def with_delay(self, delay: float) -> Base:
        """A copy with another delay of that sensor [s]."""
        return self.model_copy(update={self.sensor_name: self.sensor.model_copy(update={"delay": delay})})


class Contact(ConfigRecord):
    """A place where the ground, or whatever else the robot touches, acts on a link.

    A ``point`` takes a force, a ``surface`` a force and a moment. ``point`` is in the link's frame [m]; with a
    ``radius`` [m] it is the centre of a ball, whose lowest point is the contact. ``flag`` names the log's channel that
    tells when it is closed; without one, it always is. With ``auto`` the torque of the leg tells, and a contact on the
    base is closed while no other is. A flag is widened by ``widen`` [s] at both ends. ``force`` and ``moment`` name the
    channels of a measured wrench on the link, along the axes of ``frame``, or with the ``sign`` −1 that of the link on
    what it touches; without them, the wrench is unknown. With a fixed base, the world has the axes of the root link,
    and gravity tells which point of a ball is the lowest. ``compliance`` is how far a ball gives way per force [m/N],
    the same for all balls of a robot with a floating base, which a fit determines; a number is the first guess, and
    ``none`` a rigid ball.
    """

    name: Name
    link: Name
    kind: Literal["point", "surface"] = "point"
    point: Vector = (0.0, 0.0, 0.0)
    radius: NonNegative = 0.0
    compliance: Annotated[Literal["fit", "none"] | NonNegative, BeforeValidator(_compliance)] = "fit"
    flag: Name | None = None
    widen: Annotated[float, Field(ge=0, le=_MAX_WIDENING, allow_inf_nan=False), NoTruthValue] = 0.12
    frame: Literal["world", "link"] = "world"
    force: tuple[Name, Name, Name] | None = None
    moment: tuple[Name, Name, Name] | None = None
    sign: Literal[1, -1] = 1

    @model_validator(mode="after")
    def _consistent(self) -> Contact:
        if self.moment is not None and self.force is None:
            raise ValueError("has a moment and no force; give the channels of both")
        if self.moment is not None and self.kind == "point":
            raise ValueError("is a point, which takes no moment; set kind: surface, or leave out moment")
        if self.force is not None and self.moment is None and self.kind == "surface":
            raise ValueError("is a surface, whose moment is needed too; give moment, or set kind: point")
        return self

    @property
    def is_measured(self) -> bool:
        """True if the log has its wrench."""
        return self.force is not None

    @property
    def is_compliant(self) -> bool:
        """True for a ball that gives way."""
        return self.radius > 0 and self.compliance != "none"

    @property
    def first_compliance(self) -> float:
        """Its compliance before any data [m/N]."""
        return 0.0 if isinstance(self.compliance, str) else self.compliance

    @property
    def has_automatic_flag(self) -> bool:
        """True if the torque of the leg, or the other contacts, tell when it is closed."""
        return self.flag == "auto"

    @property
    def flag_channel(self) -> str | None:
        """Channel of its flag, which the detection adds to the log if the flag is ``auto``; None: always closed."""
        return f"contact_{self.name} (detected)" if self.has_automatic_flag else self.flag

    @property
    def logged_channels(self) -> tuple[str, ...]:
        """Channels that it needs of a log as it was read."""
        channels = [*(self.force or ()), *(self.moment or ())]
        if self.flag is not None and not self.has_automatic_flag:
            channels.insert(0, self.flag)
        return tuple(channels)

    @property
    def needs_orientation(self) -> bool:
        """True if its place, or the axes of its wrench, depend on the orientation of the base."""
        is_ball = self.radius > 0  # which touches the ground with its lowest point
        return is_ball or (self.is_measured and self.frame == "world")

    def with_unknown_wrench(self) -> Contact:
        """A copy whose wrench is not measured."""
        return self.model_copy(update={"force": None, "moment": None})
