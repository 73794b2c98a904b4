"""Faults that one channel shows by itself or against the clock: what an inspection found, where a fit suffers by it.

An inspection tells all that is worth knowing of a log; here is what has to be put right, or known, before physics is
blamed for it. New beside it: channels that froze for a while.

Letters: t stamps [s], q position [rad or m], v velocity [rad/s or m/s], tau torque or force [N·m or N], dt nominal
sample time [s], N samples.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from idtool.common.arrays import Array
from idtool.data.channels import Channels
from idtool.data.inspection import Inspection, Joint, Signal, Stamps
from idtool.data.inspection.findings import JITTER, LATE, LATE_ERRORS, LATE_PHASE, SHORT, STUCK, UNRELATED
from idtool.data.inspection.velocity import velocity_agreement
from idtool.data.logs.log import Log
from idtool.diagnosis.fault_record import Fault

_LOST = 0.002  # share of the time that is lost
_SKIPPED = 0.01  # share of steps that took the time of two: a few are hiccups
_HELD = 0.05  # share of samples that repeat the one before: fewer are hiccups of a bus
_OFTEN = 0.3  # the same of one that also sits at its extremes, on the way to which it may repeat values
_FROZEN = 0.1  # s
_LONG = 0.03, 10  # s and samples that a frozen stretch lasts at least
_MOSTLY = 0.5  # share of samples in such stretches above which a channel is not frozen but slow, or made of steps
_BY_CHANCE = 0.01  # share of repeats elsewhere below which many in a row are no chance
_NOISY = 1e-4  # noise of a channel, of its deviation, above which it cannot repeat a value
_LEAP = 8.0  # usual changes by which a channel that is no longer frozen catches up
_MOVES = 0.1  # of the joint's rms speed
_TURN, _JUMP = 0.5, 20.0  # rad off a full turn, and times what nine steps in ten stay below, that a jump may be and is
_BLOCK = 1 << 16  # samples looked at together
_TIME_UNITS = {"ms": 1e-3, "µs": 1e-6, "ns": 1e-9}
_SLOWEST = 0.2  # s from sample to sample, with which no log of a motion is made
_GAIN = 0.1  # of v over dq/dt, off 1
_OTHERS = 0.9  # share of a velocity's power that another joint's position explains


def signal_faults(log: Log, inspection: Inspection, joints: tuple[str, ...]) -> Iterator[Fault]:
    """Faults of single channels and of the clock.

    Parameters
    ----------
    log
        The log.
    inspection
        Of it.
    joints
        Those of the model.
    """
    yield from _clock(inspection)
    for name in joints:
        joint = inspection.joints[name]
        if not joint.moves:
            continue
        yield from _late(name, joint, inspection.dt)
        yield from _clipped(log, name, joint)
        yield from _stale(name, joint)
        yield from _frozen(log, name, joint)
        yield from _wrapped(log, name)


def _clock(inspection: Inspection) -> Iterator[Fault]:
    stamps, limit = inspection.stamps, 1e3 * JITTER * inspection.dt
    told = stamps.sampling
    keep = "velocity is taken from the measured v where there is one; log the sensor's own time"
    if stamps.jitter_rms_ms > limit:
        what = f"stamps stray from an even clock by {stamps.jitter_rms_ms:.3g} ms rms at {1e3 * inspection.dt:.3g} ms"
        yield Fault("time_jitter", None, f"{what} a sample: {keep}")
    elif told and told.jitter_ms > limit:
        what = f"by the joints' motion samples were taken {told.jitter_ms:.3g} ms rms off their even stamps"
        yield Fault("time_jitter", None, f"{what}, which were rounded or made up: {keep}")
    if stamps.repeated > _HELD:
        what = f"{stamps.repeated:.1%} of the samples repeat the one before in every joint"
        yield Fault("stale", None, f"{what}, as the log ran faster than its source: log at the source's rate")
    lost = _lost(inspection, stamps)
    if lost:
        yield Fault("dropped_samples", None, lost)


def time_unit(log: Log, inspection: Inspection, joints: tuple[str, ...]) -> Iterator[Fault]:
    """Stamps so far apart that they are in another unit, to which the velocity agrees where there is one.

    Parameters
    ----------
    log
        The log.
    inspection
        Of it.
    joints
        Those of the model.
    """
    if inspection.dt < _SLOWEST:
        return
    unit, factor = next(((u, f) for u, f in _TIME_UNITS.items() if inspection.dt * f < _SLOWEST), ("", 0.0))
    channels = Channels(log, joints)
    part = channels.longest(log.segments)
    q, v = channels.signal("q", part), channels.signal("v", part) if channels.measured.any() else None
    found = [] if v is None else [velocity_agreement(x, y, inspection.dt * factor) for x, y in zip(q, v, strict=True)]
    if unit and all(abs(one.gain - 1) < _GAIN for one in found if not np.isnan(one.agreement)):
        what = f"samples are {inspection.dt:.3g} s apart by their stamps"
        yield Fault("wrong_unit", None, f"{what}, which are in {unit}: write them in s")


def _lost(inspection: Inspection, stamps: Stamps) -> str:
    """What is lost, in words; empty where it is next to nothing."""
    told = stamps.sampling
    if stamps.gaps and (stamps.lost > _LOST * inspection.duration or stamps.short > SHORT):
        longest = stamps.longest_gaps[0].lost
        what = f"{stamps.gaps} gaps, {stamps.lost:.3g} s or {stamps.lost / inspection.duration:.1%} of the time, "
        what += f"the longest {longest:.3g} s"
        if stamps.short > SHORT:
            what += f"; {stamps.short:.0%} of the samples are in stretches too short to use"
        return f"{what}: no filter or derivative crosses a gap; record again if much is lost"
    even = max(stamps.jitter_rms_ms, told.jitter_ms if told else 0.0) < 1e3 * JITTER * inspection.dt
    if told and told.skipped - stamps.repeated > _SKIPPED and even:
        what = f"by the joints' motion {told.skipped:.1%} of the steps took the time of two samples or more"
        return f"{what}, though the stamps have no gap: log the sensor's own time"
    return ""


def _late(name: str, joint: Joint, dt: float) -> Iterator[Fault]:
    v = joint.velocity
    if v is None or v.lag_ms is None or v.lag_error_ms is None or v.agreement < UNRELATED:
        return
    if any(joint.signals[s].stuck > STUCK or (joint.signals[s].stale or 0) > _HELD for s in ("q", "v")):
        return  # the lag is that defect's doing
    phase = 2e-3 * np.pi * (joint.band_hz or 0.0) * abs(v.lag_ms)
    if abs(v.lag_ms) > max(1e3 * LATE * dt, LATE_ERRORS * v.lag_error_ms) and phase > LATE_PHASE:
        way = "lags" if v.lag_ms > 0 else "leads"
        what = f"v {way} the derivative of q by {abs(v.lag_ms):.3g} ± {v.lag_error_ms:.1g} ms"
        yield Fault("velocity_lag", name, f"{what}: idtool undoes it, nothing is to be done", True)


def _clipped(log: Log, name: str, joint: Joint) -> Iterator[Fault]:
    """A velocity that is cut off, or a position while the velocity goes on; of a torque, see `fault_scale.cut_off`."""
    q, v = joint.signals["q"], joint.signals.get("v")
    if v is None or v.constant:
        return
    if v.stuck > STUCK:
        what = f"v is cut off at {v.minimum:.4g} or {v.maximum:.4g} in {v.stuck:.1%} of the samples while q moves on"
        yield Fault("clipped", name, f"{what}: set `velocity: differentiated`, or raise the limit")
    if q.stuck > STUCK:
        x, speed = (log.signals[signal][:, log.joints.index(name)] for signal in ("q", "v"))
        extreme = (x == q.minimum) | (x == q.maximum)
        if np.nanmedian(np.abs(speed[extreme])) > _MOVES * joint.speed_rms:
            what = f"q is cut off at {q.minimum:.4g} or {q.maximum:.4g} in {q.stuck:.1%} of the samples while v goes on"
            yield Fault("clipped", name, f"{what}: keep the joint in the encoder's range")


def _stale(name: str, joint: Joint) -> Iterator[Fault]:
    for signal in ("q", "v", "tau"):
        x = joint.signals.get(signal)
        if x is None:
            continue
        if x.constant and signal != "q":
            do = "set `velocity: differentiated`" if signal == "v" else "name the right column in `log.columns`"
            yield Fault("stale", name, f"{signal} is {x.minimum:.4g} throughout while q moves: {do}")
        elif (x.stale or 0.0) > (_OFTEN if x.stuck > STUCK else _HELD):
            what = f"{x.stale:.0%} of {signal}'s samples repeat the one before while it changes"
            yield Fault("stale", name, f"{what}, so that it is late by half its period: read it at the log's rate")


def _frozen(log: Log, name: str, joint: Joint) -> Iterator[Fault]:
    """Channels that repeat one value for a while though the joint moves."""
    i = log.joints.index(name)
    for signal in ("q", "v", "tau"):
        x = joint.signals.get(signal)
        if x is None or x.constant or (x.stale or 0.0) > _HELD:
            continue
        found = []
        for segment in log.segments:
            for start in range(segment.start, segment.stop, _BLOCK):
                part = slice(start, min(start + _BLOCK, segment.stop))
                path = _path(log, i, part, by="v" if signal == "q" else "q") / (joint.speed_rms * log.dt)
                runs = _held(log.signals[signal][part, i], path, x, log.dt, leaps=signal == "q")
                found += [(start + a, start + b) for a, b in runs]
        seconds = sum(b - a for a, b in found) * log.dt
        if seconds > _FROZEN:
            since = float(log.t[found[0][0]] - log.t[0])
            what = f"{signal} keeps one value for {seconds:.3g} s in all while the joint moves, first {since:.3f} s in"
            yield Fault("stale", name, f"{what}: leave those stretches out of the log")


def _wrapped(log: Log, name: str) -> Iterator[Fault]:
    """A position that jumps by full turns, which its other steps do not come near."""
    i, jumps = log.joints.index(name), 0
    for segment in log.segments:
        for start in range(segment.start, segment.stop, _BLOCK):
            step = np.abs(np.diff(log.signals["q"][start : min(start + _BLOCK + 1, segment.stop), i]))
            if len(step):
                jump = (np.abs(step - 2 * np.pi) < _TURN) & (step > _JUMP * np.percentile(step, 90))
                jumps += int(np.count_nonzero(jump))
    if jumps:
        what = f"q jumps by about a full turn {jumps} times"
        yield Fault("wrapped_position", name, f"{what}: unwrap it, or cut the log there")


def _path(log: Log, i: int, part: slice, by: str) -> Array:
    """The way that a joint has gone, by v or by q every few samples, so that noise adds little; 0 without v."""
    if by == "v":
        speed = np.abs(log.signals["v"][part, i]) if log.has("v", log.joints[i]) else np.zeros(part.stop - part.start)
        return np.asarray(np.cumsum(speed) * log.dt)
    q = log.signals["q"][part, i]
    at = np.arange(0, len(q), _LONG[1] // 2)
    gone = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q[at])))])
    return np.asarray(np.interp(np.arange(len(q)), at, gone))


def _held(x: Array, path: Array, figures: Signal, dt: float, leaps: bool) -> list[tuple[int, int]]:
    """Stretches of a channel without a gap in which it froze, first sample and the one after the last.

    In a noisy channel that hardly repeats a value elsewhere, many equal ones in a row are no chance. In any other, one
    that was frozen leaps when it goes on, where one that rests or turns goes on slowly. The extremes are left to those
    who look for clipping.

    Parameters
    ----------
    x
        The channel, shape (N,).
    path
        The way that the joint has gone, in that of a sample at its usual speed, shape (N,).
    figures
        Of the channel.
    dt
        Sample time [s].
    leaps
        Whether a leap is enough, as of a position, which has to go where it comes to.
    """
    change = np.abs(np.diff(x))
    ends = np.flatnonzero(np.diff(np.concatenate([[0], change == 0, [0]]).astype(np.int8)))
    runs = ends.reshape(-1, 2) + np.array([0, 1])
    runs = runs[runs[:, 1] - runs[:, 0] >= max(_LONG[0] / dt, _LONG[1])]
    if not len(runs) or (runs[:, 1] - runs[:, 0]).sum() > _MOSTLY * len(x):
        return []
    outside = np.ones(len(change), dtype=bool)
    for a, b in runs:
        outside[a : b - 1] = False
    noisy = figures.noise > _NOISY * np.std(x) and np.mean(change[outside] == 0) < _BY_CHANCE
    changing = change[outside & (change > 0)]
    far = max(_LEAP * float(np.median(changing)), 4 * (figures.step or 0.0)) if len(changing) else np.inf
    found = []
    for a, b in runs.tolist():
        leap = b < len(x) and change[b - 1] > far
        moves = path[b - 1] - path[a] > _MOVES * (b - a)
        if x.min() < x[a] < x.max() and ((leap and leaps) or (moves and (noisy or leap))):
            found.append((a, b))
    return found


def exchanged_velocities(log: Log, inspection: Inspection, joints: tuple[str, ...]) -> Iterator[Fault]:
    """Velocities that are another joint's.

    Parameters
    ----------
    log
        The log.
    inspection
        Of it.
    joints
        Those of the model.
    """
    velocities = {name: inspection.joints[name].velocity for name in joints}
    strange = [name for name, v in velocities.items() if v is not None and v.agreement < UNRELATED]
    if len(strange) < 2:
        return
    channels = Channels(log, strange)
    part = channels.longest(channels.parts())
    q, dq = channels.signal("q", part), channels.signal("v", part)
    for j, name in enumerate(strange):
        for k, other in enumerate(strange):
            if j != k and velocity_agreement(q[j], dq[k], log.dt).agreement > _OTHERS:
                what = f"v of {other} is the derivative of q of {name}, and its own v is not"
                yield Fault("wrong_joint_order", name, f"{what}: put the columns right in `log.columns`")
