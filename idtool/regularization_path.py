"""The fit for a range of prior weights, and the weight that `auto` takes: the largest that the data do not object to.

Every weight is tried on blocks of time that were not fitted. The data object to a weight

- where its error on them is more than one standard error above the best weight's (Breiman et al. 1984), or
- where it moves the fit by more than three and a half standard errors from what fits best. Residuals of real robots
  are mostly what the model lacks, not noise, and samples of them are far from independent. So they count as many as
  there would be samples of white noise whose mean square is as uncertain as the validation error.

All of it runs on R-factors: no log is read again. Each point is the minimiser of a barrier, tracked from the last one.

Letters as in `problem`; W weights; F folds; B blocks of time; G (p' + 1, p' + 1) the Gram matrix of [A, b].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idtool.barrier import Barrier
from idtool.blocks import Blocks, together
from idtool.body import Body
from idtool.config import Regularization
from idtool.inertia import SIZE
from idtool.knowledge import Knowledge
from idtool.problem import Problem, build_problem
from idtool.reduction import Reduction
from idtool.regressor import LinearModel
from idtool.sets import ConstraintSet
from idtool.weights import weighted_rows

Array = NDArray[np.float64]

WEIGHTS = 10.0 ** np.append(np.arange(1, -4.1, -0.5), -5)  # from the firmest
_VALIDATED = np.append(np.arange(0, len(WEIGHTS) - 1, 2), len(WEIGHTS) - 1)  # indices of those tried on blocks left out
_FOLDS = 5
_SHORTEST = 1.0  # s of a block: what a residual's correlation seldom outlasts
_LAGS = 3  # blocks over which errors may still be correlated
_MOVED = 3.5  # standard errors by which a prior may move the fit
_GAP = 1e-4  # of the cost, by which a point of the path may miss its minimum
_ROUNDING = 1e-12  # of the torque's square: what is less of the residual's says nothing
_UNTESTED = 0.3  # relative standard error of the prior's inertias that is assumed where logs are too short to ask

_REASONS = {
    "validation": "with more, blocks of time that were left out would be predicted worse by over one standard error",
    "significance": f"with more, the fit would be moved by over {_MOVED:g} standard errors from what the data say",
    "range": "it is the largest that is tried",
    "untested": "the logs are too short to leave out a part, so the URDF's inertias are trusted to "
    f"{100 * _UNTESTED:g} %",
}


@dataclass(frozen=True)
class PathPoint:
    """The fit with one weight.

    Attributes
    ----------
    weight
        Of the prior.
    train_error, validation_error
        Root mean square residual on all data, and of each block of time under a fit to the others, in units of the
        joints' noise; the latter is interpolated between decades, and NaN where logs are too short.
    total_mass
        Of all bodies [kg].
    distance
        From the prior, Σ d(pi, pî) of (27).
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
        With a tenth of it, and with ten times as much.
    best
        The weight with the least validation error.
    standard_error
        Of the best weight's validation error; NaN where logs are too short.
    limit
        Why the weight is not larger: ``validation``, ``significance``, ``range`` (it is the largest tried) or
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
        """Why it is not larger, in words."""
        return _REASONS[self.limit]


def regularization_path(
    model: LinearModel,
    bodies: Sequence[Body],
    data: Sequence[Blocks],
    sets: Sequence[ConstraintSet],
    regularization: Regularization,
    known: Knowledge,
    noise: Array,
) -> RegularizationPath:
    """Try all weights, and choose one.

    Parameters
    ----------
    model
        The torque equation; its first coefficients are the bodies' parameters.
    bodies
        The bodies.
    data
        The logs in blocks.
    sets
        One set a body.
    regularization
        The prior's kind.
    known
        What is known otherwise.
    noise
        The joints' residual noise, shape (nv,) [N·m or N].

    Raises
    ------
    SolverError
        If nothing fulfils the sets and what is known exactly.
    """
    total = together([log.total for log in data])
    tracker = _Tracker(model, bodies, total, sets, regularization, known, noise)
    x = tracker.solve(tracker.total, WEIGHTS)
    train = tracker.mean_squares(tracker.total, x)
    blocks = _blocks(data)
    if len(blocks) < _FOLDS:
        weight = assumed_weight(total)
        untold = np.full(len(WEIGHTS), np.nan)
        return tracker.path(x, untold, weight, np.nan, np.nan, "untested")
    errors, rows = tracker.validation_errors(blocks, x)
    decades = errors.sum(axis=1) / rows.sum()
    validation = np.interp(-np.log(WEIGHTS), -np.log(WEIGHTS[_VALIDATED]), decades)
    best = int(_VALIDATED[np.argmin(decades)])
    spread = _standard_error(errors[np.argmin(decades)] / rows, rows)
    weight, limit = _largest(validation, train, best, spread)
    return tracker.path(x, validation, weight, float(WEIGHTS[best]), spread, limit)


def _largest(validation: Array, train: Array, best: int, spread: float) -> tuple[float, str]:
    """The largest weight that the data do not object to, between two of those tried, and what objects to more."""
    independent = 2 / (spread / validation[best]) ** 2  # samples of white noise with that spread of the mean square
    allowed = {
        "validation": validation[best] + spread,
        "significance": train[best] * (1 + _MOVED**2 / independent),
    }
    share = {"validation": validation / allowed["validation"], "significance": train / allowed["significance"]}
    for i in range(best, 0, -1):
        beyond = {name: float(ratio[i - 1]) for name, ratio in share.items() if ratio[i - 1] > 1}
        if not beyond:
            continue
        limit = max(beyond, key=lambda name: beyond[name])
        inside, outside = float(share[limit][i]), float(share[limit][i - 1])
        part = (1 - inside) / (outside - inside)
        return float(WEIGHTS[i] * (WEIGHTS[i - 1] / WEIGHTS[i]) ** part), limit
    return float(WEIGHTS[0]), "range"


def assumed_weight(total: Reduction) -> float:
    """The weight of a prior with a standard error of 30 %, were noise all that the model lacks."""
    independent = float(np.mean([factor.independent for factor in total]))
    weight = 2 / (max(independent, 1.0) * _UNTESTED**2)
    return float(np.clip(weight, WEIGHTS[-1], WEIGHTS[0]))


def _blocks(data: Sequence[Blocks]) -> list[Reduction]:
    """Blocks of a second or longer, in the order of time; of short logs so many that every fold has two."""
    seconds = sum(len(log) * log.seconds for log in data)
    length = min(_SHORTEST, seconds / (2 * _FOLDS))
    parts: list[Reduction] = []
    for log in data:
        parts += log.joined(max(round(length / log.seconds), 1)).parts
    return [part for part in parts if any(factor.rows for factor in part)]


def _standard_error(means: Array, rows: Array) -> float:
    """Standard error of the weighted mean of errors that are correlated over a few blocks (Newey & West 1987)."""
    share = rows / rows.sum()
    away = share * (means - share @ means)
    uncorrelated = float(away @ away)
    variance = uncorrelated
    for lag in range(1, min(_LAGS, len(away) - 1) + 1):
        variance += 2 * (1 - lag / (_LAGS + 1)) * float(away[lag:] @ away[:-lag])
    return float(np.sqrt(max(variance, uncorrelated)))


class _Tracker:
    """The fits of all weights and folds, each tracked from a near one.

    Attributes
    ----------
    model, noise
        The torque equation, and what its rows are measured in.
    problem
        With the weight 1: its constraints and log-dets.
    bodies
        How many there are.
    total
        Gram matrix of all data, per sample.

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
        known: Knowledge,
        noise: Array,
    ) -> None:
        without_prior, self.problem = (
            build_problem(model, bodies, total, sets, regularization.weighing(weight), noise, known)
            for weight in (0.0, 1.0)
        )
        self.model, self.noise, self.bodies = model, noise, len(bodies)
        self.total = self._gram(total)
        self._facts = _gram(without_prior) - self.total
        self._prior = _gram(self.problem) - _gram(without_prior)
        gap = _GAP * max(without_prior.constant, _GAP)
        prior = model.prior[known.free] / self.problem.scale
        start = np.asarray(np.linalg.lstsq(self.problem.S, prior, rcond=None)[0])
        self._barrier = Barrier(self.problem, *self._normal(self.total, float(WEIGHTS[0])), gap, start)

    def solve(self, gram: Array, weights: Array, starts: Array | None = None) -> Array:
        """The x of each weight, from the largest, shape (W, m); each from its own start or from the one before."""
        x = np.zeros((len(weights), self.problem.variables))
        for i, weight in enumerate(weights.tolist()):
            x[i] = self._barrier.move(*self._normal(gram, weight), weight, None if starts is None else starts[i])
        return x

    def _gram(self, data: Reduction) -> Array:
        """The Gram matrix of data, in units of the noise and per sample."""
        rows = weighted_rows(self.model, data, self.noise)
        A = rows[:, :-1] @ self.problem.K * self.problem.scale
        stacked = np.column_stack([A, rows[:, -1]])
        return np.asarray(stacked.T @ stacked)

    def _normal(self, gram: Array, weight: float) -> tuple[Array, Array]:
        """The matrix, shape (m, m), and the vector, shape (m,), of the quadratic part that x minimises."""
        S = self.problem.S
        G = gram + self._facts + weight * self._prior
        return 2 * S.T @ G[:-1, :-1] @ S, 2 * S.T @ G[:-1, -1]

    def mean_squares(self, gram: Array, x: Array) -> Array:
        """Mean squared residuals in units of the noise, of several x, shape (W, m) to (W,)."""
        v = np.column_stack([x @ self.problem.S.T, np.full(len(x), -1.0)])
        return np.asarray(np.maximum(((v @ gram) * v).sum(axis=1), _ROUNDING * gram[-1, -1]) / len(self.noise))

    def validation_errors(self, blocks: Sequence[Reduction], x: Array) -> tuple[Array, Array]:
        """Squared errors of each block under the fits to the other folds, shape (V, B), and the blocks' rows (B,).

        V weights are tried, those of whole decades. The fits to all blocks, shape (W, m), are where the search begins.
        """
        rows = np.array([sum(factor.rows for factor in block) for block in blocks], dtype=float)
        grams = np.array([self._gram(block) for block in blocks])
        weights, starts = WEIGHTS[_VALIDATED], x[_VALIDATED]
        errors = np.zeros((len(weights), len(blocks)))
        fold_of = np.arange(len(blocks)) % _FOLDS
        for fold in range(_FOLDS):
            others = np.average(grams, axis=0, weights=rows * (fold_of != fold))
            candidates = self.solve(others, weights, starts)
            for i in np.flatnonzero(fold_of == fold).tolist():
                errors[:, i] = self.mean_squares(grams[i], candidates) * rows[i]
        return errors, rows

    def path(
        self, x: Array, validation: Array, weight: float, best: float, spread: float, limit: str
    ) -> RegularizationPath:
        """The path in figures, from the smallest weight."""
        points = [self._point(*each) for each in zip(WEIGHTS, x, validation, strict=True)]
        near = weight * np.array([10.0, 1.0, 0.1])
        nearest = np.abs(np.log(WEIGHTS) - np.log(near)[:, None]).argmin(axis=1)
        errors = np.interp(np.log(near), np.log(WEIGHTS[::-1]), validation[::-1], left=np.nan, right=np.nan)
        fits = self.solve(self.total, near, starts=x[nearest])
        stronger, chosen, weaker = (self._point(*each) for each in zip(near, fits, errors, strict=True))
        return RegularizationPath(tuple(points[::-1]), chosen, weaker, stronger, best, spread, limit)

    def _point(self, weight: float, x: Array, validation: float) -> PathPoint:
        z = self.problem.S @ x
        v = np.append(z, -1.0)
        distance = float(v @ self._prior @ v) + sum(term.value(z) for term in self.problem.log_dets)
        masses = self.problem.theta(z)[: SIZE * self.bodies : SIZE]
        train = float(np.sqrt(self.mean_squares(self.total, x[None])[0]))
        return PathPoint(float(weight), train, float(np.sqrt(validation)), float(masses.sum()), distance)


def _gram(problem: Problem) -> Array:
    """The Gram matrix of the rows of a problem's quadratic part."""
    rows = np.zeros((len(problem.b) + 1, len(problem.b) + 1))
    rows[:-1] = np.column_stack([problem.A, problem.b])
    rows[-1, -1] = np.sqrt(problem.constant)
    return np.asarray(rows.T @ rows)
