"""Finds feet that slip while they are on the ground, by joints and gyroscope alone.

The points of contact of feet that do not slip move alike, relative to the base's origin. Of three feet and more, those
that most others agree with stand; of two that disagree, one slips, and it can't be told which. With a pose of the base,
every foot is compared with the ground. A foot also moves a little while its soft parts deform, by millimetres in all:
it slips if it moves faster than that in a short time, or farther in a longer one.

Shapes: N samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import field

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.estimation.dataset.foot_kinematics import FootMotion

_CONTACT_EDGE = 0.05  # s, after each touchdown and before each lift-off, in which a foot may scuff
# Averages over windows [s], and the speed [m/s] from which a foot slips. Soft feet of a trotting quadruped reach
# 0.05 m/s in the first, those of a standing one 4 mm/s in the second.
_WINDOWS = ((0.05, 0.06), (0.5, 0.015))
_MIN_WAY = 0.01  # m, of a slip that is worth a word
_MIN_SHARE = 0.01  # of the time in which a foot is compared with others
_MIN_SECONDS = 0.04  # of a slip without a pause; a foot that drags over the ground as it lifts off does so for less
_SHORT_PAUSE = 0.1  # s, between two slips that are one
_LISTED_WINDOWS = 3
_ADVICE = (
    "a fit allows a foot to slip, but not to be in the air while its flag is set: compare the flag, or set flag: auto; "
    "if the foot stood, compare the lengths of the legs in the URDF"
)


@dataclass
class FootSlip:
    """Slip of a foot, or of one of several.

    Attributes
    ----------
    feet
        Name of the foot; several, if it can't be told which of them slips.
    dt
        Time between samples [s].
    checked
        Time for which they were compared with others on the ground [s].
    windows
        Begin and end of each slip since the log's first sample [s].
    speeds
        Speed at each sample of a slip [m/s].
    """

    feet: tuple[str, ...]
    dt: float
    checked: float = 0.0
    windows: list[tuple[float, float]] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)

    def add(self, speed: Array, t: Array) -> None:
        """Add a stretch: the speed, shape (N,), not a number where it does not slip, at times [s]."""
        from scipy.ndimage import binary_opening

        shortest = max(round(_MIN_SECONDS / self.dt), 1)
        is_slipping = binary_opening(np.isfinite(speed), structure=np.ones(shortest, dtype=bool))
        self.speeds += speed[is_slipping].tolist()
        for start, stop in _runs(is_slipping, round(_SHORT_PAUSE / self.dt)):
            self.windows.append((float(t[start]), float(t[stop - 1])))

    @property
    def share(self) -> float:
        """Share of the time for which it was compared."""
        return self.dt * len(self.speeds) / self.checked if self.checked else 0.0

    @property
    def median_speed(self) -> float:
        """Speed of the slip in the median [m/s]."""
        return float(np.median(self.speeds))

    @property
    def way(self) -> float:
        """Way that it slips in all [m]."""
        return self.dt * float(np.sum(self.speeds))

    @property
    def is_notable(self) -> bool:
        """True if it is more than what scuffs now and then."""
        return self.way > _MIN_WAY and self.share > _MIN_SHARE


class SlipSearch:
    """Search for feet that slip in a log.

    Parameters
    ----------
    names
        Names of the feet.
    start
        Time of the log's first sample [s].
    """

    def __init__(self, names: Sequence[str], start: float) -> None:
        self._names = names
        self._start = start
        # entry (i, j): time for which feet i and j were both compared [s]
        self._checked = np.zeros((len(names), len(names)))
        self._slips: dict[tuple[int, ...], FootSlip] = {}

    def add(self, motion: FootMotion) -> None:
        """Add a stretch of the log."""
        is_checked, speeds = _compare_feet(motion)
        for i, j in np.ndindex(self._checked.shape):
            self._checked[i, j] += motion.dt * float((is_checked[i] & is_checked[j]).sum())
        for feet, speed in speeds.items():
            names = tuple(self._names[i] for i in feet)
            slip = self._slips.setdefault(feet, FootSlip(names, motion.dt))
            slip.add(speed, motion.t - self._start)

    def slips(self) -> list[FootSlip]:
        """Feet that slip notably, those that are known first."""
        notable = []
        for feet, slip in sorted(self._slips.items(), key=lambda item: len(item[0])):
            slip.checked = float(self._checked[np.ix_(feet, feet)].min())
            if slip.is_notable:
                notable.append(slip)
        return notable


def slip_notices(slips: Sequence[FootSlip]) -> Iterator[Notice]:
    """Notices about feet that slip."""
    for slip in slips:
        listed = [f"{begin:.2f} to {end:.2f} s" for begin, end in slip.windows[:_LISTED_WINDOWS]]
        if len(slip.windows) > len(listed):
            listed.append(f"and {len(slip.windows) - len(listed)} more")
        share = f"{100 * slip.share:.0f} % of the time"
        extent = (
            f"at {short_number(slip.median_speed, 2)} m/s in the median, {_centimetres(slip.way)} in all "
            f"({', '.join(listed)})"
        )
        message = f"it slips {share} that it is on the ground, {extent}"
        if len(slip.feet) > 1:
            message = f"one of them slips {share} that they are on the ground, {extent}"
            message += "; with three feet on the ground, idtool could tell which"
        yield Notice("foot_slip", "warning", join_names(slip.feet), message, _ADVICE)


def _centimetres(way: float) -> str:
    """A way [m] in cm, with two digits below 10 cm."""
    centimetres = 100 * way
    return f"{centimetres:.0f} cm" if centimetres >= 10 else f"{short_number(centimetres, 2)} cm"


def _compare_feet(motion: FootMotion) -> tuple[Mask, dict[tuple[int, ...], Array]]:
    """Compare the velocities of the feet that are on the ground.

    Returns
    -------
    True where a foot was compared, shape (feet, N); and by foot, or by feet of which one slips, the speed, shape (N,)
    [m/s], not a number where it does not slip.
    """
    velocity = motion.velocity
    is_checked = np.zeros(motion.is_closed.shape, dtype=bool)
    speeds: dict[tuple[int, ...], Array] = {}
    for window, least_speed in _WINDOWS:
        mean = motion.average(velocity, window)
        is_settled = motion.settled(_CONTACT_EDGE + window / 2)
        if motion.base_velocity is not None:
            is_checked |= is_settled
            mean_of_base = motion.average(motion.base_velocity, window)
            speed = np.linalg.norm(mean + mean_of_base, axis=1)
            for foot, is_slipping in enumerate(is_settled & (speed > least_speed)):
                own = np.where(is_slipping, speed[foot], np.nan)
                speeds[(foot,)] = np.fmax(speeds.get((foot,), np.nan), own)
            continue
        is_compared = is_settled & (is_settled.sum(axis=0) > 1)
        is_checked |= is_compared
        for feet, speed in _disagreeing_feet(mean, is_compared, least_speed).items():
            speeds[feet] = np.fmax(speeds.get(feet, np.nan), speed)
    return is_checked, speeds


def _disagreeing_feet(velocity: Array, is_compared: Mask, least_speed: float) -> dict[tuple[int, ...], Array]:
    """Speed of feet that do not move as most others, by feet as in `_compare_feet`."""
    both = is_compared[:, None] & is_compared[None]
    difference = np.linalg.norm(velocity[:, None] - velocity[None], axis=2)  # (feet, feet, N)
    agrees = both & (difference < least_speed)
    supporters = agrees.sum(axis=1)  # (feet, N), a foot among its own
    most = supporters.max(axis=0)
    best = supporters.argmax(axis=0)
    samples = np.arange(velocity.shape[-1])
    stands = agrees[best, :, samples].T  # (feet, N)
    slips = is_compared & ~stands
    is_undecided = (slips & (supporters == most)).any(axis=0)
    count = np.maximum(stands.sum(axis=0), 1)
    of_standing = (velocity * stands[:, None]).sum(axis=0) / count  # (3, N)
    speed = np.linalg.norm(velocity - of_standing, axis=1)

    speeds: dict[tuple[int, ...], Array] = {}
    for foot, is_slipping in enumerate(slips & ~is_undecided):
        if is_slipping.any():
            speeds[(foot,)] = np.where(is_slipping, speed[foot], np.nan)
    largest = np.where(both, difference, 0.0).max(axis=(0, 1))
    for pattern in np.unique(is_compared[:, is_undecided].T, axis=0):
        is_pattern = is_undecided & (is_compared == pattern[:, None]).all(axis=0)
        speeds[tuple(np.flatnonzero(pattern).tolist())] = np.where(is_pattern, largest, np.nan)
    return speeds


def _runs(mask: Mask, longest_gap: int) -> Iterator[tuple[int, int]]:
    """First sample and stop of each run of true samples; runs with a short gap between them are one."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))  # starts and stops by turns
    starts, stops = edges[::2], edges[1::2]
    is_apart = starts[1:] - stops[:-1] > longest_gap
    first = np.concatenate([[True], is_apart])
    last = np.concatenate([is_apart, [True]])
    if len(starts):
        yield from zip(starts[first].tolist(), stops[last].tolist(), strict=True)
