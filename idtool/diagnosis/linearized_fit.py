"""`LinearizedFit`: what a model leaves of its logs, and what of that a further effect explains that the model cannot.

The model's rows are turned into directions y in which prior, constraints and data together weigh 1, about the fitted
theta. The constraints count by the Hessian of their barrier there: along an active one the model gives way as little as
the true problem does. A candidate's columns are then seen only by what is orthogonal to all of that.

Held-out figures leave out one block of time after the other; each is a small linear problem on Gram matrices, which in
these directions are as good as QR.

Letters: p coefficients theta; r directions y; F blocks of time; sigma_j noise of joint j; k columns of a candidate.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.common.linear_algebra import svd
from idtool.data.signals import Batch
from idtool.dynamics.effects.torque_sensor import TorqueSensorEffect
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.blocks import Blocks, cut_into_blocks, merge_reductions
from idtool.estimation.dataset.experiment import Experiment, Progress, Rows, tracked
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import free_noise, weighted_rows
from idtool.estimation.identification import choose_sets
from idtool.estimation.problem.barrier import Barrier
from idtool.estimation.problem.estimate import Estimate, estimate

_FOLDS = 36  # blocks of time of all logs together
_SHORTEST = 0.4  # s of a block
_GAP = 1e-4  # of the cost, that the barrier's minimiser may cost more
_SEEN = 1e-5  # of a direction's weight that data have: with less, it is the prior's
_RANK = 1e-13  # of the largest eigenvalue
_KNOWN = 0.1  # of a joint's rows that count, at which a model must know its own columns
_SEED = 0


@dataclass(frozen=True)
class LinearizedFit:
    """A fitted model and what it leaves.

    Attributes
    ----------
    experiment
        Model and data.
    estimate
        Its fit.
    theta
        Where it is expanded about, shape (p,): strictly within the constraints.
    noise
        What each joint's rows are measured in, shape (nv,) [N·m or N].
    ways
        Changes of theta by y, shape (p, r).
    held
        Information on y of prior and constraints, shape (r, r).
    B, g, s
        Of each block: Gram matrix of the rows by y, shape (F, r, r), its product with the residual, (F, r), and the
        residual's squares by joint, (F, nv); in units of the noise.
    rows
        How many rows each block has by joint, shape (F, nv).
    size
        Rms of each joint's torque, shape (nv,) [N·m or N].
    length
        Rows of a block of time at the most.
    apart
        How far from reversals the rows are, beside what rings in the filter [s].
    """

    experiment: Experiment
    estimate: Estimate
    theta: Array
    noise: Array
    ways: Array
    held: Array
    B: Array
    g: Array
    s: Array
    rows: Array
    size: Array
    length: int
    apart: float

    @property
    def folds(self) -> int:
        """How many blocks there are, F."""
        return len(self.s)

    def left(self) -> Array:
        """Squared residuals of each block under the model fitted to the others, shape (F,)."""
        return self._left

    @cached_property
    def _left(self) -> Array:
        y = self.without
        return np.asarray(
            self.s.sum(axis=1) - 2 * np.einsum("fi,fi->f", y, self.g) + np.einsum("fi,fij,fj->f", y, self.B, y)
        )

    @cached_property
    def without(self) -> Array:
        """How y changes when a block is left out, shape (F, r)."""
        total = self.B.sum(axis=0) + self.held
        return np.stack([np.linalg.solve(total - B, -g) for B, g in zip(self.B, self.g, strict=True)])


def linearize_fit(
    experiment: Experiment,
    progress: Progress,
    like: LinearizedFit | None = None,
    own_rows: bool = False,
    apart: float = 0.0,
) -> LinearizedFit:
    """Fit a model, and see what it leaves.

    Parameters
    ----------
    experiment
        Model and data.
    progress
        Told the stage and how far it has come.
    like
        Whose rows count, and whose noise they are measured in, so that the two compare; default: what a fit without
        constraints leaves. Where torque sensors differ, in units of what each takes for the true torque, or "scale it
        to nothing" would leave least.
    own_rows
        Whether those rows count that the model itself knows its columns at.
    apart
        How far from reversals rows must be, beside what rings in the filter [s]; where there is ``like``, as its are.

    Raises
    ------
    IdtoolError
        If there are fewer samples than it takes, as where an effect knows its columns at next to none of them, or the
        problem could not be solved.
    """
    length, apart = fold_rows(experiment), like.apart if like else apart
    counting = like.experiment.equation if like and not own_rows else experiment.equation
    blocks = _blocks(experiment, length, progress, counting, apart)
    equation, config = experiment.equation, experiment.config
    reduction = experiment.checked(merge_reductions([log.total for log in blocks]))
    equalities = experiment.equalities
    size = np.array([np.linalg.norm(factor.R[:, -1]) / np.sqrt(factor.rows) for factor in reduction])
    if like is None:
        noise = free_noise(equation, reduction, equalities)
    else:
        noise = like.noise * _rescaled(experiment, size, like)
    sets, _ = choose_sets(experiment.model.bodies, config.constraints)
    found = estimate(
        equation,
        experiment.model.bodies,
        reduction,
        sets,
        config.regularization.fixed_or_weak(),
        equalities,
        config.solver.name,
        noise,
        config.solver.backend,
    )
    theta, ways, held = _directions(equation, reduction, found, noise)
    parts = [part for log in blocks for part in log.parts]
    B, g, s = (np.stack(x) for x in zip(*(_gram(equation, part, theta, ways, noise) for part in parts), strict=True))
    rows = np.array([[factor.rows for factor in part] for part in parts], dtype=float)
    return LinearizedFit(experiment, found, theta, noise, ways, held, B, g, s, rows, size, length, apart)


def held_out(linearized: LinearizedFit, counting: LinearModel) -> Array:
    """Mean squared residual on what was held out, by joint, in units of the noise, on the rows that an equation knows.

    Those in which a reversal rings are among them, but for a model that is seen away from reversals. Shape (nv,); NaN
    where nothing was held out.
    """
    squares, count = np.zeros((2, len(linearized.noise)))
    theta, equation = linearized.estimate.theta, linearized.experiment.equation
    for run in linearized.experiment.runs:
        for batch in run.signals.batches(run.held_out):
            kept = (
                counting.clean_samples(batch, linearized.apart) if linearized.apart else counting.valid_samples(batch)
            )
            for j, (active, columns) in enumerate(zip(equation.active(), equation.columns(batch.motion), strict=True)):
                e = batch.filter((columns[-1] - theta[active] @ columns[:-1])[None])[0]
                keep = kept[j]
                squares[j], count[j] = squares[j] + np.square(e[keep]).sum(), count[j] + keep.sum()
    with np.errstate(invalid="ignore"):
        return np.asarray(squares / count / np.square(linearized.noise))


def _rescaled(experiment: Experiment, size: Array, like: LinearizedFit) -> Array:
    """How much larger each joint's noise is than in the other's rows, shape (nv,).

    Where torque sensors differ, as the true torque is.
    """
    own, other = (
        [effect.key for effect in one.equation.effects if isinstance(effect, TorqueSensorEffect)]
        for one in (experiment, like.experiment)
    )
    same = own == other and not own
    left = _noise_left(experiment, like.noise) / _noise_left(like.experiment, like.noise)
    return left if same else left * size / like.size


def _noise_left(experiment: Experiment, noise: Array) -> Array:
    """How much of white noise of the measured torque, so large, is left in the rows, at the first samples; shape (nv,).

    A soft joint's acceleration follows the torque, and takes noise against noise: that explains nothing.
    """
    equation, left = experiment.equation, np.ones(len(noise))
    if not any(effect.uses_measured_torque for effect in equation.effects):
        return left
    run = next(run for run in experiment.runs if run.train)
    batch = next(iter(run.signals.batches(run.train)))
    theta = np.array([equation.operating_point.get(c.key, c.prior) for c in equation.coefficients])
    white = np.random.default_rng(_SEED).standard_normal(batch.motion.tau.shape)
    white *= (noise / batch.filter(white).std(axis=1))[:, None]
    noisy = replace(batch.motion, tau=batch.motion.tau + white)
    change = LinearizedModel(equation, theta, noisy).residual - LinearizedModel(equation, theta, batch.motion).residual
    for j, (x, n, keep) in enumerate(
        zip(batch.filter(change), batch.filter(white), equation.clean_samples(batch), strict=True)
    ):
        left[j] = min(float(np.linalg.norm(x[keep]) / np.linalg.norm(n[keep])), 1.0) if keep.any() else 1.0
    return left


def fold_rows(experiment: Experiment) -> int:
    """How many rows a block has."""
    low_pass = experiment.runs[0].signals.low_pass
    count = sum((part.stop - part.start) // low_pass.stride for run in experiment.runs for part in run.train)
    least = int(_SHORTEST / (low_pass.stride * experiment.runs[0].signals.log.dt))
    return int(max(-(-count // _FOLDS), least, 1))


def _blocks(
    experiment: Experiment, length: int, progress: Progress, counting: LinearModel, apart: float
) -> list[Blocks]:
    """The training data in blocks of so many rows, those that an equation knows its columns at.

    Raises
    ------
    ConfigError
        If the experiment's own equation knows its columns at next to none of them on a joint.
    """
    equation, found = experiment.equation, []
    counted, known = np.zeros((2, len(equation.joints)))

    def rows(batches: Iterable[Batch]) -> Rows:
        for batch in batches:
            kept = counting.clean_samples(batch, apart)
            own = equation.clean_samples(batch, apart) if equation is not counting else kept
            counted[:] += [keep.sum() for keep in kept]
            known[:] += [(keep & sure).sum() for keep, sure in zip(kept, own, strict=True)]
            yield [batch.filter(x) for x in equation.columns(batch.motion)], kept

    for run in (run for run in experiment.runs if run.train):
        low_pass = run.signals.low_pass
        batches = tracked(run.signals.batches(run.train), run.train, progress, f"reading {run.signals.log.path.name}")
        parts = tuple(cut_into_blocks(rows(batches), length, low_pass.redundancy))
        if parts:
            found.append(Blocks(run.signals.log.path.name, parts, length * low_pass.stride * run.signals.log.dt))
    for name, own, all_of_them in zip(equation.joints, known, counted, strict=True):
        if own < _KNOWN * all_of_them:
            what = f"joint {name} has {own:.0f} of {all_of_them:.0f} samples left in which all effects are defined"
            raise ConfigError("effects", f"{what}; log more motion")
    return found


def _directions(
    equation: LinearModel, reduction: Reduction, found: Estimate, noise: Array
) -> tuple[Array, Array, Array]:
    """Theta within the constraints, shape (p,), the ways, (p, r), and the prior's information on them, (r, r)."""
    problem = found.problem
    samples = max(sum(factor.rows for factor in reduction) / len(reduction), 1.0)
    A = problem.A @ problem.S
    gap = _GAP * max(found.certificate.objective, 1e-9)
    barrier = Barrier(problem, 2 * A.T @ A, 2 * A.T @ problem.b, gap)
    x = barrier.x
    to_theta = problem.K @ (problem.scale[:, None] * problem.S)
    P = samples * (A.T @ A + barrier.curvature(x) / 2)
    exact = problem.E @ problem.S
    N = _null(exact, len(x))
    size = np.sqrt(np.maximum((N.T @ P @ N).diagonal(), 1e-300))
    values, vectors = np.linalg.eigh((N.T @ P @ N) / size[:, None] / size)
    keep = values > _RANK * values[-1]
    ways = to_theta @ N @ (vectors[:, keep] / size[:, None] / np.sqrt(values[keep]))
    D = np.sqrt(samples) * weighted_rows(equation, reduction, noise)[:, :-1] @ ways
    shares, turned = np.linalg.eigh(D.T @ D)
    seen = shares > _SEEN
    ways, shares = ways @ turned[:, seen], shares[seen]
    return problem.theta(problem.S @ x), ways, np.diag(np.maximum(1 - shares, 0.0))


def _null(exact: Array, count: int) -> Array:
    """The directions that leave what is known exactly as it is, shape (m, free)."""
    if not len(exact):
        return np.eye(count)
    _, s, Vt = svd(exact, full=True)
    return np.asarray(Vt[int(np.count_nonzero(s > 1e-9 * s[0])) :].T)


def _gram(
    equation: LinearModel, part: Reduction, theta: Array, ways: Array, noise: Array
) -> tuple[Array, Array, Array]:
    """A block's Gram matrix by y, its product with the residual, and the residual's squares by joint."""
    B, g = np.zeros((ways.shape[1], ways.shape[1])), np.zeros(ways.shape[1])
    s = np.zeros(len(part))
    for j, (factor, active) in enumerate(zip(part, equation.active(), strict=True)):
        Q = factor.R[:, :-1] @ ways[active] / noise[j]
        e = (factor.R[:, -1] - factor.R[:, :-1] @ theta[active]) / noise[j]
        B, g, s[j] = B + Q.T @ Q, g + Q.T @ e, e @ e
    return B, g, s
