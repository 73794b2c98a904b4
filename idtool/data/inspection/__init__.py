"""The contents of a log and its faults: the one place for all data faults that a log shows by itself.

`inspect_log` looks at a log without a model; a configuration only names the sensors that it must have.

Ranges, counts, jumps and frozen stretches come from every sample, block by block. Shares and statistics of a long log
come from stretches spread over it, 2¹⁷ samples in all. `clock`, `joint`, `measures`, `torque`, `velocity` and `frozen`
make the figures, `findings` judges them.

Letters: t stamps [s], q position [rad or m], v velocity [rad/s or m/s], tau torque or force [N·m or N], dt nominal
sample time [s], N samples, nj joints.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from idtool.data.inspection.clock import (
    clock_deviations,
    disordered_stamps,
    first_and_last,
    fresh_rows,
    gaps,
    jitter,
    sample_steps,
    sampling,
    step_jitter,
)
from idtool.data.inspection.findings import all_findings, in_order
from idtool.data.inspection.imu_findings import imu_findings
from idtool.data.inspection.joint import inspect_joint
from idtool.data.inspection.jumps import position_jumps
from idtool.data.inspection.logged_sensors import logged_sensors
from idtool.data.inspection.records import (
    FAULT_KINDS,
    FaultKind,
    Gap,
    InspectedJoint,
    Inspection,
    Sampling,
    Signal,
    Stamps,
    TorqueSource,
    Velocity,
    data_fault,
)
from idtool.data.inspection.sensor_findings import sensor_findings
from idtool.data.inspection.signal_statistics import column_statistics, quantisation
from idtool.data.logs.log import JointLog
from idtool.data.logs.stored_arrays import copy_array, set_columns
from idtool.robot.config import Config

__all__ = [
    "FAULT_KINDS",
    "FaultKind",
    "Gap",
    "InspectedJoint",
    "Inspection",
    "Sampling",
    "Signal",
    "Stamps",
    "TorqueSource",
    "Velocity",
    "data_fault",
    "inspect_log",
    "jitter",
    "quantisation",
    "sample_steps",
]

_MAX_SAMPLES = 1 << 17  # samples that statistics are taken from
_STRETCH_SAMPLES = 1 << 14  # samples
_MIN_STRETCH = 64  # samples of a stretch, where there are longer ones
_LISTED_GAPS = 5
_SHORT_SEGMENT = 0.5  # s


def inspect_log(log: JointLog, config: Config | None = None) -> Inspection:
    """Inspect a log.

    Parameters
    ----------
    log
        As a reader returns it.
    config
        Configuration that names the sensors of a base, and wrench sensors; None: there are none.

    Returns
    -------
    Inspection
        Figures per log and per joint, and the findings.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # absurd values must not crash it
        return _inspect(log, config or Config())


def _inspect(log: JointLog, config: Config) -> Inspection:
    log = _without_unknown_torque(log)
    stretches = _stretches(log.segments)
    statistics = {name: column_statistics(x) for name, x in log.signals.items()}
    fresh = np.concatenate([fresh_rows(log, s) for s in stretches])
    jumps = position_jumps(log, stretches)
    joints: dict[str, InspectedJoint] = {}
    moving = np.zeros(len(fresh), dtype=bool)
    for i, name in enumerate(log.joints):
        joints[name], moves = inspect_joint(log, i, statistics, jumps[i], stretches, fresh)
        log.release_memory()
        moving |= moves
    repeated = 1 - float(fresh[moving].mean()) if moving.any() else 0.0
    comparable = [i for i, joint in enumerate(joints.values()) if joint.moves and joint.velocity]
    stamps = _stamps(log, stretches, comparable, repeated)
    first_stamp, last_stamp = first_and_last(log.t)
    duration = last_stamp - first_stamp
    steps = sum(s.stop - s.start - 1 for s in log.segments)
    seconds = sum(float(log.t[s.stop - 1] - log.t[s.start]) for s in log.segments)
    of_sensors = (*imu_findings(log), *sensor_findings(log, config))
    findings = in_order([*all_findings(log, duration, stamps, joints), *of_sensors])
    return Inspection(
        path=str(log.path),
        duration=duration,
        samples=len(log),
        dt=log.dt,
        rate_hz=1 / log.dt,
        mean_rate_hz=steps / seconds if seconds > 0 else 1 / log.dt,
        segments=len(log.segments),
        stamps=stamps,
        joints=joints,
        sensors=logged_sensors(log),
        findings=findings,
        reading=tuple(notice for notice in log.notices if notice not in findings),
    )


def _without_unknown_torque(log: JointLog) -> JointLog:
    """The log without the torque of joints of which none was logged, and which is 0."""
    if not log.unknown_torque:
        return log
    is_unknown = np.isin(log.joints, log.unknown_torque)
    signals = dict(log.signals)
    tau = signals.pop("tau")
    if not is_unknown.all():
        signals["tau"] = copy_array(log.path, tau)
        set_columns(signals["tau"], np.flatnonzero(is_unknown).tolist(), np.nan)
    return replace(log, signals=signals)


def _stretches(segments: tuple[slice, ...]) -> list[slice]:
    """Stretches of the segments, evenly spread over the log, of at most about `_MAX_SAMPLES` samples in all."""
    total = sum(s.stop - s.start for s in segments)
    stretches = list(segments)
    if total > _MAX_SAMPLES:
        stretches = []
        for segment in segments:
            for start in range(segment.start, segment.stop, _STRETCH_SAMPLES):
                stretches.append(slice(start, min(start + _STRETCH_SAMPLES, segment.stop)))
    stretches = [s for s in stretches if s.stop - s.start >= _MIN_STRETCH] or stretches
    count = max(len(stretches) * _MAX_SAMPLES // total, 1)
    count = min(count, len(stretches), _MAX_SAMPLES // _MIN_STRETCH)
    return [stretches[i] for i in np.linspace(0, len(stretches) - 1, count).astype(int)]


def _stamps(log: JointLog, stretches: list[slice], moving: list[int], repeated: float) -> Stamps:
    duplicates, backward = disordered_stamps(log.t)
    all_gaps = gaps(log)
    lengths = [s.stop - s.start for s in log.segments]
    short = sum(length for length in lengths if length * log.dt < _SHORT_SEGMENT)
    resolution = quantisation(log.t[stretches[0]])
    instants = None
    if "v" in log.signals:
        q, v = log.signals["q"], log.signals["v"]
        instants = sampling([(log.t[s], q[s][:, moving], v[s][:, moving]) for s in stretches], log.dt)
    return Stamps(
        step_jitter=step_jitter(log.t, log.dt, log.segments),
        jitter_rms_ms=1e3 * log.dt * jitter(log.t, log.dt, log.segments),
        jitter_max_ms=1e3 * _largest_deviation(log),
        step_ms=None if resolution is None else 1e3 * resolution,
        duplicates=duplicates,
        backward=backward,
        gaps=len(all_gaps),
        lost=sum(gap.lost for gap in all_gaps),
        longest_gaps=all_gaps[:_LISTED_GAPS],
        short=short / sum(lengths),
        repeated=repeated,
        sampling=instants,
    )


def _largest_deviation(log: JointLog) -> float:
    """Largest deviation of a stamp from a uniform clock, fitted per segment [s]."""
    largest = 0.0
    for segment in log.segments:
        for deviation in clock_deviations(log.t[segment]):
            largest = max(largest, float(np.abs(deviation).max()))
    return largest
