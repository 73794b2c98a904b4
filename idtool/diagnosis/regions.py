"""Where a disagreement lives, in words: the part of the state in which most of it happens in little of the time.

Every region is judged by the share of the disagreement's energy that lies in it less the share of time that is spent
there: Kolmogorov's distance, and Kuiper's where a region has two bounds, of the energy's distribution from the time's.

Letters: nv joints, n samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.diagnosis.lines import density, ripple
from idtool.diagnosis.residual_series import ResidualSeries

_MOST = 0.3  # by which the share of energy exceeds that of time, or the region says nothing
_HOLDS = 0.5  # of the energy, at least
_TWO_BOUNDS = 0.1  # by which a region with two bounds must be better than one with one
_WINDOW = 0.05  # by which each window of time must be worth more than a bound
_SECOND = 0.35  # as `_MOST`, of a second clause within the first
_PERIODS = 3.0  # that a ripple has over the travel, at least
_EARLY_LATE = "at the start of the log, up to {:.2g} s", "at the end of the log, from {:.2g} s"
_LINE = 2  # points of a spectrum to each side that belong to a line


@dataclass(frozen=True)
class Scene:
    """What is looked at.

    Attributes
    ----------
    course
        The motion.
    joint
        Index of the joint whose torque disagrees.
    names
        Of all joints.
    forces
        Whether each is driven by a force and not a torque, shape (nv,).
    still
        Speed at which the sign of a velocity is lost in noise, shape (nv,).
    band
        Highest frequency [Hz].
    energy
        Of the disagreement, its square times its time, sample by sample, shape (n,); may be below zero.
    torque
        What the disagreement is made of, shape (n,).
    several
        Whether it is not the only joint that disagrees, so that a region has to name it.
    one_log
        Whether there is one log, which begins and ends once.
    """

    series: ResidualSeries
    joint: int
    names: tuple[str, ...]
    forces: tuple[bool, ...]
    still: Array
    band: float
    energy: Array
    torque: Array
    several: bool
    one_log: bool


@dataclass(frozen=True)
class Region:
    """Part of the state.

    Attributes
    ----------
    score
        By how much its share of the energy exceeds its share of time.
    kind
        By what it is bounded.
    words
        In words.
    within
        Which samples lie in it, shape (n,).
    """

    score: float
    kind: str
    words: str
    within: Mask


def in_words(scene: Scene, windows: Sequence[tuple[float, float]]) -> str:
    """The region that says most, and a second one within it if that says much more.

    Parameters
    ----------
    scene
        What is looked at.
    windows
        Stretches of time in which most of it lies [s].
    """
    kept = scene.series.kept[scene.joint]
    found = [*_bounded(scene, kept), *_timed(scene, kept, windows), *_lines(scene, kept)]
    best = max(found, key=lambda region: region.score, default=None)
    if best is None or best.score < _MOST:
        return _in_stretches(windows) if windows else "all along"
    if best.kind in ("angle", "frequency", "windows"):
        return best.words
    told = {best.kind} | ({"speed", "reversal"} if best.kind in ("speed", "reversal") else set())
    rest = [region for region in _bounded(scene, best.within) if region.kind not in told]
    second = max(rest, key=lambda region: region.score, default=None)
    if second is None or second.score < _SECOND:
        return best.words
    return f"{best.words} and {second.words}"


def _bounded(scene: Scene, among: Mask) -> Iterator[Region]:
    """Regions bounded in one variable of state."""
    series, j = scene.series, scene.joint
    q, v, a, tau = _units(scene.forces[j])
    by = f" of {scene.names[j]}" if scene.several else ""
    speed = np.abs(series.v[j])
    yield from _one(scene, among, "speed", speed, f"below {{:.2g}} {v}{by}", f"above {{:.2g}} {v}{by}")
    yield from _one(scene, among, "torque", np.abs(series.tau[j]), "", f"at torques above {{:.2g}} {tau}{by}")
    yield from _one(scene, among, "acceleration", np.abs(series.a[j]), "", f"at accelerations above {{:.2g}} {a}{by}")
    after = f"in the first {{:.2g}} {q} after reversals{by}"
    yield from _one(scene, among, "reversal", since_reversal(series, j, float(scene.still[j])), after, "")
    yield from _position(scene, among, f"{q}{by}")
    for k in (k for k in range(len(scene.names)) if k != j):
        moves = f"while {scene.names[k]} moves, above {{:.2g}} {_units(scene.forces[k])[1]}"
        yield from _one(scene, among, f"speed of {scene.names[k]}", np.abs(series.v[k]), "", moves)


def _units(force: bool) -> tuple[str, str, str, str]:
    return ("m", "m/s", "m/s²", "N") if force else ("rad", "rad/s", "rad/s²", "N·m")


def _one(scene: Scene, among: Mask, kind: str, x: Array, below: str, above: str) -> Iterator[Region]:
    """Regions with one bound, as far as there are words for them."""
    ordered = _Ordered.of(x, scene, among)
    if ordered is None:
        return
    low, high = int(np.argmax(ordered.ahead)), int(np.argmin(ordered.ahead))
    if below:
        yield from ordered.region(kind, below, (0, low))
    if above:
        yield from ordered.region(kind, above, (high, len(ordered.x)))


def _position(scene: Scene, among: Mask, unit: str) -> Iterator[Region]:
    """Regions bounded in position, by one or two bounds."""
    q = scene.series.q[scene.joint]
    yield from _one(scene, among, "position", q, f"below {{:.2g}} {unit}", f"above {{:.2g}} {unit}")
    ordered = _Ordered.of(q, scene, among)
    if ordered is None:
        return
    for words, ahead in (
        (f"between {{:.2g}} and {{:.2g}} {unit}", ordered.ahead),
        (f"below {{:.2g}} or above {{:.2g}} {unit}", -ordered.ahead),
    ):
        least = np.minimum.accumulate(ahead)
        last = int(np.argmax(ahead - least))
        first = int(np.argmin(ahead[: last + 1]))
        yield from ordered.region("position", words, (first, last), outside=ahead is not ordered.ahead)


@dataclass(frozen=True)
class _Ordered:
    """Samples in the order of a variable.

    Attributes
    ----------
    x
        Its values, ascending, shape (k,).
    ahead
        Share of energy less share of time up to each place between them, shape (k + 1,).
    holds
        Share of the energy up to each, shape (k + 1,).
    values
        The variable, of all samples, shape (n,).
    among
        Which of them are looked at, shape (n,).
    """

    x: Array
    ahead: Array
    holds: Array
    values: Array
    among: Mask

    @classmethod
    def of(cls, values: Array, scene: Scene, among: Mask) -> _Ordered | None:
        energy, time = scene.energy[among], scene.series.step[among]
        if energy.sum() <= 0:
            return None
        order = np.argsort(values[among], kind="stable")
        holds, spent = (np.concatenate([[0.0], np.cumsum(y[order]) / y.sum()]) for y in (energy, time))
        return cls(values[among][order], holds - spent, holds, values, among)

    def region(self, kind: str, words: str, ends: tuple[int, int], outside: bool = False) -> Iterator[Region]:
        """Between two places, or outside; none where it holds little or has no bound."""
        first, last = ends
        holds, score = self.holds[last] - self.holds[first], self.ahead[last] - self.ahead[first]
        if outside:
            holds, score = 1 - holds, -score
        inner = [place for place in ends if 0 < place < len(self.x)]
        if holds < _HOLDS or len(inner) != words.count("{"):
            return
        bounds = [float(self.x[place - 1] + self.x[place]) / 2 for place in inner]
        low = bounds[0] if first > 0 else -np.inf
        high = bounds[-1] if last < len(self.x) else np.inf
        within = (self.values >= low) & (self.values <= high)
        yield Region(
            min(score, 1.0) - _TWO_BOUNDS * (len(inner) - 1),
            kind,
            words.format(*bounds),
            self.among & (within != outside),
        )


def _timed(scene: Scene, among: Mask, windows: Sequence[tuple[float, float]]) -> Iterator[Region]:
    """Parts of the log: its windows, and its start or end if these say next to as much."""
    series, energy, time = scene.series, scene.energy, scene.series.step
    score = -np.inf
    if windows:
        within = among & inside(series.t, windows)
        score = float(energy[within].sum() / energy[among].sum() - time[within].sum() / time[among].sum())
        yield Region(min(score, 1.0) - _WINDOW * len(windows), "windows", _in_stretches(windows), within)
    if scene.one_log:
        ends = _one(scene, among, "time", series.t, *_EARLY_LATE)
        yield from (region for region in ends if region.score > score - _TWO_BOUNDS)


def _in_stretches(windows: Sequence[tuple[float, float]]) -> str:
    return f"in {'a stretch' if len(windows) == 1 else f'{len(windows)} stretches'} of the log"


def inside(t: Array, windows: Sequence[tuple[float, float]]) -> Mask:
    """Which times lie in windows."""
    return np.asarray(np.logical_or.reduce([(t >= first) & (t <= last) for first, last in windows]))


def _lines(scene: Scene, kept: Mask) -> Iterator[Region]:
    """Lines of a spectrum in time that the motion has not, and in angle."""
    series, j = scene.series, scene.joint
    total = float(scene.energy[kept].sum() / series.step[kept].sum())
    if total <= 0:
        return
    step, by = series.step, f" of {scene.names[j]}" if scene.several else ""
    f, power = density(scene.torque, kept, step, series.stretches, scene.band)
    motion = (density(x[j], kept, step, series.stretches, scene.band)[1] for x in (series.tau, series.v, series.a))
    if len(f) > 2 * _LINE and power.any():
        k = int(np.argmax(power))
        line = slice(max(k - _LINE, 0), k + _LINE + 1)
        share = min(power[line].sum() * (f[1] - f[0]) / total, 1.0)
        share -= max(moved[line].sum() / max(moved.sum(), 1e-300) for moved in motion)
        yield Region(share, "frequency", f"at {f[line] @ power[line] / power[line].sum():.2g} Hz{by}", kept)
    n, amplitude = ripple(scene.torque[kept], series.q[j, kept], series.v[j, kept], scene.band)
    seen = n >= _PERIODS * 2 * np.pi / max(float(np.ptp(series.q[j, kept])), 1e-12)
    if seen.any():
        k = int(np.argmax(np.where(seen, amplitude, 0.0)))
        turn = "per 2π m" if scene.forces[j] else "per turn"
        yield Region(min(amplitude[k] ** 2 / 2 / total, 1.0), "angle", f"{n[k]:.3g} periods {turn}{by}", kept)


def since_reversal(series: ResidualSeries, j: int, still: float) -> Array:
    """Way of a joint since it last changed its direction [rad or m], shape (n,); infinite where it has not yet."""
    way = np.full(len(series.t), np.inf)
    for part in series.stretches:
        q, v = series.q[j, part], series.v[j, part]
        moving = np.flatnonzero(np.abs(v) > still)
        turned = moving[1:][np.diff(np.sign(v[moving])) != 0]
        if len(turned):
            last = np.searchsorted(turned, np.arange(len(q)), side="right") - 1
            way[part] = np.where(last < 0, np.inf, np.abs(q - q[turned[np.maximum(last, 0)]]))
    return way
