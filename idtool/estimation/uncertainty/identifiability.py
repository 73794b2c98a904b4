"""Information source of each parameter: the data, the data in a combination with others, the constraint set, the prior.

A coefficient's prior spread is its typical size, the body's own. The data narrow it to the posterior spread; how far
the constraints narrow what is left is seen from the range at 1 % above the least cost, with and without them. These
three shares make one. Which coefficients move together is the posterior's correlation.

Letters: p coefficients theta, p' of them free, z; r base parameters beta = B theta.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.dynamics.effects.effect import Coefficient
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.problem.estimate import Estimate
from idtool.estimation.problem.problem import Problem
from idtool.estimation.uncertainty.base_parameters import BaseParameters, structural_base_parameters
from idtool.estimation.uncertainty.ranges import free_spread, ranges
from idtool.estimation.uncertainty.standard_errors import Uncertainty, whitened_rows
from idtool.robot.inertia import PI_SIZE
from idtool.robot.model import RobotModel

InformationSource = Literal["data", "combination", "constraints", "prior"]

_DATA_SHARE = 0.5  # of the data, from which a coefficient that they determine counts as known by them
_CORRELATED = 0.3  # correlation of coefficients that move together
_MOST_PARTNERS = 3
_LEAST_INFORMATION = 1e-9  # square root, on a coefficient without prior that the data do not see


@dataclass(frozen=True)
class InformationShares:
    """Shares of data, constraints and prior in the information on one parameter.

    Attributes
    ----------
    information_source
        The largest share.
    data, constraints, prior
        Shares, which make one: what the data take off the prior spread, what the constraints take off the rest, and
        what is left.
    range
        Range that the constraints allow at 1 % above the least cost, SI; None where there is no end.
    moves_with
        Indices of the coefficients it moves with, the most correlated first, and the correlation.
    combinations
        Indices of the base parameters that it is a part of, those first of which it is most.
    """

    information_source: InformationSource
    data: float
    constraints: float
    prior: float
    range: tuple[float | None, float | None]
    moves_with: tuple[tuple[int, float], ...]
    combinations: tuple[int, ...]


@dataclass(frozen=True)
class Identifiability:
    """Base parameters and what they are known to, and the information source of every inertia parameter.

    Attributes
    ----------
    base
        The base parameters of the model.
    value, standard_error, coverage_factor
        Of beta; the standard error is infinite where the log does not determine it, and the coverage factor is half
        the width of the 95 % interval in standard errors; shape (r,).
    sources
        One per inertia parameter.
    """

    base: BaseParameters
    value: Array
    standard_error: Array
    coverage_factor: Array
    sources: tuple[InformationShares, ...]

    @property
    def determined(self) -> Mask:
        """True for base parameters that the log determines, shape (r,)."""
        return np.isfinite(self.standard_error)


def identifiability(
    model: RobotModel,
    equation: LinearModel,
    equalities: EqualityConstraints,
    reduction: Reduction,
    estimate: Estimate,
    uncertainty: Uncertainty,
    progress: Callable[[float], None],
) -> Identifiability:
    """Find the information source of every inertia parameter.

    Parameters
    ----------
    model, equation, equalities
        The robot.
    reduction
        The data.
    estimate
        The identification.
    uncertainty
        Standard errors.
    progress
        Callback for the share that is done.
    """
    base = structural_base_parameters(model, equation, equalities)
    problem, x = estimate.problem, estimate.x
    inertial = np.setdiff1d(np.arange(len(equalities.free)), problem.other_coefficients)
    names = equalities.free[inertial]
    posterior, correlation = _posterior(equation, equalities, reduction, problem, estimate.noise, uncertainty, inertial)
    limits = ranges(problem, x, inertial, progress)
    free = free_spread(problem, x)[inertial] / problem.scale[inertial]
    ends = np.where(np.isfinite(limits), limits, (-np.inf, np.inf))
    half_widths = np.diff(ends, axis=1)[:, 0] / 2 / problem.scale[inertial]
    kept = np.minimum(half_widths, 1) / np.minimum(free, 1)
    is_determined = uncertainty.identifiable[names]
    units = np.array([c.scale or 1.0 for c in equation.coefficients])
    sources = []
    for i, name in enumerate(names.tolist()):
        left_by_data = float(posterior[i])
        prior = float(posterior[i] * min(kept[i], 1.0))
        data = 1 - left_by_data
        constraints = left_by_data - prior
        low, high = limits[i].tolist()
        sources.append(
            InformationShares(
                information_source=_information_source(bool(is_determined[i]), data, constraints, prior),
                data=data,
                constraints=constraints,
                prior=prior,
                range=(low if np.isfinite(low) else None, high if np.isfinite(high) else None),
                moves_with=_partners(correlation[i], i, names),
                combinations=_combinations(base, name, units),
            )
        )
    return Identifiability(
        base=base,
        value=base.B @ estimate.theta,
        standard_error=uncertainty.of(base.B),
        coverage_factor=uncertainty.coverage_factor(base.B),
        sources=_with_copies(sources, equalities, PI_SIZE * len(model.bodies)),
    )


def _posterior(
    equation: LinearModel,
    equalities: EqualityConstraints,
    reduction: Reduction,
    problem: Problem,
    noise: Array,
    uncertainty: Uncertainty,
    inertial: Indices,
) -> tuple[Array, Array]:
    """Posterior spread of inertia parameters in units of their prior spread, and their correlation.

    The data's information is that of their independent rows, less where the residual's scatter says so.
    """
    variance = float(np.trace(uncertainty.covariance_y)) / max(len(uncertainty.covariance_y), 1)
    data = whitened_rows(equation, reduction, noise) / np.sqrt(variance or 1.0)
    soft = equalities.soft_rows()[:, : len(equation.coefficients)]
    W = equalities.free_columns(np.concatenate([soft, data])) * problem.scale
    prior = np.zeros((len(inertial), W.shape[1]))
    prior[np.arange(len(inertial)), inertial] = 1
    least = _LEAST_INFORMATION * np.eye(W.shape[1])
    R = np.linalg.qr(np.concatenate([W, prior, least]), mode="r")
    inverse = np.linalg.inv(R)
    C = (inverse @ inverse.T)[np.ix_(inertial, inertial)]
    spread = np.sqrt(np.diag(C))
    return np.minimum(spread, 1.0), C / np.outer(spread, spread)


def _information_source(is_determined: bool, data: float, constraints: float, prior: float) -> InformationSource:
    """The largest share; the data count as the source only of a coefficient that they determine."""
    if is_determined and data >= _DATA_SHARE:
        return "data"
    if data > max(constraints, prior):
        return "combination"
    return "constraints" if constraints > prior else "prior"


def _partners(correlation: Array, own: int, names: Indices) -> tuple[tuple[int, float], ...]:
    """The coefficients that one moves with, the most correlated first."""
    order = np.argsort(-np.abs(correlation), kind="stable").tolist()
    partners = [i for i in order if i != own and abs(correlation[i]) >= _CORRELATED]
    return tuple((int(names[i]), float(correlation[i])) for i in partners[:_MOST_PARTNERS])


def _combinations(base: BaseParameters, k: int, units: Array) -> tuple[int, ...]:
    """The base parameters that a coefficient is a part of, those first of which it is most."""
    parts = np.abs(base.B) * units
    share = parts[:, k] / parts.sum(axis=1)
    return tuple(int(i) for i in np.argsort(-share, kind="stable") if share[i] > 0)


def _with_copies(
    sources: Sequence[InformationShares], equalities: EqualityConstraints, count: int
) -> tuple[InformationShares, ...]:
    """One source per inertia parameter: a copy's is its original's, with signs changed where it is mirrored."""
    all_sources = []
    for row in equalities.K[:count]:
        place = int(np.argmax(np.abs(row)))
        source = sources[place]
        if row[place] < 0:
            low, high = source.range
            mirrored = (None if high is None else -high, None if low is None else -low)
            moves_with = tuple((k, -correlation) for k, correlation in source.moves_with)
            source = replace(source, range=mirrored, moves_with=moves_with)
        all_sources.append(source)
    return tuple(all_sources)


def combination(base: BaseParameters, i: int, coefficients: Sequence[Coefficient]) -> tuple[tuple[int, float], ...]:
    """Terms of a base parameter: the one it is called after, then what weighs most by the coefficients' typical sizes.

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
