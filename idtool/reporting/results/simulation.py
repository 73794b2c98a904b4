"""Records of `idtool simulate`; the motion itself is in the log that it writes."""

from __future__ import annotations

from idtool.reporting.results.base import ByJoint, Record, Result, Units, field
from idtool.reporting.results.rollouts import RolloutKind


class MotionRmse(Record):
    """RMS errors relative to the measured motion or the trajectory; null if there is none."""

    position: ByJoint | None = field("RMS position error [rad or m].")
    velocity: ByJoint | None = field("RMS velocity error [rad/s or m/s].")


class SimulationReport(Result):
    """Result of `idtool simulate`."""

    file: str | None = field("The log that was written; null if none was.")
    joints: tuple[str, ...] = field("Joints, in the order of the log.")
    units: Units = field("`rad` or `m`.")
    kind: RolloutKind = field("`open_loop`: under the logged torque; `closed_loop`: under the controller.")
    window: float | None = field("Time between restarts from the measured state [s]; null: never restarted.")
    rollouts: int = field("Number of rollouts.")
    lost: int = field("Number of rollouts that diverged and were stopped.")
    samples: int = field("Number of samples.")
    seconds: float = field("Simulated time [s].")
    log_seconds: float = field("Time in the log that has samples [s]; contacts leave part of it out.")
    wall_seconds: float = field("Wall time [s].")
    rmse: MotionRmse = field("RMS errors.")
    urdf: str = field("The URDF.")
    log: str = field("The log that drove the simulation.")
