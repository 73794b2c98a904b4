"""`InputTorque`: the torque that acts on simulated joints, as logged or the controller's on the simulated state.

Letters: q, v positions and velocities, tau torque (nv, w), t time since the log's first sample (w,) [s]. Each of
the w rollouts runs along a window of a log.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.data.signals import Signals
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.windows import gapless_range, start_times

_TWO_AT_ONCE = 2.5e-3  # s: samples closer than half of it are simulated two a step


class InputTorque:
    """The torque that acts on the joints.

    Between samples, torque and command are interpolated, the command as it was the controller's delay before. What is
    logged and what the controller sees is what the mechanism's sensors give.

    Parameters
    ----------
    signals
        The log.
    windows
        A window a rollout.
    mechanism
        Whose sensors they are.
    """

    def __init__(self, signals: Signals, windows: Sequence[slice], mechanism: Mechanism) -> None:
        self._signals, self._mechanism = signals, mechanism
        command = signals.command
        by_command = command.joints[:, None]
        self._controlled = bool(by_command.any())
        self._torque = None
        if not by_command.all():
            self._torque = _Lines(signals, windows, self._logged, 0.0, samples_per_step(signals) == 2)
        if self._controlled:
            self._kp, self._kd = command.kp * by_command, command.kd * by_command
            self._command = _Lines(signals, windows, self._commanded, command.delay)

    def _logged(self, part: slice) -> Array:
        """The measured torque when the position was measured, shape (nv, samples); zero where there is a controller."""
        channels, late = self._signals.channels, self._mechanism.torque_delay
        tau = channels.signal("tau", part)
        if late.any():
            stretch, dt = gapless_range(self._signals, part), self._signals.log.dt
            reach = int(np.ceil(np.abs(late).max() / dt)) + 1
            near = slice(max(part.start - reach, stretch.start), min(part.stop + reach, stretch.stop))
            t, around = np.arange(part.start, part.stop) * dt, np.arange(near.start, near.stop) * dt
            x = channels.signal("tau", near)
            tau = np.stack([np.interp(t + lag, around, row) for lag, row in zip(late, x, strict=True)])
        return np.where(self._signals.command.joints[:, None], 0.0, tau)

    def _commanded(self, part: slice) -> Array:
        """The command times its gains, kp qcmd + kd vcmd, shape (nv, samples)."""
        total = np.zeros((len(self._kp), part.stop - part.start))
        for name, gain in (("qcmd", self._kp), ("vcmd", self._kd)):
            if name in self._signals.log.signals:
                total += gain * np.nan_to_num(self._signals.channels.signal(name, part), nan=0.0)
        return total

    def measured_torque(self, t: Array, q: Array, v: Array, rollout_ids: Indices) -> Array:
        """The torque that sensors give at measured states of rollouts, shape (nv, w)."""
        tau = np.zeros_like(q) if self._torque is None else self._torque(t, rollout_ids)
        if self._controlled:
            tau += self._command(t, rollout_ids) - self._kp * q - self._kd * v
        return tau

    def __call__(self, t: Array, q: Array, v: Array, rollout_ids: Indices) -> Array:
        """The torque that acts in true states of rollouts, shape (nv, w).

        Parameters
        ----------
        t
            Since the log's first sample, shape (w,).
        q, v
            State, shape (nv, w).
        rollout_ids
            Which rollouts.
        """
        tau = self.measured_torque(t, q - self._mechanism.position_offset[:, None], v, rollout_ids)
        for joint, sensor in self._mechanism.torque_sensors.items():
            tau[joint] = sensor.to_true(tau[joint])
        return tau


class _Lines:
    """A signal of each rollout between its samples; before a stretch's first and after its last it is as there.

    ``even``: in steps of two samples, Simpson's rule gives those in the middle twice the weight of those at the ends.
    Noise should weigh the same in each, so they are smoothed by (1, 2, 1) / 4, which makes all weights one.
    """

    def __init__(
        self,
        signals: Signals,
        windows: Sequence[slice],
        read: Callable[[slice], Array],
        late: float,
        even: bool = False,
    ) -> None:
        dt = signals.log.dt
        before = int(np.ceil(late / dt)) + 2
        length = before + max(window.stop - window.start for window in windows) + 3
        stretches = [gapless_range(signals, window) for window in windows]
        self._x = np.stack(
            [_clipped(read, w.start - before, length, s) for w, s in zip(windows, stretches, strict=True)], axis=1
        )
        if even:
            self._x[:, :, 1:-1] = (self._x[:, :, :-2] + 2 * self._x[:, :, 1:-1] + self._x[:, :, 2:]) / 4
        self._slope = np.diff(self._x)
        self._rate = 1 / dt
        self._first = before - (start_times(signals, windows) + late) / dt

    def __call__(self, t: Array, rollout_ids: Indices) -> Array:
        """Values, shape (nv, w), at moments, shape (w,) [s]."""
        place = t * self._rate + self._first[rollout_ids]
        whole = place.astype(np.intp)
        return np.asarray(self._x[:, rollout_ids, whole] + (place - whole) * self._slope[:, rollout_ids, whole])


def samples_per_step(signals: Signals) -> int:
    """How many samples a step takes."""
    return 2 if 2 * signals.log.dt <= _TWO_AT_ONCE else 1


def _clipped(read: Callable[[slice], Array], first: int, length: int, stretch: slice) -> Array:
    """Samples of a signal, those that lie outside its stretch being as at its end."""
    start, stop = max(first, stretch.start), min(first + length, stretch.stop)
    return np.pad(read(slice(start, stop)), [(0, 0), (start - first, first + length - stop)], mode="edge")
