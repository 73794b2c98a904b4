"""Findings on the motion of a joint: at rest, jumping, too fast for the sampling; and on the source of its torque."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from idtool.common.names import count_text
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.data.inspection.records import FrozenStretches, InspectedJoint

MAX_STANDSTILL = 0.5  # share of the time
MAX_TRAVEL = 8 * np.pi  # rad: four turns are degrees, or a wheel
MAX_RELATIVE_BAND = 0.2  # of the sampling rate: above it, no short difference is a derivative any more


def motion_findings(name: str, joint: InspectedJoint, frozen: FrozenStretches | None, dt: float) -> Iterator[Notice]:
    """All findings on the motion of a joint.

    Parameters
    ----------
    name, joint
        The joint.
    frozen
        Frozen stretches of its position.
    dt
        Nominal sample time [s].
    """
    if "q" not in joint.signals:
        return
    if not joint.moves:
        meaning = (
            "its friction and inertia cannot be identified; leave it out of `joints`, and lock it in `locked_joints`"
        )
        yield Notice("joint_at_rest", "warning", name, "the joint does not move", meaning)
        return
    if joint.standstill > MAX_STANDSTILL:
        share = f"the joint is at rest {100 * joint.standstill:.0f} % of the time"
        meaning = (
            "samples at rest determine hardly anything except gravity, and gravity only to within the static friction"
        )
        yield Notice("often_at_rest", "note", name, share, meaning)
    yield from _jumps(name, joint, frozen)
    if joint.band_hz is not None and joint.band_hz > MAX_RELATIVE_BAND / dt:
        rate = f"the sampling rate is only {short_number(1 / dt, 4)} Hz"
        band = f"99 % of the velocity's power lies below {short_number(joint.band_hz)} Hz, but {rate}"
        meaning = "accelerations at these frequencies are unreliable: log faster, or lower `filter.cutoff_hz`"
        yield Notice("motion_too_fast", "warning", name, band, meaning)
    q = joint.signals["q"]
    if q.maximum - q.minimum > MAX_TRAVEL:
        travel = f"q spans {short_number(q.maximum - q.minimum)}"
        meaning = "the joint is a wheel, or q is in degrees; for degrees, set `log.scale` of q to 0.0174533"
        yield Notice("many_turns", "note", name, travel, meaning)


def _jumps(name: str, joint: InspectedJoint, frozen: FrozenStretches | None) -> Iterator[Notice]:
    """Jumps of the position, but for those with which one that was frozen catches up."""
    jumps = joint.jumps - (frozen.stretches if frozen and not joint.wraps else 0)
    if jumps > 0:
        meaning = "velocity and acceleration are wrong around each jump; unwrap q, or cut the log there"
        if joint.wraps:
            number = f"{count_text(jumps, 'jump')} of q by about a full turn"
            yield Notice("wrapped_position", "problem", name, number, meaning)
        else:
            yield Notice("position_jumps", "problem", name, f"{count_text(jumps, 'jump')} of q", meaning)


def commanded_torque(name: str, joint: InspectedJoint) -> Iterator[Notice]:
    """A torque that looks commanded."""
    if joint.torque and joint.torque.kind == "commanded":
        meaning = "the true torque can differ from the command: expect a `time_delay` and a `torque_gain`"
        yield Notice("torque_commanded", "note", name, f"tau seems to be commanded: {joint.torque.reason}", meaning)
