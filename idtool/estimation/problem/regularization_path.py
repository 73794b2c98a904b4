"""Fits for a range of prior weights, and the weight that `auto` takes: the largest that the data do not object to.

Every weight is tried on blocks of time that were not fitted. The data object to a weight

- where its error on them is more than one standard error above the best weight's (Breiman et al. 1984), or
- where it moves the fit by more than three and a half standard errors from what fits best. Residuals of real robots
  are mostly what the model lacks, not noise, and samples of them are far from independent. So they count as many as
  there would be samples of white noise whose mean square is as uncertain as the validation error.

They never object to the weight with the least error on what was left out.

All of it runs on R-factors: no log is read again. Each point is the minimiser of a barrier, tracked from the last one.
Gram matrices are of all data and of each fold, on [x; −1]: with rows [Y, tau] and theta = T x, they are
[T 0; 0 1]ᵀ [Y, tau]ᵀ [Y, tau] [T 0; 0 1]. They square the condition number, which moves the weight by as little as the
path's own accuracy; errors on what was left out are those of the rows themselves, and the fit does not use them.

Letters as in `problem`; W weights; F folds; B blocks of time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.linalg import block_diag

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.processes import Progress, no_progress, shared_among_processes
from idtool.common.threads import in_threads
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.blocks import Blocks, merge_reductions
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import weighted_rows
from idtool.estimation.problem.barrier import Barrier
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.robot.body import Body
from idtool.robot.config import Regularization
from idtool.robot.inertia import PI_SIZE
from idtool.robot.sets import ConstraintSet

WEIGHTS = 10.0 ** np.append(np.arange(1, -4.1, -0.5), -5)  # from the firmest
_VALIDATED = np.append(np.arange(0, len(WEIGHTS) - 1, 2), len(WEIGHTS) - 1)  # indices of whole decades
_FOLDS = 5
_BLOCK_SECONDS = 1.0  # less where logs are short; a residual's correlation seldom lasts longer
_MIN_BLOCKS_OF_LOG = 5
_LAGS = 3  # blocks over which errors may still be correlated
_MOST_MOVED = 3.5  # standard errors by which a prior may move the fit
_GAP = 1e-4  # of the cost, by which a point of the path may miss its minimum
_LEAST_COST = 1e-4  # below which that is no smaller
_ROUNDING = 1e-12  # of the torque's square: what is less of the residual's says nothing
_ASSUMED_ERROR = 0.3  # relative standard error of the prior's inertias where logs are too short to ask

_FEWEST_SHARED = 200  # variables of a problem whose folds are worth a copy of this process

_REASONS = {
    "validation": "a larger weight would increase the error on the cross-validation blocks by more than one standard "
    "error",
    "significance": f"a larger weight would move the estimate more than {_MOST_MOVED:g} standard errors away from the "
    "one that fits the data best",
    "range": "it is the largest weight that is tried",
    "untested": "the logs are too short for cross-validation, so the URDF's inertias are assumed to be accurate to "
    f"{100 * _ASSUMED_ERROR:g} %",
}


@dataclass(frozen=True)
class PathPoint:
    """Figures of the fit with one weight of the prior.

    Attributes
    ----------
    weight
        The weight.
    train_error, validation_error
        Root mean square residual on all data, and of each block of time under a fit to the others, in units of the
        joints' noise; the latter is interpolated between decades, and NaN where logs are too short.
    total_mass
        Mass of all bodies [kg].
    distance
        Distance from the prior, Σ d(pi, pî) of (27) in Wensing, Kim & Slotine (2018).
    """

    weight: float
    train_error: float
    validation_error: float
    total_mass: float
    distance: float


@dataclass(frozen=True)
class RegularizationPath:
    """The fits along the weights, and the choice.

    Attributes
    ----------
    points
        From the smallest weight to the largest.
    chosen
        The fit with the chosen weight.
    weaker, stronger
        The fits with a tenth of the chosen weight, and with ten times it.
    best
        The weight with the least validation error.
    standard_error
        Standard error of the best weight's validation error squared; NaN where logs are too short.
    limit
        Reason why the weight is not larger: ``validation``, ``significance``, ``range`` (it is the largest tried) or
        ``untested`` (logs are too short to leave out a part).
    """

    points: tuple[PathPoint, ...]
    chosen: PathPoint
    weaker: PathPoint
    stronger: PathPoint
    best: float
    standard_error: float
    limit: str

    @property
    def weight(self) -> float:
        """The chosen weight."""
        return self.chosen.weight

    @property
    def reason(self) -> str:
        """Reason why the weight is not larger, in words."""
        return _REASONS[self.limit]


def regularization_path(
    model: LinearModel,
    bodies: Sequence[Body],
    data: Sequence[Blocks],
    sets: Sequence[ConstraintSet],
    regularization: Regularization,
    equalities: EqualityConstraints,
    noise: Array,
    rows: Array | None = None,
) -> RegularizationPath:
    """Fit with every weight of the path, and choose the largest that the data do not object to.

    Parameters
    ----------
    model
        The torque equation; its first coefficients are the bodies' parameters.
    bodies
        The bodies.
    data
        The logs in blocks.
    sets
        One set per body.
    regularization
        The prior's kind.
    equalities
        The equality constraints.
    noise
        The joints' residual noise, shape (nv,) [N·m or N].
    rows
        The `weighted_rows` of all data, if they are known.

    Raises
    ------
    SolverError
        If nothing fulfils the sets and exact constraints.
    """
    total = merge_reductions([log.total for log in data])
    rows = weighted_rows(model, total, noise) if rows is None else rows
    tracker = _Tracker(model, bodies, total, sets, regularization, equalities, noise, rows)
    fits = tracker.solve(tracker.data_gram, WEIGHTS)
    groups = _blocks(data)
    blocks = [block for group in groups for block in group]
    if len(blocks) < _FOLDS:
        unknown = np.full(len(WEIGHTS), np.nan)
        weight = assumed_weight(total)
        return tracker.path(fits, unknown, weight, best_weight=np.nan, standard_error=np.nan, limit="untested")
    sums, rows = tracker.validation_errors(blocks, fits)
    validated = sums.sum(axis=1) / rows.sum()
    best_validated = int(np.argmin(validated))
    standard_error = _standard_error(sums[best_validated] / rows, rows, [len(group) for group in groups])
    softness = -np.log(WEIGHTS)  # which increases
    validation = np.interp(softness, softness[_VALIDATED], validated)
    best = int(_VALIDATED[best_validated])
    train = tracker.mean_squares(tracker.data_gram, fits)
    weight, limit = _largest_accepted(train, validation, best, standard_error)
    return tracker.path(fits, validation, weight, float(WEIGHTS[best]), standard_error, limit)


def _largest_accepted(train: Array, validation: Array, best: int, standard_error: float) -> tuple[float, str]:
    """The largest weight that no criterion objects to, interpolated between those tried, and the one that objects next.

    Parameters
    ----------
    train, validation
        Mean squared residuals of each weight on all data and on what was left out, shape (W,).
    best
        Index of the weight with the least squared residual on what was left out.
    standard_error
        Standard error of that residual.
    """
    effective_samples = 2 / (standard_error / validation[best]) ** 2  # a mean square's relative variance is 2 / n
    ratios = {  # above 1 the data object
        "validation": validation / (validation[best] + standard_error),
        "significance": train / (train.min() * (1 + _MOST_MOVED**2 / effective_samples)),
    }
    for weaker in range(best, 0, -1):
        firmer = weaker - 1
        crossings = {}  # as a share of the way to the firmer weight, in its logarithm
        for name, ratio in ratios.items():
            if ratio[firmer] > 1:
                crossing = (1 - ratio[weaker]) / (ratio[firmer] - ratio[weaker])
                crossings[name] = float(np.clip(crossing, 0, 1))
        if crossings:
            limit = min(crossings, key=lambda name: crossings[name])
            factor = WEIGHTS[firmer] / WEIGHTS[weaker]
            return float(WEIGHTS[weaker] * factor ** crossings[limit]), limit
    return float(WEIGHTS[0]), "range"


def assumed_weight(total: Reduction) -> float:
    """The weight that a prior with an assumed relative error has, were noise all that the model lacks.

    Of n samples of white noise, the likelihood weighs a squared error of the noise's size by 1 / n beside the mean
    squared residual, and half a squared relative error e² / 2 of an inertia by 2 / (n e²).
    """
    samples = float(np.mean([factor.independent for factor in total]))
    weight = 2 / (max(samples, 1.0) * _ASSUMED_ERROR**2)
    return float(np.clip(weight, WEIGHTS[-1], WEIGHTS[0]))


def _blocks(data: Sequence[Blocks]) -> list[list[Reduction]]:
    """The logs cut into blocks of a second, in the order of time; of short logs so many that every fold has two.

    Each log is a group of its own, but logs of few blocks, which tell little of their own mean error, are one together.
    """
    seconds = sum(len(log) * log.seconds for log in data)
    block_seconds = min(_BLOCK_SECONDS, seconds / (2 * _FOLDS))
    groups: list[list[Reduction]] = []
    of_short_logs: list[Reduction] = []
    for log in data:
        parts = log.regrouped(max(round(block_seconds / log.seconds), 1)).parts
        blocks = [block for block in parts if any(factor.rows for factor in block)]
        if len(blocks) < _MIN_BLOCKS_OF_LOG:
            of_short_logs += blocks
        else:
            groups.append(blocks)
    return [*groups, of_short_logs] if of_short_logs else groups


def _standard_error(means: Array, rows: Array, group_sizes: Sequence[int]) -> float:
    """Standard error of the weighted mean of errors that are correlated over a few blocks (Newey & West 1987).

    Deviations are from the mean of the own group: that a motion of one log has larger errors than that of another is no
    scatter.

    Parameters
    ----------
    means, rows
        Mean squared error and number of rows of each block, group after group, shape (F,).
    group_sizes
        Number of blocks of each group.
    """
    variance = 0.0
    first = 0
    for size in group_sizes:
        group = slice(first, first + size)
        own_mean = np.average(means[group], weights=rows[group])
        deviations = rows[group] / rows.sum() * (means[group] - own_mean)
        variance += _variance_of_sum(deviations)
        first += size
    return float(np.sqrt(variance))


def _variance_of_sum(deviations: Array) -> float:
    """Variance of the sum of values that are correlated over a few blocks, from their deviations, shape (F,)."""
    uncorrelated = float(deviations @ deviations)
    variance = uncorrelated
    for lag in range(1, min(_LAGS, len(deviations) - 1) + 1):
        taper = 1 - lag / (_LAGS + 1)
        covariance = float(deviations[lag:] @ deviations[:-lag])
        variance += 2 * taper * covariance
    return max(variance, uncorrelated)


class _Tracker:
    """The fits of all weights and folds, each tracked from a near one.

    Attributes
    ----------
    model, noise
        The torque equation, and what its rows are measured in.
    problem
        The problem at the weight 1, for its constraints and log-dets.
    body_count
        Number of bodies.
    data_gram
        Gram matrix of all data on [x; −1], per sample.

    Parameters
    ----------
    As of `regularization_path`; ``total`` is the data of all logs together.
    """

    def __init__(
        self,
        model: LinearModel,
        bodies: Sequence[Body],
        total: Reduction,
        sets: Sequence[ConstraintSet],
        regularization: Regularization,
        equalities: EqualityConstraints,
        noise: Array,
        rows: Array,
    ) -> None:
        def problem_with(weight: float) -> Problem:
            weighted = regularization.with_weight(weight)
            return build_problem(model, bodies, total, sets, weighted, noise, equalities, rows)

        without_prior, self.problem = problem_with(0.0), problem_with(1.0)
        self.model, self.noise, self.body_count = model, noise, len(bodies)
        K, S = self.problem.K * self.problem.scale, self.problem.S
        self._theta_of_x = _homogeneous(K @ S)  # sparse: a body's parameters depend on its own variables only
        self._z_of_x = _homogeneous(S)
        self.data_gram = _transformed(rows.T @ rows, self._theta_of_x)
        gram_without_prior = _transformed(_gram_of_problem(without_prior), self._z_of_x)
        self._constraint_gram = gram_without_prior - self.data_gram  # of measured constraints and the anchor
        # At the weight 1:
        self._prior_gram = _transformed(_gram_of_problem(self.problem), self._z_of_x) - gram_without_prior
        gap = _GAP * max(without_prior.constant, _LEAST_COST)
        prior = model.prior[equalities.free] / self.problem.scale
        start = np.asarray(np.linalg.lstsq(S, prior, rcond=None)[0])
        self._barrier = Barrier(self.problem, *self._quadratic(self.data_gram, float(WEIGHTS[0])), gap, start)

    def solve(self, data_gram: Array, weights: Array, starts: Array | None = None) -> Array:
        """The x of each weight, from the largest, shape (W, m); each from its own start or from the one before."""
        x = np.zeros((len(weights), self.problem.variables))
        for i, weight in enumerate(weights.tolist()):
            P, q = self._quadratic(data_gram, weight)
            x[i] = self._barrier.move(P, q, weight, None if starts is None else starts[i])
        return x

    def _gram_of_blocks(self, blocks: Sequence[Reduction]) -> Array:
        """Gram matrix of some blocks' data on [x; −1], in units of the noise."""
        p = len(self.problem.K)
        gram = np.zeros((p + 1, p + 1))
        for factors, columns, sigma in zip(zip(*blocks, strict=True), self.model.active(), self.noise, strict=True):
            own = [*columns, p]
            rows = np.concatenate([factor.R for factor in factors])
            gram[np.ix_(own, own)] += rows.T @ rows / sigma**2
        return _transformed(gram, self._theta_of_x)

    def _quadratic(self, data_gram: Array, weight: float) -> tuple[Array, Array]:
        """The quadratic part ½ xᵀ P x − qᵀ x of the cost at a weight: P, shape (m, m), and q, shape (m,)."""
        gram = data_gram + self._constraint_gram + weight * self._prior_gram
        return 2 * gram[:-1, :-1], 2 * gram[:-1, -1]

    def mean_squares(self, gram: Array, x: Array) -> Array:
        """Mean squared residuals in units of the noise, of several x, shape (W, m) to (W,)."""
        v = _with_minus_ones(x)
        squares = ((v @ gram) * v).sum(axis=1)
        return self._above_rounding(squares, gram[-1, -1]) / len(self.noise)

    def _above_rounding(self, squares: Array, squared_torque: float) -> Array:
        """Sums of squared residuals, no smaller than rounding leaves of those of the torque."""
        return np.asarray(np.maximum(squares, _ROUNDING * squared_torque))

    def squared_residuals(self, block: Reduction, x: Array) -> Array:
        """Sum of a block's squared residuals in units of the noise, of several x, shape (W, m) to (W,)."""
        v = _with_minus_ones(x) @ self._theta_of_x.T
        p = len(self.problem.K)
        squares, squared_torque = np.zeros(len(x)), 0.0
        for factor, columns, sigma in zip(block, self.model.active(), self.noise, strict=True):
            residuals = factor.R @ v[:, [*columns, p]].T / sigma
            squares += np.square(residuals).sum(axis=0)
            squared_torque += float(np.square(factor.R[:, -1] / sigma).sum())
        return self._above_rounding(squares, squared_torque)

    def validation_errors(self, blocks: Sequence[Reduction], x: Array) -> tuple[Array, Array]:
        """Sums of squared residuals of each block under the fit to the other folds, shape (V, B), and its rows (B,).

        V weights are tried, those of whole decades; rows count all joints' samples. The fits to all blocks, shape
        (W, m), are where the search begins.
        """
        rows = np.array([sum(factor.rows for factor in block) for block in blocks], dtype=float)
        weights, starts = WEIGHTS[_VALIDATED], x[_VALIDATED]
        sums = np.zeros((len(weights), len(blocks)))
        folds = [range(fold, len(blocks), _FOLDS) for fold in range(_FOLDS)]
        work = sum(factor.R.size for block in blocks for factor in block)
        grams = np.array(in_threads(lambda fold: self._gram_of_blocks([blocks[i] for i in fold]), folds, work))
        rows_of_fold = np.array([rows[fold].sum() for fold in folds])

        def fits_without(k: int, progress: Progress) -> Array:
            others = np.arange(_FOLDS) != k
            samples = rows_of_fold[others].sum() / len(self.noise)
            return self.solve(grams[others].sum(axis=0) / samples, weights, starts)

        if self.problem.variables < _FEWEST_SHARED:
            fits = [fits_without(k, no_progress) for k in range(_FOLDS)]
        else:
            fits = shared_among_processes(fits_without, range(_FOLDS), no_progress)
        for fold, fit in zip(folds, fits, strict=True):
            for i in fold:
                sums[:, i] = self.squared_residuals(blocks[i], fit)
        return sums, rows

    def path(
        self, x: Array, validation: Array, weight: float, best_weight: float, standard_error: float, limit: str
    ) -> RegularizationPath:
        """The result: a point for each weight, from the smallest, and the chosen one with its neighbours."""
        points = [self._point(*each) for each in zip(WEIGHTS, x, validation, strict=True)]
        reported = weight * np.array([10.0, 1.0, 0.1])
        distance = np.abs(np.log(WEIGHTS) - np.log(reported)[:, None])
        fits = self.solve(self.data_gram, reported, starts=x[distance.argmin(axis=1)])
        softness = -np.log(WEIGHTS)
        errors = np.interp(-np.log(reported), softness, validation, left=np.nan, right=np.nan)
        stronger, chosen, weaker = (self._point(*each) for each in zip(reported, fits, errors, strict=True))
        return RegularizationPath(tuple(points[::-1]), chosen, weaker, stronger, best_weight, standard_error, limit)

    def _point(self, weight: float, x: Array, validation: float) -> PathPoint:
        """The figures of the fit x with a weight, and its mean squared error on what was left out."""
        z = self.problem.S @ x
        v = np.append(x, -1.0)
        quadratic = float(v @ self._prior_gram @ v)
        log_dets = sum(term.value(z) for term in self.problem.log_dets)
        parameters = self.problem.theta(z)
        masses = parameters[: PI_SIZE * self.body_count : PI_SIZE]  # a body's first parameter
        train = float(self.mean_squares(self.data_gram, x[None])[0])
        return PathPoint(
            weight=float(weight),
            train_error=float(np.sqrt(train)),
            validation_error=float(np.sqrt(validation)),
            total_mass=float(masses.sum()),
            distance=quadratic + log_dets,
        )


def _homogeneous(M: Array) -> sparse.csr_array:
    """The matrix of [x; −1] to [M x; −1]."""
    return sparse.csr_array(block_diag(M, np.ones((1, 1))))


def _transformed(gram: Array, M: sparse.csr_array) -> Array:
    """Mᵀ gram M of a symmetric Gram matrix."""
    return np.asarray(M.T @ (M.T @ gram).T)


def _with_minus_ones(x: Array) -> Array:
    """Rows [x; −1], shape (W, m) to (W, m + 1)."""
    return np.column_stack([x, np.full(len(x), -1.0)])


def _gram_of_problem(problem: Problem) -> Array:
    """The Gram matrix of the rows of a problem's quadratic part, with what least squares leave of b in the corner."""
    rows = np.zeros((len(problem.b) + 1, len(problem.b) + 1))
    rows[:-1] = np.column_stack([problem.A, problem.b])
    rows[-1, -1] = np.sqrt(problem.constant)
    return np.asarray(rows.T @ rows)
