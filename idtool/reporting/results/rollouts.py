"""Records of a model run forwards along logs."""

from __future__ import annotations

from typing import Literal

from idtool.reporting.results.base import ByJointOrNone, Record, Units, field

RolloutKind = Literal["open_loop", "closed_loop"]


class WindowCount(Record):
    """Number of simulated windows; for long logs and many joints, a selection spread over them."""

    simulated: int = field("Number of windows that were simulated.")
    of: int = field("Total number of windows.")


class MotionErrors(Record):
    """RMS errors of a simulated motion; null if rollouts diverged."""

    position: ByJointOrNone = field("RMS position error [rad or m].")
    velocity: ByJointOrNone = field("RMS velocity error [rad/s or m/s].")


class Horizon(Record):
    """RMS position errors at one time after a restart."""

    seconds: float = field("Time since the restart [s].")
    position: ByJointOrNone = field("Error of the model [rad or m].")
    baseline: ByJointOrNone = field("Error of the baseline.")
    prior: ByJointOrNone | None = field("Error of the prior; null without one.")


class Simulation(Record):
    """Forward simulation of a model, compared with the measured motion."""

    kind: RolloutKind = field("`open_loop`: under the logged torque; `closed_loop`: under the controller.")
    window: float | None = field("Time between restarts from the measured state [s]; null: never restarted.")
    windows: WindowCount = field("Number of simulated windows.")
    seconds: float = field("Simulated time [s].")
    units: Units = field("`rad` or `m`.")
    position: ByJointOrNone = field("RMS position error of the model [rad or m].")
    velocity: ByJointOrNone = field("RMS velocity error of the model [rad/s or m/s].")
    baseline: MotionErrors = field(
        "Errors of a robot that keeps its position (open loop) or follows its command exactly (closed loop)."
    )
    prior: MotionErrors | None = field("Errors of the prior; null without one.")
    horizon: tuple[Horizon, ...] = field("Errors against the time since a restart; empty in closed loop.")
    lost: int = field("Number of rollouts of the model that diverged and were stopped.")
    prior_lost: int | None = field("Number of rollouts of the prior that diverged; null without one.")
