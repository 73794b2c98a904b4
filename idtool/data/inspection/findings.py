"""What the figures of an inspection mean for a fit.

One function per concern, each yielding its findings. The thresholds stand at the top, each with its reason; a clean log
crosses none of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from idtool.data.inspection.records import Finding, Joint, Severity, Signal, Stamps, Velocity

JITTER = 0.1  # samples that a step is off: differencing neighbouring positions is then wrong by a tenth of the velocity
REPEATED = 0.005  # share of the samples, or of the steps that skip one: less is a hiccup
OFTEN = 0.1  # share: from here on the rate is wrong by as much
STALE = 0.02  # share of the samples while a channel changes
LOST = 0.01  # share of the time
SHORT = 0.05  # share of samples in segments too short for a filter to settle in
TOO_SHORT = 0.5  # the same, from which on hardly anything is left
LATE = 0.25  # samples: less, no fit can see
LATE_ERRORS = 3.0  # standard errors that a lag must exceed to count
LATE_PHASE = 0.01  # rad at the band's edge: v is wrong by this share there
DISAGREEMENT = 0.03  # of v's power: 17 % of its amplitude
UNRELATED = 0.5  # of v's power
GAIN = 0.03  # off 1: more than a clock is out
WRONG_UNIT = 0.2  # off 1: more than a calibration is out
COARSE = 0.02  # rounding noise over the signal's rms
BAND = 5.0  # times the velocity's band: about what a fit's filter lets through
STUCK = 0.005  # share of samples while moving
STILL = 0.5  # share of the time
TURNS = 8 * np.pi  # rad: four turns are degrees, or a wheel
FAST = 0.2  # of the sampling rate: above it, no short difference is a derivative any more

_RANK: dict[Severity, int] = {"problem": 0, "warning": 1, "note": 2}
_OVER_STEPS = "q differentiated from sample to sample is noisy: a fit takes the logged v where it is less so"


def find(
    dt: float,
    duration: float,
    samples: int,
    segments: int,
    stamps: Stamps,
    joints: Mapping[str, Joint],
    in_seconds: bool = True,
) -> tuple[Finding, ...]:
    """All findings, problems first, those with the same meaning side by side.

    Parameters
    ----------
    dt
        Nominal sample time [s].
    duration
        Of the log [s].
    samples
        Rows of the log.
    segments
        Number of runs without a gap.
    stamps
        Figures of the stamps.
    joints
        Figures of the joints, by name.
    in_seconds
        Whether there is no doubt about the stamps' unit, in which v can be compared with dq/dt.
    """
    found = [*_clock(dt, stamps), *_rows(duration, samples, stamps), *_pieces(segments, stamps)]
    for name, joint in joints.items():
        found += [*_presence(name, joint), *_motion(name, joint, dt), *_torque(name, joint)]
        if joint.velocity and in_seconds and not _spoilt(joint):
            found += _velocity(name, joint.velocity, joint.band_hz or 0.0, dt)
        for signal, figures in joint.signals.items():
            found += _signal(name, signal, figures, joint, dt)
    first = {finding.meaning: i for i, finding in reversed(list(enumerate(found)))}
    return tuple(sorted(found, key=lambda finding: (_RANK[finding.severity], first[finding.meaning])))


def _often(share: float) -> Severity:
    return "warning" if share > OFTEN else "note"


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + ("s" if number != 1 else "")


def _clock(dt: float, stamps: Stamps) -> Iterator[Finding]:
    limit = 1e3 * JITTER * dt
    told = stamps.sampling
    if stamps.step_jitter > JITTER:
        what = f"the time from stamp to stamp strays by {stamps.step_jitter:.2g} samples rms"
        yield Finding("warning", None, what, _OVER_STEPS)
    elif told and told.jitter_ms > limit:
        off = told.jitter_ms / (1e3 * dt)
        what = f"by the joints' motion the samples were taken {off:.2g} samples rms off the stamps' even clock"
        yield Finding("warning", None, what, "the stamps were rounded or made up; " + _OVER_STEPS)
    if told and told.skipped - stamps.repeated > REPEATED and told.jitter_ms < limit:
        what = f"by the joints' motion {told.skipped:.1%} of the steps took the time of two samples or more"
        yield Finding(_often(told.skipped), None, what, "samples were lost without a gap in the stamps; " + _OVER_STEPS)
    if stamps.repeated > REPEATED:
        what = f"{stamps.repeated:.1%} of the samples repeat the one before in every joint"
        yield Finding(_often(stamps.repeated), None, what, "the log ran faster than its source; " + _OVER_STEPS)


def _rows(duration: float, samples: int, stamps: Stamps) -> Iterator[Finding]:
    if stamps.gaps:
        longest = stamps.longest_gaps[0]
        what = (
            f"{_count(stamps.gaps, 'gap')}, {stamps.lost:.3g} s in all; the longest, {longest.lost:.3g} s, "
            f"{longest.start:.3f} s into the log"
        )
        severity: Severity = "warning" if stamps.lost > LOST * duration else "note"
        meaning = "no filter crosses a gap: the samples next to one are lost, short stretches altogether"
        yield Finding(severity, None, what, meaning)
    if stamps.duplicates:
        what = f"{_count(stamps.duplicates, 'stamp')} equal to the one before"
        meaning = "a coarse clock, or rows written twice; name the sensor's own time in `log.columns` if it is logged"
        yield Finding(_often(stamps.duplicates / samples), None, what, meaning)
    if stamps.backward:
        what = f"{_count(stamps.backward, 'stamp')} earlier than the one before"
        meaning = "two recordings or a clock that was set: the log is split there; check that the parts belong together"
        yield Finding("warning", None, what, meaning)


def _pieces(segments: int, stamps: Stamps) -> Iterator[Finding]:
    if segments < 2 or stamps.short < SHORT:
        return
    severity: Severity = "problem" if stamps.short > TOO_SHORT else "warning"
    what = f"gaps and missing values cut the log in {segments}: {stamps.short:.0%} of it is in stretches below 0.5 s"
    left = "hardly anything is left to fit" if stamps.short > TOO_SHORT else "they may be lost to a fit"
    meaning = f"shorter than a filter takes to settle, {left}: fill in single missing values, or log without gaps"
    yield Finding(severity, None, what, meaning)


def _presence(name: str, joint: Joint) -> Iterator[Finding]:
    if "q" not in joint.signals:
        meaning = "the joint can't be used; name its column in `log.columns`, or leave it out of `joints`"
        yield Finding("problem", name, "q is missing", meaning)
    if "v" not in joint.signals:
        yield Finding("note", name, "v is missing", "it is differentiated from q")
    if "tau" not in joint.signals:
        if "qcmd" in joint.signals:
            meaning = "it is computed from the command: give the joint's gains under `controller`"
            yield Finding("note", name, "tau is missing, qcmd is there", meaning)
        else:
            meaning = "nothing can be fitted to the joint; name its column in `log.columns`, or log qcmd"
            yield Finding("problem", name, "tau is missing", meaning)


def _motion(name: str, joint: Joint, dt: float) -> Iterator[Finding]:
    if "q" not in joint.signals:
        return
    if not joint.moves:
        meaning = "its friction and inertia can't be seen; leave it out of `joints`, and lock it in `locked_joints`"
        yield Finding("warning", name, "the joint does not move", meaning)
        return
    if joint.standstill > STILL:
        what = f"the joint stands still {joint.standstill:.0%} of the time"
        yield Finding("note", name, what, "samples at rest tell gravity within static friction, and little else")
    if joint.jumps:
        what = _count(joint.jumps, "jump") + " of q" + (" by about a full turn" if joint.wraps else "")
        meaning = "velocity and acceleration are wrong around each jump; unwrap q, or cut the log there"
        yield Finding("problem", name, what, meaning)
    if joint.band_hz is not None and joint.band_hz > FAST / dt:
        what = f"99 % of the velocity's power reaches up to {joint.band_hz:.3g} Hz, at {1 / dt:.4g} samples a second"
        meaning = "accelerations are not to be trusted up there: log faster, or lower `filter.cutoff_hz`"
        yield Finding("warning", name, what, meaning)
    q = joint.signals["q"]
    if q.maximum - q.minimum > TURNS:
        what = f"q spans {q.maximum - q.minimum:.4g}"
        yield Finding("note", name, what, "a wheel, or degrees: then set `log.scale` of q to 0.0174533")


def _velocity(name: str, v: Velocity, band: float, dt: float) -> Iterator[Finding]:
    if v.agreement < 1 - DISAGREEMENT or v.gain is None or v.lag_ms is None or v.lag_error_ms is None:
        what = f"only {v.agreement:.0%} of v's power in the motion's band is that of the derivative of q"
        severity: Severity = "problem" if v.agreement < UNRELATED else "warning"
        yield Finding(severity, name, what, "another joint's v, or a broken one: set `velocity: differentiated`")
        return
    if abs(v.gain - 1) > GAIN:
        what = f"v is {v.gain:.4g} times the derivative of q"
        meaning = "a unit, gear ratio or sign: put it right in `log.scale`, or set `velocity: differentiated`"
        yield Finding("problem" if abs(v.gain - 1) > WRONG_UNIT else "warning", name, what, meaning)
    phase = 2e-3 * np.pi * band * abs(v.lag_ms)
    if abs(v.lag_ms) > max(1e3 * LATE * dt, LATE_ERRORS * v.lag_error_ms) and phase > LATE_PHASE:
        relation = "lags" if v.lag_ms > 0 else "leads"
        what = f"v {relation} the derivative of q by {abs(v.lag_ms):.3g} ± {v.lag_error_ms:.1g} ms"
        yield Finding("note", name, what, "a filter's doing: a fit undoes it, nothing is to be done")


def _torque(name: str, joint: Joint) -> Iterator[Finding]:
    if joint.torque and joint.torque.kind == "commanded":
        meaning = "what the drive made of the command is not in it: expect a `time_delay` and a `torque_gain`"
        yield Finding("note", name, f"tau looks commanded: {joint.torque.reason}", meaning)


def _signal(name: str, signal: str, x: Signal, joint: Joint, dt: float) -> Iterator[Finding]:
    if x.not_finite:
        meaning = "the rows are left out, and each run of them splits the log"
        yield Finding("warning", name, f"{_count(x.not_finite, 'sample')} of {signal} not finite", meaning)
    if not joint.moves:
        return
    if x.constant and signal in ("v", "tau"):
        instead = "set `velocity: differentiated`" if signal == "v" else "name the right column in `log.columns`"
        what = f"{signal} is {x.minimum + 0.0:.4g} throughout while q moves"  # 0, not -0
        yield Finding("problem", name, what, f"the channel was not filled; {instead}")
    if x.stuck > STUCK and signal in ("v", "tau"):
        what = f"{signal} sits at its extremes, {x.minimum:.4g} and {x.maximum:.4g}, in {x.stuck:.1%} of the samples"
        meaning = "what lies beyond was cut off and pulls the fit; excite less, or raise the limit"
        yield Finding("warning", name, what, meaning)
    elif x.stale is not None and x.stale > STALE and signal in ("q", "v", "tau"):
        what = f"{x.stale:.1%} of {signal}'s samples repeat the one before while it changes"
        meaning = "the channel is read too seldom, and is late by half its period; check the bus"
        yield Finding(_often(x.stale), name, what, meaning)
    noise = _rounding(signal, x, joint, dt)
    if noise > COARSE:
        of = "velocity" if signal == "q" else signal
        what = f"{signal} comes in steps of {x.step:.3g}, which make {noise:.0%} of noise in the {of}"
        instead = {
            "q": "a fit takes the logged v where it is less noisy, else",
            "v": "a fit differentiates q where that is less noisy, else",
        }.get(signal, "excite more, or")
        yield Finding("warning", name, what, f"too coarse: {instead} lower `filter.cutoff_hz`")


def _spoilt(joint: Joint) -> bool:
    """Whether q or v repeats values, so that lag and gain are that defect's doing."""
    return any(joint.signals[s].stuck > STUCK or (joint.signals[s].stale or 0) > STALE for s in ("q", "v"))


def _rounding(signal: str, x: Signal, joint: Joint, dt: float) -> float:
    """Noise that rounding makes, over what it disturbs; 0 where it is nothing to a fit.

    Rounding is white noise of step²/12. In v and tau it counts as it is; in q, as the velocity that differentiating
    it up to a frequency B makes: step² dt (2 pi)² B³ / 18.
    """
    if x.step is None or x.constant:
        return 0.0
    if signal in ("v", "tau"):
        return float(x.step / np.sqrt(12) / x.rms)
    if signal == "q" and joint.speed_rms > 0:
        band = min(BAND * (joint.band_hz or 0.0), 0.5 / dt)
        return float(x.step * 2 * np.pi * np.sqrt(dt * band**3 / 18) / joint.speed_rms)
    return 0.0
