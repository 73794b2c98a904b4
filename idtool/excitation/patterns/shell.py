"""The paper's motion: a tip swings on an ellipsoidal shell (Wensing, Kim & Slotine, arXiv 1701.04395, section V).

Spherical angles phi and theta with rates A_phi sin(w_phi t) and A_theta sin(w_theta t), the pole along x of the root
link. The shell's centre and size come from the tip's workspace within the joints' limits; amplitude and rates are
reduced until the motion is within them. Joints that do not move a tip stay at home.

Letters: tip positions (3, N) in the root link [m]; q (nv, N).
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline as Spline
from scipy.interpolate import make_interp_spline
from typing_extensions import override

from idtool.common.arrays import Array, Indices
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, ModelError
from idtool.common.names import suggestion
from idtool.excitation.patterns.base import MotionSamples, Pattern, PatternSpec, smooth_step
from idtool.robot.inertia import mass_com_inertia
from idtool.robot.model import RobotModel
from idtool.robot.rotation import rotation_about

PHI_RATE = 12.0  # amplitude of the rate [rad/s]
PHI_FREQUENCY = 1.63  # [rad/s]
THETA_RATE = 3.4  # amplitude of the rate [rad/s]
THETA_FREQUENCY = 0.265  # [rad/s]
_RATE = 60.0  # Hz, of the inverse kinematics
_MAX_INSTANTS = 20_000  # instants
_ITERATIONS = 25  # of damped least squares
_DAMPING = 0.05  # of the tip's spread over its workspace
_WORKSPACE_POSES = 500  # random ones, for a tip's workspace
_TOLERANCE = 0.05  # of the shell's largest radius, for the tip's distance from it
_MIN_SPREAD = 0.05  # in any direction, of that in the widest
_SHRINKING = 0.75  # factor on the size of a shell that does not fit
_MIN_SIZE = 0.02  # of a shell, at which the search ends
_RAMP = 1.5  # s from home to the shell, at most a fifth of the duration


@dataclass(frozen=True)
class _Limb:
    """A tip: body and point p (3,) in it, the joints that move it, and its spread over the workspace (3,) [m]."""

    body: int
    p: Array
    joints: Indices
    spread: Array


class Shell(Pattern):
    """Every limb's tip on a shell of its own, or only that of the named link.

    x: the size of the whole, the share of the paper's rates, the shell's centre from the tip's home (3,) and its radii
    (3,), in units of the tip's spread over its workspace.
    """

    name = "shell"
    draws = 5

    def __init__(self, spec: PatternSpec) -> None:
        super().__init__(spec)
        self.model = spec.model
        self.limbs = self._limbs(spec.tip)
        self._solution: dict[bytes, tuple[Spline, float]] = {}  # of the last x

    @override
    def draw(self, rng: np.random.Generator) -> Array:
        x = np.concatenate([[1.0, 1.0], rng.uniform(-0.4, 0.4, 3), rng.uniform(0.7, 1.3, 3)])
        while x[0] > _MIN_SIZE:
            _, error = self._solve(x)
            t = np.linspace(0, self.duration, max(int(self.duration * _RATE / 4), 100))
            q, v, a = self.motion(x, t)
            excursion = np.abs(q - self.home[:, None]).max(axis=1)
            fits = error <= _TOLERANCE and (excursion <= self.max_excursion).all()
            if not fits:
                x[0] *= _SHRINKING
                continue
            by_velocity = (np.abs(v).max(axis=1) / self.limits.velocity).max()
            by_acceleration = np.sqrt((np.abs(a).max(axis=1) / self.limits.acceleration).max())
            rate = max(by_velocity, by_acceleration)  # of the motion, over that at the limits
            if rate <= 1:
                break
            x[1] *= 0.98 / rate
        return x

    @override
    def scaled(self, x: Array, share: Array) -> Array:
        # The whole shell about the tip's home, by the smallest of the shares.
        return np.concatenate([[x[0] * share.min()], x[1:]])

    @override
    def motion(self, x: Array, t: Array) -> MotionSamples:
        spline = self._solve(x)[0]
        return MotionSamples(*(np.ascontiguousarray(spline(t, k).T) for k in range(3)))

    def _solve(self, x: Array) -> tuple[Spline, float]:
        """The joints' positions over time, and the largest error of a tip relative to its shell's largest radius."""
        key = x.tobytes()
        if key not in self._solution:
            intervals = min(max(int(self.duration * _RATE), 100), _MAX_INSTANTS)
            t = np.linspace(0, self.duration, intervals + 1)
            q = np.repeat(self.home[:, None], len(t), axis=1)
            largest_error = 0.0
            for i, limb in enumerate(self.limbs):
                target = self._target(x, t, limb, i)
                q, error = self._inverse_kinematics(q, target, limb)
                if len(limb.joints) >= 3:
                    radius = float(x[0] * (x[5:8] * limb.spread).max())
                    largest_error = max(largest_error, error / radius)
            zero = np.zeros(len(q))
            at_rest = [(1, zero), (2, zero)]  # first and second derivative at an end
            spline = make_interp_spline(t, q.T, k=5, bc_type=(at_rest, at_rest))  # type: ignore[arg-type]
            self._solution = {key: (spline, largest_error)}
        return self._solution[key]

    def _target(self, x: Array, t: Array, limb: _Limb, index: int) -> Array:
        """Target of a tip, shape (3, N): from home to the shell, along it, and home again."""
        phi = np.pi * (1 + index / 2) + PHI_RATE / PHI_FREQUENCY * (1 - np.cos(x[1] * PHI_FREQUENCY * t))
        theta = THETA_RATE / THETA_FREQUENCY * (1 - np.cos(x[1] * THETA_FREQUENCY * t))
        direction = np.array([np.cos(theta), np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)])
        offset = (x[2:5, None] + x[5:8, None] * direction) * limb.spread[:, None]
        ramp = min(_RAMP, self.duration / 5)
        window = smooth_step(t / ramp).q * smooth_step((self.duration - t) / ramp).q
        start, _ = tip_and_jacobian(self.model, limb.body, limb.p, self.home[:, None])
        return np.asarray(start + x[0] * window * offset)

    def _inverse_kinematics(self, q: Array, target: Array, limb: _Limb) -> tuple[Array, float]:
        """Joint positions that bring a tip to its target, by damped least squares from home, and the error [m].

        The number of steps does not depend on the target, so that the result is as smooth as the target.
        """
        damping = (_DAMPING * float(limb.spread.max())) ** 2 * np.eye(3)
        q = q.copy()
        error = np.zeros_like(target)
        for _ in range(_ITERATIONS):
            p, J_all = tip_and_jacobian(self.model, limb.body, limb.p, q)
            J = J_all[:, :, limb.joints]
            J_transposed = J.transpose(0, 2, 1)
            error = target - p
            step = J_transposed @ np.linalg.solve(J @ J_transposed + damping, error.T[:, :, None])
            q[limb.joints] += step[:, :, 0].T
        return q, float(np.linalg.norm(error, axis=0).max())

    def _limbs(self, tip: str | None) -> tuple[_Limb, ...]:
        """The tip of the named link, or tips of limbs that have no joint in common, longest first."""
        robot = self.model.robot
        if tip is not None and tip not in robot.links:
            raise ConfigError("--tip", f"{tip} is not a link; {suggestion(tip, robot.links)}")
        if tip is not None:
            tips = [tip]
        else:
            parents = {joint.parent for joint in robot.joints.values()}
            tips = [link for link in reversed(robot.links) if link not in parents]
        support = self.model.support()
        tip_points = [point for point in (_tip_point(self.model, link) for link in tips) if point is not None]
        tip_points.sort(key=lambda point: -int(support[point[0]].sum()))

        rng = np.random.default_rng(0)
        is_free = np.ones(len(self.home), dtype=bool)
        limbs = []
        for body, p in tip_points:
            joints = np.flatnonzero(support[body])
            if not is_free[joints].all():
                continue
            lower = self.limits.lower[joints, None]
            upper = self.limits.upper[joints, None]
            poses = np.repeat(self.home[:, None], _WORKSPACE_POSES, axis=1)
            poses[joints] = lower + (upper - lower) * rng.random((len(joints), _WORKSPACE_POSES))
            positions, _ = tip_and_jacobian(self.model, body, p, poses)
            spread = positions.std(axis=1)
            if spread.max() > 0:
                limbs.append(_Limb(body, p, joints, np.maximum(spread, _MIN_SPREAD * spread.max())))
                is_free[joints] = False
        if not limbs:
            raise ModelError(
                robot.path,
                "has no moving link that could follow the shell; give another --tip or another --pattern",
            )
        return tuple(limbs)


def tip_and_jacobian(model: RobotModel, body: int, p: Array, q: Array) -> tuple[Array, Array]:
    """Position of a body's point p (3,) in the root link, shape (3, N), and its Jacobian, shape (N, 3, nv).

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
    R = np.broadcast_to(np.eye(3), (count, 3, 3))
    origin = np.zeros((count, 3))
    axes = []
    for i in reversed(chain):
        link = model.bodies[i]
        origin = origin + R @ link.mount.p
        R = R @ link.mount.R
        axis = R @ link.axis
        phi = link.ratios @ q + link.offset
        if link.prismatic:
            origin = origin + axis * phi[:, None]
        else:
            R = R @ rotation_about(link.axis, phi)
        axes.append((link, axis, origin))
    tip = origin + R @ p
    J = np.zeros((count, 3, len(q)))
    for link, axis, origin in axes:
        velocity = axis if link.prismatic else np.cross(axis, tip - origin)  # per unit of the body's own coordinate
        J += velocity[:, :, None] * link.ratios
    return tip.T, J


def _tip_point(model: RobotModel, link: str) -> tuple[int, Array] | None:
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
