"""Distances d(pi, pî) of a body from its prior in (27), each without units.

- euclidean: ‖pi − pî‖² in units of the body's own mass and size, or as in the paper in SI units;
- entropic: −log det J + log det Ĵ + Tr(Ĵ⁻¹ J) − 4, the log-det Bregman divergence (Lee, Wensing & Park 2020);
- pullback: its second-order form at the prior, ½ Tr(Ĵ⁻¹ δJ Ĵ⁻¹ δJ).

The last two do not depend on units and frames. They need a prior that a body can have; where it has not, the nearest
that is well inside takes its place.

A mass is known better than an inertia: it has been on scales, or follows from volume and material, whereas an inertia
needs to know where inside it is. Relative deviations of the mass therefore count mass_precision² times as much.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.robot.body import Body
from idtool.robot.config import Regularization
from idtool.robot.inertia import J_BASIS, PI_SIZE, from_mass_com_inertia, mass_com_inertia, pseudo_inertia
from idtool.robot.metric import pullback_metric

_LEAST_MOMENT = 1e-3  # least second moment of a prior about its centre of mass, in units of its mass and typical size


@dataclass(frozen=True)
class LogDet:
    """weight · (−log det X + Tr X − n), X = Σ_k z[first + k] G_k.

    Attributes
    ----------
    first
        Index in z of the first of the ten.
    G
        Symmetric matrices, shape (10, 4, 4); X = 1 at the prior.
    weight
        Weight of the divergence.
    """

    first: int
    G: Array
    weight: float

    @property
    def z_slice(self) -> slice:
        """The ten coefficients in z."""
        return slice(self.first, self.first + PI_SIZE)

    @property
    def slope(self) -> Array:
        """Slope of the linear part, weight · Tr G, shape (10,)."""
        return np.asarray(self.weight * np.trace(self.G, axis1=1, axis2=2))

    @property
    def offset(self) -> float:
        """Constant part, −weight · n."""
        return -self.weight * len(self.G[0])

    def matrix(self, z: Array) -> Array:
        """X, shape (4, 4)."""
        return np.asarray(np.tensordot(z[self.z_slice], self.G, axes=1))

    def value(self, z: Array) -> float:
        """Value of the term; infinite where X is not positive definite."""
        X = self.matrix(z)
        eigenvalues = np.linalg.eigvalsh(X)
        if eigenvalues[0] <= 0:
            return np.inf
        return float(self.weight * (eigenvalues - 1 - np.log(eigenvalues)).sum())

    def gradient(self, z: Array) -> Array:
        """Derivative with respect to the ten coefficients, shape (10,)."""
        X = self.matrix(z)
        return np.asarray(self.weight * np.einsum("kij,ji->k", self.G, np.eye(len(X)) - np.linalg.inv(X)))

    def root(self, z: Array) -> Array:
        """A matrix whose square, root.T @ root, is the second derivative, shape (16, 10)."""
        X = self.matrix(z)
        inverse = np.linalg.inv(np.linalg.cholesky(X))
        return np.asarray(np.sqrt(self.weight) * (inverse @ self.G @ inverse.T).reshape(PI_SIZE, -1).T)


def realizable_prior(pi: Array, scales: Array) -> Array:
    """The parameters pi, or near ones well inside the realizable set if pi is not; shape (10,).

    Mass and centre of mass stay, so this does not depend on the frame.

    Parameters
    ----------
    pi
        A body's prior, shape (10,).
    scales
        Units of its parameters, shape (10,).
    """
    unit = float(scales[1] / scales[0])
    if pi[0] <= 0:
        return from_mass_com_inertia(float(scales[0]), np.zeros(3), unit**2 * float(scales[0]) * np.eye(3))
    mass, com, inertia = mass_com_inertia(pi)
    moments, axes = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)  # of Sigma_C
    least = _LEAST_MOMENT * mass * unit**2
    if moments[0] >= least:
        return pi
    covariance = (axes * np.maximum(moments, least)) @ axes.T
    return from_mass_com_inertia(mass, com, np.trace(covariance) * np.eye(3) - covariance)


def moved_priors(model: LinearModel, bodies: Sequence[Body], regularization: Regularization) -> tuple[str, ...]:
    """Names of the bodies whose distance is not from the prior itself but from its `realizable_prior`."""
    if regularization.kind not in ("entropic", "pullback"):
        return ()
    scales = np.array([c.scale or 0.0 for c in model.coefficients[: PI_SIZE * len(bodies)]]).reshape(-1, PI_SIZE)
    pairs = zip(bodies, scales, strict=True)
    return tuple(body.name for body, own in pairs if not np.array_equal(realizable_prior(body.pi, own), body.pi))


def prior_rows(model: LinearModel, bodies: Sequence[Body], regularization: Regularization, units: Array) -> Array:
    """Rows of the distance as least squares, ‖rows · [theta; −1]‖²; shape (rows, p + 1), none for a divergence.

    Parameters
    ----------
    model
        The torque equation; its first coefficients are the bodies' parameters.
    bodies
        The bodies.
    regularization
        The prior's kind and weight.
    units
        Units of theta, shape (p,).
    """
    root_weight = np.sqrt(regularization.numeric_weight)
    prior = model.prior
    p, inertial = len(prior), PI_SIZE * len(bodies)
    L = np.zeros((inertial, p))
    if regularization.kind == "euclidean":
        np.fill_diagonal(L, root_weight / (units[:inertial] if regularization.units == "relative" else 1.0))
    elif regularization.kind == "pullback":
        prior = prior.copy()
        for i, body in enumerate(bodies):
            own = slice(PI_SIZE * i, PI_SIZE * (i + 1))
            prior[own] = realizable_prior(body.pi, units[own])
            M = units[own, None] * pullback_metric(prior[own]) * units[own]
            L[own, own] = root_weight * np.linalg.cholesky(M).T / units[own]
    masses = _mass_rows(bodies, regularization, units, p)
    return np.column_stack([np.concatenate([L, masses]), np.concatenate([L @ prior, masses @ model.prior])])


def _mass_rows(bodies: Sequence[Body], regularization: Regularization, units: Array, p: int) -> Array:
    """Rows that weigh masses beyond their share in the distance, shape (bodies, p)."""
    rows = np.zeros((len(bodies), p))
    if regularization.kind == "none" or regularization.units == "si":
        return rows
    share = 1.0 if regularization.kind == "euclidean" else 0.5  # of a mass's relative deviation squared, in d
    beyond = share * (regularization.mass_precision_factor**2 - 1)
    for i in range(len(bodies)):
        rows[i, PI_SIZE * i] = np.sqrt(regularization.numeric_weight * beyond) / units[PI_SIZE * i]
    return rows


def log_dets(
    model: LinearModel,
    bodies: Sequence[Body],
    regularization: Regularization,
    equalities: EqualityConstraints,
    scale: Array,
) -> tuple[LogDet, ...]:
    """Divergences of all bodies, copies too, from their priors, on z in units of ``scale``, shape (p',)."""
    if regularization.kind != "entropic" or not regularization.numeric_weight:
        return ()
    terms = []
    for i, body in enumerate(bodies):
        rows = equalities.K[PI_SIZE * i : PI_SIZE * (i + 1)]
        first = int(np.flatnonzero(rows.any(axis=0))[0])
        own = slice(first, first + PI_SIZE)
        units = np.array([c.scale for c in model.coefficients[PI_SIZE * i : PI_SIZE * (i + 1)]])
        J = pseudo_inertia(realizable_prior(body.pi, units))
        inverse = np.linalg.inv(np.linalg.cholesky(J))
        G = np.tensordot((rows[:, own] * scale[own]).T, inverse @ J_BASIS @ inverse.T, axes=1)
        terms.append(LogDet(first, G, regularization.numeric_weight))
    return tuple(terms)
