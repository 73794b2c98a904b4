"""`InputTorque`: the torque on simulated joints, as logged or the controller's at the simulated state.

Letters: q, v positions and velocities, tau torque (nv, w), t time since the log's first sample (w,) [s]; w rollouts,
each along a window of a log.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.data.signals import Signals
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.windows import gapless_range, start_times

_MAX_STEP_OF_TWO = 2.5e-3  # s: longest step that takes two samples


class InputTorque:
    """The torque on the joints, as `Rollouts` call it.

    Between samples, torque and command are interpolated; the command is the one before the controller's delay. The log
    and the controller have what the mechanism's sensors give.

    Parameters
    ----------
    signals
        The log.
    windows
        One window per rollout.
    mechanism
        Its sensors are used.
    """

    def __init__(self, signals: Signals, windows: Sequence[slice], mechanism: Mechanism) -> None:
        self._signals = signals
        self._mechanism = mechanism
        command = signals.controller
        by_command = command.joints[:, None]
        self._has_controller = bool(by_command.any())
        self._logged_torque = None
        if not by_command.all():
            smooth = samples_per_step(signals) == 2
            self._logged_torque = _Interpolation(signals, windows, self._read_torque, delay=0.0, smooth=smooth)
        if self._has_controller:
            self._kp = command.kp * by_command
            self._kd = command.kd * by_command
            self._command = _Interpolation(signals, windows, self._read_command, delay=command.delay)

    def _read_torque(self, part: slice) -> Array:
        """Logged torque at the time of the position, shape (nv, samples); zero for joints with a controller."""
        channels = self._signals.channels
        delays = self._mechanism.torque_delay
        tau = channels.signal("tau", part)
        if delays.any():
            dt = self._signals.log.dt
            gapless = gapless_range(self._signals, part)
            reach = int(np.ceil(np.abs(delays).max() / dt)) + 1
            near = slice(max(part.start - reach, gapless.start), min(part.stop + reach, gapless.stop))
            t = np.arange(part.start, part.stop) * dt
            t_near = np.arange(near.start, near.stop) * dt
            tau_near = channels.signal("tau", near)
            rows = [np.interp(t + delay, t_near, row) for delay, row in zip(delays, tau_near, strict=True)]
            tau = np.stack(rows)
        return np.where(self._signals.controller.joints[:, None], 0.0, tau)

    def _read_command(self, part: slice) -> Array:
        """The command times its gains, kp qcmd + kd vcmd, shape (nv, samples)."""
        total = np.zeros((len(self._kp), part.stop - part.start))
        for name, gain in (("qcmd", self._kp), ("vcmd", self._kd)):
            if name in self._signals.log.signals:
                total += gain * np.nan_to_num(self._signals.channels.signal(name, part), nan=0.0)
        return total

    def measured_torque(self, t: Array, q: Array, v: Array, rollout_ids: Indices) -> Array:
        """Torque that the sensors give at measured states of rollouts, shape (nv, w)."""
        tau = np.zeros_like(q) if self._logged_torque is None else self._logged_torque(t, rollout_ids)
        if self._has_controller:
            tau += self._command(t, rollout_ids) - self._kp * q - self._kd * v
        return tau

    def __call__(self, t: Array, q: Array, v: Array, rollout_ids: Indices) -> Array:
        """True torque at true states of rollouts, shape (nv, w).

        Parameters
        ----------
        t
            Since the log's first sample, shape (w,) [s].
        q, v
            State, shape (nv, w).
        rollout_ids
            Indices of the rollouts, shape (w,).
        """
        tau = self.measured_torque(t, q - self._mechanism.position_offset[:, None], v, rollout_ids)
        for joint, sensor in self._mechanism.torque_sensors.items():
            tau[joint] = sensor.to_true(tau[joint])
        return tau


class _Interpolation:
    """A signal of each rollout, linear between samples and constant beyond the ends of its gapless range.

    In steps of two samples, Simpson's rule gives those in the middle twice the weight of those at the ends. Noise
    should weigh the same in each, so ``smooth`` applies (1, 2, 1) / 4, which makes all weights one.
    """

    def __init__(
        self,
        signals: Signals,
        windows: Sequence[slice],
        read: Callable[[slice], Array],
        delay: float,
        smooth: bool = False,
    ) -> None:
        dt = signals.log.dt
        samples_before = int(np.ceil(delay / dt)) + 2
        length = samples_before + max(window.stop - window.start for window in windows) + 3
        samples = []
        for window in windows:
            gapless = gapless_range(signals, window)
            samples.append(_read_padded(read, window.start - samples_before, length, gapless))
        x = np.stack(samples, axis=1)
        if smooth:
            x[:, :, 1:-1] = (x[:, :, :-2] + 2 * x[:, :, 1:-1] + x[:, :, 2:]) / 4
        self._x = x
        self._difference = np.diff(x)
        self._rate = 1 / dt
        self._origin = samples_before - (start_times(signals, windows) + delay) / dt

    def __call__(self, t: Array, rollout_ids: Indices) -> Array:
        """Values, shape (nv, w), at times, shape (w,) [s]."""
        position = t * self._rate + self._origin[rollout_ids]
        index = position.astype(np.intp)
        difference = self._difference[:, rollout_ids, index]
        return np.asarray(self._x[:, rollout_ids, index] + (position - index) * difference)


def samples_per_step(signals: Signals) -> int:
    """Samples of the log per step of the simulation."""
    return 2 if 2 * signals.log.dt <= _MAX_STEP_OF_TWO else 1


def _read_padded(read: Callable[[slice], Array], first: int, length: int, gapless: slice) -> Array:
    """Samples of a signal, those outside its gapless range being as at its end."""
    end = first + length
    start = max(first, gapless.start)
    stop = min(end, gapless.stop)
    return np.pad(read(slice(start, stop)), [(0, 0), (start - first, end - stop)], mode="edge")
