"""`InputTorque`: the torque on simulated joints, as logged or the controller's at the simulated state.

Letters: q, v positions and velocities, tau torque (nv, w), t time since the log's first sample (w,) [s]; w rollouts,
each along a window of a log.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.data.signals import Signals
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.signal_interpolation import SignalInterpolation
from idtool.dynamics.simulation.windows import gapless_range

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
            self._logged_torque = SignalInterpolation(signals, windows, self._read_torque, delay=0.0, smooth=smooth)
        if self._has_controller:
            command.check_gains()
            self._kp = command.kp * by_command
            self._kd = command.kd * by_command
            self._command = SignalInterpolation(signals, windows, self._read_command, delay=command.delay)

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


def samples_per_step(signals: Signals) -> int:
    """Samples of the log per step of the simulation."""
    return 2 if 2 * signals.log.dt <= _MAX_STEP_OF_TWO else 1
