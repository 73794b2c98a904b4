"""`JointRotation`: the rotation between a body's frame and its parent's, of many samples at once.

About a coordinate axis, it mixes two components of a vector and leaves the third: less work than a matrix for each
sample. For any other axis, the frames are turned by constant matrices so that it is one.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass


@dataclass(frozen=True)
class JointRotation:
    """Change of coordinates from the parent's axes to the body's: after · (turn about a coordinate axis) · before.

    Attributes
    ----------
    before, after
        Constant matrices, from the parent's axes to those of the turn and from these to the body's, shape (3, 3);
        None: the identity.
    axis
        Index of the coordinate axis of the turn.
    cos, sin
        Of the angle by which the body has turned about it, shape (N,); None: there is no turn.
    """

    before: Array | None = None
    after: Array | None = None
    axis: int = 0
    cos: Array | None = None
    sin: Array | None = None

    @classmethod
    def about(cls, mount: Array, axis: Array, angle: Array) -> JointRotation:
        """The rotation of a body that turns in its mount.

        Parameters
        ----------
        mount
            Rotation of the body's frame in its parent's at an angle of 0, shape (3, 3).
        axis
            Unit vector of the turn in the body's frame, shape (3,).
        angle
            Angle of the turn, shape (N,) [rad].
        """
        cos, sin = np.cos(angle), np.sin(angle)
        if np.count_nonzero(axis) == 1:
            i = int(np.argmax(np.abs(axis)))
            signed_sin = axis[i] * sin
            return cls(_unless_identity(mount.T), None, i, cos, signed_sin)
        to_x = _rotation_to_x(axis)
        return cls(to_x @ mount.T, to_x.T, 0, cos, sin)

    @classmethod
    def constant(cls, mount: Array) -> JointRotation:
        """The rotation of a body that does not turn in its mount, whose rotation is given as in `about`."""
        return cls(_unless_identity(mount.T))

    def to_body(self, x: Array) -> Array:
        """Vectors along the body's axes, from those along the parent's; shape (3, ..., N) or (3, ..., 1)."""
        before_turn = _product(self.before, x)
        after_turn = self._turned(before_turn, self.sin)
        return _product(self.after, after_turn)

    def to_parent(self, x: Array) -> Array:
        """Vectors along the parent's axes, from those along the body's; shape (3, ..., N) or (3, ..., 1)."""
        x = _product(None if self.after is None else self.after.T, x)
        turned = self._turned(x, None if self.sin is None else -self.sin)
        return _product(None if self.before is None else self.before.T, turned)

    @cached_property
    def matrix(self) -> Array:
        """The rotation from the parent's axes to the body's, shape (3, 3, N) or (3, 3, 1)."""
        return self.to_body(np.eye(3)[:, :, None])

    def _turned(self, x: Array, sin: Array | None) -> Array:
        """Components along axes that were turned by an angle with this sine, shape (3, ..., N)."""
        if self.cos is None or sin is None:
            return x
        i, j, k = self.axis, (self.axis + 1) % 3, (self.axis + 2) % 3
        turned = np.empty((*x.shape[:-1], len(sin)))
        turned[i] = x[i]
        np.multiply(self.cos, x[j], out=turned[j])
        turned[j] += sin * x[k]
        np.multiply(self.cos, x[k], out=turned[k])
        turned[k] -= sin * x[j]
        return turned


def _rotation_to_x(axis: Array) -> Array:
    """A rotation that takes a unit vector to the x axis, shape (3, 3)."""
    across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    across /= np.linalg.norm(across)
    return np.stack([axis, across, np.cross(axis, across)])


def _unless_identity(R: Array) -> Array | None:
    """A rotation matrix, or None for the identity."""
    return None if np.array_equal(R, np.eye(3)) else R


def _product(R: Array | None, x: Array) -> Array:
    """A constant rotation of vectors, shape (3, ..., N)."""
    return x if R is None else np.tensordot(R, x, axes=1)
