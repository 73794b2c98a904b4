"""What each number rests on: the data, the data in a combination with others, the constraint set, or the prior.

A coefficient's prior spread is its typical size, the body's own. The data narrow it to the posterior spread; how far
the constraints narrow what is left is seen from the range at 1 % above the least cost, with and without them. These
three shares make one. Which coefficients move together is the posterior's correlation.

Letters: p coefficients theta, p' of them free, z; r base parameters beta = B theta.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.dynamics.effects.effect import Coefficient
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.knowledge import Knowledge
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.problem.identify import Estimate
from idtool.estimation.problem.problem import Problem
from idtool.estimation.uncertainty.base import BaseParameters, structural_base
from idtool.estimation.uncertainty.ranges import free_spread, ranges
from idtool.estimation.uncertainty.uncertainty import Uncertainty, weighed
from idtool.robot.inertia import SIZE
from idtool.robot.model import Model

Ground = Literal["data", "combination", "constraints", "prior"]

_KNOWN = 0.5  # share of the data at which a coefficient that they determine counts as known by them
_TIED = 0.3  # correlation of coefficients that move together
_NAMED = 3  # of them


@dataclass(frozen=True)
class Basis:
    """What a coefficient rests on.

    Attributes
    ----------
    on
        The most of it.
    data, constraints, prior
        Shares, which make one: what the data take off the prior spread, what the constraints take off the rest, and
        what is left.
    range
        What the constraints allow at 1 % above the least cost, SI; None where there is no end.
    moves_with
        Indices of the coefficients it moves with, the most tied first, and whether they rise or fall with it.
    combinations
        Indices of the base parameters that it is a part of, those first of which it is most.
    """

    on: Ground
    data: float
    constraints: float
    prior: float
    range: tuple[float | None, float | None]
    moves_with: tuple[tuple[int, float], ...]
    combinations: tuple[int, ...]


@dataclass(frozen=True)
class Identifiability:
    """What the parameters rest on.

    Attributes
    ----------
    base
        The base parameters of the model.
    value, standard_error, reach
        Theirs: beta, its standard error, infinite where the log does not determine it, and half the width of the 95 %
        interval in standard errors; shape (r,).
    bases
        One an inertia parameter.
    """

    base: BaseParameters
    value: Array
    standard_error: Array
    reach: Array
    bases: tuple[Basis, ...]

    @property
    def seen(self) -> Mask:
        """Which base parameters the log determines, shape (r,)."""
        return np.isfinite(self.standard_error)


def identifiability(
    model: Model,
    equation: LinearModel,
    known: Knowledge,
    reduction: Reduction,
    estimate: Estimate,
    found: Uncertainty,
    tell: Callable[[float], None],
) -> Identifiability:
    """Ask what each number rests on.

    Parameters
    ----------
    model, equation, known
        The robot.
    reduction
        The data.
    estimate
        The identification.
    found
        Standard errors.
    tell
        Told the share that is done.
    """
    base, problem, x = structural_base(model, equation, known), estimate.problem, estimate.x
    inertial = np.setdiff1d(np.arange(len(known.free)), problem.others)
    spread, tied = _posterior(equation, known, reduction, problem, estimate.noise, found, inertial)
    limits = ranges(problem, x, inertial, tell)
    free = free_spread(problem, x)[inertial] / problem.scale[inertial]
    ends = np.where(np.isfinite(limits), limits, (-np.inf, np.inf))
    widths = np.diff(ends, axis=1)[:, 0] / 2 / problem.scale[inertial]
    kept = np.minimum(widths, 1) / np.minimum(free, 1)
    sees = found.identifiable[known.free[inertial]]
    units = np.array([c.scale or 1.0 for c in equation.coefficients])
    bases = []
    for i, k in enumerate(inertial):
        prior = float(spread[i] * min(kept[i], 1.0))
        data, held = 1 - float(spread[i]), float(spread[i]) - prior
        on = _ground(bool(sees[i]), data, held, prior)
        low, high = (float(v) if np.isfinite(v) else None for v in limits[i])
        partners = _partners(tied[i], i, known.free[inertial])
        bases.append(
            Basis(on, data, held, prior, (low, high), partners, _combinations(base, int(known.free[k]), units))
        )
    every = _for_all(bases, known, SIZE * len(model.bodies))
    return Identifiability(base, base.B @ estimate.theta, found.of(base.B), found.reach(base.B), every)


def _posterior(
    equation: LinearModel,
    known: Knowledge,
    reduction: Reduction,
    problem: Problem,
    noise: Array,
    found: Uncertainty,
    inertial: Indices,
) -> tuple[Array, Array]:
    """Of inertia parameters in units of their prior spread: posterior spread, and correlation.

    The data's information is that of their independent rows, less where the residual's scatter says so.
    """
    inflated = float(np.trace(found.spread)) / max(len(found.spread), 1)
    data = np.concatenate(weighed(equation, reduction, noise)) / np.sqrt(inflated or 1.0)
    told = known.soft_rows()[:, : len(equation.coefficients)]
    W = np.concatenate([told, data]) @ known.K * problem.scale
    prior = np.zeros((len(inertial), W.shape[1]))
    prior[np.arange(len(inertial)), inertial] = 1
    least = 1e-9 * np.eye(W.shape[1])  # of a coefficient without prior that the data do not see
    R = np.linalg.qr(np.concatenate([W, prior, least]), mode="r")
    inverse = np.linalg.inv(R)
    C = (inverse @ inverse.T)[np.ix_(inertial, inertial)]
    spread = np.sqrt(np.diag(C))
    return np.minimum(spread, 1.0), C / np.outer(spread, spread)


def _ground(sees: bool, data: float, constraints: float, prior: float) -> Ground:
    """The most of what a coefficient rests on."""
    if sees and data >= _KNOWN:
        return "data"
    if data > max(constraints, prior):
        return "combination"
    return "constraints" if constraints > prior else "prior"


def _partners(correlation: Array, own: int, names: Indices) -> tuple[tuple[int, float], ...]:
    """The coefficients that one moves with, the most tied first."""
    order = np.argsort(-np.abs(correlation), kind="stable")
    tied = [int(i) for i in order if i != own and abs(correlation[i]) >= _TIED][:_NAMED]
    return tuple((int(names[i]), float(correlation[i])) for i in tied)


def _combinations(base: BaseParameters, k: int, units: Array) -> tuple[int, ...]:
    """The base parameters that a coefficient is a part of, those first of which it is most."""
    parts = np.abs(base.B) * units
    share = parts[:, k] / parts.sum(axis=1)
    return tuple(int(i) for i in np.argsort(-share, kind="stable") if share[i] > 0)


def _for_all(bases: Sequence[Basis], known: Knowledge, count: int) -> tuple[Basis, ...]:
    """One for each inertia parameter, a copy's being its original's, turned round where it is reflected."""
    found = []
    for row in known.K[:count]:
        place = int(np.argmax(np.abs(row)))
        original = bases[place]
        if row[place] < 0:
            low, high = original.range
            turned = None if high is None else -high, None if low is None else -low
            moves = tuple((k, -tied) for k, tied in original.moves_with)
            original = replace(original, range=turned, moves_with=moves)
        found.append(original)
    return tuple(found)


def combination(base: BaseParameters, i: int, coefficients: Sequence[Coefficient]) -> tuple[tuple[int, float], ...]:
    """A base parameter's terms: the one it is called after, then what weighs most by the coefficients' typical sizes.

    Parameters
    ----------
    base, i
        The base parameters, and which one.
    coefficients
        The p coefficients.

    Returns
    -------
    Index and share of each.
    """
    row = base.B[i]
    size = np.abs(row) * [c.scale or 1.0 for c in coefficients]
    size[base.own[i]] = np.inf
    return tuple((int(k), float(row[k])) for k in np.argsort(-size, kind="stable") if row[k])
