"""Data faults: mistakes in the logs, which are looked for before effects that the model lacks.

The faults that a log shows by itself are findings of its inspection, `idtool.data.inspection`. Those that only the
model shows are found here: signs, order and units of the channels, and torques that are cut off. A torque that is late
against the position is the effect `time_delay`, and no fault.

=================== ==================================================================================================
fault               what it is
=================== ==================================================================================================
wrong_unit          a channel is in degrees, mm, mN·m, A and the like; all torques by one factor; stamps not in s
wrong_sign          a channel, or all of a joint's, turned round against the others and the URDF
wrong_joint_order   torques, velocities or whole joints that stand under each other's names
dropped_samples     time lost in gaps, or samples lost without one in the stamps
clipped             a channel sits at its extremes while what it measures goes on beyond
stale               a channel repeats values while it, or the joint, changes: held, frozen, not filled
velocity_lag        the measured velocity lags the position; this is corrected
time_jitter         stamps that are not even, or samples that were not taken at their stamps
wrapped_position    the position jumps by full turns
imu_mount           the IMU is rotated relative to its link in the URDF
foot_slip           a foot slips on the ground, or is in the air while its flag is set
=================== ==================================================================================================
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.notice import Notice
from idtool.data.inspection import FAULT_KINDS, Inspection, data_fault, inspect_log
from idtool.data.inspection.channel_findings import MAX_STUCK_SHARE
from idtool.data.inspection.velocity_findings import MAX_DISAGREEMENT
from idtool.diagnosis.data_faults.channel_fit import ChannelFit
from idtool.diagnosis.data_faults.channel_mistakes import LogScale
from idtool.diagnosis.data_faults.channel_search import ChannelSearch
from idtool.diagnosis.data_faults.torque_scale import clipped_torque, wrong_torque_unit
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.kinematic_checks import KINEMATIC_FAULTS

__all__ = ["find_data_faults"]


def find_data_faults(experiment: Experiment, progress: Progress) -> tuple[Notice, ...]:
    """Faults of the logs.

    Single channels and the clock are checked by themselves, from segments spread over the logs. Signs, order and units
    are checked by whether realizable bodies with friction can explain the torque once a mistake is undone, from a
    sample of bounded length.

    Parameters
    ----------
    experiment
        Model and logs.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Returns
    -------
    One fault per kind and joint, in the order of the table above; empty if there is none.
    """
    logs = [run.signals.log for run in experiment.runs]
    inspections: list[Inspection] = []
    faults: list[tuple[int | None, Notice]] = []  # with the number of the log; None for all logs
    for k, log in enumerate(logs):
        progress("inspecting the logs", k / len(logs))
        inspections.append(inspect_log(log))
        own = inspection_faults(inspections[-1], experiment.model.joint_names)
        wrong_time = [fault for fault in own if (fault.code, fault.subject) == ("wrong_unit", None)]
        if wrong_time:  # with it, all derivatives are wrong
            return tuple(wrong_time)
        faults += [(k, fault) for fault in own]
        for notice in experiment.runs[k].signals.notices:
            if notice.code in KINEMATIC_FAULTS:
                faults.append((k, notice))
    if not experiment.has_only_joints:  # the torque of its joints says nothing without the contact forces
        return _merged(faults, [log.path.name for log in logs])
    faults += [(None, fault) for fault in _model_faults(experiment, ChannelFit(experiment), inspections, progress)]
    return _merged(faults, [log.path.name for log in logs])


def inspection_faults(inspection: Inspection, joints: Sequence[str]) -> list[Notice]:
    """Findings of an inspection that are faults, of the log and of the model's joints."""
    faults = []
    for finding in inspection.findings:
        if data_fault(finding) is not None and (finding.subject is None or finding.subject in joints):
            faults.append(finding)
    return faults


def _model_faults(
    experiment: Experiment, fit: ChannelFit, inspections: Sequence[Inspection], progress: Progress
) -> Iterator[Notice]:
    """Faults that only the model shows."""
    model = experiment.model
    commands = [run.signals.controller for run in experiment.runs]
    computed = {name for j, name in enumerate(model.names) if any(command.joints[j] for command in commands)}
    search = ChannelSearch(
        fit,
        model.joints,
        _position_ranges(model.names, inspections),
        _velocity_gains(inspections),
        computed,
        LogScale(dict(experiment.config.log.scale)),
        progress,
    )
    yield from search.faults()
    yield from wrong_torque_unit(fit, search.position, search.T)
    for j, name in enumerate(model.names):
        for inspection in inspections:
            tau = inspection.joints[name].signals.get("tau")
            if tau is not None and not tau.constant and tau.stuck > MAX_STUCK_SHARE:
                yield from clipped_torque(fit, j, inspection.joints[name])
                break


def _position_ranges(joints: Sequence[str], inspections: Sequence[Inspection]) -> Array:
    """Least and greatest q of each joint, shape (nv, 2)."""
    ranges = []
    for name in joints:
        q = [inspection.joints[name].signals["q"] for inspection in inspections]
        least = min(of_log.minimum for of_log in q)
        greatest = max(of_log.maximum for of_log in q)
        ranges.append((least, greatest))
    return np.array(ranges)


def _velocity_gains(inspections: Sequence[Inspection]) -> dict[str, float]:
    """Gain of v over dq/dt by joint, from the last log in which they agree otherwise; NaN if they do in none."""
    gains: dict[str, float] = {}
    for inspection in inspections:
        for name, joint in inspection.joints.items():
            if joint.velocity is None:
                continue
            gains.setdefault(name, np.nan)
            if joint.velocity.gain and joint.velocity.agreement > 1 - MAX_DISAGREEMENT:
                gains[name] = joint.velocity.gain
    return gains


def _merged(faults: Sequence[tuple[int | None, Notice]], logs: Sequence[str]) -> tuple[Notice, ...]:
    """One fault per kind and joint: that of the first log that has it, which is named if there are several logs.

    Parameters
    ----------
    faults
        Each with the number of its log; None for all logs.
    logs
        Names of the logs.
    """
    alike: dict[tuple[str, str | None], list[tuple[int | None, Notice]]] = defaultdict(list)
    for k, fault in faults:
        alike[fault.code, fault.subject].append((k, fault))
    merged = []
    for entries in alike.values():
        first, fault = entries[0]
        if first is not None and len(logs) > 1:
            more = len({k for k, _ in entries if k is not None}) - 1
            others = f" and {more} more log{'s' if more > 1 else ''}" if more else ""
            fault = replace(fault, message=f"{fault.message} ({logs[first]}{others})")
        merged.append(fault)
    kinds: list[str] = list(FAULT_KINDS)
    return tuple(sorted(merged, key=lambda fault: kinds.index(fault.code)))
