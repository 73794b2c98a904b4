"""Generic probes: functions of state, and lines in time, of any form.

They show structure in a residual that no effect of the library explains. Each is a `Probe` as any effect is, evaluated
by what it explains on blocks of time that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.diagnosis.residual_series import ResidualSeries
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.probe import Probe

UNKNOWN = "unknown"
_BUMPS = 14  # over a range, of a function of one variable
_WAVES = 40  # random ones, of a function of several variables (Rahimi & Recht 2007)
_LINES = 160  # frequencies in time
_TRIED_LINES = 12  # of them, by joint
_LOWEST_HZ = 0.5
_HIGHEST = 0.9  # of the band
_SLOW = 0.15  # of the rms speed, up to which a function of speed changes fastest
_MAX_SPEED = 3.0  # times the rms speed, up to which there are bumps
_STATE_SCALE = 3.0  # of the travel in a function of the state, against the rms speed
_SEED = 0


def generic_probes(summary: DataSummary, residual: ResidualSeries) -> Iterator[Probe]:
    """Functions of a joint's position, of its speed, of both, of all joints' state, and its strongest lines in time.

    Parameters
    ----------
    summary
        The data.
    residual
        Residual that is to be explained, of one model.
    """
    names = summary.model.names
    all_joints = list(range(len(names)))
    lines = _strongest_lines(residual, np.geomspace(_LOWEST_HZ, _HIGHEST * summary.band_hz, _LINES))
    for j, name in enumerate(names):
        yield _probe(name, j, _BUMPS, partial(_position_columns, summary, j))
        yield _probe(name, j, _BUMPS, partial(_speed_columns, summary, j))
        yield _probe(name, j, _WAVES, partial(_state_columns, summary, [j]))
        if len(names) > 1:
            yield _probe(name, j, _WAVES, partial(_state_columns, summary, all_joints))
        for hertz in lines[j].tolist():
            yield _probe(name, j, 2, partial(_line_columns, hertz))


def _strongest_lines(residual: ResidualSeries, frequencies: Array) -> Array:
    """Frequencies of the sines that are largest in each joint's residual, shape (nv, k) [Hz]."""
    samples = residual.residuals[-1] * residual.valid
    amplitude = np.zeros((len(samples), len(frequencies)))
    for k, hertz in enumerate(frequencies):
        amplitude[:, k] = np.abs(samples @ np.exp(2j * np.pi * hertz * residual.t))
    strongest = np.argsort(-amplitude, axis=1)[:, :_TRIED_LINES]
    return np.asarray(frequencies[strongest])


def _probe(name: str, joint: int, count: int, joint_columns: Callable[[Motion], Array]) -> Probe:
    """Probe of a joint's columns, shape (count, N), that is no effect and so has no configuration entry."""

    def columns(motion: Motion, model: Linearization) -> Mapping[int, Array]:
        return {joint: joint_columns(motion)}

    return Probe(UNKNOWN, name, None, columns, count, lambda c, information: None)


def _bumps(x: Array) -> Array:
    """Overlapping bumps over [0, 1], shape (k, N)."""
    centers = np.linspace(0, 1, _BUMPS)[:, None]
    return np.asarray(np.exp(-0.5 * np.square((x - centers) * _BUMPS)))


def _position_columns(summary: DataSummary, joint: int, motion: Motion) -> Array:
    """Bumps over the travel of a joint, shape (k, N)."""
    return _bumps((motion.q[joint] - summary.q_min[joint]) / max(summary.q_range[joint], 1e-9))


def _speed_columns(summary: DataSummary, joint: int, motion: Motion) -> Array:
    """Bumps over the velocity of a joint, narrower near 0, shape (k, N)."""
    scaled = np.arcsinh(motion.v[joint] / (_SLOW * max(summary.rms_velocity[joint], 1e-9)))
    highest = np.arcsinh(_MAX_SPEED / _SLOW)
    return _bumps((scaled + highest) / (2 * highest))


def _state_columns(summary: DataSummary, joints: Sequence[int], motion: Motion) -> Array:
    """Waves in random directions over position and speed of joints, shape (k, N)."""
    rng = np.random.default_rng(_SEED)
    own = list(joints)
    position = (motion.q[own] - summary.q_min[own, None]) / np.maximum(summary.q_range[own, None], 1e-9) * _STATE_SCALE
    speed = motion.v[own] / np.maximum(summary.rms_velocity[own, None], 1e-9)
    state = np.concatenate([position, speed])
    directions = rng.normal(size=(_WAVES, len(state))) / np.sqrt(len(own))
    phases = rng.uniform(0, 2 * np.pi, (_WAVES, 1))
    return np.asarray(np.cos(directions @ state + phases))


def _line_columns(hertz: float, motion: Motion) -> Array:
    """Sine and cosine in time, shape (2, N)."""
    angle = 2 * np.pi * hertz * motion.t
    return np.stack([np.sin(angle), np.cos(angle)])
