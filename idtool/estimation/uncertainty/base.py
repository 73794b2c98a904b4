"""Base parameters: the combinations of the coefficients that the torque depends on, and no others.

The columns of Y are linearly dependent whatever the motion (Gautier & Khalil 1990). A rank-revealing QR takes a largest
set of independent ones; every other column is a combination of these, so that

    Y theta = Y_own beta,  beta = B theta,

with r base parameters beta (Gautier 1991). As in the literature, a combination is called after the coefficient nearest
to the base of the robot.

Letters: p coefficients theta; r base parameters beta; B (r, p).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.data.signals import Motion
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.knowledge import Knowledge
from idtool.robot.inertia import SIZE
from idtool.robot.model import Model

_RANK = 1e-5  # of a column: what the others leave of it by less is rounding, such as that of 1.5708 in a URDF
_ZERO = 1e-5  # of a column, as a share of a combination: the same
_SAMPLES, _DT = 1500, 0.02  # of a random motion [s]
_TONES = 7  # a joint
_FASTEST = 1.5  # Hz
_RANGE = {"revolute": 1.5, "prismatic": 0.5}  # rad or m, rms


@dataclass(frozen=True)
class BaseParameters:
    """Combinations of the coefficients.

    Attributes
    ----------
    own
        Index of the coefficient that each is called after, shape (r,); its share of the combination is 1.
    B
        The combinations, shape (r, p).
    """

    own: Indices
    B: Array

    def __len__(self) -> int:
        return len(self.own)


def base_parameters(Y: Array, order: Indices) -> BaseParameters:
    """The base parameters of a regressor.

    Parameters
    ----------
    Y
        Any matrix with the regressor's rows or their triangular factor, shape (rows, p).
    order
        All columns, those first after which combinations are to be called, shape (p,).
    """
    size = np.linalg.norm(Y, axis=0)
    seen = np.flatnonzero(size > 0)
    R = np.asarray(np.linalg.qr(Y[:, seen] / size[seen], mode="r")) if len(seen) else np.zeros((0, 0))
    place = {int(k): i for i, k in enumerate(seen)}
    Q: Array = np.zeros((len(R), 0))
    own: list[int] = []
    for k in (int(k) for k in order if int(k) in place):
        rest = R[:, place[k]]
        for _ in range(2):  # once more: what the first projection leaves of a dependent column is rounding
            rest = rest - Q @ (Q.T @ rest)
        left = float(np.linalg.norm(rest))
        if left > _RANK:
            Q = np.column_stack([Q, rest / left])
            own.append(k)
    own.sort()
    B = np.zeros((len(own), Y.shape[1]))
    if own:
        shares = np.linalg.lstsq(R[:, [place[k] for k in own]], R, rcond=None)[0]
        shares[np.abs(shares) < _ZERO] = 0.0
        B[:, seen] = shares * size[seen] / size[own][:, None]
    return BaseParameters(np.array(own, dtype=np.intp), B)


def structural_base(model: Model, equation: LinearModel, known: Knowledge | None = None) -> BaseParameters:
    """The base parameters that the best of motions could tell.

    Parameters
    ----------
    model
        The tree of bodies.
    equation
        The torque equation.
    known
        Of which only the copies count: a combination names the coefficients that they are copies of.
    """
    p = len(equation.coefficients)
    known = known or Knowledge.none(p)
    motion, factors = random_motion(model), []
    for columns, block in zip(equation.active(), equation.columns(motion), strict=True):
        R = np.linalg.qr(block[:-1].T, mode="r")
        factors.append(np.zeros((len(R), p)))
        factors[-1][:, columns] = R
    Y = np.concatenate(factors)
    order = np.argsort(known.free < SIZE * len(model.bodies), kind="stable")  # friction bears its own name
    base = base_parameters(felt(Y, equation, _RANK) @ known.K, order)
    B = np.zeros((len(base), p))
    B[:, known.free] = base.B
    return BaseParameters(known.free[base.own], B)


def felt(Y: Array, equation: LinearModel, rounding: float) -> Array:
    """Rows, shape (rows, p), without what is rounding beside the rest of a body.

    Parameters
    ----------
    Y
        The regressor's rows or their triangular factor.
    equation
        The torque equation.
    rounding
        Effect of a parameter of typical size, relative to the body's largest, below which it is none.
    """
    size = np.linalg.norm(Y, axis=0) * [c.scale or 0.0 for c in equation.coefficients]
    bodies = size[: len(size) // SIZE * SIZE].reshape(-1, SIZE)
    small = np.zeros(len(size), dtype=bool)
    small[: bodies.size] = ((bodies > 0) & (bodies < rounding * bodies.max(axis=1, keepdims=True))).ravel()
    return np.where(small, 0.0, Y)


def random_motion(model: Model, seed: int = 0) -> Motion:
    """A smooth motion without any regularity, limits not regarded; what depends on time or history can be told too."""
    rng = np.random.default_rng(seed)
    t: Array = _DT * np.arange(_SAMPLES, dtype=np.float64)
    nv = len(model.joints)
    size = np.array([_RANGE["prismatic" if joint.kind == "prismatic" else "revolute"] for joint in model.joints])
    w = 2 * np.pi * rng.uniform(0.05, _FASTEST, (nv, _TONES, 1))
    amplitude = size[:, None, None] * np.sqrt(2 / _TONES) * rng.uniform(0.5, 1.5, (nv, _TONES, 1))
    phase = w * t + rng.uniform(0, 2 * np.pi, (nv, _TONES, 1))
    q = (amplitude * np.sin(phase)).sum(axis=1) + rng.uniform(-1, 1, (nv, 1)) * size[:, None]
    v = (amplitude * w * np.cos(phase)).sum(axis=1)
    a: Array = -(amplitude * np.square(w) * np.sin(phase)).sum(axis=1)
    tau = rng.normal(size=q.shape)
    return Motion(t, q, v, a, tau, tau, np.full(nv, 1e-3), _DT)
