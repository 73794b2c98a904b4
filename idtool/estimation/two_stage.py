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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.linear_algebra import svd
from idtool.common.names import some
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.reduction import Factor, Reduction, reduce_blocks
from idtool.estimation.dataset.weights import residual_noise
from idtool.estimation.instruments import Instruments, Kind, instrumented_rows, instruments
from idtool.estimation.problem.identify import solve
from idtool.estimation.problem.problem import build_problem
from idtool.robot.sets import ConstraintSet

_MOST = 4  # times that instruments are made
_SETTLED = 0.02  # of the torque's noise: less change of the torque than that is none
_UNSETTLED = 0.1  # of it: more than that is worth a word
_RANK = 1e-8  # of the largest singular value of scaled columns: less is rounding
_TOLD = 10.0  # standard errors of a coefficient, its size, from which on a column tells something of it
_WEAK = 10.0  # the first stage's F below which instruments are weak (Staiger & Stock 1997)


@dataclass(frozen=True)
class TwoStage:
    """An estimate by instrumental variables.

    Attributes
    ----------
    theta
        The coefficients, shape (p,).
    projected
        The data seen through the instruments: they take the place of least squares' data in (27).
    full
        The same rows of [Y, tau], not projected.
    noise
        What theta leaves in these, shape (nv,) [N·m or N]: the weights that go with ``projected``.
    instruments
        The last, one a log that is fitted to.
    correlation
        By joint, the least canonical correlation of Z and Y; see `correlations`.
    change
        RMS change of the torque in the last iteration, as a share of its noise.
    iterations
        How many estimates were made.
    warnings
        What a user should know, a plain sentence each.
    """

    theta: Array
    projected: Reduction
    full: Reduction
    noise: Array
    instruments: tuple[Instruments, ...]
    correlation: dict[str, float]
    change: float
    iterations: int
    warnings: tuple[str, ...]

    @property
    def kind(self) -> Kind:
        """``smoothed`` where the instruments of any log are."""
        return "smoothed" if any(one.kind == "smoothed" for one in self.instruments) else "closed_loop"


def two_stage(experiment: Experiment, sets: Sequence[ConstraintSet], theta: Array, progress: Progress) -> TwoStage:
    """Make instruments with a model, estimate, and again with the estimate, until that no longer changes the torque.

    Parameters
    ----------
    experiment
        Model and data.
    sets
        One set a body.
    theta
        Coefficients to begin with, such as least squares', shape (p,).
    progress
        Told how far it has come.

    Raises
    ------
    LogError
        If a joint has no sample that counts.
    ModelError
        If a model on the way cannot be simulated, or runs away.
    SolverError
        If the problem could not be solved.
    """
    equation, iterations, change = experiment.equation, 0, np.inf
    made: list[Instruments] = []
    stacked: Reduction = ()
    while change > _SETTLED and iterations < _MOST:
        if not made or any(one.kind == "closed_loop" for one in made):
            made = [instruments(experiment, run, theta, progress) for run in experiment.runs if run.train]
            stacked = stack(experiment, made, progress)
        projected, full = project(stacked), unprojected(stacked)
        before, theta = theta, _solved(experiment, sets, projected, _noise(equation, full, theta))
        noise = _noise(equation, full, theta)
        change, iterations = _change(equation, full, noise, theta - before), iterations + 1
    found = [correlations(f, size) for f, size in zip(stacked, _sizes(equation, noise, theta), strict=True)]
    weak = weak_joints(equation, stacked, noise, theta)
    least = dict(zip(equation.joints, (float(c.min(initial=1.0)) for c in found), strict=True))
    warnings = _doubts(made, weak, change)
    return TwoStage(theta, projected, full, noise, tuple(made), least, change, iterations, warnings)


def stack(experiment: Experiment, made: Sequence[Instruments], progress: Progress) -> Reduction:
    """The training data as factors of [Z_j, Y_j, tau_j], shape (at most 2 m_j + 1, 2 m_j + 1) each.

    Raises
    ------
    LogError
        If a joint has no sample that counts.
    """
    total = tuple(Factor(np.zeros((0, 2 * len(active) + 1)), 0, 0.0) for active in experiment.equation.active())
    for one in made:
        blocks = _kept(experiment, one, progress)
        total = reduce_blocks(blocks, total, one.run.signals.low_pass.redundancy)
    return experiment.checked(total)


def _kept(experiment: Experiment, made: Instruments, progress: Progress) -> Iterator[list[Array]]:
    for blocks, counts in instrumented_rows(experiment, made, progress):
        yield [block[:, count] for block, count in zip(blocks, counts, strict=True)]


def unprojected(stacked: Reduction) -> Reduction:
    """The factors of [Y_j, tau_j] from those of [Z_j, Y_j, tau_j]."""
    return tuple(Factor.joined([replace(factor, R=factor.R[:, _size(factor) :])]) for factor in stacked)


def project(stacked: Reduction) -> Reduction:
    """The factors of P_j [Y_j, tau_j] from those of [Z_j, Y_j, tau_j]; where Z = Y, least squares' but for a constant.

    Each has as many rows as Z_j has independent columns, but is said to stand for all samples, so that these weigh as
    much against a prior as in least squares. What theta leaves in them says nothing of the noise.
    """
    return tuple(
        replace(factor, R=_basis(factor.R[:, : _size(factor)]).T @ factor.R[:, _size(factor) :]) for factor in stacked
    )


def correlations(stacked: Factor, size: Array) -> Array:
    """Canonical correlations of Z_j with what Y_j tells of the coefficients, descending: 1 where they move as one.

    What Y_j does not tell to a tenth of a coefficient's size is left out: noise has a correlation of nearly 0.

    Parameters
    ----------
    stacked
        The factor of [Z_j, Y_j, tau_j].
    size
        How large the m_j coefficients are, in units of the torque's noise per unit of the column, shape (m_j,).
    """
    m = _size(stacked)
    told = stacked.R[:, m:-1] * size * np.sqrt(stacked.independent / max(stacked.rows, 1))
    U, s, _ = svd(told)
    _, cosines, _ = svd(_basis(stacked.R[:, :m]).T @ U[:, s > _TOLD])
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
        An estimate and what it leaves, shape (nv,) [N·m or N] and (p,).
    """
    sizes = zip(equation.joints, stacked, _sizes(equation, noise, theta), strict=True)
    return [name for name, f, size in sizes if first_stage(correlations(f, size), f.independent) < _WEAK]


def _size(stacked: Factor) -> int:
    """How many columns Z_j has."""
    return int(stacked.R.shape[1]) // 2


def _basis(columns: Array) -> Array:
    """An orthonormal basis of what columns span, each of them as important as the others."""
    size = np.linalg.norm(columns, axis=0)
    U, s, _ = svd(columns[:, size > 0] / size[size > 0])
    return np.asarray(U[:, s > _RANK * s.max(initial=0.0)])


def _solved(experiment: Experiment, sets: Sequence[ConstraintSet], projected: Reduction, noise: Array) -> Array:
    """The coefficients (27) of projected data."""
    bodies, regularization = experiment.model.bodies, experiment.config.regularization
    problem = build_problem(experiment.equation, bodies, projected, sets, regularization, noise, experiment.known)
    return np.asarray(problem.theta(problem.S @ solve(problem)[0]), dtype=float)


def _noise(equation: LinearModel, full: Reduction, theta: Array) -> Array:
    return np.array([residual_noise(f, theta[columns]) for f, columns in zip(full, equation.active(), strict=True)])


def _change(equation: LinearModel, full: Reduction, noise: Array, step: Array) -> float:
    """RMS over joints and samples of what a step of theta changes in the torque, in units of its noise."""
    means = [
        np.square(factor.R[:, :-1] @ step[columns]).sum() / factor.rows / sigma**2
        for factor, columns, sigma in zip(full, equation.active(), noise, strict=True)
    ]
    return float(np.sqrt(np.mean(means)))


def _sizes(equation: LinearModel, noise: Array, theta: Array) -> list[Array]:
    """How large each joint's coefficients are, in units of its torque's noise per unit of the column."""
    size = np.array([c.scale or abs(value) for c, value in zip(equation.coefficients, theta, strict=True)])
    return [size[columns] / sigma for columns, sigma in zip(equation.active(), noise, strict=True)]


def _doubts(made: Sequence[Instruments], weak: Sequence[str], change: float) -> tuple[str, ...]:
    """What speaks against an estimate."""
    said = []
    smoothed = [np.minimum(one.cutoff_hz, one.run.signals.band_hz) for one in made if one.kind == "smoothed"]
    if smoothed:
        said.append(
            "without a command and a controller for every joint, instruments are the measured motion below "
            f"{np.max(smoothed):.3g} Hz: the noise that is left in it still biases"
        )
    if weak:
        said.append(f"instruments are weak, some parameters may be as biased as by least squares: {some(weak)}")
    if change > _UNSETTLED:
        said.append(f"instruments have not settled: the last changed the torque by {change:.2g} of its noise")
    return tuple(said)


def first_stage(found: Array, independent: float) -> float:
    """F of the first stage where Z_j tells least of Y_j (Cragg & Donald 1993).

    Parameters
    ----------
    found
        From `correlations`, shape (r,).
    independent
        Rows that they were found from.
    """
    if not len(found):
        return np.inf
    least = float(found[-1]) ** 2
    return max(independent - len(found), 0.0) / len(found) * least / max(1 - least, np.finfo(float).eps)
