"""Pairs of logs: a robot's and a simulator's under the same commands; and their common clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, LogError
from idtool.common.names import count_text, is_url, join_names, printable, stem
from idtool.common.number_text import short_number
from idtool.data.logs.bag import METADATA
from idtool.data.logs.log import JointLog

_OPTION = "--against"
_MIN_OVERLAP = 0.5  # of the longer log's duration
_MAX_DELAY = 0.1  # s: a smaller offset is the robot's delay, not that of its clock
_MAX_GRID = 1 << 18  # samples from which an offset is estimated
_MAX_DIFFERENCE = 0.7  # of the robot's motion, between two logs of one command; unrelated motions differ by 1.4


@dataclass(frozen=True)
class LogPair:
    """A robot's log and the simulator's, on a common clock.

    Attributes
    ----------
    measured, simulated
        The two logs.
    offset
        Time in the robot's log, from its start, at which the simulator's log starts [s].
    seconds
        Duration of the overlap [s].
    torque, position
        RMS difference of the two by joint, as logged, and ``overall`` [N·m or N; rad or m]; torque is None if one of
        the logs has none.
    motion
        RMS deviation of the robot's position from its mean by joint, and ``overall`` [rad or m].
    """

    measured: Path
    simulated: Path
    offset: float
    seconds: float
    torque: Mapping[str, float] | None
    position: Mapping[str, float]
    motion: Mapping[str, float]

    @property
    def moves_alike(self) -> bool:
        """True if the two may be motions under the same commands."""
        return self.position["overall"] <= _MAX_DIFFERENCE * self.motion["overall"]

    @property
    def is_unrelated(self) -> bool:
        """True if the two differ by as much as the robot moves, so that they cannot be compared."""
        return self.position["overall"] > self.motion["overall"]


def paired_paths(logs: Sequence[Path], against: Sequence[Path]) -> list[Path]:
    """The simulator's log of each of the robot's logs.

    Parameters
    ----------
    logs
        The robot's logs.
    against
        The simulator's: one for each log, in the same order, or a folder with a log of the same name for each.

    Raises
    ------
    IdtoolError
        If a log has no partner.
    """
    if len(against) == 1 and _is_folder_of_logs(against[0]):
        return [_partner(log, against[0]) for log in logs]
    if len(against) != len(logs):
        what = f"{len(against)} simulated for {count_text(len(logs), 'measured log')}"
        raise ConfigError(
            _OPTION, f"{what}; give one for each, in the same order, or a folder with logs of the same names"
        )
    return list(against)


def _is_folder_of_logs(path: Path) -> bool:
    """True for a folder on a disk that is not itself a log, as a rosbag2 folder with its metadata is."""
    if is_url(path):
        return False
    return path.is_dir() and not (path / METADATA).is_file()


def _partner(log: Path, folder: Path) -> Path:
    """The log in a folder with the name of another, whatever its format."""
    name = stem(log)
    files = sorted(path for path in folder.iterdir() if stem(path) == name and not path.name.startswith("."))
    if not files:
        others = join_names(sorted(path.name for path in folder.iterdir()))
        raise LogError(folder, f"has no log named {printable(name)} for {printable(log.name)}; it has {others}")
    if len(files) > 1:
        raise LogError(folder, f"has {len(files)} logs named {printable(name)} ({join_names([f.name for f in files])})")
    return files[0]


def check_joints(simulated: JointLog, joints: Sequence[str]) -> None:
    """Check that a simulator's log has the joints of the robot's logs.

    Raises
    ------
    LogError
        If it lacks one.
    """
    missing = [name for name in joints if not simulated.has("q", name)]
    if missing:
        what = f"has no position of joint {join_names(missing)}, which the robot's logs have"
        raise LogError(simulated.path, f"{what}; log the same joints in the simulator")


def align(measured: JointLog, simulated: JointLog, joints: Sequence[str]) -> LogPair:
    """Put two logs on a common clock, and compare them there.

    Both clocks are taken to start with the log. If the motions fit better with another offset, of more than a delay, it
    is used.

    Parameters
    ----------
    measured, simulated
        The logs.
    joints
        Names of the joints.

    Raises
    ------
    LogError
        If one of the logs is much shorter than the other.
    """
    duration = measured.duration
    simulated_duration = simulated.duration
    if min(duration, simulated_duration) < _MIN_OVERLAP * max(duration, simulated_duration):
        what = (
            f"lasts {short_number(simulated_duration)} s, and {printable(measured.path.name)} lasts "
            f"{short_number(duration)} s"
        )
        raise LogError(simulated.path, f"{what}; play the same commands in the simulator")
    offset = _offset(measured, simulated, joints)
    t = measured.t - measured.start
    start = max(offset, 0.0)
    end = min(duration, offset + simulated_duration)
    inside = (t >= start) & (t <= end)
    torque = _differences(measured, simulated, joints, "tau", offset, t, inside)
    position = _differences(measured, simulated, joints, "q", offset, t, inside)
    if position is None:
        raise AssertionError  # every log has positions
    return LogPair(
        measured=measured.path,
        simulated=simulated.path,
        offset=offset,
        seconds=end - start,
        torque=torque,
        position=position,
        motion=_motion(measured, joints, inside),
    )


def _differences(
    measured: JointLog,
    simulated: JointLog,
    joints: Sequence[str],
    signal: str,
    offset: float,
    t: Array,
    inside: Mask,
) -> dict[str, float] | None:
    """RMS difference of a signal by joint and ``overall``; None if a joint lacks the signal in one of the logs."""
    squares = []
    for name in joints:
        if not (measured.has(signal, name) and simulated.has(signal, name)):
            return None
        x = measured.signals[signal][inside, measured.joints.index(name)]
        difference = x - _sampled(simulated, signal, name, t[inside] - offset)
        squares.append(float(np.nanmean(np.square(difference))))
    return _rms_by_joint(joints, squares)


def _motion(log: JointLog, joints: Sequence[str], inside: Mask) -> dict[str, float]:
    """RMS deviation of the position from its mean by joint and ``overall`` [rad or m]."""
    variances = [float(np.nanvar(log.signals["q"][inside, log.joints.index(name)])) for name in joints]
    return _rms_by_joint(joints, variances)


def _rms_by_joint(joints: Sequence[str], mean_squares: Sequence[float]) -> dict[str, float]:
    """Square roots of mean squares by joint, and ``overall``."""
    rms = dict(zip(joints, np.sqrt(mean_squares).tolist(), strict=True))
    return {**rms, "overall": float(np.sqrt(np.mean(mean_squares)))}


def _sampled(log: JointLog, signal: str, joint: str, t: Array) -> Array:
    """A signal at times from the log's start, shape (N,)."""
    x = log.signals[signal][:, log.joints.index(joint)]
    known = np.isfinite(x) & np.isfinite(log.t)
    stamps = np.maximum.accumulate(log.t[known] - log.start)
    return np.asarray(np.interp(t, stamps, x[known]))


def _offset(measured: JointLog, simulated: JointLog, joints: Sequence[str]) -> float:
    """Time from the start of one log to that of the other at which their motions differ least [s].

    The commands are compared if both logs have them, else the positions.
    """
    from scipy.signal import correlate

    has_commands = all(log.has("qcmd", name) for log in (measured, simulated) for name in joints)
    signal = "qcmd" if has_commands else "q"
    duration = measured.duration
    simulated_duration = simulated.duration
    dt = max(measured.dt, simulated.dt, max(duration, simulated_duration) / _MAX_GRID)
    t = np.arange(0.0, duration, dt)
    u = np.arange(0.0, simulated_duration, dt)
    lags = np.arange(-len(u) + 1, len(t))  # samples of t at which u starts
    products = np.zeros(len(lags))
    squares = np.zeros(len(lags))  # of x and of y, where they overlap
    for name in joints:
        x = _sampled(measured, signal, name, t)
        y = _sampled(simulated, signal, name, u)
        spread = float(np.std(x)) or 1.0
        x = (x - x.mean()) / spread
        y = (y - y.mean()) / spread
        products += correlate(x, y, mode="full", method="fft")
        squares += correlate(x**2, np.ones(len(u)), mode="full", method="fft")
        squares += correlate(np.ones(len(t)), y**2, mode="full", method="fft")
    overlap = np.minimum(lags + len(u), len(t)) - np.maximum(lags, 0)
    mean_square = (squares - 2 * products) / overlap
    is_long = overlap >= _MIN_OVERLAP * max(len(t), len(u))
    best = float(lags[is_long][np.argmin(mean_square[is_long])] * dt)
    return best if abs(best) > _MAX_DELAY else 0.0
