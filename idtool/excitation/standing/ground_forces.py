"""Forces of the ground on the feet of a robot that stands, and what the ground can exert.

With more than six components, the forces are not determined by the motion alone. Joint controllers without a force
controller above them yield to a torque tau by tau / kp each, so that the forces are those with the least Σ tau² / kp:
of all that hold the motion, the elastic energy in the controllers is least. A motion is feasible if these forces are
within the friction cones, press on the ground everywhere, and have their centre of pressure inside the soles.

Letters: F (k, N) components of the wrenches of all feet along the axes of the world, J (N, k, nv) their Jacobian.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.excitation.standing.feet import Foot

_RIDGE = 1e-9  # of the largest diagonal entry: forces that take no torque, as along a straight leg, are equal
_MIN_NORMAL = 1e-6  # N, in place of less where a ratio is reported


@dataclass(frozen=True)
class GroundLimits:
    """Limits of the forces between the feet and the ground.

    Attributes
    ----------
    friction_coefficient
        Largest ratio of the force along the ground to that across it.
    min_load
        Least force across the ground on each foot [N].
    sole_share
        Share of the sole, about its middle, in which the centre of pressure stays.
    force_error
        Error of the force along the ground that the friction of each foot must bear beside the predicted force [N].
    """

    friction_coefficient: float
    min_load: float
    sole_share: float
    force_error: float


@dataclass(frozen=True)
class GroundLoads:
    """Loads of the feet along a motion.

    Attributes
    ----------
    normal
        Force across the ground, shape (feet, N) [N].
    friction
        Ratio of the force along the ground to that across it; of soles also that of the moment about the vertical to
        what friction at the edge of the sole would exert; shape (feet, N).
    pressure
        Distance of the centre of pressure from the middle of the sole, as a share of half its size; 0 for points; shape
        (feet, N).
    """

    normal: Array
    friction: Array
    pressure: Array


class GroundForces:
    """Forces on the feet that hold a motion.

    Parameters
    ----------
    feet
        The feet.
    stiffness
        Of the joint controllers, shape (n,); only their ratios count.
    limits
        What the ground exerts at most.
    """

    def __init__(self, feet: Sequence[Foot], stiffness: Array, limits: GroundLimits) -> None:
        self.feet = tuple(feet)
        self.limits = limits
        self._compliance = 1 / stiffness
        self._joints = len(stiffness)
        starts = np.cumsum([0, *(foot.size for foot in self.feet)])
        self._parts = [slice(int(start), int(end)) for start, end in pairwise(starts)]

    def distribute(self, J: Array, required: Array) -> tuple[Array, Array]:
        """The forces with the least elastic energy, and the torques of the joints that go with them.

        Parameters
        ----------
        J
            Jacobian of the feet, shape (N, k, nv).
        required
            Generalized force that the motion takes, shape (nv, N) [N·m or N].

        Returns
        -------
        F, shape (k, N), and torques, shape (n, N).
        """
        n = self._joints
        base = slice(J.shape[2] - 6, J.shape[2])
        J_joints, J_base = J[:, :, :n], J[:, :, base]
        weighted = J_joints * self._compliance
        H = weighted @ J_joints.transpose(0, 2, 1)
        ridge = _RIDGE * np.maximum(np.trace(H, axis1=1, axis2=2), np.finfo(float).tiny)
        H = H + ridge[:, None, None] * np.eye(H.shape[1])
        g = weighted @ required[:n].T[:, :, None]
        solved = np.linalg.solve(H, np.concatenate([g, J_base], axis=2))
        free, by_base = solved[:, :, :1], solved[:, :, 1:]
        missing = required[base].T[:, :, None] - J_base.transpose(0, 2, 1) @ free
        multiplier = np.linalg.solve(J_base.transpose(0, 2, 1) @ by_base, missing)
        F = (free + by_base @ multiplier)[:, :, 0]
        torque = required[:n] - np.einsum("nkj,nk->jn", J_joints, F)
        return F.T, torque

    def loads(self, F: Array, R: Sequence[Array]) -> GroundLoads:
        """Loads of the feet.

        Parameters
        ----------
        F
            Components of all wrenches, shape (k, N).
        R
            Rotation of every foot's link at the stance, shape (3, 3) each, along whose axes a sole extends.
        """
        count = F.shape[1]
        normal, friction, pressure = np.zeros((3, len(self.feet), count))
        for i, (foot, part) in enumerate(zip(self.feet, self._parts, strict=True)):
            wrench = F[part]
            normal[i] = wrench[2]
            positive = np.maximum(wrench[2], _MIN_NORMAL)
            friction[i] = np.hypot(wrench[0], wrench[1]) / positive
            if foot.sole is None:
                continue
            middle = foot.sole.mean(axis=0)
            half = (foot.sole[1] - foot.sole[0]) / 2
            moment = R[i].T @ wrench[3:]
            force = R[i].T @ wrench[:3]
            center = np.stack([-moment[1], moment[0]]) / positive - middle[:, None]
            pressure[i] = np.abs(center / half[:, None]).max(axis=0)
            about_center = moment[2] - (center[0] + middle[0]) * force[1] + (center[1] + middle[1]) * force[0]
            friction[i] = np.maximum(friction[i], np.abs(about_center) / (np.hypot(*half) * positive))
        return GroundLoads(normal, friction, pressure)

    def limit_shares(self, loads: GroundLoads) -> GroundLoads:
        """Loads as shares of their limits, 1 at the limit: of the least force, of friction and of the sole.

        Parameters
        ----------
        loads
            The loads.
        """
        limits = self.limits
        normal = np.maximum(loads.normal, _MIN_NORMAL)
        friction = (loads.friction + limits.force_error / normal) / limits.friction_coefficient
        return GroundLoads(limits.min_load / normal, friction, loads.pressure / limits.sole_share)

    def violations(self, loads: GroundLoads, even_load: float, margin: float = 0.0) -> Array:
        """By how much the loads are beyond the limits, as shares of an even load, shape (N,); 0 within them.

        Parameters
        ----------
        loads
            The loads.
        even_load
            Weight per foot [N].
        margin
            By which the limits are tighter, as a share of an even load.
        """
        limits = self.limits
        normal = loads.normal
        share = np.maximum(normal, _MIN_NORMAL) / even_load
        unexpected = margin + limits.force_error / even_load
        lifted = np.maximum((limits.min_load - normal) / even_load + margin, 0.0)
        slipping = np.maximum(unexpected + (loads.friction - limits.friction_coefficient) * share, 0.0)
        tipping = np.maximum((loads.pressure - limits.sole_share) * share + margin, 0.0)
        return np.asarray(np.sqrt(np.square(np.stack([lifted, slipping, tipping])).sum(axis=(0, 1))))
