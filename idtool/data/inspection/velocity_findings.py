"""Findings on a measured velocity against its position: another joint's, another unit, late."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from idtool.common.notice import Notice, Severity
from idtool.common.number_text import number, short_number, with_error
from idtool.data.inspection.records import InspectedJoint, Velocity
from idtool.data.logs.log import JointLog
from idtool.data.velocity_agreement import velocity_agreement

MIN_LAG = 0.25  # samples: less, no fit can see
MIN_LAG_ERRORS = 3.0  # standard errors that a lag must exceed to count
MIN_LAG_PHASE = 0.01  # rad at the band's edge: v is wrong by this share there
MAX_DISAGREEMENT = 0.03  # of v's power: 17 % of its amplitude
MIN_AGREEMENT = 0.5  # of v's power
MIN_EXCHANGE_AGREEMENT = (
    0.9  # share of v's power that another joint's position must explain: two joints seldom move so much alike
)
MAX_GAIN_ERROR = 0.03  # off 1: more than a clock is out
MAX_LOG_GAIN = 0.25  # of log |gain|: more than a calibration is out

_MIN_SHOWN_ERROR = 2e-3  # of a lag: a smaller standard error does not change its three digits
_MAX_SAMPLES = 1 << 15  # samples


def exchanged_velocities(log: JointLog, joints: Mapping[str, InspectedJoint]) -> dict[str, str]:
    """Joints whose velocity is another's, each with the joint under whose name its own stands.

    Only joints whose velocity has nothing to do with their position are compared, over a stretch of bounded length.
    """
    unrelated = []
    for name, joint in joints.items():
        if joint.velocity is not None and joint.velocity.agreement < MIN_AGREEMENT:
            unrelated.append(name)
    longest = max(log.segments, key=lambda segment: segment.stop - segment.start)
    stretch = slice(longest.start, min(longest.stop, longest.start + _MAX_SAMPLES))
    exchanged: dict[str, str] = {}
    for name, other in itertools.permutations(unrelated, 2):
        q = np.ascontiguousarray(log.signals["q"][stretch, log.joints.index(name)])
        v = np.ascontiguousarray(log.signals["v"][stretch, log.joints.index(other)])
        if name not in exchanged and velocity_agreement(q, v, log.dt).agreement > MIN_EXCHANGE_AGREEMENT:
            exchanged[name] = other
    return exchanged


def exchanged_velocity(name: str, other: str) -> Notice:
    """The finding that the velocity of a joint stands under the name of another."""
    evidence = f"v of {other} is the derivative of q of {name}, but v of {name} is not"
    return Notice("wrong_joint_order", "problem", name, evidence, "correct the columns in `log.columns`")


def velocity_against_position(name: str, v: Velocity, band: float, dt: float) -> Iterator[Notice]:
    """Disagreement of a velocity with its position, else its gain and lag.

    Whether the unit or sign of q or that of v is wrong is for the model to tell, so that a gain is no fault here.

    Parameters
    ----------
    name
        Name of the joint.
    v
        Figures of the velocity.
    band
        Band of the motion [Hz].
    dt
        Nominal sample time [s].
    """
    if v.agreement < 1 - MAX_DISAGREEMENT or v.gain is None or v.lag_ms is None or v.lag_error_ms is None:
        share = (
            f"the derivative of q explains only {100 * v.agreement:.0f} % of the power of v in the band of the motion"
        )
        meaning = "v belongs to another joint or is wrong: set `velocity: differentiated`"
        severity: Severity = "problem" if v.agreement < MIN_AGREEMENT else "warning"
        yield Notice("velocity_unrelated", severity, name, share, meaning)
        return
    if abs(v.gain - 1) > MAX_GAIN_ERROR:
        gain = f"v is {short_number(v.gain)} times the derivative of q"
        meaning = "its unit, gear ratio or sign is wrong: correct it in `log.scale`, or set `velocity: differentiated`"
        severity = "problem" if v.gain < 0 or is_another_unit(v.gain) else "warning"
        yield Notice("velocity_gain", severity, name, gain, meaning)
    phase = 2e-3 * np.pi * band * abs(v.lag_ms)
    if abs(v.lag_ms) > max(1e3 * MIN_LAG * dt, MIN_LAG_ERRORS * v.lag_error_ms) and phase > MIN_LAG_PHASE:
        relation = "lags" if v.lag_ms > 0 else "leads"
        lag = number(float(f"{abs(v.lag_ms):.3g}"))  # 1.00 rather than 1.000 for 0.9999
        if v.lag_error_ms > _MIN_SHOWN_ERROR * abs(v.lag_ms):
            lag = " ± ".join(with_error(abs(v.lag_ms), v.lag_error_ms, digits=1))
        message = f"v {relation} the derivative of q by {lag} ms"
        yield Notice("velocity_lag", "note", name, message, "idtool corrects it")


def is_another_unit(gain: float) -> bool:
    """True if a gain, of whatever sign, is too far from 1 for a calibration error."""
    if not gain:
        return False
    return bool(abs(np.log(abs(gain))) > MAX_LOG_GAIN)
