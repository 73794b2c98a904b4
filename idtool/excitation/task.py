"""`DesignTask`: what a trajectory is to tell, of which robot, within which limits.

Shapes: nv joints, N samples, r base parameters, p coefficients. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.names import nearest
from idtool.data.filters import LowPass
from idtool.data.signals import Motion, default_cutoff
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.uncertainty.base_parameters import BaseParameters, structural_base_parameters
from idtool.excitation.criteria import BaseColumns, Criterion, DesignCriterion, base_parameter_scales, favoured_indices
from idtool.excitation.limits import Limits, joint_limits
from idtool.excitation.patterns import Fourier, MotionSamples, PatternSpec
from idtool.robot.collision import SelfCollision
from idtool.robot.config import Config
from idtool.robot.model import Model

VELOCITY_DEADBAND = 3e-3  # rad/s or m/s: least velocity whose sign a fit believes
_REST = 3.0  # times that: where a joint rests and its row is left out
_NOISE = 0.01  # of the effort limit, or of the largest torque of a random motion
_TYPICAL = 10.0  # times the noise: the torque of a coefficient whose size nothing tells
_SECONDS = 10.0  # of a random motion


@dataclass(frozen=True)
class DesignTask:
    """What is to be told, of which robot, within which limits.

    Attributes
    ----------
    model, equation, equalities
        The robot, its torque equation, and what is known of its coefficients.
    theta
        Coefficients that predict the torque, shape (p,).
    full, limits
        The joints' limits, and what a design keeps to.
    collision, clearance
        The robot's geometry, None without any, and how near links may come to each other [m].
    base, columns, scales
        The base parameters, their columns, and their units, shape (r,).
    noise, noise_assumed
        Of each joint's torque in the band [N·m or N], shape (nv,), and that of the joints for which it was not given.
    rate, independent_rate
        Samples and independent samples in the band a second [Hz].
    criterion
        The criterion.
    """

    model: Model
    equation: LinearModel
    equalities: EqualityConstraints
    theta: Array
    full: Limits
    limits: Limits
    collision: SelfCollision | None
    clearance: float
    base: BaseParameters
    columns: BaseColumns
    scales: Array
    noise: Array
    noise_assumed: tuple[str, ...]
    rate: float
    independent_rate: float
    criterion: DesignCriterion

    def blocks(self, samples: MotionSamples, t: Array, still: Array) -> list[Array]:
        """Columns of each joint's equation, less what takes no coefficient in the last, (m_j + 1, N)."""
        zero = np.zeros_like(samples.q)
        dt = float(t[1] - t[0]) if len(t) > 1 else 1.0
        return self.equation.columns(Motion(t, *samples, zero, zero, still, dt))

    def torque(self, samples: MotionSamples, t: Array) -> Array:
        """Predicted torque, shape (nv, N)."""
        zero, still = np.zeros_like(samples.q), np.full(len(samples.q), VELOCITY_DEADBAND)
        dt = float(t[1] - t[0]) if len(t) > 1 else 1.0
        return self.equation.torque(Motion(t, *samples, zero, zero, still, dt), self.theta)

    def information(self, samples: MotionSamples, t: Array) -> Array:
        """Of even samples of a motion about the base parameters in units of their sizes, shape (r, r).

        Where a joint rests, its row tells nothing.
        """
        still = np.full(len(samples.q), VELOCITY_DEADBAND)
        M = np.zeros((len(self.scales), len(self.scales)))
        worth = self.independent_rate * float(t[1] - t[0])
        for j, block in enumerate(self.blocks(samples, t, still)):
            own = self.columns.joint_columns[j]
            moving = np.abs(samples.v[j]) > _REST * VELOCITY_DEADBAND
            Y = self.columns.project(j, block[:-1, moving]) * (self.scales[own, None] / self.noise[j])
            M[np.ix_(own, own)] += worth * Y @ Y.T
        return M


def make_design_task(
    model: Model,
    equation: LinearModel,
    equalities: EqualityConstraints,
    config: Config,
    *,
    rate: float,
    margin: float,
    clearance: float,
    criterion: Criterion,
    favour: Sequence[str],
    noise: Mapping[str, float],
) -> DesignTask:
    """What is to be told of a model.

    Parameters
    ----------
    model, equation, equalities, config
        The robot, its torque equation, what is known of its coefficients, and the configuration.
    rate
        Of the log to come [Hz].
    margin
        Share of every limit that is left unused, see `Limits.within`.
    clearance
        How near links may come to each other [m].
    criterion, favour
        The aim; names as in `criteria.favoured_indices`.
    noise
        Of a joint's torque in the band, by name [N·m or N]; of others, a share of the effort limit.

    Raises
    ------
    ConfigError
        If limits contradict each other, or a name is not known.
    """
    for name in noise:
        if name not in model.names:
            raise ConfigError("--noise", f"{name} is no moving joint; {nearest(name, model.names)}")
    full = joint_limits(model, config)
    limits = full.with_margin(margin)
    base = structural_base_parameters(model, equation, equalities)
    if not len(base):
        raise ModelError(model.robot.path, "has no parameter that a motion could tell: its torque is always zero")
    sigma, typical, assumed = _scales(model, equation, limits, noise)
    return DesignTask(
        model=model,
        equation=equation,
        equalities=equalities,
        theta=equation.prior,
        full=full,
        limits=limits,
        collision=SelfCollision.from_model(model, config.locked_joints),
        clearance=clearance,
        base=base,
        columns=BaseColumns(equation, base, equalities),
        scales=base_parameter_scales(base, equation, typical),
        noise=sigma,
        noise_assumed=assumed,
        rate=rate,
        independent_rate=_independent(config, rate),
        criterion=DesignCriterion(criterion, favoured_indices(favour, base, equation)),
    )


def _independent(config: Config, rate: float) -> float:
    """Independent samples a second in the band of the log to come."""
    band = config.filter.cutoff_hz or default_cutoff(1 / rate)
    if band >= 0.45 * rate:
        raise ConfigError("filter.cutoff_hz", f"{band:g} Hz is too high for --rate {rate:g}")
    stride = max(1, int(rate / (4 * band)))
    return rate / (stride * LowPass(band, config.filter.order, 1 / rate, stride).redundancy)


def _scales(
    model: Model, equation: LinearModel, limits: Limits, given: Mapping[str, float]
) -> tuple[Array, Array, tuple[str, ...]]:
    """Noise of each joint (nv,), typical sizes of the coefficients (p,), and what is to be said of the noise.

    Of a random motion within the limits: the largest torque where there is no limit, and the columns' sizes.
    """
    pattern = Fourier(PatternSpec(model, limits, limits.middle, _SECONDS))
    t = np.linspace(0, _SECONDS, 500)
    samples = pattern.motion(pattern.draw(np.random.default_rng(0)), t)
    zero = np.zeros_like(samples.q)
    motion = Motion(t, *samples, zero, zero, np.full(len(zero), VELOCITY_DEADBAND), float(t[1]))
    largest = np.abs(equation.torque(motion, equation.prior)).max(axis=1)
    of = np.where(np.isfinite(limits.effort), limits.effort, np.where(largest > 0, largest, 1.0))
    noise = np.array([given.get(name, _NOISE * x) for name, x in zip(model.names, of, strict=True)])
    typical = np.zeros(len(equation.prior))
    for active, block, sigma in zip(equation.active(), equation.columns(motion), noise, strict=True):
        rms = np.sqrt(np.square(block[:-1]).mean(axis=1))
        typical[active] = np.maximum(typical[active], np.divide(_TYPICAL * sigma, rms, where=rms > 0, out=0 * rms))
    assumed = [f"{name} {x:.3g}" for name, x in zip(model.names, noise, strict=True) if name not in given]
    return noise, np.where(typical > 0, typical, 1.0), tuple(assumed)
