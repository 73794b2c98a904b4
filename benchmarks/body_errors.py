"""Priors with errors of a known size, and distances of bodies from the true ones.

A body's length L is the longest side of the homogeneous box with its mass and second moments.

Letters: pi inertia parameters in idtool's order, (bodies, 10); J pseudo-inertia (4, 4); Sigma_C second moments (3, 3)
of the mass about its centre [kg m^2].
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvalsh
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "sample_logs"))

from bodies import Body, realizable

from idtool.robot.inertia import LENGTH_POWERS, from_mass_com_inertia, mass_com_inertia, pseudo_inertia
from idtool.robot.metric import pullback_metric

Array = NDArray[np.float64]

_AXIS_ERROR = 0.3  # rad, of the principal axes, per unit of the error of the inertia's logarithm
_MAX_TRIES = 1000
_MIN_EIGENVALUE = 1e-12  # smaller ones are rounding

DISTANCES = ("euclidean", "links", "rotors", "pullback", "affine", "mass")


@dataclass(frozen=True)
class PriorErrors:
    """Size of a prior's errors.

    Attributes
    ----------
    mass, inertia
        Standard deviations of the logarithms of the mass, to which the inertia is proportional, and of each principal
        second moment.
    com
        RMS displacement of the centre of mass, in lengths L.
    exact
        True if masses and moments have errors of exactly this size, up or down; otherwise these are normal.
    """

    mass: float = 0.2
    com: float = 0.1
    inertia: float = 0.3
    exact: bool = False

    def link(self, rng: np.random.Generator, body: Body, Q: Array | None) -> Body:
        """Draw a link's prior that is realizable within its ellipsoid Q, if any."""
        moments, axes = np.linalg.eigh(body.moments)
        for _ in range(_MAX_TRIES):
            scale = np.exp(self._error(rng, self.mass))
            rotated_axes = Rotation.from_rotvec(rng.normal(0, _AXIS_ERROR * self.inertia, 3)).as_matrix() @ axes
            factors = np.exp([self._error(rng, self.inertia) for _ in range(3)])
            second_moments = rotated_axes @ np.diag(scale * moments * factors) @ rotated_axes.T
            com = body.com + rng.normal(0, self.com * length(body) / np.sqrt(3), 3)
            candidate = Body(scale * body.mass, com, np.trace(second_moments) * np.eye(3) - second_moments)
            if Q is None or realizable(candidate, Q):
                return candidate
        raise RuntimeError(f"none of {_MAX_TRIES} priors can be within the ellipsoid")

    def rotor(self, rng: np.random.Generator, body: Body) -> Body:
        """Draw a rotor's prior; its centre of mass is the true one."""
        mass_factor = np.exp(self._error(rng, self.mass))
        inertia_factor = np.exp(self._error(rng, self.inertia))
        return Body(mass_factor * body.mass, body.com, mass_factor * inertia_factor * body.inertia)

    def _error(self, rng: np.random.Generator, size: float) -> float:
        return float(size * (rng.choice([-1, 1]) if self.exact else rng.normal()))


def length(body: Body) -> float:
    """Length L of a body [m]."""
    return float(np.sqrt(12 * np.linalg.eigvalsh(body.moments)[-1] / body.mass))


def parameters(bodies: Mapping[str, Body]) -> Array:
    """Parameters pi of bodies, shape (bodies, 10)."""
    return np.array([from_mass_com_inertia(body.mass, body.com, body.inertia) for body in bodies.values()])


def typical_sizes(bodies: Mapping[str, Body]) -> Array:
    """Typical sizes m L^powers of the parameters of bodies, shape (bodies, 10)."""
    return np.array([body.mass * length(body) ** LENGTH_POWERS for body in bodies.values()])


@dataclass(frozen=True)
class Truth:
    """True bodies, and the mask of those that are links."""

    bodies: Mapping[str, Body]
    links: NDArray[np.bool_]

    def distances(self, pi: Array) -> dict[str, float]:
        """Distances of other parameters of the bodies from the true ones.

        Parameters
        ----------
        pi
            Parameters of all bodies in their order, shape (bodies, 10).

        Returns
        -------
        - euclidean, links, rotors: rms of (pi - pi_true) / (m_true L^powers) of all bodies, of links, of rotors;
        - pullback: rms over bodies of the root of 1/2 tr(J_true^-1 dJ J_true^-1 dJ);
        - affine: rms over bodies of the affine-invariant distance, the norm of log(J_true^-1 J);
        - mass: rms of the logarithm of the mass over the true one;
        - total: mass of all bodies over the true one;
        - worst: the largest factor by which a link is too heavy or too light;
        - needle: the smallest principal moment of inertia of a body over the body's true smallest one, the minimum.
        """
        true = parameters(self.bodies)
        deviation = (pi - true) / typical_sizes(self.bodies)
        squares = np.mean(np.square(deviation), axis=1)
        pullback, affine, needle = [], [], []
        for own, own_true in zip(pi, true, strict=True):
            pullback.append((own - own_true) @ pullback_metric(own_true) @ (own - own_true))
            affine.append(_squared_affine_distance(own, own_true))
            needle.append(_smallest_moment(own) / _smallest_moment(own_true))
        mass_errors = np.log(np.maximum(pi[:, 0], _MIN_EIGENVALUE) / true[:, 0])
        return {
            "euclidean": _root_mean(squares),
            "links": _root_mean(squares[self.links]),
            "rotors": _root_mean(squares[~self.links]),
            "pullback": _root_mean(np.array(pullback)),
            "affine": _root_mean(np.array(affine)),
            "mass": _root_mean(np.square(mass_errors)),
            "total": float(pi[:, 0].sum() / true[:, 0].sum()),
            "worst": float(np.exp(np.abs(mass_errors[self.links]).max())),
            "needle": min(needle),
        }


def _root_mean(squares: Array) -> float:
    return float(np.sqrt(squares.mean())) if len(squares) else float("nan")


def _squared_affine_distance(pi: Array, true: Array) -> float:
    """Squared affine-invariant distance; finite for unrealizable bodies too."""
    eigenvalues = eigvalsh(pseudo_inertia(pi), pseudo_inertia(true))
    return float(np.square(np.log(np.maximum(eigenvalues, _MIN_EIGENVALUE))).sum())


def _smallest_moment(pi: Array) -> float:
    return max(float(np.linalg.eigvalsh(mass_com_inertia(pi)[2])[0]), 0.0)


def enclosing_ellipsoid(body: Body) -> dict[str, Any]:
    """Entry of the configuration: the ellipsoid through the corners of a body's homogeneous box, 10 % larger."""
    moments, axes = np.linalg.eigh(body.moments)
    axes = axes * np.sign(np.linalg.det(axes))
    semi_axes = 1.1 * 3 * np.sqrt(moments / body.mass)
    rpy = Rotation.from_matrix(axes).as_euler("xyz")
    return {"center": body.com.tolist(), "semi_axes": semi_axes.tolist(), "rpy": rpy.tolist()}


def ellipsoid_matrix(ellipsoid: Mapping[str, Any]) -> Array:
    """Matrix Q, shape (4, 4), of a configuration's ellipsoid: the points x with [x; 1]' Q [x; 1] >= 0."""
    R = Rotation.from_euler("xyz", ellipsoid.get("rpy", [0, 0, 0])).as_matrix()
    center = np.array(ellipsoid["center"], float)
    shape = R @ np.diag(np.array(ellipsoid["semi_axes"], float) ** -2) @ R.T
    corner = 1 - center @ shape @ center
    return np.block([[-shape, (shape @ center)[:, None]], [(center @ shape)[None], np.atleast_2d(corner)]])
