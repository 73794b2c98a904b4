"""Stribeck friction: what a joint takes to break loose beyond what it takes to slide."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.joint_effect import Held
from idtool.dynamics.effects.joint_term import DryFriction, mean_within
from idtool.dynamics.effects.probe import spread
from idtool.dynamics.effects.survey import Survey

_REACH = 6.0  # velocities v_s beyond which nothing is left
_SLOWEST = 4.0  # widths of the sign that v_s has at least
_TRIED = 7
_GRID = 10_000  # points of each part of an integral


class StribeckFriction(DryFriction):
    """(f_s − f_c) exp(−(v/v_s)²) sign(v), beside Coulomb friction f_c; the velocity v_s is held."""

    id = "stribeck_friction"
    means = "friction rises at low speed"
    shows = "slow sweeps at several speeds below that at which it rises"
    contains = ("coulomb_friction",)
    upon = ("coulomb_friction", "presliding_hysteresis")
    name = "stribeck"
    unit = ("N·m", "N")
    held = (Held("velocity", positive=True),)

    @classmethod
    def tried(cls, survey: Survey, joint: int) -> Iterator[Mapping[str, float]]:
        """See `JointEffect.tried`: from what the sign's width hides to what would pass for viscous friction."""
        for velocity in spread(_SLOWEST * survey.still[joint], survey.speed[joint], _TRIED):
            yield {"velocity": velocity}

    def level(self, motion: Motion) -> Array:
        """One at rest, which falls with speed."""
        return np.asarray(np.exp(-np.square(motion.v[self.joint] / self.shape["velocity"])))

    def column(self, motion: Motion) -> Array:
        """Level times direction; their common mean, since a fast reversal passes through all of it within a sample."""
        x = motion.v[self.joint] / motion.still[self.joint]
        width = self.shape["velocity"] / motion.still[self.joint]
        grid = np.union1d(np.linspace(0, _REACH, _GRID), np.linspace(0, _REACH * width, _GRID))
        f = np.tanh(grid) * np.exp(-np.square(grid / width))
        integral = np.append(0.0, np.cumsum(np.diff(grid) * 0.5 * (f[1:] + f[:-1])))
        of_sample = np.tanh(x) * self.level(motion)
        return mean_within(of_sample, x, lambda edge: np.interp(np.abs(edge), grid, integral))
