"""`SignalInterpolation`: a signal along the windows of rollouts, at any time of any of them.

Letters: t time since the log's first sample (w,) [s]; w rollouts, each along a window of a log; k rows of the signal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.data.signals import Signals
from idtool.dynamics.simulation.windows import Window, gapless_range


class SignalInterpolation:
    """A signal of each rollout, linear between samples and constant beyond the ends of what is known of it.

    In steps of two samples, Simpson's rule gives those in the middle twice the weight of those at the ends. Noise
    should weigh the same in each, so ``smooth`` applies (1, 2, 1) / 4, which makes all weights one.

    Parameters
    ----------
    windows
        One window per rollout.
    read
        Signal at samples of a log, shape (k, samples).
    delay
        The value is that so long before, shape (W,) [s].
    smooth
        True for the windows of which this is done, shape (W,); see above. None: of no window.
    known_range
        Samples about a window at which the signal is known.
    """

    def __init__(
        self,
        windows: Sequence[Window],
        read: Callable[[Signals, slice], Array],
        delay: Array,
        smooth: Mask | None = None,
        known_range: Callable[[Signals, slice], slice] = gapless_range,
    ) -> None:
        dt = np.array([window.dt for window in windows])
        reach = int(np.ceil(np.abs(delay) / dt).max())
        samples_before = reach + 2
        samples_after = reach + 3
        longest = max(map(len, windows))
        samples = []
        for window in windows:
            known = known_range(window.signals, window.part)
            own = partial(read, window.signals)
            surroundings = slice(window.part.start - samples_before, window.part.stop + samples_after)
            samples.append(_read_padded(own, surroundings, known, longest - len(window)))
        x = np.stack(samples, axis=1)
        if smooth is not None:
            rough = x[:, smooth]
            x[:, smooth, 1:-1] = (rough[:, :, :-2] + 2 * rough[:, :, 1:-1] + rough[:, :, 2:]) / 4
        start_times = np.array([window.start_time for window in windows])
        self._x = x
        self._difference = np.diff(x)
        self._rate = 1 / dt
        self._origin = samples_before - (start_times + delay) / dt

    def __call__(self, t: Array, rollout_ids: Indices) -> Array:
        """Values, shape (k, w), at times, shape (w,) [s]."""
        position = t * self._rate[rollout_ids] + self._origin[rollout_ids]
        index = position.astype(np.intp)
        difference = self._difference[:, rollout_ids, index]
        return np.asarray(self._x[:, rollout_ids, index] + (position - index) * difference)


def _read_padded(read: Callable[[slice], Array], part: slice, known: slice, further: int) -> Array:
    """Samples of a signal and a number of further ones, all but those that are known as at the end of these."""
    start = max(part.start, known.start)
    stop = min(part.stop, known.stop)
    return np.pad(read(slice(start, stop)), [(0, 0), (start - part.start, part.stop - stop + further)], mode="edge")
