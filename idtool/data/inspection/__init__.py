"""What is in a log, and what is wrong with it.

`inspect_log` looks at a log and nothing else: no model, no configuration. Ranges and counts come from every sample;
shares and statistics of a long log from stretches spread over it, 2¹⁷ samples in all.

Letters: t stamps [s], q position [rad or m], v velocity [rad/s or m/s], tau torque or force [N·m or N], dt nominal
sample time [s], N samples, nj joints.
"""

from __future__ import annotations

import numpy as np

from idtool.data.inspection.clock import clock_deviation, fresh_rows, gaps, jitter, sample_steps, sampling, step_jitter
from idtool.data.inspection.findings import find
from idtool.data.inspection.joint import inspect_joint
from idtool.data.inspection.measures import quantisation, span
from idtool.data.inspection.records import (
    Finding,
    Gap,
    Inspection,
    Joint,
    Sampling,
    Signal,
    Stamps,
    TorqueSource,
    Velocity,
)
from idtool.data.inspection.velocity import velocity_lag
from idtool.data.logs.log import Log
from idtool.data.logs.times import doubtful_unit

__all__ = [
    "Finding",
    "Gap",
    "Inspection",
    "Joint",
    "Sampling",
    "Signal",
    "Stamps",
    "TorqueSource",
    "Velocity",
    "inspect_log",
    "jitter",
    "quantisation",
    "sample_steps",
    "velocity_lag",
]

_MOST = 1 << 17  # samples that statistics are taken from
_STRETCH = 1 << 14  # samples
_SHORTEST = 64  # samples of a stretch, where there are longer ones
_LONGEST_GAPS = 5
_SHORT = 0.5  # s


def inspect_log(log: Log) -> Inspection:
    """Inspect a log.

    Parameters
    ----------
    log
        As a reader returns it.

    Returns
    -------
    Inspection
        Figures per log and per joint, and the findings.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # values beyond all sense are no crash
        return _inspected(log)


def _inspected(log: Log) -> Inspection:
    stretches = _stretches(log.segments)
    spans = {name: span(x) for name, x in log.signals.items()}
    fresh = np.concatenate([fresh_rows(log, s) for s in stretches])
    joints, moving = {}, np.zeros(len(fresh), dtype=bool)
    for i, name in enumerate(log.joints):
        joints[name], moves = inspect_joint(log, i, spans, stretches, fresh)
        moving |= moves
    repeated = 1 - float(fresh[moving].mean()) if moving.any() else 0.0
    stamps = _stamps(log, stretches, [i for i, j in enumerate(joints.values()) if j.moves and j.velocity], repeated)
    t = log.t[np.isfinite(log.t)]
    duration = float(t[-1] - t[0])
    runs = [(s.stop - s.start - 1, float(log.t[s.stop - 1] - log.t[s.start])) for s in log.segments]
    steps, seconds = (sum(column) for column in zip(*runs, strict=True))
    in_seconds = doubtful_unit(log.dt, log.segments, log.signals) is None
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
        findings=find(log.dt, duration, len(log), len(log.segments), stamps, joints, in_seconds),
        warnings=log.warnings,
    )


def _stretches(segments: tuple[slice, ...]) -> list[slice]:
    """Stretches of the segments, evenly spread over the log, that hold at most about `_MOST` samples in all."""
    cut = [slice(a, min(a + _STRETCH, s.stop)) for s in segments for a in range(s.start, s.stop, _STRETCH)]
    total = sum(s.stop - s.start for s in segments)
    if total <= _MOST:
        cut = list(segments)
    cut = [s for s in cut if s.stop - s.start >= _SHORTEST] or cut
    keep = np.linspace(0, len(cut) - 1, min(max(len(cut) * _MOST // total, 1), len(cut), _MOST // _SHORTEST))
    return [cut[i] for i in keep.astype(int)]


def _stamps(log: Log, stretches: list[slice], moving: list[int], repeated: float) -> Stamps:
    step = np.diff(log.t[np.isfinite(log.t)])
    lost = gaps(log)
    short = sum(s.stop - s.start for s in log.segments if (s.stop - s.start) * log.dt < _SHORT)
    resolution = quantisation(log.t[stretches[0]])
    told = None
    if "v" in log.signals:
        q, v = log.signals["q"], log.signals["v"]
        told = sampling([(log.t[s], q[s][:, moving], v[s][:, moving]) for s in stretches], log.dt)
    return Stamps(
        step_jitter=step_jitter(log.t, log.dt, log.segments),
        jitter_rms_ms=1e3 * log.dt * jitter(log.t, log.dt, log.segments),
        jitter_max_ms=1e3 * max(float(np.abs(clock_deviation(log.t[s])).max()) for s in log.segments),
        step_ms=None if resolution is None else 1e3 * resolution,
        duplicates=int(np.sum(step == 0)),
        backward=int(np.sum(step < 0)),
        gaps=len(lost),
        lost=sum(gap.lost for gap in lost),
        longest_gaps=lost[:_LONGEST_GAPS],
        short=short / sum(s.stop - s.start for s in log.segments),
        repeated=repeated,
        sampling=told,
    )
