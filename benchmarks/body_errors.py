"""Priors that are wrong by a known amount, and the distance of bodies from what they truly are.

A body's length L is that of the longest side of the uniform box with its mass and second moments.

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

_TURN = 0.3  # rad, of the principal axes, for an error of the inertia by a factor e
_TRIES = 1000
_LEAST = 1e-12  # of an eigenvalue: what is below is not told from zero

DISTANCES = ("euclidean", "links", "rotors", "pullback", "affine", "mass")


@dataclass(frozen=True)
class PriorErrors:
    """Size of a prior's errors.

    Attributes
    ----------
    mass, inertia
        Standard deviations of the logarithms of the mass, which the inertia is proportional to, and of each principal
        second moment.
    com
        Root mean square of the way of the centre of mass, in lengths L.
    exact
        Whether masses and moments are off by as much as that, up or down, rather than normally distributed.
    """

    mass: float = 0.2
    com: float = 0.1
    inertia: float = 0.3
    exact: bool = False

    def link(self, rng: np.random.Generator, body: Body, Q: Array | None) -> Body:
        """A link's prior, drawn until it can be within its ellipsoid."""
        moments, axes = np.linalg.eigh(body.moments)
        for _ in range(_TRIES):
            scale = np.exp(self._error(rng, self.mass))
            turn = Rotation.from_rotvec(rng.normal(0, _TURN * self.inertia, 3)).as_matrix() @ axes
            factors = np.exp([self._error(rng, self.inertia) for _ in range(3)])
            changed = turn @ np.diag(scale * moments * factors) @ turn.T
            com = body.com + rng.normal(0, self.com * length(body) / np.sqrt(3), 3)
            candidate = Body(scale * body.mass, com, np.trace(changed) * np.eye(3) - changed)
            if Q is None or realizable(candidate, Q):
                return candidate
        raise RuntimeError(f"none of {_TRIES} priors can be within the ellipsoid")

    def rotor(self, rng: np.random.Generator, body: Body) -> Body:
        """A rotor's prior: balanced as rotors are, its centre where it is."""
        scale = np.exp(self._error(rng, self.mass))
        change = np.exp(self._error(rng, self.inertia))
        return Body(scale * body.mass, body.com, scale * change * body.inertia)

    def _error(self, rng: np.random.Generator, size: float) -> float:
        return float(size * (rng.choice([-1, 1]) if self.exact else rng.normal()))


def length(body: Body) -> float:
    """L [m]."""
    return float(np.sqrt(12 * np.linalg.eigvalsh(body.moments)[-1] / body.mass))


def parameters(bodies: Mapping[str, Body]) -> Array:
    """Their pi."""
    return np.array([from_mass_com_inertia(body.mass, body.com, body.inertia) for body in bodies.values()])


def sizes(bodies: Mapping[str, Body]) -> Array:
    """Typical sizes m L^powers of their parameters, (bodies, 10)."""
    return np.array([body.mass * length(body) ** LENGTH_POWERS for body in bodies.values()])


@dataclass(frozen=True)
class Truth:
    """True bodies, and which of them are links."""

    bodies: Mapping[str, Body]
    links: NDArray[np.bool_]

    def figures(self, pi: Array) -> dict[str, float]:
        """Distance of other parameters of the bodies from the true ones.

        Parameters
        ----------
        pi
            Of all bodies in their order, (bodies, 10).

        Returns
        -------
        - euclidean, links, rotors: rms of (pi - pi_true) / (m_true L^powers) of all, of links, of rotors;
        - pullback: rms over bodies of the root of 1/2 tr(J_true^-1 dJ J_true^-1 dJ);
        - affine: rms over bodies of the affine-invariant distance, the norm of log(J_true^-1 J);
        - mass: rms of the logarithm of the mass over the true one;
        - total: mass of all bodies over the true one;
        - worst: the largest factor by which a link is too heavy or too light;
        - needle: the least principal moment of inertia of a body over the body's true least one.
        """
        true = parameters(self.bodies)
        deviation = (pi - true) / sizes(self.bodies)
        squares = np.mean(np.square(deviation), axis=1)
        pulled = [d @ pullback_metric(t) @ d for d, t in zip(pi - true, true, strict=True)]
        ratios = np.log(np.maximum(pi[:, 0], _LEAST) / true[:, 0])
        return {
            "euclidean": _root_mean(squares),
            "links": _root_mean(squares[self.links]),
            "rotors": _root_mean(squares[~self.links]),
            "pullback": _root_mean(np.array(pulled)),
            "affine": _root_mean(np.array([_affine(p, t) for p, t in zip(pi, true, strict=True)])),
            "mass": _root_mean(np.square(ratios)),
            "total": float(pi[:, 0].sum() / true[:, 0].sum()),
            "worst": float(np.exp(np.abs(ratios[self.links]).max())),
            "needle": min(_least_moment(p) / _least_moment(t) for p, t in zip(pi, true, strict=True)),
        }


def _root_mean(squares: Array) -> float:
    return float(np.sqrt(squares.mean())) if len(squares) else float("nan")


def _affine(pi: Array, true: Array) -> float:
    """Squared affine-invariant distance; a body that cannot be is as far as rounding tells."""
    eigenvalues = eigvalsh(pseudo_inertia(pi), pseudo_inertia(true))
    return float(np.square(np.log(np.maximum(eigenvalues, _LEAST))).sum())


def _least_moment(pi: Array) -> float:
    return max(float(np.linalg.eigvalsh(mass_com_inertia(pi)[2])[0]), 0.0)


def enclosing_ellipsoid(body: Body) -> dict[str, Any]:
    """The ellipsoid through the corners of the uniform box of a body, 10 % larger, as a configuration has it."""
    moments, axes = np.linalg.eigh(body.moments)
    axes = axes * np.sign(np.linalg.det(axes))
    semi_axes = 1.1 * 3 * np.sqrt(moments / body.mass)
    rpy = Rotation.from_matrix(axes).as_euler("xyz")
    return {"center": body.com.tolist(), "semi_axes": semi_axes.tolist(), "rpy": rpy.tolist()}


def ellipsoid_matrix(ellipsoid: Mapping[str, Any]) -> Array:
    """Q (4, 4) of a configuration's ellipsoid: the points x with [x; 1]' Q [x; 1] >= 0."""
    R = Rotation.from_euler("xyz", ellipsoid.get("rpy", [0, 0, 0])).as_matrix()
    center = np.array(ellipsoid["center"], float)
    shape = R @ np.diag(np.array(ellipsoid["semi_axes"], float) ** -2) @ R.T
    corner = 1 - center @ shape @ center
    return np.block([[-shape, (shape @ center)[:, None]], [(center @ shape)[None], np.atleast_2d(corner)]])
