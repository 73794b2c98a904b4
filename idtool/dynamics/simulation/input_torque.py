"""`InputTorque`: the torque on simulated joints, as logged or the controller's at the simulated state.

Letters: q, v positions and velocities, tau torque (nv, w), t time since the log's first sample (w,) [s]; w rollouts,
each along a window of a log.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.data.controller import JointController
from idtool.data.signals import Signals
from idtool.dynamics.mechanism import Mechanism
from idtool.dynamics.simulation.signal_interpolation import SignalInterpolation
from idtool.dynamics.simulation.windows import Window, gapless_range

_MAX_STEP_OF_TWO = 2.5e-3  # s: longest step that takes two samples


class InputTorque:
    """The torque on the joints, as `Rollouts` call it.

    Between samples, torque and command are interpolated. The command is the one before the controller's delay. Logs and
    controllers have what the mechanism's sensors read.

    Parameters
    ----------
    windows
        One window per rollout.
    mechanism
        Its sensors are used.
    """

    def __init__(self, windows: Sequence[Window], mechanism: Mechanism) -> None:
        self._mechanism = mechanism
        controllers = [window.signals.controller for window in windows]
        by_command = np.array([controller.joints for controller in controllers])
        self._has_controller = bool(by_command.any())
        self._logged_torque = None
        if not by_command.all():
            no_delay = np.zeros(len(windows))
            smooth = np.array([samples_per_step(window.dt) == 2 for window in windows])
            self._logged_torque = SignalInterpolation(windows, self._read_torque, no_delay, smooth)
        if self._has_controller:
            self._kp, self._kd = np.concatenate([_gains(controller) for controller in controllers], axis=2)
            delay = np.array([controller.delay for controller in controllers])
            self._command = SignalInterpolation(windows, _read_command, delay)

    def _read_torque(self, signals: Signals, part: slice) -> Array:
        """Logged torque at the time of the position, shape (nv, samples); zero for joints with a controller."""
        channels = signals.channels
        if "tau" not in signals.log.signals:
            return np.zeros((len(signals.joints), part.stop - part.start))
        delays = self._mechanism.torque_delay
        tau = channels.signal("tau", part)
        if delays.any():
            dt = signals.log.dt
            gapless = gapless_range(signals, part)
            reach = int(np.ceil(np.abs(delays).max() / dt)) + 1
            near = slice(max(part.start - reach, gapless.start), min(part.stop + reach, gapless.stop))
            t = np.arange(part.start, part.stop) * dt
            t_near = np.arange(near.start, near.stop) * dt
            tau_near = channels.signal("tau", near)
            rows = [np.interp(t + delay, t_near, row) for delay, row in zip(delays, tau_near, strict=True)]
            tau = np.stack(rows)
        return np.where(signals.controller.joints[:, None], 0.0, tau)

    def measured_torque(self, t: Array, q: Array, v: Array, rollout_ids: Indices) -> Array:
        """Torque that the sensors give at measured states of rollouts, shape (nv, w)."""
        tau = np.zeros_like(q) if self._logged_torque is None else self._logged_torque(t, rollout_ids)
        if self._has_controller:
            tau += self._command(t, rollout_ids) - self._kp[:, rollout_ids] * q - self._kd[:, rollout_ids] * v
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


def _gains(controller: JointController) -> Array:
    """Proportional and derivative gain of each joint, shape (2, nv, 1); zero for joints without the controller."""
    controller.check_gains()
    return np.where(controller.joints[:, None], [controller.kp, controller.kd], 0.0)


def _read_command(signals: Signals, part: slice) -> Array:
    """The command times its gains, kp qcmd + kd vcmd, shape (nv, samples)."""
    total = np.zeros((len(signals.joints), part.stop - part.start))
    for name, gain in zip(("qcmd", "vcmd"), _gains(signals.controller), strict=True):
        if name in signals.log.signals:
            total += gain * np.nan_to_num(signals.channels.signal(name, part), nan=0.0)
    return total


def samples_per_step(dt: float) -> int:
    """Samples per step of the simulation of a log with a sample time [s]."""
    return 2 if 2 * dt <= _MAX_STEP_OF_TWO else 1
