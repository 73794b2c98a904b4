"""Motions to command the leg of sample_logs to: the paper's, and random ones.

Letters: q [rad], v [rad/s], a [rad/s^2] of the joints abad, hip and knee, each (N, 3), at 1 kHz.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from leg_truth import JOINTS, PAPER, URDF
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATE = 1000  # samples a second
_HIP, _THIGH, _SHANK = 0.045, 0.342, 0.345  # m: offset of the leg's plane, lengths


class Motion(NamedTuple):
    """A commanded motion and its derivatives, each (N, 3)."""

    q: Array
    v: Array
    a: Array


def shell(seconds: float, start: float = PAPER.SETTLE) -> Motion:
    """The joints' motion with the foot on the paper's shell (sample_logs/leg.py), from a time on [s]."""
    t = start + np.arange(round(seconds * RATE)) / RATE
    d = 1e-4  # s: of differences whose error is 1e-8 of the motion
    before, q, after = (_reach(np.transpose([PAPER.foot_target(x)[0] for x in t + shift])) for shift in (-d, 0, d))
    return Motion(q, (after - before) / (2 * d), (after - 2 * q + before) / d**2)


def _reach(foot: Array) -> Array:
    """Angles (N, 3) that put the foot there (3, N) [m], knee bent backwards."""
    x, y, z = foot
    down = np.sqrt(y**2 + z**2 - _HIP**2)
    abad = np.arctan2(z, y) + np.arctan2(down, _HIP)
    knee = -np.arccos((x**2 + down**2 - _THIGH**2 - _SHANK**2) / (2 * _THIGH * _SHANK))
    hip = np.arctan2(x, down) - np.arctan2(_SHANK * np.sin(knee), _THIGH + _SHANK * np.cos(knee))
    return np.transpose([abad, hip, knee])


def fourier(
    seed: int, seconds: float, *, base: float = 0.1, harmonics: int = 15, speed: float = 8.0, share: float = 0.8
) -> Motion:
    """Random sines within the URDF's limits.

    Parameters
    ----------
    seed
        Of amplitudes and phases.
    seconds
        Length.
    base, harmonics
        Frequencies are multiples 1 to ``harmonics`` of ``base`` [Hz]. Velocity amplitudes are of one size for all.
    speed
        No joint is faster [rad/s]; the URDF allows 21.
    share
        Of each joint's range, of which no joint uses more.
    """
    rng = np.random.default_rng([seed, 2])
    low, high = position_limits()
    w = 2 * np.pi * base * np.arange(1, harmonics + 1)
    t = np.arange(round(seconds * RATE)) / RATE
    amplitude = rng.normal(size=(3, harmonics)) / w
    angle = w[:, None] * t + rng.uniform(0, 2 * np.pi, (3, harmonics))[..., None]
    turns = (w**k * amplitude for k in range(3))
    q, v, a = (np.einsum("jh,jhn->nj", x, np.sin(angle + k * np.pi / 2)) for k, x in enumerate(turns))
    room = share * (high - low)
    scale = np.minimum(speed / np.abs(v).max(axis=0), room / np.ptp(q, axis=0))
    slack = room - scale * np.ptp(q, axis=0)  # where it does not fill its share, off the middle
    center = (high + low) / 2 + rng.uniform(-0.5, 0.5, 3) * slack
    middle = (q.max(axis=0) + q.min(axis=0)) / 2
    return Motion(center + scale * (q - middle), scale * v, scale * a)


def position_limits() -> tuple[Array, Array]:
    """Of the joints, from the URDF [rad]."""
    model = pin.buildModelFromUrdf(str(URDF))
    index = [model.joints[model.getJointId(joint)].idx_q for joint in JOINTS]
    return model.lowerPositionLimit[index], model.upperPositionLimit[index]
