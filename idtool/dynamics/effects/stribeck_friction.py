"""Stribeck friction: the excess of breakaway friction over sliding friction."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.data.signals import Motion
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.joint_term import DryFriction, sample_mean
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.effects.probe import geometric_grid

_REACH = 6.0  # velocities v_s beyond which nothing is left
_MIN_VELOCITY = 4.0  # least v_s tried, in deadbands: below, the sign's width hides the effect
_TRIALS = 7
_GRID = 10_000  # points of each part of an integral


class StribeckFriction(DryFriction):
    """(f_s − f_c) exp(−(v/v_s)²) sign(v), besides Coulomb friction f_c; the velocity v_s is nonlinear."""

    id = "stribeck_friction"
    label = "Stribeck friction"
    description = "friction increases towards low speed"
    excitation_hint = "slow sweeps at several speeds, some of them below the Stribeck velocity"
    generalizes = ("coulomb_friction",)
    requires = ("coulomb_friction", "presliding_hysteresis")
    coefficient_name = "stribeck"
    units = ("N·m", "N")
    nonlinear_parameters = (NonlinearParameter("velocity", ("rad/s", "m/s"), positive=True),)

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        """Velocities up to the rms speed; beyond, the effect would pass for viscous friction."""
        slowest = _MIN_VELOCITY * summary.velocity_deadband[joint]
        for velocity in geometric_grid(slowest, summary.rms_velocity[joint], _TRIALS):
            yield {"velocity": velocity}

    @classmethod
    @override
    def dry_friction(cls, values: Mapping[str, Any]) -> float:
        return float(values["stribeck"])

    @override
    def level(self, motion: Motion) -> Array:
        """One at rest, falling with speed."""
        return np.asarray(np.exp(-np.square(motion.v[self.joint] / self.nonlinear_values["velocity"])))

    @override
    def column(self, motion: Motion) -> Array:
        """Mean of level times direction over a sample, since a fast reversal passes through all of it within one."""
        deadband = motion.velocity_deadband[self.joint]
        x = motion.v[self.joint] / deadband
        width = self.nonlinear_values["velocity"] / deadband
        grid = np.union1d(np.linspace(0, _REACH, _GRID), np.linspace(0, _REACH * width, _GRID))
        f = np.tanh(grid) * np.exp(-np.square(grid / width))
        integral = np.append(0.0, np.cumsum(np.diff(grid) * 0.5 * (f[1:] + f[:-1])))
        at_samples = np.tanh(x) * self.level(motion)
        return sample_mean(at_samples, x, lambda edges: np.interp(np.abs(edges), grid, integral))
