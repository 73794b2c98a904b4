"""Findings on a measured velocity against its position: another joint's, another unit, late."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from idtool.common.notice import Notice, Severity
from idtool.data.inspection.records import InspectedJoint, Velocity
from idtool.data.inspection.velocity import velocity_agreement
from idtool.data.logs.log import Log

LATE = 0.25  # samples: less, no fit can see
LATE_ERRORS = 3.0  # standard errors that a lag must exceed to count
LATE_PHASE = 0.01  # rad at the band's edge: v is wrong by this share there
DISAGREEMENT = 0.03  # of v's power: 17 % of its amplitude
UNRELATED = 0.5  # of v's power
ANOTHERS = 0.9  # share of v's power that another joint's position must explain: two joints seldom move so much alike
GAIN = 0.03  # off 1: more than a clock is out
WRONG_UNIT = 0.25  # of log |gain|: more than a calibration is out

_MAX_SAMPLES = 1 << 15  # samples


def exchanged_velocities(log: Log, joints: Mapping[str, InspectedJoint]) -> dict[str, str]:
    """Joints whose velocity is another's, each with the joint under whose name its own stands.

    Only joints whose velocity has nothing to do with their position are compared, over a stretch of bounded length.
    """
    unrelated = []
    for name, joint in joints.items():
        if joint.velocity is not None and joint.velocity.agreement < UNRELATED:
            unrelated.append(name)
    longest = max(log.segments, key=lambda segment: segment.stop - segment.start)
    stretch = slice(longest.start, min(longest.stop, longest.start + _MAX_SAMPLES))
    exchanged: dict[str, str] = {}
    for name, other in itertools.permutations(unrelated, 2):
        q = np.ascontiguousarray(log.signals["q"][stretch, log.joints.index(name)])
        v = np.ascontiguousarray(log.signals["v"][stretch, log.joints.index(other)])
        if name not in exchanged and velocity_agreement(q, v, log.dt).agreement > ANOTHERS:
            exchanged[name] = other
    return exchanged


def exchanged_velocity(name: str, other: str) -> Notice:
    """The finding that the velocity of a joint stands under the name of another."""
    evidence = f"v of {other} is the derivative of q of {name}, and its own v is not"
    return Notice("wrong_joint_order", "problem", name, evidence, "correct the columns in `log.columns`")


def velocity_against_position(name: str, v: Velocity, band: float, dt: float) -> Iterator[Notice]:
    """Disagreement of a velocity with its position, else its gain and lag.

    Whether the unit or sign of q or that of v is wrong is for the model to tell, so that a gain is no fault here.

    Parameters
    ----------
    name
        Of the joint.
    v
        Figures of the velocity.
    band
        Band of the motion [Hz].
    dt
        Nominal sample time [s].
    """
    if v.agreement < 1 - DISAGREEMENT or v.gain is None or v.lag_ms is None or v.lag_error_ms is None:
        share = f"only {v.agreement:.0%} of v's power in the motion's band is that of the derivative of q"
        meaning = "v belongs to another joint or is wrong: set `velocity: differentiated`"
        severity: Severity = "problem" if v.agreement < UNRELATED else "warning"
        yield Notice("velocity_unrelated", severity, name, share, meaning)
        return
    if abs(v.gain - 1) > GAIN:
        gain = f"v is {v.gain:.4g} times the derivative of q"
        meaning = "its unit, gear ratio or sign is wrong: correct it in `log.scale`, or set `velocity: differentiated`"
        severity = "problem" if v.gain < 0 or is_another_unit(v.gain) else "warning"
        yield Notice("velocity_gain", severity, name, gain, meaning)
    phase = 2e-3 * np.pi * band * abs(v.lag_ms)
    if abs(v.lag_ms) > max(1e3 * LATE * dt, LATE_ERRORS * v.lag_error_ms) and phase > LATE_PHASE:
        relation = "lags" if v.lag_ms > 0 else "leads"
        lag = f"v {relation} the derivative of q by {abs(v.lag_ms):.3g} ± {v.lag_error_ms:.1g} ms"
        yield Notice("velocity_lag", "note", name, lag, "idtool corrects it; no action is needed")


def is_another_unit(gain: float) -> bool:
    """Whether a gain, of whatever sign, is too far from 1 for a calibration that is off."""
    return abs(np.log(abs(gain))) > WRONG_UNIT if gain else False
