"""Regions of the state in which most of a residual's energy lies in little of the time, in words.

A region's score is the share of the energy that lies in it less the share of time spent there: Kolmogorov's distance
of the energy's distribution from the time's, and Kuiper's where a region has two bounds.

Letters: nv joints, n samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.number_text import number, range_text, short_number
from idtool.diagnosis.residual_series import ResidualSeries
from idtool.diagnosis.spectra import angle_spectrum, masked_power_density

_MIN_SCORE = 0.3  # of a region that is named
_MIN_ENERGY = 0.5  # share of the energy in a region
_SECOND_BOUND = 0.1  # by which a region with two bounds must be better than one with one
_PER_WINDOW = 0.05  # by which each window of time must be worth more than a bound
_MIN_SECOND_SCORE = 0.35  # as `_MIN_SCORE`, of a second region within the first
_MIN_PERIODS = 3.0  # of a ripple over the travel
_UNTIL = "at the start of the log, up to {} s"
_FROM = "at the end of the log, from {} s"
_LINE_WIDTH = 2  # points of a spectrum to each side that belong to a line


@dataclass(frozen=True)
class JointResidual:
    """Residual of one joint, to be located in the state.

    Attributes
    ----------
    series
        The motion.
    joint
        Index of the joint.
    names
        Names of all joints.
    is_prismatic
        True for joints driven by a force, shape (nv,).
    band
        Highest frequency [Hz].
    energy
        Square of the torque times its time, sample by sample, shape (n,); may be below zero.
    torque
        The residual torque, shape (n,).
    name_joint
        True if other joints disagree too, so that a region has to name the joint.
    is_one_log
        True if there is one log, which begins and ends once.
    """

    series: ResidualSeries
    joint: int
    names: tuple[str, ...]
    is_prismatic: tuple[bool, ...]
    band: float
    energy: Array
    torque: Array
    name_joint: bool
    is_one_log: bool

    @property
    def suffix(self) -> str:
        """Words that name the joint; empty if it need not be named."""
        return f" of {self.names[self.joint]}" if self.name_joint else ""


@dataclass(frozen=True)
class Region:
    """Part of the state.

    Attributes
    ----------
    score
        Share of the energy less share of the time.
    kind
        Variable that bounds it.
    words
        Description.
    within
        Mask of its samples, shape (n,).
    """

    score: float
    kind: str
    words: str
    within: Mask


def describe_region(residual: JointResidual, windows: Sequence[tuple[float, float]]) -> str:
    """Description of the region with the best score, and of a second one within it if its score is high.

    Parameters
    ----------
    residual
        The residual to locate.
    windows
        Time intervals that contain most of it [s].
    """
    valid = residual.series.valid[residual.joint]
    regions = [
        *_state_regions(residual, valid),
        *_time_regions(residual, valid, windows),
        *_spectral_regions(residual, valid),
    ]
    best = max(regions, key=lambda region: region.score, default=None)
    if best is None or best.score < _MIN_SCORE:
        return _windows_text(windows) if windows else "in the whole log"
    if best.kind in ("angle", "frequency", "windows"):
        return best.words

    named_kinds = {"speed", "reversal"} if best.kind in ("speed", "reversal") else {best.kind}
    others = [region for region in _state_regions(residual, best.within) if region.kind not in named_kinds]
    second = max(others, key=lambda region: region.score, default=None)
    if second is None or second.score < _MIN_SECOND_SCORE:
        return best.words
    return f"{best.words} and {second.words}"


def _state_regions(residual: JointResidual, among: Mask) -> Iterator[Region]:
    """Regions bounded in one variable of the state."""
    series = residual.series
    j = residual.joint
    suffix = residual.suffix
    q_unit, v_unit, a_unit, tau_unit = _units(residual.is_prismatic[j])
    speed = np.abs(series.v[j])
    slow, fast = f"at speeds{suffix} below {{}} {v_unit}", f"at speeds{suffix} above {{}} {v_unit}"
    yield from _half_lines(residual, among, "speed", speed, slow, fast)
    high_torque = f"at torques{suffix} above {{}} {tau_unit}"
    yield from _half_lines(residual, among, "torque", np.abs(series.tau[j]), "", high_torque)
    high_acceleration = f"at accelerations{suffix} above {{}} {a_unit}"
    yield from _half_lines(residual, among, "acceleration", np.abs(series.a[j]), "", high_acceleration)
    if series.q[j].any():  # that of a floating base is not measured, and is 0
        after_reversals = f"in the first {{}} {q_unit} after reversals{suffix}"
        distance = distance_since_reversal(series, j)
        yield from _half_lines(residual, among, "reversal", distance, after_reversals, "")
        yield from _position_regions(residual, among, q_unit)
    for k, name in enumerate(residual.names):
        if k != j:
            moves = f"while {name} moves faster than {{}} {_units(residual.is_prismatic[k])[1]}"
            yield from _half_lines(residual, among, f"speed of {name}", np.abs(series.v[k]), "", moves)


def _units(is_prismatic: bool) -> tuple[str, str, str, str]:
    """Units of position, velocity, acceleration and torque."""
    return ("m", "m/s", "m/s²", "N") if is_prismatic else ("rad", "rad/s", "rad/s²", "N·m")


def _half_lines(residual: JointResidual, among: Mask, kind: str, x: Array, below: str, above: str) -> Iterator[Region]:
    """Regions of x below a bound and above one; none without words for it."""
    samples = _SortedSamples.of(x, residual, among)
    if samples is None:
        return
    if below:
        yield from samples.region(kind, below, (0, int(np.argmax(samples.excess))))
    if above:
        yield from samples.region(kind, above, (int(np.argmin(samples.excess)), len(samples.x)))


def _position_regions(residual: JointResidual, among: Mask, unit: str) -> Iterator[Region]:
    """Regions of the position with one or two bounds."""
    q = residual.series.q[residual.joint]
    start = f"at positions{residual.suffix}"
    low, high = f"{start} below {{}} {unit}", f"{start} above {{}} {unit}"
    yield from _half_lines(residual, among, "position", q, low, high)
    samples = _SortedSamples.of(q, residual, among)
    if samples is None:
        return
    between = _largest_rise(samples.excess)
    yield from samples.region("position", f"{start} between {{}} and {{}} {unit}", between)
    outside = _largest_rise(-samples.excess)
    yield from samples.region("position", f"{start} below {{}} or above {{}} {unit}", outside, outside=True)


def _largest_rise(x: Array) -> tuple[int, int]:
    """Places between which a curve rises most."""
    last = int(np.argmax(x - np.minimum.accumulate(x)))
    first = int(np.argmin(x[: last + 1]))
    return first, last


@dataclass(frozen=True)
class _SortedSamples:
    """Samples sorted by a variable.

    Attributes
    ----------
    x
        Its values, ascending, shape (k,).
    excess
        Share of the energy less share of time up to each place between them, shape (k + 1,).
    energy_share
        Share of the energy up to each place, shape (k + 1,).
    values
        The variable at all samples, shape (n,).
    among
        Mask of the sorted samples, shape (n,).
    """

    x: Array
    excess: Array
    energy_share: Array
    values: Array
    among: Mask

    @classmethod
    def of(cls, values: Array, residual: JointResidual, among: Mask) -> _SortedSamples | None:
        """Sorted samples; None without energy."""
        energy = residual.energy[among]
        if energy.sum() <= 0:
            return None
        order = np.argsort(values[among], kind="stable")
        energy_share = _cumulative_share(energy[order], energy.sum())
        time = residual.series.dt[among]
        time_share = _cumulative_share(time[order], time.sum())
        return cls(values[among][order], energy_share - time_share, energy_share, values, among)

    def region(self, kind: str, words: str, ends: tuple[int, int], outside: bool = False) -> Iterator[Region]:
        """Region between two places, or outside them; none if it has little energy or lacks a bound."""
        first, last = ends
        energy_share = self.energy_share[last] - self.energy_share[first]
        score = self.excess[last] - self.excess[first]
        if outside:
            energy_share = 1 - energy_share
            score = -score
        inner = [place for place in ends if 0 < place < len(self.x)]
        if energy_share < _MIN_ENERGY or len(inner) != words.count("{"):
            return
        bounds = [float(self.x[place - 1] + self.x[place]) / 2 for place in inner]
        low = bounds[0] if first > 0 else -np.inf
        high = bounds[-1] if last < len(self.x) else np.inf
        within = (self.values >= low) & (self.values <= high)
        score = min(score, 1.0) - _SECOND_BOUND * (len(inner) - 1)
        words = words.format(*(number(bound, 2) for bound in bounds))
        yield Region(score, kind, words, self.among & (within != outside))


def _cumulative_share(x: Array, total: float) -> Array:
    """Share of a total up to each place between samples, shape (k + 1,)."""
    return np.concatenate([[0.0], np.cumsum(x) / total])


def _time_regions(residual: JointResidual, among: Mask, windows: Sequence[tuple[float, float]]) -> Iterator[Region]:
    """Parts of the log: its windows, and its start or end if their scores are nearly as high."""
    series = residual.series
    score = -np.inf
    if windows:
        within = among & is_inside(series.t, windows)
        energy_share = residual.energy[within].sum() / residual.energy[among].sum()
        time_share = series.dt[within].sum() / series.dt[among].sum()
        score = float(energy_share - time_share)
        yield Region(min(score, 1.0) - _PER_WINDOW * len(windows), "windows", _windows_text(windows), within)
    if residual.is_one_log:
        for region in _half_lines(residual, among, "time", series.t, _UNTIL, _FROM):
            if region.score > score - _SECOND_BOUND:
                yield region


def _windows_text(windows: Sequence[tuple[float, float]]) -> str:
    if len(windows) == 1:
        return f"from {range_text(*windows[0])} s"
    total = sum(last - first for first, last in windows)
    return f"in {len(windows)} time intervals, {number(total, 2)} s in total"


def is_inside(t: Array, windows: Sequence[tuple[float, float]]) -> Mask:
    """Mask of the times inside windows."""
    return np.asarray(np.logical_or.reduce([(t >= first) & (t <= last) for first, last in windows]))


def _spectral_regions(residual: JointResidual, valid: Mask) -> Iterator[Region]:
    """Lines of the spectrum in time that the motion does not have, and of that over the angle."""
    series = residual.series
    total = float(residual.energy[valid].sum() / series.dt[valid].sum())
    if total > 0:
        yield from _frequency_region(residual, valid, total)
        yield from _angle_region(residual, valid, total)


def _frequency_region(residual: JointResidual, valid: Mask, total: float) -> Iterator[Region]:
    series = residual.series
    j = residual.joint
    f, power = masked_power_density(residual.torque, valid, series.dt, series.segments, residual.band)
    if len(f) <= 2 * _LINE_WIDTH or not power.any():
        return
    peak = int(np.argmax(power))
    line = slice(max(peak - _LINE_WIDTH, 0), peak + _LINE_WIDTH + 1)
    motion_share = 0.0
    for x in (series.tau[j], series.v[j], series.a[j]):
        _, motion_power = masked_power_density(x, valid, series.dt, series.segments, residual.band)
        motion_share = max(motion_share, motion_power[line].sum() / max(motion_power.sum(), 1e-300))
    score = min(power[line].sum() * (f[1] - f[0]) / total, 1.0) - motion_share
    frequency = f[line] @ power[line] / power[line].sum()
    where = f" on {residual.names[j]}" if residual.name_joint else ""
    yield Region(score, "frequency", f"at {number(frequency, 2)} Hz{where}", valid)


def _angle_region(residual: JointResidual, valid: Mask, total: float) -> Iterator[Region]:
    series = residual.series
    j = residual.joint
    q = series.q[j, valid]
    n, amplitude = angle_spectrum(residual.torque[valid], q, series.v[j, valid], residual.band)
    is_ripple = n >= _MIN_PERIODS * 2 * np.pi / max(float(np.ptp(q)), 1e-12)
    if not is_ripple.any():
        return
    peak = int(np.argmax(np.where(is_ripple, amplitude, 0.0)))
    turn = "per 2π m" if residual.is_prismatic[j] else "per turn"
    score = min(amplitude[peak] ** 2 / 2 / total, 1.0)
    count = short_number(n[peak])
    periods = "period" if count == "1" else "periods"
    yield Region(score, "angle", f"at {count} {periods} {turn}{residual.suffix}", valid)


def distance_since_reversal(series: ResidualSeries, j: int) -> Array:
    """Distance of a joint from its last reversal [rad or m], shape (n,); infinite before the first."""
    distance = np.full(len(series.t), np.inf)
    for segment in series.segments:
        q = series.q[j, segment]
        v = series.v[j, segment]
        moving = np.flatnonzero(np.abs(v) > series.velocity_deadband[j])
        reversals = moving[1:][np.diff(np.sign(v[moving])) != 0]
        if len(reversals):
            last = np.searchsorted(reversals, np.arange(len(q)), side="right") - 1
            since = np.abs(q - q[reversals[np.maximum(last, 0)]])
            distance[segment] = np.where(last < 0, np.inf, since)
    return distance
