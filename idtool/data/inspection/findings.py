"""The findings of an inspection: what its figures mean for a fit.

Each defect is found by one function, in the file of its subject: `time_findings`, `motion_findings`,
`channel_findings`, `velocity_findings`. The thresholds stand at their tops, each with its reason; a clean log crosses
none of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from idtool.common.notice import SEVERITIES, Notice
from idtool.data.inspection import time_findings
from idtool.data.inspection.channel_findings import MAX_STALE_SHARE, MAX_STUCK_SHARE, channel_findings, missing_channels
from idtool.data.inspection.frozen import frozen_channels
from idtool.data.inspection.logged_sensors import logged_sensors
from idtool.data.inspection.motion_findings import commanded_torque, motion_findings
from idtool.data.inspection.records import FrozenStretches, InspectedJoint, Stamps
from idtool.data.inspection.velocity_findings import (
    exchanged_velocities,
    exchanged_velocity,
    velocity_against_position,
)
from idtool.data.logs.log import JointLog


def all_findings(log: JointLog, duration: float, stamps: Stamps, joints: Mapping[str, InspectedJoint]) -> list[Notice]:
    """All findings on stamps and joints.

    Where the stamps seem to be in another unit than seconds, which is a notice of the log, v can't be compared with
    dq/dt, and no stretch be called long or short.

    Parameters
    ----------
    log
        The log.
    duration
        From its first to its last stamp [s].
    stamps
        Figures of the stamps.
    joints
        Figures of the joints, by name.
    """
    findings = [notice for notice in log.notices if notice.code == "wrong_unit"]
    in_seconds = not findings
    findings += time_findings.sampling_jitter(log.dt, stamps)
    findings += time_findings.skipped_samples(log.dt, stamps)
    findings += time_findings.repeated_rows(stamps)
    findings += time_findings.gaps(duration, stamps)
    findings += time_findings.disordered_stamps(len(log), stamps)
    findings += time_findings.short_segments(len(log.segments), stamps)
    exchanged = exchanged_velocities(log, joints) if in_seconds else {}
    frozen = frozen_channels(log, joints) if in_seconds else {name: {} for name in joints}
    has_wrench_sensor = any(sensor.kind == "wrench" for sensor in logged_sensors(log))
    for name, joint in joints.items():
        is_needed = name not in log.unknown_torque
        missing = missing_channels(name, joint, has_wrench_sensor)
        findings += [one for one in missing if is_needed or one.code != "missing_torque"]
        findings += motion_findings(name, joint, frozen[name].get("q"), log.dt)
        findings += commanded_torque(name, joint)
        if name in exchanged:
            findings.append(exchanged_velocity(name, exchanged[name]))
        elif in_seconds and joint.velocity is not None and not _repeats_values(joint, frozen[name]):
            findings += velocity_against_position(name, joint.velocity, joint.band_hz or 0.0, log.dt)
        findings += channel_findings(name, joint, frozen[name], log.dt)
    return findings


def _repeats_values(joint: InspectedJoint, frozen: Mapping[str, FrozenStretches]) -> bool:
    """True if q or v repeats values: the lag and gain of v then come from that defect."""
    for signal in ("q", "v"):
        figures = joint.signals[signal]
        if signal in frozen or figures.stuck > MAX_STUCK_SHARE or (figures.stale or 0.0) > MAX_STALE_SHARE:
            return True
    return False


def in_order(findings: Sequence[Notice]) -> tuple[Notice, ...]:
    """The findings, problems first, those with the same advice side by side."""
    first: dict[str, int] = {}
    for i, finding in enumerate(findings):
        first.setdefault(finding.advice, i)
    return tuple(sorted(findings, key=lambda finding: (SEVERITIES.index(finding.severity), first[finding.advice])))
