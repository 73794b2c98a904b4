"""Two-stage least squares: an identification that noise in position and velocity does not bias.

Noise in q and v is in the rows Y too: squared in Yᵀ Y, and in Yᵀ tau where a controller feeds it back. Least squares
takes it for motion and finds too little inertia. Along a motion close to the true one that knows nothing of the noise,
the rows Z are instruments: Zᵀ (tau − Y theta) is zero on average at the true theta (Janot, Vandanjon & Gautier 2014).
With more of these equations than coefficients (Sargan 1958),

    min over theta of Σ_j ‖P_j (Y_j theta − tau_j)‖² / sigma_j²,  P_j the projection onto the columns of Z_j.

That is as quadratic as least squares, so (27) keeps its constraints and its prior. Nor does it take the samples: with
U an orthonormal basis of the first m_j columns of the triangular factor R of [Z_j, Y_j, tau_j], ‖P_j x‖ = ‖Uᵀ R x‖.

Letters: nv joints; p coefficients theta, m_j of them in joint j's equation; Z_j, Y_j (n, m_j), tau_j (n,) and their
motions as in `instruments`; sigma_j noise of a joint's torque [N·m or N].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.linear_algebra import svd
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.blocks import merge_reductions
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.reduction import Factor, Reduction
from idtool.estimation.dataset.weights import residual_noise
from idtool.estimation.instruments import Instruments, Kind, instrumented_blocks, instruments
from idtool.estimation.problem.estimate import solve
from idtool.estimation.problem.problem import build_problem
from idtool.robot.sets import ConstraintSet

_MOST_ITERATIONS = 4
_CONVERGED = 0.02  # change of the torque relative to its noise
_NOT_CONVERGED = 0.1  # change of the torque relative to its noise from which it is warned of
_RANK = 1e-8  # of the largest singular value of scaled columns: less is rounding
_INFORMATIVE = 10.0  # standard errors in the size of a coefficient, from which a column tells something of it
_WEAK = 10.0  # the first stage's F below which instruments are weak (Staiger & Stock 1997)


@dataclass(frozen=True)
class TwoStage:
    """An estimate by instrumental variables.

    Attributes
    ----------
    theta
        The coefficients, shape (p,).
    projected
        The data projected onto the instruments: they take the place of least squares' data in (27).
    full
        The same rows of [Y, tau], not projected.
    noise
        Residual noise of theta in these, shape (nv,) [N·m or N]: the weights that go with ``projected``.
    instruments
        The last, one per log that is fitted to.
    correlation
        By joint, the least canonical correlation of Z and Y; see `correlations`.
    change
        RMS change of the torque in the last iteration, as a share of its noise.
    iterations
        Number of estimates made.
    notices
        Plain sentences for the user.
    """

    theta: Array
    projected: Reduction
    full: Reduction
    noise: Array
    instruments: tuple[Instruments, ...]
    correlation: dict[str, float]
    change: float
    iterations: int
    notices: tuple[Notice, ...]

    @property
    def kind(self) -> Kind:
        """``smoothed`` where the instruments of any log are."""
        return "smoothed" if any(each.kind == "smoothed" for each in self.instruments) else "closed_loop"


def two_stage_estimate(
    experiment: Experiment, sets: Sequence[ConstraintSet], theta: Array, progress: Progress
) -> TwoStage:
    """Make instruments with a model, estimate, and again with the estimate, until that no longer changes the torque.

    Parameters
    ----------
    experiment
        Model and data.
    sets
        One set per body.
    theta
        Coefficients to begin with, such as least squares', shape (p,).
    progress
        Callback for the stage and its progress, from 0 to 1.

    Raises
    ------
    LogError
        If a joint has no sample that counts.
    ModelError
        If a model on the way cannot be simulated, or runs away.
    SolverError
        If the problem could not be solved.
    """
    equation = experiment.equation
    iterations = 0
    change = np.inf
    made: list[Instruments] = []
    stacked: Reduction = ()
    while change > _CONVERGED and iterations < _MOST_ITERATIONS:
        if not made or any(each.kind == "closed_loop" for each in made):
            made = instruments(experiment, theta, progress)
            stacked = stack(experiment, made, progress)
        projected, full = project(stacked), unprojected(stacked)
        previous = theta
        theta = _estimated_theta(experiment, sets, projected, _residual_noise(equation, full, theta))
        noise = _residual_noise(equation, full, theta)
        change = _torque_change(equation, full, noise, theta - previous)
        iterations += 1
    least_correlation = {}
    for name, factor, size in zip(equation.joints, stacked, _coefficient_sizes(equation, noise, theta), strict=True):
        least_correlation[name] = float(correlations(factor, size).min(initial=1.0))
    weak = weak_joints(equation, stacked, noise, theta)
    return TwoStage(
        theta=theta,
        projected=projected,
        full=full,
        noise=noise,
        instruments=tuple(made),
        correlation=least_correlation,
        change=change,
        iterations=iterations,
        notices=_notices(made, weak, change),
    )


def stack(experiment: Experiment, made: Sequence[Instruments], progress: Progress) -> Reduction:
    """The training data as factors of [Z_j, Y_j, tau_j], shape (at most 2 m_j + 1, 2 m_j + 1) each.

    Raises
    ------
    LogError
        If a joint has no sample that counts.
    """
    return merge_reductions([log.total for log in instrumented_blocks(experiment, made, progress)])


def unprojected(stacked: Reduction) -> Reduction:
    """The factors of [Y_j, tau_j] from those of [Z_j, Y_j, tau_j]."""
    return tuple(Factor.merged([replace(factor, R=factor.R[:, _width(factor) :])]) for factor in stacked)


def project(stacked: Reduction) -> Reduction:
    """The factors of P_j [Y_j, tau_j] from those of [Z_j, Y_j, tau_j]; where Z = Y, least squares' but for a constant.

    Each has as many rows as Z_j has independent columns, but counts for all samples, so that these weigh as much
    against a prior as in least squares. The residual of theta in them says nothing of the noise.
    """
    projected = []
    for factor in stacked:
        m = _width(factor)
        projected.append(replace(factor, R=_basis(factor.R[:, :m]).T @ factor.R[:, m:]))
    return tuple(projected)


def correlations(stacked: Factor, size: Array) -> Array:
    """Canonical correlations of Z_j with the informative directions of Y_j, descending: 1 where they move as one.

    Directions that Y_j does not tell to a tenth of a coefficient's size are left out: noise has a correlation of
    nearly 0.

    Parameters
    ----------
    stacked
        The factor of [Z_j, Y_j, tau_j].
    size
        Sizes of the m_j coefficients, in units of the torque's noise per unit of the column, shape (m_j,).
    """
    m = _width(stacked)
    in_standard_errors = stacked.R[:, m:-1] * size * np.sqrt(stacked.independent / max(stacked.rows, 1))
    U, s, _ = svd(in_standard_errors)
    _, cosines, _ = svd(_basis(stacked.R[:, :m]).T @ U[:, s > _INFORMATIVE])
    return np.minimum(cosines, 1.0)


def weak_joints(equation: LinearModel, stacked: Reduction, noise: Array, theta: Array) -> list[str]:
    """The joints whose Z_j tells so little of Y_j that the estimate leans to that of least squares.

    Parameters
    ----------
    equation
        The torque equation.
    stacked
        Its data, from `stack`.
    noise, theta
        Residual noise and an estimate, shape (nv,) [N·m or N] and (p,).
    """
    weak = []
    for name, factor, size in zip(equation.joints, stacked, _coefficient_sizes(equation, noise, theta), strict=True):
        if first_stage_f_statistic(correlations(factor, size), factor.independent) < _WEAK:
            weak.append(name)
    return weak


def _width(stacked: Factor) -> int:
    """Number of columns of Z_j, m_j."""
    return int(stacked.R.shape[1]) // 2


def _basis(columns: Array) -> Array:
    """An orthonormal basis of the span of columns, each of them as important as the others."""
    size = np.linalg.norm(columns, axis=0)
    U, s, _ = svd(columns[:, size > 0] / size[size > 0])
    return np.asarray(U[:, s > _RANK * s.max(initial=0.0)])


def _estimated_theta(
    experiment: Experiment, sets: Sequence[ConstraintSet], projected: Reduction, noise: Array
) -> Array:
    """The coefficients by (27) from projected data, shape (p,)."""
    bodies, regularization = experiment.model.bodies, experiment.config.regularization
    problem = build_problem(experiment.equation, bodies, projected, sets, regularization, noise, experiment.equalities)
    x, _ = solve(problem)
    return np.asarray(problem.theta(problem.S @ x), dtype=float)


def _residual_noise(equation: LinearModel, full: Reduction, theta: Array) -> Array:
    return np.array([residual_noise(f, theta[columns]) for f, columns in zip(full, equation.active(), strict=True)])


def _torque_change(equation: LinearModel, full: Reduction, noise: Array, step: Array) -> float:
    """RMS over joints and samples of the change of torque by a step of theta, in units of its noise."""
    means = [
        np.square(factor.R[:, :-1] @ step[columns]).sum() / factor.rows / sigma**2
        for factor, columns, sigma in zip(full, equation.active(), noise, strict=True)
    ]
    return float(np.sqrt(np.mean(means)))


def _coefficient_sizes(equation: LinearModel, noise: Array, theta: Array) -> list[Array]:
    """Sizes of each joint's coefficients, in units of its torque's noise per unit of the column, shape (m_j,) each."""
    size = np.array([c.scale or abs(value) for c, value in zip(equation.coefficients, theta, strict=True)])
    return [size[columns] / sigma for columns, sigma in zip(equation.active(), noise, strict=True)]


def _notices(made: Sequence[Instruments], weak: Sequence[str], change: float) -> tuple[Notice, ...]:
    """Notices about the instruments."""
    notices = []
    smoothed = [np.minimum(each.cutoff_hz, each.run.signals.band_hz) for each in made if each.kind == "smoothed"]
    if smoothed:
        message = (
            "not every joint has a command and a controller, so the instruments are the measured motion below "
            f"{short_number(np.max(smoothed))} Hz: its remaining noise still biases the parameters"
        )
        notices.append(Notice("instruments_from_motion", "note", None, message))
    if weak:
        message = f"instruments are weak; some parameters may be as biased as with least squares: {join_names(weak)}"
        notices.append(Notice("weak_instruments", "warning", None, message))
    if change > _NOT_CONVERGED:
        message = (
            "the instruments have not converged: the last iteration changed the torque by "
            f"{short_number(change, 2)} of its noise"
        )
        notices.append(Notice("instruments_not_settled", "warning", None, message))
    return tuple(notices)


def first_stage_f_statistic(canonical: Array, independent: float) -> float:
    """F statistic of the first stage in the direction of Y_j that Z_j tells least of (Cragg & Donald 1993).

    Parameters
    ----------
    canonical
        From `correlations`, shape (r,).
    independent
        Number of independent rows that they were computed from.
    """
    r = len(canonical)
    if not r:
        return np.inf
    least = float(canonical[-1]) ** 2
    return max(independent - r, 0.0) / r * least / max(1 - least, np.finfo(float).eps)
