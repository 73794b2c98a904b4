"""Signals of joints in motion, and their inspection."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from paths import REAL

from idtool.data.inspection import Inspection, inspect_log
from idtool.data.logs.log import JointLog, make_log

Array = NDArray[np.float64]
Signals = dict[str, Array]

JOINTS = ("abad", "hip", "knee")
needs_data = pytest.mark.skipif(not REAL.is_dir(), reason="the shared development data is not here")


def motion(t: Array, joint: int = 0, derivative: int = 0) -> Array:
    """Sum of seven sines from 0.2 to 6 Hz with velocities of like size, or its derivative."""
    rng = np.random.default_rng(joint)
    w = 2 * np.pi * np.array([0.2, 0.5, 1.1, 1.9, 2.9, 4.3, 6.0]) * (1 + 0.05 * joint)
    phase, speed = rng.uniform(0, 2 * np.pi, len(w)), rng.uniform(0.3, 1.0, len(w))
    angle = np.outer(np.asarray(t), w) + phase + derivative * np.pi / 2
    return np.asarray(np.sin(angle) @ (speed * w ** (derivative - 1.0)))


def torque(t: Array, joint: int) -> Array:
    """Inertia, gravity and friction of a pendulum."""
    q, v, a = (motion(t, joint, d) for d in range(3))
    return np.asarray(0.05 * a + 2.0 * np.sin(q) + 0.1 * v + 0.3 * np.tanh(v / 0.02))


def clean_signals(seconds: float = 30.0, rate: float = 1000.0, noise: float = 1.0, joints: int = 3) -> Signals:
    """Signals of joints that swing, with a little white noise; ``noise`` is its level."""
    t = np.arange(round(seconds * rate)) / rate
    rng = np.random.default_rng(7)
    levels = {"q": 1e-5, "v": 3e-3, "tau": 0.02}
    x = {
        "q": np.stack([motion(t, j) for j in range(joints)], axis=1),
        "v": np.stack([motion(t, j, 1) for j in range(joints)], axis=1),
        "tau": np.stack([torque(t, j) for j in range(joints)], axis=1),
    }
    return {"t": t} | {name: y + noise * levels[name] * rng.normal(size=y.shape) for name, y in x.items()}


def log_of(signals: Signals) -> JointLog:
    """Signals as a log."""
    rest = {name: x for name, x in signals.items() if name != "t"}
    return make_log(Path("synthetic.csv"), signals["t"], JOINTS[: rest["q"].shape[1]], rest)


def inspect(signals: Signals) -> Inspection:
    """The inspection of signals."""
    return inspect_log(log_of(signals))
