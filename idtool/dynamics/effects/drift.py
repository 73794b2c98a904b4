"""Friction that changes over a log: warm-up, temperature."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_effect import Held
from idtool.dynamics.effects.joint_term import DryFriction, JointTerm, JointTerms
from idtool.dynamics.effects.probe import spread
from idtool.dynamics.effects.survey import Survey

_SOON, _LATE, _TRIED = 0.1, 2.0, 6  # of the log


def _share(motion: Motion, time_constant: float | Array) -> Array:
    """How much of the change there has been, of 1."""
    return np.asarray(-np.expm1(-motion.t / time_constant))


class _Viscous(JointTerm):
    name = "viscous_change"
    friction = True
    unit = ("N·m·s/rad", "N·s/m")
    lower = -np.inf

    def column(self, motion: Motion) -> Array:
        """The velocity, more and more."""
        return np.asarray(motion.v[self.joint] * _share(motion, self.shape["time_constant"]))


class _Coulomb(DryFriction):
    name = "coulomb_change"
    unit = ("N·m", "N")
    lower = -np.inf

    def level(self, motion: Motion) -> Array:
        """From nothing to one."""
        return _share(motion, self.shape["time_constant"])


class FrictionDrift(JointTerms):
    """(b v + c sign(v)) (1 − exp(−t/T)), t from the log's first sample; b and c are of either sign, T is held.

    Every log begins anew: each is taken to start with the joint in the same state.
    """

    id = "friction_drift"
    means = "friction changes over the log"
    shows = "the same motion again, warm"
    contains = ("viscous_friction", "coulomb_friction")
    friction = True
    upon = ("coulomb_friction", "presliding_hysteresis")
    held = (Held("time_constant", positive=True),)
    kinds = (_Viscous, _Coulomb)

    @classmethod
    def tried(cls, survey: Survey, joint: int) -> Iterator[Mapping[str, float]]:
        """See `JointEffect.tried`: changes that are seen to begin and to go on."""
        for time_constant in spread(_SOON * survey.seconds, _LATE * survey.seconds, _TRIED):
            yield {"time_constant": time_constant}

    @classmethod
    def made(cls) -> tuple[str, ...]:
        """See `JointEffect.made`."""
        return "viscous", "coulomb"
