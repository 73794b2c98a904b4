"""Motion of every body of the tree, for a whole batch of samples at once.

Letters, all in the body's own frame, component first: w angular velocity [rad/s] and alpha its derivative [rad/s²],
acc acceleration of the frame's origin less gravity [m/s²], each (3, N); for the k coordinates that move the body, S_w
and S_v its angular and linear velocity per unit of that coordinate's, each (3, k, N). q, v, a are (nv, N). A last axis
of length 1 stands for all samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array, Indices
from idtool.robot.body import Body
from idtool.robot.inertia import skew
from idtool.robot.model import Model


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
    coordinates: Indices

    @cached_property
    def M(self) -> Array:  # noqa: N802
        """A point x of the body has the acceleration acc + M x: M = S(alpha) + S(w)², shape (3, 3, N) [1/s²]."""
        w, alpha = self.w, self.alpha
        M = w[:, None] * w
        square = M[0, 0] + M[1, 1] + M[2, 2]
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            M[i, i] -= square
            M[i, j] -= alpha[k]
            M[j, i] += alpha[k]
        return M


def cross(a: Array, b: Array) -> Array:
    """Cross product along the first axis; much faster than numpy's for long last axes."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


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
    for body, moved in zip(model.bodies, model.support(), strict=True):
        parent = base if body.mount.body < 0 else motions[body.mount.body]
        own = np.array([body.ratios @ x for x in (q, v, a)])
        motions.append(_step(body, parent, own, np.flatnonzero(moved)))
    return motions


def body_placements(model: Model, q: Array) -> dict[int, tuple[Array, Array]]:
    """Where every body's frame is in the root link, by index; −1 is the root link.

    Parameters
    ----------
    model
        The tree.
    q
        Positions of the joints, shape (nv, N).

    Returns
    -------
    Rotation R, shape (N, 3, 3) or (1, 3, 3), and position p [m], shape (N, 3) or (1, 3).
    """
    places = {-1: (np.eye(3)[None], np.zeros((1, 3)))}
    for i, body in enumerate(model.bodies):
        R, p = places[body.mount.body]
        phi = (body.ratios @ q + body.offset)[:, None]
        R, p = R @ body.mount.R, p + R @ body.mount.p
        if body.prismatic:
            places[i] = R, p + R @ body.axis * phi
        else:
            places[i] = R @ Rotation.from_rotvec(body.axis * phi).as_matrix(), p
    return places


def _step(body: Body, parent: BodyMotion, own: Array, coordinates: Indices) -> BodyMotion:
    """A body's motion from its parent's and its own along its axis, ``own`` = phi less its offset, dphi, ddphi."""
    phi, dphi, ddphi = own
    phi = phi + body.offset
    axis = body.axis[:, None]
    p = body.mount.p[:, None]
    if body.prismatic:
        p = p + (body.mount.R @ axis) * phi
    R = _rotation(body, phi)
    w, alpha, acc = (_times(R, x) for x in (parent.w, parent.alpha, parent.acc + _times(parent.M, p)))
    inherited = np.searchsorted(coordinates, parent.coordinates)
    S_w, S_v = np.zeros((2, 3, len(coordinates), len(phi)))
    S_w[:, inherited] = _times(R, parent.S_w)
    S_v[:, inherited] = _times(R, parent.S_v + cross(parent.S_w, p[:, None]))
    by_coordinate = axis[:, :, None] * body.ratios[coordinates, None]
    if body.prismatic:
        acc = acc + 2 * cross(w, axis * dphi) + axis * ddphi
        S_v += by_coordinate
    else:
        spin = axis * dphi
        alpha = alpha + axis * ddphi + cross(w, spin)
        w = w + spin
        S_w += by_coordinate
    return BodyMotion(w, alpha, acc, S_w, S_v, coordinates)


def _rotation(body: Body, phi: Array) -> Array:
    """From the parent's frame into the body's (Rodrigues' formula, backwards), shape (3, 3, N) or (3, 3, 1)."""
    mount = body.mount.R.T
    if body.prismatic:
        return mount[:, :, None]
    S = skew(body.axis)
    # exp(−S phi) = 1 + S² − S sin(phi) − S² cos(phi)
    terms = np.stack([mount + S @ S @ mount, -S @ mount, -S @ S @ mount], axis=-1)
    return np.asarray(terms @ np.array([np.ones_like(phi), np.sin(phi), np.cos(phi)]))


def _times(R: Array, x: Array) -> Array:
    """Matrices (3, 3, N) times vectors (3, N) or (3, k, N)."""
    return np.asarray(np.einsum("ij...,j...->i...", R, x))
