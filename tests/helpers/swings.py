"""Logs of joints that swing as sums of sines, whose derivatives are known at every instant."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idtool.data.logs.log import JointLog, make_log
from idtool.data.signals import Motion, Signals
from idtool.robot.config import parse_config

Array = NDArray[np.float64]

JOINTS = ("hip", "knee")
RATE = 1000.0

# Amplitude [rad], frequency [Hz] and phase [rad] of each joint's sines.
_SINES = np.array([[(0.5, 0.7, 0.1), (0.2, 2.3, 1.0)], [(0.4, 1.1, 2.0), (0.1, 3.1, 0.4)]])


def swing(t: Array, derivative: int = 0) -> Array:
    """Position of both joints at times t (N,), or a derivative of it, shape (N, 2)."""
    amplitude, frequency, phase = np.moveaxis(_SINES, -1, 0)
    w = 2 * np.pi * frequency
    x = amplitude * w**derivative * np.sin(w * t[:, None, None] + phase + derivative * np.pi / 2)
    return np.asarray(x.sum(axis=-1))


def clock(seconds: float, rate: float = RATE) -> Array:
    """Even stamps [s]."""
    return np.arange(round(seconds * rate)) / rate


def swinging(t: Array, **signals: Array | None) -> JointLog:
    """A log of both joints: exact q, v and a torque, but for the signals given, each (N, 2), None for one left out."""
    chosen = {"q": swing(t), "v": swing(t, 1), "tau": np.cos(swing(t)), **signals}
    return make_log(Path("swing.csv"), t, JOINTS, {name: x for name, x in chosen.items() if x is not None})


def signals_of(log: JointLog, **config: Any) -> Signals:
    """The log's signals under a configuration."""
    return Signals(log, JOINTS, parse_config(config, "swing.yaml"))


def joined(signals: Signals, of: Callable[[Motion], Array]) -> Array:
    """Something of the motion, shape (..., N), of all batches one after the other, their surroundings left out."""
    batches = signals.batches(every_sample=True)
    return np.concatenate([of(b.motion)[..., b.before : len(b.motion.t) - b.after] for b in batches], axis=-1)


def filtered(signals: Signals, of: Callable[[Motion], Array]) -> Array:
    """The same in the band."""
    return np.concatenate([batch.filter(of(batch.motion)) for batch in signals.batches()], axis=-1)


def everything(motion: Motion) -> Array:
    """All of a motion as rows, (1 + 5 nv, N)."""
    return np.vstack([motion.t, motion.q, motion.v, motion.a, motion.tau, motion.logged_tau])
