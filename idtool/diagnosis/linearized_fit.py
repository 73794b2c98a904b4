"""`LinearizedFit`: a fitted model and its residual, expanded to first order, to which further effects are compared.

About the fitted theta, the model's rows are expressed in directions y in which prior, constraints and data together
have unit information. The constraints count by the Hessian of their barrier there: along an active one the model is as
stiff as in the constrained problem. Of a candidate's columns, only the part orthogonal to all of that explains
anything.

Cross-validation leaves out one block of time after the other. Each is a small linear problem on Gram matrices, which in
these directions are as accurate as QR.

Letters: p coefficients theta; r directions y; F blocks of time; k columns of a candidate.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.common.linear_algebra import null_space
from idtool.data.signals import Batch
from idtool.diagnosis.noise_gain import noise_gain_of
from idtool.dynamics.effects import NamedEffect, effect_from_entry, effect_types
from idtool.dynamics.effects.torque_sensor import TorqueSensorEffect
from idtool.dynamics.regressor import LinearModel
from idtool.dynamics.row_filter import Shares
from idtool.estimation.dataset.blocks import Blocks, cut_into_blocks, merge_reductions
from idtool.estimation.dataset.experiment import Experiment, Progress, tracked
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import free_noise, weighted_rows
from idtool.estimation.identification import choose_sets
from idtool.estimation.problem.barrier import Barrier
from idtool.estimation.problem.estimate import Estimate, estimate
from idtool.robot.config import EffectEntry
from idtool.robot.model import WRENCH_SIZE, RobotModel

_BLOCKS = 36  # of time, of all logs together
_MIN_BLOCK_SECONDS = 0.4
_BARRIER_GAP = 1e-4  # of the cost, that the barrier's minimiser may cost more
_MIN_DATA_SHARE = 1e-5  # of a direction's information: with less from the data, the prior determines it
_MIN_REMAINING_INFORMATION = 0.02  # of all, without one block
_RANK = 1e-13  # of the largest eigenvalue: smaller ones are 0
_LEVER_ARM = 0.3  # m; 0.3 % of it, below which errors are negligible, is as much as a soft foot moves its contact point
_MIN_DEFINED_ROWS = 0.1  # of a joint's rows, at which the model's own columns must be defined


@dataclass(frozen=True)
class FurtherDirections:
    """Directions of a model beside those of its theta: other parameters that are free, to first order.

    Attributes
    ----------
    columns
        Change of the residual with each parameter, in units of the noise, (nv, k, n) for each batch of training data.
    whitening
        The directions, of which the data together have unit information, by parameter, shape (k, m).
    overlap
        What the model's own directions reproduce of them, shape (r, m).
    score
        Products of their rows with the residual, what the model's own directions reproduce left out, shape (m,).
    """

    columns: tuple[Array, ...]
    whitening: Array
    overlap: Array
    score: Array

    def rows(self, batch_number: int, joint: int, own_rows: Array) -> Array:
        """Rows of a joint in one batch by these directions, shape (m, n), from those by the model's own, (r, n)."""
        columns = self.columns[batch_number][joint]
        return np.asarray(self.whitening.T @ columns - self.overlap.T @ own_rows)


@dataclass(frozen=True)
class LinearizedFit:
    """A fitted model and its residual.

    Attributes
    ----------
    experiment
        Model and data.
    estimate
        The fit.
    theta
        Point of the expansion, shape (p,): strictly within the constraints.
    noise
        Unit of each joint's rows, shape (nv,) [N·m or N].
    noise_gain
        Ratio of the rows' noise to that of the measured torque, shape (nv,).
    directions
        Changes of theta by y, shape (p, r).
    prior_information
        Information on y from prior and constraints, shape (r, r).
    gram
        Gram matrices of the rows by y, of each block, shape (F, r, r).
    score
        Products of the rows with the residual, of each block, shape (F, r).
    sse
        Sum of squared residuals of each block, by joint, shape (F, nv); in units of the noise.
    row_counts
        Rows of each block, by joint, shape (F, nv).
    rms_torque
        Rms of each joint's torque, and size of the force and the moment of each wrench sensor and of a floating base,
        shape (nv,) [N·m or N].
    block_length
        Rows of a block of time; the last of a log may have fewer.
    reversal_margin
        Least distance of the rows from reversals, beside the filter's ringing [s].
    row_experiment
        Model whose columns are defined at all rows.
    further
        Directions that y has in addition to those of theta; None: none.
    """

    experiment: Experiment
    estimate: Estimate
    theta: Array
    noise: Array
    noise_gain: Array
    directions: Array
    prior_information: Array
    gram: Array
    score: Array
    sse: Array
    row_counts: Array
    rms_torque: Array
    block_length: int
    reversal_margin: float
    row_experiment: Experiment
    further: FurtherDirections | None = None

    def find_effect(self, entry: EffectEntry) -> tuple[NamedEffect, slice] | None:
        """Effect of a configuration entry and the range of its coefficients in theta; None if it has none."""
        key = effect_from_entry(entry, self.experiment.model).key
        effect_and_slice = self.experiment.equation.find_named_effect(key)
        if effect_and_slice is None:
            return None
        _, part = effect_and_slice
        return effect_and_slice if part.stop > part.start else None

    @property
    def row_equation(self) -> LinearModel:
        """Equation whose columns are defined at all rows."""
        return self.row_experiment.equation

    @property
    def block_count(self) -> int:
        """Number of blocks, F."""
        return len(self.sse)

    @property
    def joint_count(self) -> int:
        """Number of joints, nv."""
        return len(self.noise)

    @property
    def mean_squared_residual(self) -> Array:
        """Mean squared residual of each joint's rows, shape (nv,) [(N·m)² or N²]."""
        rows = np.maximum(self.row_counts.sum(axis=0), 1.0)
        return np.asarray(self.sse.sum(axis=0) * np.square(self.noise) / rows)

    @cached_property
    def information(self) -> Array:
        """Information on y from data, prior and constraints, shape (r, r)."""
        return np.asarray(self.gram.sum(axis=0) + self.prior_information)

    @cached_property
    def cv_squared_error(self) -> Array:
        """Squared validation error per block under the model fitted to the others, shape (F,)."""
        y = self.jackknife_shift
        linear = np.einsum("fi,fi->f", y, self.score)
        quadratic = np.einsum("fi,fij,fj->f", y, self.gram, y)
        return np.asarray(self.sse.sum(axis=1) - 2 * linear + quadratic)

    @property
    def total_cv_squared_error(self) -> float:
        """Squared validation error of all blocks."""
        return float(self.cv_squared_error.sum())

    @property
    def total_score(self) -> Array:
        """Slope of the fit along y, shape (r,): 0 along the model's own directions, of which it is the optimum."""
        own = np.zeros(len(self.information))
        if self.further is not None:
            own[-len(self.further.score) :] = self.further.score
        return own

    def information_without(self, block: int) -> Array:
        """Information on y without a block, shape (r, r).

        Along further directions a small share remains, since those that only one block determines stay as they are.
        """
        information = np.array(self.information - self.gram[block])
        if self.further is not None:
            m = len(self.further.score)
            information[-m:, -m:] += _MIN_REMAINING_INFORMATION * np.eye(m)
        return information

    @cached_property
    def jackknife_shift(self) -> Array:
        """Change of y when a block is left out, shape (F, r)."""
        shifts = []
        for f, score in enumerate(self.score):
            shifts.append(np.linalg.solve(self.information_without(f), self.total_score - score))
        return np.stack(shifts)

    def jackknife_covariance(self, coefficients: slice) -> Array:
        """Covariance of m coefficients, given by their range, over blocks that are left out in turn, shape (m, m)."""
        shift = self.jackknife_shift @ self.directions[coefficients].T
        deviation = shift - shift.mean(axis=0)
        return np.asarray((self.block_count - 1) / self.block_count * deviation.T @ deviation)


def linearize_fit(
    experiment: Experiment,
    progress: Progress,
    reference: LinearizedFit | None = None,
    own_rows: bool = False,
    reversal_margin: float = 0.0,
) -> LinearizedFit:
    """Fit a model and expand it.

    Parameters
    ----------
    experiment
        Model and data.
    progress
        Callback for the stage and its progress, from 0 to 1.
    reference
        Fit whose rows and noise are used, so that the two compare; default: own rows, and the noise that a fit without
        constraints leaves. If torque sensors differ, the noise is in units of what each takes as the true torque;
        otherwise scaling the torque to zero would have the smallest residual.
    own_rows
        True to use the rows at which the model's own columns are defined, even with a ``reference``.
    reversal_margin
        Least distance of the rows from reversals, beside the filter's ringing [s]; with a ``reference``, its own.

    Raises
    ------
    IdtoolError
        If there are too few samples, as where an effect's columns are hardly ever defined, or if the problem could not
        be solved.
    """
    length = _block_length(experiment)
    row_experiment = experiment
    if reference is not None:
        reversal_margin = reference.reversal_margin
        if not own_rows:
            row_experiment = reference.row_experiment
    equation = experiment.equation

    def read(equation: LinearModel) -> tuple[list[Blocks], Array]:
        return _read_blocks(experiment, equation, length, progress, row_experiment.equation, reversal_margin)

    blocks, rms_torque = read(equation)
    reduction = experiment.checked(merge_reductions([log.total for log in blocks]))
    if reference is None:
        free_equation, free_reduction = equation, reduction
        if equation.known_bodies is not None:  # what is wrong with these is no noise
            free_equation = replace(equation, known_bodies=None)
            free_blocks, _ = read(free_equation)
            free_reduction = merge_reductions([log.total for log in free_blocks])
        noise = free_noise(free_equation, free_reduction, experiment.equalities)
        noise_gain = noise_gain_of(experiment, noise)
    else:
        noise_gain = reference.noise_gain
        if _torque_using_effects(experiment) != _torque_using_effects(reference.experiment):
            noise_gain = noise_gain_of(experiment, reference.noise)
        noise = reference.noise * noise_gain / reference.noise_gain
        if _has_torque_sensor_effect(experiment) or _has_torque_sensor_effect(reference.experiment):
            noise = noise * rms_torque / reference.rms_torque
    estimated = _estimate(experiment, reduction, noise)
    theta, directions, prior_information = _directions(equation, reduction, estimated, noise)

    parts = [part for log in blocks for part in log.parts]
    sums = [_block_sums(equation, part, theta, directions, noise) for part in parts]
    gram, score, sse = (np.stack(of_blocks) for of_blocks in zip(*sums, strict=True))
    row_counts = np.array([[float(factor.rows) for factor in part] for part in parts])
    return LinearizedFit(
        experiment=experiment,
        estimate=estimated,
        theta=theta,
        noise=noise,
        noise_gain=noise_gain,
        directions=directions,
        prior_information=prior_information,
        gram=gram,
        score=score,
        sse=sse,
        row_counts=row_counts,
        rms_torque=rms_torque,
        block_length=length,
        reversal_margin=reversal_margin,
        row_experiment=row_experiment,
    )


def _rms_torque(model: RobotModel, mean_squares: Array) -> Array:
    """Rms of each joint's torque, and size of the force and the moment of each sensor and of the base, shape (nv,).

    The moment counts as at least that of the force at a lever arm of `_LEVER_ARM`.

    Parameters
    ----------
    model
        The tree of bodies.
    mean_squares
        Mean squared torque of each row, shape (nv,).
    """
    squares = mean_squares.copy()
    for first in range(model.joint_count, len(model.joints), WRENCH_SIZE):
        force, moment = first + np.arange(WRENCH_SIZE).reshape(2, 3)
        squares[force] = squares[force].sum()
        squares[moment] = max(squares[moment].sum(), _LEVER_ARM**2 * squares[force[0]])
    return np.asarray(np.sqrt(squares))


def _estimate(experiment: Experiment, reduction: Reduction, noise: Array) -> Estimate:
    """Estimate of the coefficients as configured, the joints weighted by their noise, shape (nv,)."""
    config = experiment.config
    bodies = experiment.model.bodies
    sets = choose_sets(bodies, config.constraints)
    return estimate(
        experiment.equation,
        bodies,
        reduction,
        sets,
        config.regularization.fixed_or_weak(),
        experiment.equalities,
        config.solver.name,
        noise,
        config.solver.backend,
    )


def _torque_using_effects(experiment: Experiment) -> list[EffectEntry]:
    """Effects that use the measured torque, and thus can cancel its noise."""
    return [entry for entry in experiment.config.effects if effect_types()[entry.effect].uses_measured_torque]


def _has_torque_sensor_effect(experiment: Experiment) -> bool:
    """True if an effect of the torque sensors is in the model."""
    return any(isinstance(effect, TorqueSensorEffect) for effect in experiment.equation.effects)


def _block_length(experiment: Experiment) -> int:
    """Rows of a block."""
    signals = experiment.runs[0].signals
    stride = signals.low_pass.stride
    count = sum((part.stop - part.start) // stride for run in experiment.runs for part in run.train)
    least = int(_MIN_BLOCK_SECONDS / (stride * signals.log.dt))
    return int(max(math.ceil(count / _BLOCKS), least, 1))


def _read_blocks(
    experiment: Experiment,
    equation: LinearModel,
    length: int,
    progress: Progress,
    row_equation: LinearModel,
    reversal_margin: float,
) -> tuple[list[Blocks], Array]:
    """Training data in blocks of rows at which the columns of ``row_equation`` are defined, and `_rms_torque`.

    Raises
    ------
    ConfigError
        If the columns of the equation are hardly ever defined at a joint's rows.
    """
    nv = len(equation.joints)
    row_count = np.zeros(nv)
    defined_count = np.zeros(nv)
    squares = np.zeros(nv)
    share_sum = np.zeros(nv)

    def filtered_rows(batches: Iterable[Batch]) -> Iterator[tuple[list[Array], Shares]]:
        for batch in batches:
            masks = row_equation.clean_samples(batch, reversal_margin)
            own_masks = masks if equation is row_equation else equation.clean_samples(batch, reversal_margin)
            for j, (mask, own_mask) in enumerate(zip(masks, own_masks, strict=True)):
                row_count[j] += mask.sum()
                defined_count[j] += (mask & own_mask).sum()
            row_filter = equation.row_filter(batch, row_equation, reversal_margin)
            torque = equation.filtered_torque(batch, row_filter)
            for j, (row, share) in enumerate(zip(torque, row_filter.shares, strict=True)):
                squares[j] += np.square(row[share.astype(bool)]).sum()
                share_sum[j] += share.sum()
            yield equation.filtered_columns(batch, row_filter), row_filter.shares

    logs = []
    for run in experiment.runs:
        if not run.train:
            continue
        low_pass = run.signals.low_pass
        log = run.signals.log
        batches = tracked(experiment.batches(run, held_out=False), run.train, progress, f"reading {log.path.name}")
        parts = tuple(block for _, block in cut_into_blocks(filtered_rows(batches), length, low_pass.redundancy))
        if parts:
            logs.append(Blocks(log.path.name, parts, length * low_pass.stride * log.dt))
    for name, defined, total in zip(equation.joints, defined_count, row_count, strict=True):
        if defined < _MIN_DEFINED_ROWS * total:
            what = f"at joint {name}, all effects are defined in only {defined:.0f} of {total:.0f} samples"
            raise ConfigError("effects", f"{what}; log more motion")
    return logs, _rms_torque(experiment.model, squares / np.maximum(share_sum, 1.0))


def _directions(
    equation: LinearModel, reduction: Reduction, estimated: Estimate, noise: Array
) -> tuple[Array, Array, Array]:
    """Point of the expansion, and the directions about it in which all information together is 1.

    Directions on which the data have hardly any information are left out: the prior determines them.

    Returns
    -------
    Theta strictly within the constraints, shape (p,), the directions, (p, r), and the information of prior and
    constraints on y, (r, r).
    """
    problem = estimated.problem
    samples = max(sum(factor.rows for factor in reduction) / len(reduction), 1.0)
    A = problem.A @ problem.S
    gap = _BARRIER_GAP * max(estimated.certificate.objective, 1e-9)
    barrier = Barrier(problem, 2 * A.T @ A, 2 * A.T @ problem.b, gap)
    x = barrier.x
    information = samples * (A.T @ A + barrier.curvature(x) / 2)  # the cost is a mean over the samples
    free = null_space(problem.E @ problem.S)
    to_theta = problem.K @ (problem.scale[:, None] * problem.S)
    directions = to_theta @ free @ _whitening(free.T @ information @ free)

    rows = np.sqrt(samples) * weighted_rows(equation, reduction, noise)[:, :-1] @ directions
    data_shares, rotation = np.linalg.eigh(rows.T @ rows)
    is_from_data = data_shares > _MIN_DATA_SHARE
    directions = directions @ rotation[:, is_from_data]
    prior_information = np.diag(np.maximum(1 - data_shares[is_from_data], 0.0))
    return problem.theta(problem.S @ x), directions, prior_information


def _whitening(information: Array) -> Array:
    """Basis W of the range of an information matrix M with Wᵀ M W = 1; its columns are scaled first, for accuracy."""
    size = np.sqrt(np.maximum(information.diagonal(), 1e-300))
    values, vectors = np.linalg.eigh(information / size[:, None] / size)
    keep = values > _RANK * values.max(initial=0.0)
    return np.asarray(vectors[:, keep] / size[:, None] / np.sqrt(values[keep]))


def _block_sums(
    equation: LinearModel, block: Reduction, theta: Array, directions: Array, noise: Array
) -> tuple[Array, Array, Array]:
    """Sums over a block's rows in units of the noise.

    Returns
    -------
    Gram matrix of the rows by y, shape (r, r), their products with the residual, (r,), and the squared residual by
    joint, (nv,).
    """
    r = directions.shape[1]
    gram = np.zeros((r, r))
    score = np.zeros(r)
    sse = np.zeros(len(block))
    for j, (factor, active) in enumerate(zip(block, equation.active(), strict=True)):
        Q = factor.R[:, :-1] @ directions[active] / noise[j]
        e = (factor.R[:, -1] - factor.R[:, :-1] @ theta[active]) / noise[j]
        gram += Q.T @ Q
        score += Q.T @ e
        sse[j] = e @ e
    return gram, score, sse
