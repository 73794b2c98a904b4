"""Trials of a first configuration's terms: the logs are reduced once, and every variant is solved from the reduction.

A variant has a subset of the columns of the reduction, so its R-factors are columns of those. It is fitted to the
training parts and scored on the held-out parts; neither is read again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import LogError, SolverError
from idtool.dynamics.armature import with_armature
from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import equality_constraints
from idtool.estimation.dataset.experiment import Experiment, Progress, Run, tracked
from idtool.estimation.dataset.reduction import Factor, Reduction, empty, merge
from idtool.estimation.identification import choose_sets
from idtool.estimation.problem.estimate import estimate
from idtool.estimation.problem.prior_bodies import prior_bodies
from idtool.estimation.problem.regularization_path import assumed_weight
from idtool.robot.config import Config


@dataclass(frozen=True)
class TrialScore:
    """Errors and coefficients of a variant.

    Attributes
    ----------
    train, held_out
        Mean squared torque error in the band, shape (joints,) [(N·m)² or N²]; NaN where a joint has no samples.
    values
        Coefficients by effect and joint or body.
    share
        RMS contribution of a coefficient to the joint's training torque, by effect and joint or body [N·m or N].
    """

    train: Array
    held_out: Array
    values: dict[tuple[str, str], float]
    share: dict[tuple[str, str], float]

    def rms(self) -> float:
        """Held-out RMS over the joints that have samples."""
        return float(np.sqrt(np.nanmean(self.held_out)))

    def rms_of(self, j: int) -> float | None:
        """Held-out RMS of a joint [N·m or N]; None where it has no samples."""
        return None if np.isnan(self.held_out[j]) else float(np.sqrt(self.held_out[j]))


class TrialEvaluator:
    """Scores variants on reduced logs.

    Parameters
    ----------
    experiment
        The experiment with every column.
    progress
        Callback for the stage and its share that is done.

    Raises
    ------
    LogError
        If a joint has no training samples, or there are no held-out samples.
    """

    def __init__(self, experiment: Experiment, progress: Progress) -> None:
        self.experiment = experiment
        self.train = experiment.checked(_reduced(experiment, lambda run: run.train, progress))
        self.held_out = _reduced(experiment, lambda run: run.held_out, progress)
        if not any(factor.rows for factor in self.held_out):
            path = experiment.runs[0].signals.log.path
            raise LogError(path, "is too short for held-out data; log for longer")

    def score(self, config: Config) -> TrialScore:
        """Fit a variant.

        Parameters
        ----------
        config
            With none but the effects, friction terms and bodies of the evaluator's experiment.

        Raises
        ------
        SolverError
            If the problem could not be solved.
        """
        model = self.experiment.model
        config = with_armature(config, model)
        equation = LinearModel(model.names, build_effects(model, config), contacts=self.experiment.equation.contacts)
        train = self._part(self.train, equation)
        sets = choose_sets(model.bodies, config.constraints)
        equalities = equality_constraints(config, model, equation)
        prior = prior_bodies(config, model, equation, train)
        solve = partial(estimate, prior.equation, prior.bodies, train, sets, equalities=equalities)
        given = config.regularization
        # Bodies are held, or they would stand in for the terms that are tried.
        held = given.with_weight(assumed_weight(train)) if given.is_automatic else given
        try:
            theta = solve(regularization=held).theta
        except SolverError:  # data that no body explains, as of torque with the wrong sign
            theta = solve(regularization=given.fixed_or_weak()).theta
        held_out = self._part(self.held_out, equation)
        named = [(c.effect, c.owner) for c in equation.coefficients]
        values = dict(zip(named, theta.tolist(), strict=True))
        share = dict(zip(named, _shares(equation, theta, train).tolist(), strict=True))
        return TrialScore(self._errors(equation, theta, train), self._errors(equation, theta, held_out), values, share)

    def torque(self) -> Array:
        """Mean square of the held-out torque in the band, shape (joints,) [(N·m)² or N²]; NaN where there is none."""
        nothing = np.zeros(len(self.experiment.equation.coefficients))
        return self._errors(self.experiment.equation, nothing, self.held_out)

    def _errors(self, equation: LinearModel, theta: Array, data: Reduction) -> Array:
        """Mean squared error of the joints' rows, shape (joints,)."""
        pairs = zip(data, equation.active(), strict=True)
        errors = [f.squared_error(theta[active]) / f.rows if f.rows else np.nan for f, active in pairs]
        return np.array(errors[: self.experiment.model.joint_count])

    def _part(self, whole: Reduction, equation: LinearModel) -> Reduction:
        """The columns of the reduction that another equation has."""
        full = self.experiment.equation
        keys, wanted = ([c.key for c in e.coefficients] for e in (full, equation))
        parts = []
        for factor, has, takes in zip(whole, full.active(), equation.active(), strict=True):
            place = {keys[k]: i for i, k in enumerate(has)}
            columns = [*(place[wanted[k]] for k in takes), len(has)]
            parts.append(Factor.merged((replace(factor, R=factor.R[:, columns]),)))
        return tuple(parts)


def _reduced(experiment: Experiment, parts: Callable[[Run], tuple[slice, ...]], progress: Progress) -> Reduction:
    """Parts of the logs as R-factors."""
    total = empty(experiment.equation.active())
    for run in experiment.runs:
        redundancy = run.signals.low_pass.redundancy
        stage = f"reading {run.signals.log.path.name}"
        for batch in tracked(run.signals.batches(parts(run)), parts(run), progress, stage):
            rows = zip(*experiment.equation.counted_rows(batch), strict=True)
            total = merge(total, tuple(Factor.from_shares(x, share.astype(float), redundancy) for x, share in rows))
    return total


def _shares(equation: LinearModel, theta: Array, data: Reduction) -> Array:
    """RMS torque of each coefficient on the joint on which it is largest, shape (p,)."""
    share = np.zeros(len(theta))
    for factor, active in zip(data, equation.active(), strict=True):
        column = np.linalg.norm(factor.R[:, :-1], axis=0) / np.sqrt(max(factor.rows, 1))
        share[active] = np.maximum(share[active], np.abs(theta[active]) * column)
    return share
