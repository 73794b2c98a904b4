"""The paper's motion: a tip swings on an ellipsoidal shell (Wensing, Kim & Slotine, arXiv 1701.04395, section V).

Spherical angles phi and theta with rates A_phi sin(w_phi t) and A_theta sin(w_theta t), the pole along x of the root
link. The shell's place and size come from where the tip can be within the joints' limits; amplitude and rates are
reduced until the motion is within them. Joints that do not move a tip stay at home.

Letters: tip positions (3, N) in the root link [m]; q (nv, N).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline as Spline
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation
from typing_extensions import override

from idtool.common.arrays import Array, Indices
from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.names import nearest
from idtool.excitation.patterns.base import MotionSamples, Pattern, PatternSpec, smooth_step
from idtool.robot.inertia import mass_com_inertia
from idtool.robot.model import Model

PHI, THETA = 12.0, 3.4  # amplitudes of the rates [rad/s]
PHI_FREQUENCY, THETA_FREQUENCY = 1.63, 0.265  # [rad/s]
_RATE = 60.0  # Hz at which the joints' angles are solved for
_MAX_INSTANTS = 20_000  # instants
_ITERATIONS = 25  # of damped least squares
_DAMPING = 0.05  # of the tip's reach
_REACHED = 500  # random poses that tell where a tip can be
_MISSED = 0.05  # of the shell's smallest radius, by which the tip may miss it
_SMALLER, _LEAST = 0.75, 0.02  # factor by which a shell that does not fit is made smaller, and when to give up
_RAMP = 1.5  # s from home to the shell, at most a fifth of all


@dataclass(frozen=True)
class _Limb:
    """A tip: its body and place in it, the joints that move it, and its mean and spread over the workspace (3,) [m]."""

    body: int
    p: Array
    joints: Indices
    spread: Array


class Shell(Pattern):
    """Every limb's tip on a shell of its own, or that of the link named.

    x: the size of all, the share of the paper's rates, the shell's centre from the tip's home (3,) and its radii (3,),
    in units of the tip's spread over its workspace.
    """

    name = "shell"
    draws = 5

    def __init__(self, setting: PatternSpec) -> None:
        super().__init__(setting)
        self.model = setting.model
        self.limbs = self._limbs(setting.tip)
        self._solved: dict[bytes, tuple[Spline, float]] = {}

    @override
    def draw(self, rng: np.random.Generator) -> Array:
        x = np.concatenate([[1.0, 1.0], rng.uniform(-0.4, 0.4, 3), rng.uniform(0.7, 1.3, 3)])
        while x[0] > _LEAST:
            missed = self._solve(x)[1]
            q, v, a = self.motion(x, np.linspace(0, self.duration, max(int(self.duration * _RATE / 4), 100)))
            away = np.abs(q - self.home[:, None]).max(axis=1)
            if missed <= _MISSED and (away <= self.max_excursion).all():
                fast = (np.abs(v).max(axis=1) / self.limits.velocity).max()
                hard = np.sqrt((np.abs(a).max(axis=1) / self.limits.acceleration).max())
                if max(fast, hard) <= 1:
                    break
                x[1] *= 0.98 / max(fast, hard)
            else:
                x[0] *= _SMALLER
        return x

    @override
    def scaled(self, x: Array, share: Array) -> Array:
        """The whole shell about the tip's home, by the least of the shares."""
        return np.concatenate([[x[0] * share.min()], x[1:]])

    @override
    def motion(self, x: Array, t: Array) -> MotionSamples:
        spline = self._solve(x)[0]
        return MotionSamples(*(np.ascontiguousarray(spline(t, k).T) for k in range(3)))

    def _solve(self, x: Array) -> tuple[Spline, float]:
        """The joints' positions over time, and by which share of the smallest radius a tip misses its shell at most."""
        key = x.tobytes()
        if key not in self._solved:
            t = np.linspace(0, self.duration, min(max(int(self.duration * _RATE), 100), _MAX_INSTANTS) + 1)
            q, missed = np.repeat(self.home[:, None], len(t), axis=1), 0.0
            for i, limb in enumerate(self.limbs):
                target = self._target(x, t, limb, i)
                q, error = self._reach(q, target, limb)
                if len(limb.joints) >= 3:
                    missed = max(missed, error / float(x[0] * (x[5:8] * limb.spread).max()))
            still = [(1, np.zeros(len(q))), (2, np.zeros(len(q)))]
            spline = make_interp_spline(t, q.T, k=5, bc_type=(still, still))  # type: ignore[arg-type]
            self._solved = {key: (spline, missed)}
        return self._solved[key]

    def _target(self, x: Array, t: Array, limb: _Limb, turn: int) -> Array:
        """Where a tip is to be, shape (3, N): from home to the shell, along it, and home again."""
        phi = np.pi * (1 + turn / 2) + PHI / PHI_FREQUENCY * (1 - np.cos(x[1] * PHI_FREQUENCY * t))
        theta = THETA / THETA_FREQUENCY * (1 - np.cos(x[1] * THETA_FREQUENCY * t))
        unit = np.array([np.cos(theta), np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)])
        away = (x[2:5, None] + x[5:8, None] * unit) * limb.spread[:, None]
        ramp = min(_RAMP, self.duration / 5)
        window = smooth_step(t / ramp).q * smooth_step((self.duration - t) / ramp).q
        start = tip_and_jacobian(self.model, limb.body, limb.p, self.home[:, None])[0]
        return np.asarray(start + x[0] * window * away)

    def _reach(self, q: Array, target: Array, limb: _Limb) -> tuple[Array, float]:
        """Joint positions that put a tip there, by so many steps of damped least squares from home, and the error [m].

        The number of steps does not depend on the target, so that the result is as smooth as the target.
        """
        damping = (_DAMPING * float(limb.spread.max())) ** 2 * np.eye(3)
        q, error = q.copy(), np.zeros_like(target)
        for _ in range(_ITERATIONS):
            p, every = tip_and_jacobian(self.model, limb.body, limb.p, q)
            error, J = target - p, every[:, :, limb.joints]
            push = np.linalg.solve(J @ J.transpose(0, 2, 1) + damping, error.T[:, :, None])
            q[limb.joints] += (J.transpose(0, 2, 1) @ push)[:, :, 0].T
        return q, float(np.linalg.norm(error, axis=0).max())

    def _limbs(self, tip: str | None) -> tuple[_Limb, ...]:
        """The tip asked for, or tips of limbs that have no joint in common, longest first."""
        robot = self.model.robot
        if tip is not None and tip not in robot.links:
            raise ConfigError("--tip", f"{tip} is no link; {nearest(tip, robot.links)}")
        parents = {joint.parent for joint in robot.joints.values()}
        tips = [tip] if tip is not None else [link for link in reversed(robot.links) if link not in parents]
        rng, found = np.random.default_rng(0), []
        places = [place for link in tips if (place := _place(self.model, link)) is not None]
        support = self.model.support()
        free = np.ones(len(self.home), dtype=bool)
        for body, p in sorted(places, key=lambda place: -int(support[place[0]].sum())):
            joints = np.flatnonzero(support[body])
            if free[joints].all():
                poses = np.repeat(self.home[:, None], _REACHED, axis=1)
                share = rng.random((len(joints), _REACHED))
                lower, upper = self.limits.lower[joints, None], self.limits.upper[joints, None]
                poses[joints] = lower + (upper - lower) * share
                spread = tip_and_jacobian(self.model, body, p, poses)[0].std(axis=1)
                if spread.max() > 0:
                    found.append(_Limb(body, p, joints, np.maximum(spread, _MISSED * spread.max())))
                    free[joints] = False
        if not found:
            raise ModelError(robot.path, "has no tip that its joints move; give another --tip, or another --pattern")
        return tuple(found)


def tip_and_jacobian(model: Model, body: int, p: Array, q: Array) -> tuple[Array, Array]:
    """Where a point p (3,) of a body is in the root link, shape (3, N), and its Jacobian, shape (N, 3, nv).

    Parameters
    ----------
    model
        The tree of bodies.
    body, p
        Index of the body, and the point in its frame [m].
    q
        Joint positions, shape (nv, N).
    """
    chain = [body]
    while model.bodies[chain[-1]].mount.body >= 0:
        chain.append(model.bodies[chain[-1]].mount.body)
    count = q.shape[1]
    R, x = np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3))
    axes = []
    for part in (model.bodies[i] for i in reversed(chain)):
        x, R = x + R @ part.mount.p, R @ part.mount.R
        axis = R @ part.axis
        phi = part.ratios @ q + part.offset
        if part.prismatic:
            x = x + axis * phi[:, None]
        else:
            R = R @ Rotation.from_rotvec(part.axis * phi[:, None]).as_matrix()
        axes.append((part, axis, x))
    tip = x + R @ p
    J = np.zeros((count, 3, len(q)))
    for part, axis, origin in axes:
        way = axis if part.prismatic else np.cross(axis, tip - origin)
        J += way[:, :, None] * part.ratios
    return tip.T, J


def _place(model: Model, link: str) -> tuple[int, Array] | None:
    """The moving body that a link is part of, and the link's origin in it, joints between them at zero.

    A link that is itself a moving body has its origin at its joint; its far end is about twice as far as its centre of
    mass.
    """
    bodies = {body.name: i for i, body in enumerate(model.bodies) if body.kind == "link"}
    joints = {joint.child: joint for joint in model.robot.joints.values()}
    if link in bodies:
        mass, com, _ = mass_com_inertia(model.bodies[bodies[link]].pi)
        return bodies[link], 2 * com if mass > 0 else np.zeros(3)
    p = np.zeros(3)
    while link not in bodies:
        if link not in joints:
            return None
        p = joints[link].p + joints[link].R @ p
        link = joints[link].parent
    return bodies[link], p
