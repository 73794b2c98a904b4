"""Data faults: what is wrong with the logs themselves, found before physics is blamed for it.

A torque that is late against the position is the effect `time_delay`, and not here.

=================== ==================================================================================================
fault               what it is
=================== ==================================================================================================
wrong_unit          a channel is in degrees, mm, mN·m, A and the like; all torques by one factor; stamps not in s
wrong_sign          a channel, or all of a joint's, turned round against the others and the URDF
wrong_joint_order   torques, velocities or whole joints that stand under each other's names
dropped_samples     time lost in gaps, or samples lost without one in the stamps
clipped             a channel sits at its extremes while what it measures goes on beyond
stale               a channel repeats values while it, or the joint, changes: held, frozen, not filled
velocity_lag        the measured velocity is late against the position; it is undone
time_jitter         stamps that are not even, or samples that were not taken at their stamps
wrapped_position    the position jumps by full turns
=================== ==================================================================================================
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.data.inspection import Inspection, inspect_log
from idtool.data.inspection.findings import DISAGREEMENT, STUCK
from idtool.diagnosis.fault_channels import ChannelSearch
from idtool.diagnosis.fault_fit import FaultFit
from idtool.diagnosis.fault_record import Fault
from idtool.diagnosis.fault_scale import cut_off, torque_unit
from idtool.diagnosis.fault_signals import exchanged_velocities, signal_faults, time_unit
from idtool.estimation.dataset.experiment import Experiment, Progress

__all__ = ["Fault", "faults"]


KINDS = (
    "wrong_unit",
    "wrong_sign",
    "wrong_joint_order",
    "dropped_samples",
    "clipped",
    "stale",
    "velocity_lag",
    "time_jitter",
    "wrapped_position",
)


def faults(experiment: Experiment, progress: Progress) -> tuple[Fault, ...]:
    """What is wrong with the logs.

    Single channels and the clock are judged by themselves, from stretches spread over the logs. Signs, order and units
    are judged by whether realizable bodies with friction can explain the torque once a mistake is undone, from a sample
    of bounded length.

    Parameters
    ----------
    experiment
        Model and logs.
    progress
        Told the stage and how far it has come.

    Returns
    -------
    One fault a kind and joint, in the order of the table above; none in data as it should be.
    """
    joints = experiment.model.names
    logs = [run.signals.log for run in experiment.runs]
    inspections, found = [], []
    for k, log in enumerate(logs):
        progress("inspecting the logs", k / len(logs))
        inspections.append(inspect_log(log))
        unit = list(time_unit(log, inspections[-1], joints))
        if unit:  # with it, all derivatives are wrong
            return tuple(unit)
        own = [*signal_faults(log, inspections[-1], joints), *exchanged_velocities(log, inspections[-1], joints)]
        found += [(log.path.name, fault) for fault in own]
    found += [("", fault) for fault in _model_faults(experiment, FaultFit(experiment), inspections, progress)]
    return _merged(found, len(logs))


def _model_faults(
    experiment: Experiment, fit: FaultFit, inspections: Sequence[Inspection], progress: Progress
) -> Iterator[Fault]:
    """Faults that the model tells."""
    model = experiment.model
    commands = [run.signals.command for run in experiment.runs]
    computed = {name for j, name in enumerate(model.names) if any(command.joints[j] for command in commands)}
    limits, gains = _limits(model.names, inspections), _gains(inspections)
    search = ChannelSearch(fit, model.joints, limits, gains, computed, progress)
    yield from search.faults()
    yield from torque_unit(fit, search.position, search.T)
    for j, name in enumerate(model.names):
        for inspection in inspections:
            tau = inspection.joints[name].signals.get("tau")
            if tau is not None and not tau.constant and tau.stuck > STUCK:
                yield from cut_off(fit, j, inspection.joints[name])
                break


def _limits(joints: Sequence[str], inspections: Sequence[Inspection]) -> Array:
    """Least and greatest q of each joint, shape (nv, 2)."""
    q = [[one.joints[name].signals["q"] for one in inspections] for name in joints]
    return np.array([(min(x.minimum for x in own), max(x.maximum for x in own)) for own in q])


def _gains(inspections: Sequence[Inspection]) -> dict[str, float]:
    """Of v over dq/dt, by joint, where the two agree but for it; of the last log that tells."""
    return {
        name: joint.velocity.gain
        for inspection in inspections
        for name, joint in inspection.joints.items()
        if joint.velocity and joint.velocity.gain and joint.velocity.agreement > 1 - DISAGREEMENT
    }


def _merged(found: Sequence[tuple[str, Fault]], logs: int) -> tuple[Fault, ...]:
    """One fault a kind and joint: that of the first log that has it, which is named where there are several."""
    same: dict[tuple[str, str | None], list[tuple[str, Fault]]] = defaultdict(list)
    for log, fault in found:
        same[fault.fault, fault.joint].append((log, fault))
    merged = []
    for entries in same.values():
        log, fault = entries[0]
        where = f" ({log} and {len(entries) - 1} more logs)" if log and logs > 1 else ""
        merged.append(replace(fault, detail=fault.detail + where))
    return tuple(sorted(merged, key=lambda fault: KINDS.index(fault.fault)))
