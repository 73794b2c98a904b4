"""True rigid bodies for the sample logs: the URDF's and config's, changed by 10 to 30 % and still realizable.

Letters: m mass [kg], c centre of mass [m], I rotational inertia about it [kg m^2], J pseudo-inertia (4, 4),
Q an ellipsoid as the points x with [x; 1]' Q [x; 1] >= 0, shape (4, 4). All in the body's own frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Body:
    """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg m^2] of a rigid body."""

    mass: float
    com: Array
    inertia: Array

    @staticmethod
    def from_config(inertial: Mapping[str, Any]) -> Body:
        """Read a config's ``inertial``, its inertia in the order xx, xy, yy, xz, yz, zz."""
        xx, xy, yy, xz, yz, zz = inertial["inertia"]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], float)
        return Body(float(inertial["mass"]), np.array(inertial["com"], float), inertia)

    def to_config(self) -> dict[str, Any]:
        """Write what `from_config` reads."""
        inertia = self.inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        return {"mass": self.mass, "com": self.com.tolist(), "inertia": inertia.tolist()}

    @property
    def moments(self) -> Array:
        """Second moments (3, 3) of the mass about its centre [kg m^2]: tr(I) 1 / 2 - I."""
        return np.asarray(np.trace(self.inertia) / 2 * np.eye(3) - self.inertia)


def ellipsoid_matrix(ellipsoid: Mapping[str, Sequence[float]]) -> Array:
    """Q (4, 4) of an axis-aligned ``{center, semi_axes}`` [m]."""
    center = np.array(ellipsoid["center"], float)
    shape = np.diag(np.array(ellipsoid["semi_axes"], float) ** -2)
    corner = 1 - center @ shape @ center
    return np.block([[-shape, (shape @ center)[:, None]], [(center @ shape)[None], np.atleast_2d(corner)]])


def realizable(body: Body, Q: Array) -> bool:
    """Whether some density inside the ellipsoid has these moments: J > 0 and tr(J Q) >= 0 (arXiv 1701.04395, 25)."""
    com = np.append(body.com, 1)
    J = body.mass * np.outer(com, com)
    J[:3, :3] += body.moments
    return bool(np.linalg.eigvalsh(J)[0] > 0 and np.trace(J @ Q) >= 0)


def _factors(rng: np.random.Generator, n: int) -> Array:
    """Draw factors that are 10 to 30 % above or below one, shape (n,)."""
    return 1 + rng.choice([-1, 1], n) * rng.uniform(0.1, 0.3, n)


def true_link(rng: np.random.Generator, prior: Body, Q: Array) -> Body:
    """Change mass, centre and principal second moments by 10 to 30 %, and turn the principal axes a little.

    Where the prior's centre has a zero, a factor would leave it: there it moves by 10 to 30 % of the mass's standard
    deviation.
    """
    moments, axes = np.linalg.eigh(prior.moments)
    deviation = np.sqrt(np.diag(prior.moments) / prior.mass)
    while True:
        com = np.where(prior.com == 0, deviation * (_factors(rng, 3) - 1), prior.com * _factors(rng, 3))
        turn = Rotation.from_rotvec(rng.uniform(-0.06, 0.06, 3)).as_matrix() @ axes
        body = _body(
            mass=prior.mass * float(_factors(rng, 1)[0]),
            com=com,
            moments=turn @ np.diag(moments * _factors(rng, 3)) @ turn.T,
        )
        if realizable(body, Q):
            return body


def true_rotor(rng: np.random.Generator, prior: Body, Q: Array, axis: Sequence[float]) -> Body:
    """Change mass and second moments by 10 to 30 %, balanced: symmetric about the axis, the centre moved along it."""
    along = np.outer(axis, axis)
    while True:
        mass, length, radius, shift = _factors(rng, 4)
        deviation = np.sqrt(np.trace(prior.moments @ along) / prior.mass)
        body = _body(
            mass=prior.mass * float(mass),
            com=prior.com + (shift - 1) * deviation * np.array(axis),
            moments=prior.moments @ (along * length + (np.eye(3) - along) * radius),
        )
        if realizable(body, Q):
            return body


def _body(mass: float, com: Array, moments: Array) -> Body:
    return Body(mass, com, np.trace(moments) * np.eye(3) - moments)
