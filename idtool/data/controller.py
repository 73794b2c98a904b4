"""`JointController`: the torque of position-controlled joints, from what was commanded.

Shapes: nv joints, N samples. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, LogError
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.data.channels import Channels
from idtool.data.filters import DELAY_REACH, DIFFERENCE_REACH, delay_signal, differentiate
from idtool.data.logs.log import JointLog
from idtool.data.logs.stored_arrays import column_ranges, copy_array, set_columns
from idtool.robot.config import Controller

MAX_DELAY = 0.05  # s: upper limit of the search


@dataclass(frozen=True)
class JointController:
    """Joint controller: tau = kp (qcmd − q) + kd (vcmd − v), with a delayed command.

    Attributes
    ----------
    joints
        True for joints whose torque is the controller's, shape (nv,).
    kp, kd
        Gains, shape (nv, 1) [N·m/rad, N·m·s/rad]; NaN where they are yet to be fitted.
    delay
        From command to torque [s]; 0 where it is yet to be fitted.
    """

    joints: Mask
    kp: Array
    kd: Array
    delay: float

    @classmethod
    def from_log(cls, log: JointLog, joints: Sequence[str], controller: Controller | None) -> JointController:
        """The controller of the joints that have no torque."""
        lacks_torque = np.array([not log.has("tau", name) for name in joints])
        for name in np.array(joints)[lacks_torque]:
            if not log.has("qcmd", name):
                raise LogError(
                    log.path,
                    f"joint {name} has neither torque nor position command; log one, or leave it out of joints",
                )
            if controller is None or controller.kp_of(name) is None:
                what = f"joint {name} has no torque; set its gains controller.kp and kd in the configuration"
                raise LogError(log.path, f"{what}, or fit in their place")
        if controller is None or not lacks_torque.any():
            return cls(lacks_torque, np.zeros((len(joints), 1)), np.zeros((len(joints), 1)), 0.0)
        kp = np.array([[controller.kp_of(name) or 0.0] for name in joints])
        kd = np.array([[controller.kd_of(name)] for name in joints])
        delay = controller.known_delay
        return cls(lacks_torque, kp, kd, delay.value if delay else 0.0)

    @property
    def lacks_gains(self) -> bool:
        """True if gains of its joints are yet to be fitted."""
        return bool(np.isnan([self.kp[self.joints], self.kd[self.joints]]).any())

    def check_gains(self) -> None:
        """Refuse a controller with gains that are yet to be fitted; ConfigError."""
        if self.lacks_gains:
            raise ConfigError("controller", "needs numbers for kp and kd in place of fit; idtool fit finds them")

    def with_unknown_gains(self, kp: float, kd: float) -> JointController:
        """The controller with values for the gains that are yet to be fitted."""
        return replace(self, kp=np.where(np.isnan(self.kp), kp, self.kp), kd=np.where(np.isnan(self.kd), kd, self.kd))

    def torque(self, channels: Channels, part: slice) -> Array:
        """The torque at samples of the log, shape (nv, N)."""
        return np.asarray(self.torques(channels, part, (self.delay,))[0])

    def torques(self, channels: Channels, part: slice, delays: Sequence[float]) -> Array:
        """The torque at samples of the log for each of some delays [s], shape (delays, nv, N)."""
        self.check_gains()
        feedback = self._feedback(channels, part)
        return np.stack([self._feedforward(channels, part, delay) - feedback for delay in delays])

    def _feedback(self, channels: Channels, part: slice) -> Array:
        """Feedback kp q + kd v: the controller's own measurements are in time with its torque."""
        r = DIFFERENCE_REACH
        q = channels.signal("q", slice(part.start - r, part.stop + r))
        v = differentiate(q, channels.log.dt)
        if channels.has_velocity.any():  # as logged: the controller did not know how late it is
            logged = channels.signal("v", part) - channels.bias[:, None]  # or kd × bias would pass for gravity
            v = np.where(channels.has_velocity[:, None], logged, v)
        return np.asarray(self.kp * q[:, r:-r] + self.kd * v)

    def _feedforward(self, channels: Channels, part: slice, delay: float) -> Array:
        """Command kp qcmd + kd vcmd as it was a delay [s] before; one that the log has not counts as zero."""
        samples = delay / channels.log.dt
        whole = int(np.floor(samples))
        window = slice(part.start - whole - DELAY_REACH, part.stop - whole + DELAY_REACH - 1)
        total = np.zeros((len(self.kp), window.stop - window.start))
        for name, gain in (("qcmd", self.kp), ("vcmd", self.kd)):
            if name in channels.log.signals:
                total += gain * np.nan_to_num(channels.signal(name, window), nan=0.0)
        return delay_signal(total, samples - whole)


def without_constant_torque(log: JointLog, controller: Controller | None) -> JointLog:
    """The log without the torque of joints that have a command and gains and whose torque never changes.

    Drivers without a torque sensor publish zeros.
    """
    if controller is None:
        return log
    columns = []
    for i, name in enumerate(log.joints):
        if controller.kp_of(name) is not None and log.has("qcmd", name) and _is_constant(log, i):
            columns.append(i)
    if not columns:
        return log
    tau = copy_array(log.path, log.signals["tau"])
    set_columns(tau, columns, np.nan)
    names = join_names([log.joints[i] for i in columns])
    message = f"the logged torque of these joints never changes, so the controller's torque is used: {names}"
    notice = Notice("torque_from_command", "note", None, message)
    return replace(log, signals={**log.signals, "tau": tau}, notices=(*log.notices, notice))


def with_unknown_torque(log: JointLog, controller: Controller | None) -> JointLog:
    """The log of a robot with wrench sensors, in which joints may have neither a torque nor a command with gains.

    Their torque counts as unknown: their rows of the torque equation are left out.
    """
    unknown = []
    for i, name in enumerate(log.joints):
        has_gains = controller is not None and controller.kp_of(name) is not None
        has_command = has_gains and log.has("qcmd", name)
        has_torque = log.has("tau", name) and not _is_constant(log, i)
        if not (has_torque or has_command):
            unknown.append(i)
    if not unknown:
        return log
    tau = copy_array(log.path, log.signals.get("tau", log.signals["q"]))
    if "tau" not in log.signals:
        set_columns(tau, range(len(log.joints)), np.nan)
    set_columns(tau, unknown, 0.0)
    names = tuple(log.joints[i] for i in unknown)
    message = f"no torque was logged of {join_names(names)}; the wrench sensors alone tell what these joints move"
    notice = Notice("torque_unknown", "note", None, message)
    signals = {**log.signals, "tau": tau}
    return replace(log, signals=signals, unknown_torque=names, notices=(*log.notices, notice))


def _is_constant(log: JointLog, joint: int) -> bool:
    """True if a joint has a torque that never changes."""
    if not log.has("tau", log.joints[joint]):
        return False
    least, greatest = column_ranges(log.signals["tau"][:, joint : joint + 1])
    return bool(least[0] == greatest[0])
