"""Windows of a log: where simulations start, and from which state.

Shapes: nv joints, W windows. Units: rad or m, s.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Signals

_AROUND = 0.25  # periods of the band to either side from which a state is taken
_FEWEST = 3  # samples to either side for that, at least


def gapless_range(signals: Signals, window: slice) -> slice:
    """The stretch of the log without a gap that a window lies in."""
    parts: list[slice] = signals.channels.parts()
    return next(part for part in parts if part.start <= window.start < part.stop)


def start_times(signals: Signals, windows: Sequence[slice]) -> Array:
    """When windows begin, since the log's first sample [s], shape (W,)."""
    firsts = [signals.channels.times(slice(window.start, window.start + 1))[0] for window in windows]
    return np.asarray(np.array(firsts) - signals.log.t[0])


def split_into_windows(
    signals: Signals, parts: Sequence[slice], seconds: float | None, again: bool = False
) -> list[slice]:
    """Windows of so many seconds, one after the other.

    Parameters
    ----------
    signals
        The log.
    parts
        Samples of it, no gap within one. One that reaches to the first or last sample that has all derivatives is
        taken to begin or end with its stretch.
    seconds
        None: one window a part.
    again
        Whether a window ends with the sample that the next one begins with.
    """
    windows = []
    for part in parts:
        stretch = gapless_range(signals, part)
        usable = next(whole for whole in signals.ranges if whole.start <= part.start < whole.stop)
        start = stretch.start if part.start == usable.start else part.start
        stop = stretch.stop if part.stop == usable.stop else part.stop
        every = stop - start if seconds is None else max(round(seconds / signals.log.dt), 1)
        firsts = range(start, stop - 1, every)
        windows += [slice(first, min(first + every + again, stop)) for first in firsts]
    return windows


def measured_states(signals: Signals, samples: Sequence[int]) -> tuple[Array, Array]:
    """Position and velocity at samples of a log, from a parabola through the positions around them.

    Parameters
    ----------
    signals
        The log.
    samples
        Their W indices.

    Returns
    -------
    q, v, shape (nv, W) each.
    """
    dt = signals.log.dt
    reach = max(_FEWEST, round(_AROUND / (signals.band_hz * dt)))
    states = np.zeros((len(samples), 2, len(signals.joints)))
    for state, sample in zip(states, samples, strict=True):
        within = gapless_range(signals, slice(sample, sample + 1))
        near = slice(max(sample - reach, within.start), min(sample + reach + 1, within.stop))
        steps = np.arange(near.start, near.stop) - sample
        powers = np.vander(steps * dt, min(3, len(steps)), increasing=True)
        found = np.linalg.lstsq(powers, signals.channels.signal("q", near).T, rcond=None)[0][:2]
        state[: len(found)] = found
    return states[:, 0].T.copy(), states[:, 1].T.copy()
