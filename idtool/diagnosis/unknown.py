"""What is structured in a residual and has no name: functions of state, and lines in time, of any form.

Each is a `Probe` as any effect is, judged by what it explains on blocks of time that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.probe import Probe, ProbeColumns

UNKNOWN = "unknown"
_BUMPS = 14  # over a range, of a function of one variable
_WAVES = 40  # random ones, of a function of several (Rahimi & Recht 2007)
_LINES = 160  # frequencies in time
_LOWEST, _HIGHEST = 0.5, 0.9  # Hz; of the band
_SLOW = 0.15  # of the rms speed, at which a function of speed changes fastest
_SEED = 0


def unnamed(survey: DataSummary) -> Iterator[Probe]:
    """Functions of a joint's position, its speed, of both, of all joints' state, and lines in time."""
    for j, name in enumerate(survey.model.names):
        yield _probe(name, j, _BUMPS, partial(_position, survey, j), {"of": 0.0})
        yield _probe(name, j, _BUMPS, partial(_speed, survey, j), {"of": 1.0})
        yield _probe(name, j, _WAVES, partial(_state, survey, [j]), {"of": 2.0})
        if len(survey.model.names) > 1:
            yield _probe(name, j, _WAVES, partial(_state, survey, range(len(survey.model.names))), {"of": 3.0})
        for hertz in np.geomspace(_LOWEST, _HIGHEST * survey.band_hz, _LINES):
            yield _probe(name, j, 2, partial(_line, float(hertz)), {"of": 4.0, "hertz": float(hertz)})


def _probe(name: str, joint: int, size: int, made: partial[Array], shape: Mapping[str, float]) -> Probe:
    def columns(motion: Motion, present: Linearization) -> Mapping[int, Array]:
        return {joint: made(motion)}

    typed: ProbeColumns = columns
    return Probe(UNKNOWN, name, None, typed, size, lambda c, information: None, shape)


def _bumps(x: Array) -> Array:
    """Overlapping bumps over [0, 1], shape (k, N)."""
    centres = np.linspace(0, 1, _BUMPS)[:, None]
    return np.asarray(np.exp(-0.5 * np.square((x - centres) * _BUMPS)))


def _position(survey: DataSummary, joint: int, motion: Motion) -> Array:
    return _bumps((motion.q[joint] - survey.q_min[joint]) / max(survey.q_range[joint], 1e-9))


def _speed(survey: DataSummary, joint: int, motion: Motion) -> Array:
    scale = np.arcsinh(motion.v[joint] / (_SLOW * max(survey.rms_velocity[joint], 1e-9)))
    most = np.arcsinh(3 / _SLOW)
    return _bumps((scale + most) / (2 * most))


def _state(survey: DataSummary, joints: range | list[int], motion: Motion) -> Array:
    """Waves over position and speed, shape (k, N)."""
    rng = np.random.default_rng(_SEED)
    own = list(joints)
    z = np.concatenate(
        [
            (motion.q[own] - survey.q_min[own, None]) / np.maximum(survey.q_range[own, None], 1e-9) * 3,
            motion.v[own] / np.maximum(survey.rms_velocity[own, None], 1e-9),
        ]
    )
    ways = rng.normal(size=(_WAVES, len(z))) / np.sqrt(len(own))
    return np.asarray(np.cos(ways @ z + rng.uniform(0, 2 * np.pi, (_WAVES, 1))))


def _line(hertz: float, motion: Motion) -> Array:
    angle = 2 * np.pi * hertz * motion.t
    return np.stack([np.sin(angle), np.cos(angle)])
