"""Channels that froze: stretches in which one value is repeated while the joint moves.

Letters: x one channel, q position [rad or m], v velocity [rad/s or m/s], dt nominal sample time [s], N samples of a
block.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.data.inspection.channel_findings import MAX_STALE_SHARE
from idtool.data.inspection.records import FrozenStretches, InspectedJoint, Signal
from idtool.data.logs.log import JointLog

MIN_DURATION = 0.1  # s in all: less is too short for a filter to carry any further
MIN_STRETCH_DURATION = 0.03  # s that one stretch lasts at least: less is a hiccup of a bus
MIN_STRETCH_SAMPLES = 10  # the same in samples, where the rate is low
MAX_FROZEN_SHARE = (
    0.5  # share of a block in such stretches above which the channel is slow, or made of steps, and not frozen
)
MAX_REPEAT_SHARE = 0.01  # share of repeats elsewhere below which many in a row are no chance
MIN_RELATIVE_NOISE = 1e-4  # noise over deviation above which a channel cannot repeat a value at all
LEAP_FACTOR = 8.0  # usual changes by which a channel that was frozen catches up: one that rests or turns goes on slowly
MIN_RELATIVE_SPEED = 0.1  # of the joint's rms speed: below it, an encoder may well repeat a value

_CHANNELS = ("q", "v", "tau")
_BLOCK = 1 << 16  # samples looked at together
_READING_STRIDE = 5  # samples from one reading of q to the next for the distance, so that noise adds little to it


def frozen_channels(log: JointLog, joints: Mapping[str, InspectedJoint]) -> dict[str, dict[str, FrozenStretches]]:
    """Frozen stretches by joint and signal; of every sample of the log.

    Parameters
    ----------
    log
        The log.
    joints
        Its joints, inspected.
    """
    shortest = int(np.ceil(max(MIN_STRETCH_DURATION / log.dt, MIN_STRETCH_SAMPLES)))
    first_stamp = log.t[np.argmax(np.isfinite(log.t))]
    frozen: dict[str, dict[str, FrozenStretches]] = {name: {} for name in joints}
    for signal in _CHANNELS:
        stretches = _stretches(log, joints, signal, shortest)
        for name, runs in stretches.items():
            seconds = float(sum(stop - start for start, stop in runs) * log.dt)
            if seconds > MIN_DURATION:
                frozen[name][signal] = FrozenStretches(len(runs), seconds, float(log.t[runs[0][0]] - first_stamp))
    return frozen


def _stretches(
    log: JointLog, joints: Mapping[str, InspectedJoint], signal: str, shortest: int
) -> dict[str, list[tuple[int, int]]]:
    """First sample of each frozen stretch of a signal, and the one after its last, by joint."""
    columns = [i for i, name in enumerate(log.joints) if _may_freeze(joints[name], signal)]
    stretches: dict[str, list[tuple[int, int]]] = {}
    if not columns:
        return stretches
    for block in _blocks(log.segments, shortest):
        x = np.ascontiguousarray(log.signals[signal][block].T)  # (joints, samples)
        repeats = np.count_nonzero(x[:, 1:] == x[:, :-1], axis=1)
        for i in columns:
            if repeats[i] < shortest - 1:
                continue
            name = log.joints[i]
            for start, stop in _frozen_runs(log, block, signal, i, joints[name], shortest):
                stretches.setdefault(name, []).append((block.start + start, block.start + stop))
        log.release_memory()
    return stretches


def _may_freeze(joint: InspectedJoint, signal: str) -> bool:
    """True if a joint has a channel that changes and is not stale throughout."""
    figures = joint.signals.get(signal)
    return joint.moves and figures is not None and not figures.constant and (figures.stale or 0.0) <= MAX_STALE_SHARE


def _blocks(segments: Sequence[slice], shortest: int) -> Iterator[slice]:
    for segment in segments:
        for start in range(segment.start, segment.stop, _BLOCK):
            block = slice(start, min(start + _BLOCK, segment.stop))
            if block.stop - block.start >= shortest:
                yield block


def _frozen_runs(
    log: JointLog, block: slice, signal: str, i: int, joint: InspectedJoint, shortest: int
) -> Iterator[tuple[int, int]]:
    """First sample of each frozen stretch in a block, and the one after its last.

    In a noisy channel that hardly repeats a value elsewhere, many equal ones in a row are no chance. In any other, one
    that was frozen leaps when it goes on, where one that rests or turns goes on slowly. For a position a leap is
    enough, as it has to go where it comes to. The extremes are left to clipping.
    """
    x = np.ascontiguousarray(log.signals[signal][block, i])
    runs = _equal_runs(x, shortest)
    if not len(runs) or (runs[:, 1] - runs[:, 0]).sum() > MAX_FROZEN_SHARE * len(x):
        return
    change = np.abs(np.diff(x))
    is_outside = np.ones(len(change), dtype=bool)
    for start, stop in runs.tolist():
        is_outside[start : stop - 1] = False
    is_noisy = _is_noisy(x, change[is_outside], joint.signals[signal])
    least_leap = _least_leap(change[is_outside], joint.signals[signal])
    distance = _distance(log, block, i, joint, by="v" if signal == "q" else "q")
    lowest, highest = x.min(), x.max()
    for start, stop in runs.tolist():
        leaps = stop < len(x) and change[stop - 1] > least_leap
        moves = distance[stop - 1] - distance[start] > MIN_RELATIVE_SPEED * (stop - start)
        is_extreme = not lowest < x[start] < highest
        is_frozen = (leaps and signal == "q") or (moves and (is_noisy or leaps))
        if is_frozen and not is_extreme:
            yield start, stop


def _equal_runs(x: Array, shortest: int) -> Indices:
    """Runs of ``shortest`` and more equal samples: the first, and the one after the last, shape (runs, 2)."""
    equal = np.concatenate([[False], x[1:] == x[:-1], [False]])
    edges = np.flatnonzero(equal[1:] != equal[:-1])
    runs = edges.reshape(-1, 2) + np.array([0, 1])
    return np.asarray(runs[runs[:, 1] - runs[:, 0] >= shortest])


def _is_noisy(x: Array, changes: Array, figures: Signal) -> bool:
    """True if a channel is too noisy to repeat values, judged by its changes outside all long runs."""
    return bool(figures.noise > MIN_RELATIVE_NOISE * np.std(x) and np.mean(changes == 0) < MAX_REPEAT_SHARE)


def _least_leap(changes: Array, figures: Signal) -> float:
    """Change from one sample to the next that tells a channel that was frozen, by the changes outside all long runs."""
    changes = changes[changes > 0]
    if not len(changes):
        return np.inf
    return max(LEAP_FACTOR * float(np.median(changes)), 4 * (figures.step or 0.0))


def _distance(log: JointLog, block: slice, i: int, joint: InspectedJoint, by: str) -> Array:
    """Distance covered, by v or by q, over that of a sample at the joint's rms speed, shape (N,); 0 without v."""
    usual_step = joint.speed_rms * log.dt
    if by == "v":
        if "v" not in joint.signals:
            return np.zeros(block.stop - block.start)
        return np.asarray(np.cumsum(np.abs(log.signals["v"][block, i])) * log.dt / usual_step)
    q = log.signals["q"][block, i]
    readings = np.arange(0, len(q), _READING_STRIDE)
    covered = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q[readings])))])
    return np.asarray(np.interp(np.arange(len(q)), readings, covered / usual_step))
