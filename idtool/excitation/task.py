"""`DesignTask`: robot, limits and criterion of a trajectory design.

Shapes: nv joints, N samples, r base parameters, p coefficients. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.names import suggestion
from idtool.common.number_text import short_number
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
from idtool.robot.model import RobotModel

VELOCITY_DEADBAND = 3e-3  # rad/s or m/s: below it, a fit does not rely on the sign of the velocity
_REST = 3.0  # times that: a slower joint is at rest, and its row is left out
NOISE_SHARE = 0.01  # of the effort limit, or of the largest torque of a random motion
TYPICAL_TORQUE = 10.0  # times the noise, of a coefficient whose magnitude is unknown
_RANDOM_DURATION = 10.0  # s of a random motion


@dataclass(frozen=True)
class DesignTask:
    """Robot, limits and criterion of a trajectory design.

    Attributes
    ----------
    model, equation, equalities
        The robot, its torque equation, and the equality constraints between its coefficients.
    theta
        Coefficients that predict the torque, shape (p,).
    robot_limits, limits
        The joints' limits, and the tighter ones of the design.
    collision, clearance
        The robot's geometry, None without any, and the smallest distance that links may have [m].
    base, columns, scales
        The base parameters, their columns, and their scales, shape (r,).
    noise, noise_assumed
        Torque noise of each joint in the band [N·m or N], shape (nv,), and that of the joints for which it is assumed.
    rate, independent_rate
        Samples, and independent samples in the band, per second [Hz].
    criterion
        The criterion.
    """

    model: RobotModel
    equation: LinearModel
    equalities: EqualityConstraints
    theta: Array
    robot_limits: Limits
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

    def blocks(self, samples: MotionSamples, t: Array, velocity_deadband: Array) -> list[Array]:
        """Columns of each joint's equation and, last, minus the part without coefficients, (m_j + 1, N) each."""
        return self.equation.columns(_motion(samples, t, velocity_deadband))

    def torque(self, samples: MotionSamples, t: Array) -> Array:
        """Predicted torque, shape (nv, N)."""
        velocity_deadband = np.full(len(samples.q), VELOCITY_DEADBAND)
        return self.equation.torque(_motion(samples, t, velocity_deadband), self.theta)

    def information(self, samples: MotionSamples, t: Array) -> Array:
        """Information in even samples of a motion on the base parameters in units of their scales, shape (r, r).

        Rows of a joint at rest are left out.
        """
        velocity_deadband = np.full(len(samples.q), VELOCITY_DEADBAND)
        M = np.zeros((len(self.scales), len(self.scales)))
        samples_per_row = self.independent_rate * float(t[1] - t[0])
        for j, block in enumerate(self.blocks(samples, t, velocity_deadband)):
            columns = self.columns.joint_columns[j]
            is_moving = np.abs(samples.v[j]) > _REST * VELOCITY_DEADBAND
            Y = self.columns.project(j, block[:-1, is_moving]) * (self.scales[columns, None] / self.noise[j])
            M[np.ix_(columns, columns)] += samples_per_row * Y @ Y.T
        return M


def _motion(samples: MotionSamples, t: Array, velocity_deadband: Array) -> Motion:
    """Samples of a design as the torque equation takes them, without measured torque."""
    zero = np.zeros_like(samples.q)
    dt = float(t[1] - t[0]) if len(t) > 1 else 1.0
    return Motion(t, *samples, tau=zero, logged_tau=zero, velocity_deadband=velocity_deadband, dt=dt)


def make_design_task(
    model: RobotModel,
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
    """The task of designing a trajectory for a model.

    Parameters
    ----------
    model, equation, equalities, config
        The robot, its torque equation, the constraints between its coefficients, and the configuration.
    rate
        Sampling rate of the log to come [Hz].
    margin
        Share of every limit that is not used, see `Limits.within`.
    clearance
        Smallest distance that links may have [m].
    criterion, favour
        The criterion, and the names of `criteria.favoured_indices`.
    noise
        Torque noise in the band by joint [N·m or N]; that of others is a share of the effort limit.

    Raises
    ------
    ConfigError
        If limits contradict each other, or a name is not known.
    """
    check_noise_names(model, noise)
    full = joint_limits(model, config)
    limits = full.with_margin(margin)
    base = structural_base_parameters(model, equation, equalities)
    if not len(base):
        raise ModelError(model.robot.path, "has no parameter that a motion could determine: its torque is always zero")
    sigma, typical, assumed = _scales(model, equation, limits, noise)
    return DesignTask(
        model=model,
        equation=equation,
        equalities=equalities,
        theta=equation.prior,
        robot_limits=full,
        limits=limits,
        collision=SelfCollision.from_model(model, config.locked_joints),
        clearance=clearance,
        base=base,
        columns=BaseColumns(equation, base, equalities),
        scales=base_parameter_scales(base, equation, typical),
        noise=sigma,
        noise_assumed=assumed,
        rate=rate,
        independent_rate=independent_rate(config, rate),
        criterion=DesignCriterion(criterion, favoured_indices(favour, base, equation)),
    )


def check_noise_names(model: RobotModel, noise: Mapping[str, float]) -> None:
    """Raise ConfigError if noise is given for a row that the model does not have."""
    for name in noise:
        if name not in model.names:
            raise ConfigError("--noise", f"{name} is not a moving joint; {suggestion(name, model.names)}")


def independent_rate(config: Config, rate: float) -> float:
    """Independent samples per second in the band of the log to come [Hz]."""
    band = config.filter.cutoff_hz or default_cutoff(1 / rate)
    if band >= 0.45 * rate:
        raise ConfigError("filter.cutoff_hz", f"{band:g} Hz is too high for --rate {rate:g}")
    stride = max(1, int(rate / (4 * band)))
    low_pass = LowPass(band, config.filter.order, 1 / rate, stride)
    return rate / (stride * low_pass.redundancy)


def _scales(
    model: RobotModel, equation: LinearModel, limits: Limits, given: Mapping[str, float]
) -> tuple[Array, Array, tuple[str, ...]]:
    """Noise of each joint (nv,), typical magnitudes of the coefficients (p,), and the joints whose noise is assumed.

    A random motion within the limits gives the largest torque where there is no limit, and the columns' magnitudes.
    """
    pattern = Fourier(PatternSpec(model, limits, limits.middle, _RANDOM_DURATION))
    t = np.linspace(0, _RANDOM_DURATION, 500)
    samples = pattern.motion(pattern.draw(np.random.default_rng(0)), t)
    motion = _motion(samples, t, np.full(len(samples.q), VELOCITY_DEADBAND))
    largest = np.abs(equation.torque(motion, equation.prior)).max(axis=1)
    largest = np.where(largest > 0, largest, 1.0)
    full_torque = np.where(np.isfinite(limits.effort), limits.effort, largest)
    noise = np.array([given.get(name, NOISE_SHARE * tau) for name, tau in zip(model.names, full_torque, strict=True)])
    typical = np.zeros(len(equation.prior))
    for active, block, sigma in zip(equation.active(), equation.columns(motion), noise, strict=True):
        rms = np.sqrt(np.square(block[:-1]).mean(axis=1))
        magnitude = np.divide(TYPICAL_TORQUE * sigma, rms, where=rms > 0, out=0 * rms)
        typical[active] = np.maximum(typical[active], magnitude)
    assumed = [f"{name} {short_number(x)}" for name, x in zip(model.names, noise, strict=True) if name not in given]
    return noise, np.where(typical > 0, typical, 1.0), tuple(assumed)
