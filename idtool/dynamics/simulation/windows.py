"""`Window`: samples of a log along which a model is simulated; where windows start, and from which state.

Shapes: nv joints, W windows. Units: rad or m, s.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.data.signals import BATCH_SAMPLES, Signals
from idtool.dynamics.contact_model import ContactModel, contacts_of

_AROUND = 0.25  # periods of the band to either side from which a state is taken
_MIN_SAMPLES = 3  # to either side for that


@dataclass(frozen=True)
class Window:
    """Samples of a log along which a model is simulated.

    Attributes
    ----------
    signals
        The log.
    part
        The samples, the first being the start; no gap within them.
    """

    signals: Signals
    part: slice

    def __len__(self) -> int:
        return int(self.part.stop - self.part.start)

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self.signals.log.dt

    @property
    def start_time(self) -> float:
        """Start, since the log's first sample [s]."""
        first = slice(self.part.start, self.part.start + 1)
        return float(self.signals.channels.times(first)[0] - self.signals.log.start)


def gapless_range(signals: Signals, part: slice) -> slice:
    """Samples of the log without a gap that a part of it lies in."""
    stretches: list[slice] = signals.channels.stretches()
    return next(stretch for stretch in stretches if stretch.start <= part.start < stretch.stop)


def usable_range(signals: Signals, part: slice) -> slice:
    """Samples of the log with all derivatives that a part of it lies in."""
    return next(usable for usable in signals.ranges if usable.start <= part.start < usable.stop)


def stretches_without_contact(signals: Signals, parts: Sequence[slice], contacts: ContactModel) -> list[slice]:
    """Stretches of parts of a log in which no contact force acts on a link that the joints move."""
    stretches = []
    for part in parts:
        acts = []
        for first in range(part.start, part.stop, BATCH_SAMPLES):
            motion = signals.motion(slice(first, min(first + BATCH_SAMPLES, part.stop)))
            acts.append(contacts.acts_on_joints(contacts_of(motion)))
        is_free = ~np.concatenate(acts)
        edges = np.flatnonzero(np.diff(is_free, prepend=False, append=False)).reshape(-1, 2)
        for first, stop in edges.tolist():
            stretches.append(slice(part.start + first, part.start + stop))
    return stretches


def split_into_windows(
    signals: Signals, parts: Sequence[slice], seconds: float | None, share_ends: bool = False
) -> list[slice]:
    """Windows of equal duration, one after the other.

    Parameters
    ----------
    signals
        The log.
    parts
        Samples of it, no gap within one. One that reaches to the first or last sample that has all derivatives is
        extended to the gap before or after, unless the motion of a base, or contacts, are needed there.
    seconds
        Duration of a window [s]; None: one window per part.
    share_ends
        True if a window's last sample is the first one of the next.
    """
    windows = []
    for part in parts:
        start, stop = part.start, part.stop
        if signals.contact_channels is None:  # else the base floats, or there are contacts
            gapless = gapless_range(signals, part)
            usable = usable_range(signals, part)
            start = gapless.start if part.start == usable.start else part.start
            stop = gapless.stop if part.stop == usable.stop else part.stop
        length = stop - start
        if seconds is not None:
            length = max(round(seconds / signals.log.dt), 1)
        for first in range(start, stop - 1, length):
            windows.append(slice(first, min(first + length + share_ends, stop)))
    return windows


def measured_states(signals: Signals, samples: Sequence[int]) -> tuple[Array, Array]:
    """Position and velocity at samples of a log, from a parabola through the positions around them.

    Parameters
    ----------
    signals
        The log.
    samples
        W indices.

    Returns
    -------
    q, v, shape (nv, W) each.
    """
    dt = signals.log.dt
    reach = max(_MIN_SAMPLES, round(_AROUND / (signals.band_hz * dt)))
    states = np.zeros((len(samples), 2, len(signals.joints)))
    for state, sample in zip(states, samples, strict=True):
        gapless = gapless_range(signals, slice(sample, sample + 1))
        near = slice(max(sample - reach, gapless.start), min(sample + reach + 1, gapless.stop))
        offsets = np.arange(near.start, near.stop) - sample
        powers = np.vander(offsets * dt, min(3, len(offsets)), increasing=True)
        q = signals.channels.signal("q", near)
        polynomial = np.linalg.lstsq(powers, q.T, rcond=None)[0]
        state[: min(2, len(polynomial))] = polynomial[:2]
    return states[:, 0].T.copy(), states[:, 1].T.copy()
