"""Compares a pose of the base with the IMU beside it."""

from __future__ import annotations

import numpy as np

from idtool.common.notice import Notice
from idtool.data.base_sensors import PoseSensors
from idtool.data.signals import Signals

_SMOOTHING = 0.02  # s
_MIN_RATE = 0.05  # rad/s, rms, with which the base must turn
_MAX_TURN = np.deg2rad(5)  # of the one against the other
_MIN_EXPLAINED = 0.8  # share of the squares that one turn of the pose explains
_MAX_SAMPLES = 60_000  # of the longest stretch


def pose_against_imu(signals: Signals, pose: PoseSensors) -> Notice | None:
    """Notice about a pose whose link turns otherwise than the IMU tells; None if they agree, or hardly turn."""
    from scipy.ndimage import gaussian_filter1d
    from scipy.spatial.transform import Rotation

    imu = signals.base_sensors
    if imu is None:
        return None
    longest = max(signals.ranges, key=lambda part: part.stop - part.start)
    t = signals.channels.times(slice(longest.start, min(longest.stop, longest.start + _MAX_SAMPLES)))
    w_pose = pose.angular_velocity(t)
    w_imu = gaussian_filter1d(imu.angular_velocity(t), _SMOOTHING / signals.log.dt, axis=-1)
    squares = float(np.square(w_imu).sum())
    if squares < len(t) * _MIN_RATE**2:
        return None
    turn, _ = Rotation.align_vectors(w_imu.T, w_pose.T)
    unexplained = float(np.square(w_imu - turn.apply(w_pose.T).T).sum())
    explained = 1 - unexplained / squares
    if explained < _MIN_EXPLAINED:
        message = f"it explains {100 * max(explained, 0.0):.0f} % of the angular velocity that the IMU measures"
        advice = "compare its times, and the order and the direction of its orientation (link to world)"
        return Notice("pose_against_imu", "warning", "pose", message, advice)
    if turn.magnitude() < _MAX_TURN:
        return None
    angle = turn.magnitude()
    axis = ", ".join(f"{x:.2f}" for x in turn.as_rotvec() / angle + 0.0)
    turned = f"it is rotated by {np.rad2deg(angle):.0f}° about the axis ({axis}) of the base"
    message = f"{turned} relative to its link, according to the IMU"
    advice = "compare the axes of base.pose.link and base.imu.link; if the feet agree with the IMU, the pose is wrong"
    return Notice("pose_against_imu", "warning", "pose", message, advice)
