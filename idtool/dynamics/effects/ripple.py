"""Torque ripple: cogging, gear mesh, eccentric encoders."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Self

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_effect import Held
from idtool.dynamics.effects.joint_term import JointTerm, JointTerms
from idtool.dynamics.effects.named import Value
from idtool.dynamics.effects.survey import Survey
from idtool.robot.model import Model

_FINE = 0.42  # of a period over the travel, between the n that are tried
_FEWEST = 1.2  # periods over the travel: fewer pass for springs and stops
_MOST = 220  # n that are tried
_SLOW = 0.3  # of the rms speed, at which a wave must stay within the band to be seen


class _Wave(JointTerm):
    unit = ("N·m", "N")
    lower = -np.inf
    even = False

    def angle(self, motion: Motion) -> Array:
        """That of the wave [rad]."""
        return np.asarray(self.shape["periods"] * motion.q[self.joint])


class _Sine(_Wave):
    """A cos φ."""

    name = "sine"

    def column(self, motion: Motion) -> Array:
        """sin(n q)."""
        return np.asarray(np.sin(self.angle(motion)))


class _Cosine(_Wave):
    """A sin φ."""

    name = "cosine"

    def column(self, motion: Motion) -> Array:
        """cos(n q)."""
        return np.asarray(np.cos(self.angle(motion)))


class TorqueRipple(JointTerms):
    """A sin(n q + φ), identified as A cos φ sin(n q) + A sin φ cos(n q); a joint may have several with other n.

    n is held. It counts periods per turn of the joint, so that a motor's own are its gear ratio times those of its
    turn, and need not be whole. On a prismatic joint it is per 2π m.
    """

    id = "torque_ripple"
    means = "torque ripples with the angle"
    shows = "slow motion over the whole travel at several speeds"
    contains = ("parallel_spring", "end_stop", "torque_offset")
    held = (Held("periods", positive=True, apart=True, error=0.3),)
    kinds = (_Sine, _Cosine)

    @classmethod
    def tried(cls, survey: Survey, joint: int) -> Iterator[Mapping[str, float]]:
        """See `JointEffect.tried`: from one period over the travel to what leaves the band even where it is slow."""
        turns = survey.travel[joint] / (2 * np.pi)
        if not turns > 0 or not survey.speed[joint] > 0:
            return
        fastest = 2 * np.pi * survey.band_hz / (_SLOW * survey.speed[joint])
        count = int(min((fastest - _FEWEST / turns) * turns / _FINE, _MOST))
        for k in range(max(count, 0)):
            yield {"periods": float((_FEWEST + _FINE * k) / turns)}

    @classmethod
    def made(cls) -> tuple[str, ...]:
        """See `JointEffect.made`."""
        return "amplitude", "phase"

    @classmethod
    def with_values(cls, model: Model, joint: int, values: Mapping[str, float], shape: Mapping[str, float]) -> Self:
        """See `JointEffect.with_values`."""
        amplitude, phase = values["amplitude"], values["phase"]
        return cls(model, joint, [amplitude * np.cos(phase), amplitude * np.sin(phase)], shape)

    def parameters(self, theta: Array, covariance: Array) -> dict[str, Value]:
        """See `NamedEffect.parameters`; errors to first order. The phase lies in [−π, π]."""
        amplitude, phase = float(np.hypot(*theta)), float(np.arctan2(theta[1], theta[0]))
        if not amplitude or not np.isfinite(covariance).all():
            return {"amplitude": (amplitude, None), "phase": (phase, None)}
        along = theta / amplitude
        across = np.array([-along[1], along[0]]) / amplitude
        errors = [float(np.sqrt(slope @ covariance @ slope)) for slope in (along, across)]
        return {"amplitude": (amplitude, errors[0]), "phase": (phase, errors[1])}
