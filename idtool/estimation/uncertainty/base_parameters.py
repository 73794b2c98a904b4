"""Base parameters: the combinations of the coefficients that the torque depends on, and no others.

The columns of Y are linearly dependent whatever the motion (Gautier & Khalil 1990). A rank-revealing QR takes a largest
set of independent ones; every other column is a combination of these, so that

    Y theta = Y_own beta,  beta = B theta,

with r base parameters beta (Gautier 1991). As in the literature, a combination is called after the coefficient nearest
to the base of the robot.

Letters: p coefficients theta; r base parameters beta; B (r, p).
"""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.linear_algebra import compressed_rows
from idtool.data.signals import Motion
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.weights import without_rounding
from idtool.robot.inertia import PI_SIZE
from idtool.robot.model import RobotModel

_RANK = 1e-5  # of a column: what the others leave of it by less is rounding, such as that of 1.5708 in a URDF
_ZERO = 1e-5  # of a column, as a share of a combination: the same
_SECONDS = 30.0  # of a random motion
_SAMPLES = (300, 1500)  # of it: fewest, however much memory their columns take, and most
_BYTES = 64 << 20  # that these columns may take
_TONES = 7  # per joint
_HIGHEST_FREQUENCY = 1.5  # Hz
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
    nonzero = np.flatnonzero(size > 0)
    R = np.asarray(np.linalg.qr(Y[:, nonzero] / size[nonzero], mode="r")) if len(nonzero) else np.zeros((0, 0))
    column_of = {int(k): i for i, k in enumerate(nonzero)}
    Q: Array = np.zeros((len(R), 0))
    own: list[int] = []
    for k in order.tolist():
        if k not in column_of:
            continue
        rest = R[:, column_of[k]]
        for _ in range(2):  # once more: what the first projection leaves of a dependent column is rounding
            rest = rest - Q @ (Q.T @ rest)
        norm = float(np.linalg.norm(rest))
        if norm > _RANK:
            Q = np.column_stack([Q, rest / norm])
            own.append(k)
    own.sort()
    B = np.zeros((len(own), Y.shape[1]))
    if own:
        shares = np.linalg.lstsq(R[:, [column_of[k] for k in own]], R, rcond=None)[0]
        shares[np.abs(shares) < _ZERO] = 0.0
        B[:, nonzero] = shares * size[nonzero] / size[own][:, None]
    return BaseParameters(np.array(own, dtype=np.intp), B)


def structural_base_parameters(
    model: RobotModel, equation: LinearModel, equalities: EqualityConstraints | None = None
) -> BaseParameters:
    """The base parameters that the best of motions could determine.

    Parameters
    ----------
    model
        The tree of bodies.
    equation
        The torque equation.
    equalities
        Only the copies count: a combination names the coefficients that they are copies of.
    """
    p = len(equation.coefficients)
    equalities = equalities or EqualityConstraints.none(p)
    active = equation.active_in_columns()
    bytes_per_sample = 8 * sum(len(columns) + 1 for columns in active)
    samples = int(np.clip(_BYTES // bytes_per_sample, *_SAMPLES))
    factors = []
    for columns, block in zip(active, equation.columns(random_motion(model, samples)), strict=True):
        R = np.asarray(np.linalg.qr(block[:-1].T, mode="r"))
        factors.append((R, columns))
    Y = compressed_rows(factors, p)
    order = np.argsort(equalities.free < PI_SIZE * len(model.bodies), kind="stable")  # friction bears its own name
    base = base_parameters(equalities.free_columns(without_rounding(Y, equation, _RANK)), order)
    B = np.zeros((len(base), p))
    B[:, equalities.free] = base.B
    return BaseParameters(equalities.free[base.own], B)


def random_motion(model: RobotModel, samples: int) -> Motion:
    """A smooth motion without any regularity, limits not regarded; what depends on time or history can be told too."""
    rng = np.random.default_rng(0)
    dt = _SECONDS / samples
    t: Array = dt * np.arange(samples, dtype=np.float64)
    nv = len(model.joints)
    size = np.array([_RANGE["prismatic" if joint.kind == "prismatic" else "revolute"] for joint in model.joints])
    w = 2 * np.pi * rng.uniform(0.05, _HIGHEST_FREQUENCY, (nv, _TONES, 1))
    amplitude = size[:, None, None] * np.sqrt(2 / _TONES) * rng.uniform(0.5, 1.5, (nv, _TONES, 1))
    phase = w * t + rng.uniform(0, 2 * np.pi, (nv, _TONES, 1))
    q = (amplitude * np.sin(phase)).sum(axis=1) + rng.uniform(-1, 1, (nv, 1)) * size[:, None]
    v = (amplitude * w * np.cos(phase)).sum(axis=1)
    a: Array = -(amplitude * np.square(w) * np.sin(phase)).sum(axis=1)
    tau = rng.normal(size=q.shape)
    return Motion(t, q, v, a, tau, tau, np.full(nv, 1e-3), dt)
