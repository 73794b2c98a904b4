"""Motion of every body of the tree, for a whole batch of samples at once.

Letters, all in the body's own frame, component first: w angular velocity [rad/s] and alpha its derivative [rad/s²],
acc acceleration of the frame's origin less gravity [m/s²], each (3, N); for the k coordinates that move the body, S_w
and S_v its angular and linear velocity per unit of that coordinate's, each (3, k, N). q, v, a are (nv, N). A last axis
of length 1 stands for all samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idtool.body import Body
from idtool.inertia import skew
from idtool.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BodyMotion:
    """One body's motion.

    Attributes
    ----------
    w, alpha, acc
        Angular velocity, angular acceleration, and linear acceleration less gravity; shape (3, N) or (3, 1).
    S_w, S_v
        Columns of the body's Jacobian, shape (3, k, N) or (3, k, 1).
    coordinates
        The k coordinates, ascending.
    """

    w: Array
    alpha: Array
    acc: Array
    S_w: Array
    S_v: Array
    coordinates: NDArray[np.intp]


def cross(a: Array, b: Array) -> Array:
    """Cross product along the first axis; much faster than numpy's for long last axes."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def body_motions(model: Model, q: Array, v: Array, a: Array) -> list[BodyMotion]:
    """The motion of every body, by the forward recursion of Newton and Euler (2), (3).

    Parameters
    ----------
    model
        The tree.
    q, v, a
        Positions, velocities, accelerations of the joints, shape (nv, N).
    """
    still = np.zeros((3, 1))
    none = np.zeros((3, 0, 1))
    base = BodyMotion(still, still, -model.gravity[:, None], none, none, np.zeros(0, dtype=np.intp))
    motions: list[BodyMotion] = []
    for body in model.bodies:
        parent = base if body.mount.body < 0 else motions[body.mount.body]
        motions.append(_step(body, parent, q, v, a))
    return motions


def _step(body: Body, parent: BodyMotion, q: Array, v: Array, a: Array) -> BodyMotion:
    moved = np.flatnonzero(body.ratios)
    ratios = body.ratios[moved]
    phi, dphi, ddphi = ratios @ q[moved] + body.offset, ratios @ v[moved], ratios @ a[moved]
    p = body.mount.p[:, None]
    if body.prismatic:
        p = p + (body.mount.R @ body.axis)[:, None] * phi
    acc = parent.acc + cross(parent.alpha, p) + cross(parent.w, cross(parent.w, p))
    S_v = parent.S_v + cross(parent.S_w, p[:, None])
    # One rotation for everything: columns are w, alpha, acc, then the Jacobian's.
    inherited = _into(body, phi, _side_by_side(parent.w, parent.alpha, acc, parent.S_w, S_v))
    k = len(parent.coordinates)
    w, alpha, acc = inherited[:, 0], inherited[:, 1], inherited[:, 2]
    S_w, S_v = inherited[:, 3 : 3 + k], inherited[:, 3 + k :]
    axis = body.axis[:, None]
    coordinates = np.union1d(parent.coordinates, moved)
    if body.prismatic:
        acc = acc + 2 * cross(w, axis * dphi) + axis * ddphi
        S_v = _with_axis(S_v, parent.coordinates, coordinates, body)
        S_w = _spread(S_w, parent.coordinates, coordinates)
    else:
        spin = axis * dphi
        alpha = alpha + axis * ddphi + cross(w, spin)
        w = w + spin
        S_w = _with_axis(S_w, parent.coordinates, coordinates, body)
        S_v = _spread(S_v, parent.coordinates, coordinates)
    return BodyMotion(w, alpha, acc, S_w, S_v, coordinates)


def _side_by_side(w: Array, alpha: Array, acc: Array, S_w: Array, S_v: Array) -> Array:
    length = max(x.shape[-1] for x in (w, alpha, acc, S_w, S_v))
    parts = [w[:, None], alpha[:, None], acc[:, None], S_w, S_v]
    return np.concatenate([np.broadcast_to(x, (3, x.shape[1], length)) for x in parts], axis=1)


def _into(body: Body, phi: Array, x: Array) -> Array:
    """Rotate vectors (3, m, N) from the parent's frame into the body's (Rodrigues' formula, backwards)."""
    x = np.tensordot(body.mount.R.T, x, axes=1)
    if body.prismatic:
        return x
    S = skew(body.axis)
    # exp(−S phi) = 1 − S sin(phi) + S² (1 − cos(phi))
    R = np.eye(3)[:, :, None] - S[:, :, None] * np.sin(phi) + (S @ S)[:, :, None] * (1 - np.cos(phi))
    return np.stack([R[i, 0] * x[0] + R[i, 1] * x[1] + R[i, 2] * x[2] for i in range(3)])


def _spread(S: Array, coordinates: NDArray[np.intp], wider: NDArray[np.intp]) -> Array:
    """Jacobian columns for more coordinates, zero where new."""
    if len(coordinates) == len(wider):
        return S
    out = np.zeros((3, len(wider), S.shape[-1]))
    out[:, np.searchsorted(wider, coordinates)] = S
    return out


def _with_axis(S: Array, coordinates: NDArray[np.intp], wider: NDArray[np.intp], body: Body) -> Array:
    """The same, with the body's own motion added."""
    out = np.array(_spread(S, coordinates, wider))
    out += body.axis[:, None, None] * body.ratios[wider][None, :, None]
    return out
