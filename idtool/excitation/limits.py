"""`Limits` of a model's joints: the URDF's limits, tightened by the configuration.

Shapes: nv joints, N samples. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.common.names import join_names, suggestion
from idtool.common.notice import Notice
from idtool.robot.config import Config
from idtool.robot.config.limits import JointLimits
from idtool.robot.model import RobotModel
from idtool.robot.urdf.reading import UrdfJoint

DEFAULT_RANGE = math.pi  # rad to either side of zero, of a joint without position limits
DEFAULT_VELOCITY = {False: 3.0, True: 0.3}  # rad/s, or m/s of a prismatic joint (True), without a velocity limit
# Time [s] from rest to the velocity limit of a joint without an acceleration limit. With an effort limit (True) it is
# shorter, since that bounds the acceleration too.
DEFAULT_RISE_TIME = {True: 0.1, False: 0.2}
QUANTITIES = ("position", "velocity", "acceleration", "effort")


@dataclass(frozen=True)
class Limits:
    """Limits of a model's joints.

    Attributes
    ----------
    joints
        Their names.
    lower, upper
        Limits of the position, shape (nv,) [rad or m].
    velocity, acceleration, effort
        Limits of the magnitudes, shape (nv,) [rad/s, rad/s², N·m or m/s, m/s², N]; an effort may be infinite.
    notices
        What was assumed where neither URDF nor configuration has a limit.
    """

    joints: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    effort: Array
    notices: tuple[Notice, ...] = ()

    @property
    def middle(self) -> Array:
        """Middle of the position's range, shape (nv,)."""
        return (self.lower + self.upper) / 2

    @property
    def half_range(self) -> Array:
        """Half the position's range, shape (nv,)."""
        return (self.upper - self.lower) / 2

    def with_margin(self, margin: float) -> Limits:
        """Tighter limits, for a design.

        Parameters
        ----------
        margin
            Share of every limit that is not used, for the tracking error; twice that share of the effort, since the
            torque is predicted by the model that is still to be identified.
        """
        spare = margin * self.half_range
        return replace(
            self,
            lower=self.lower + spare,
            upper=self.upper - spare,
            velocity=(1 - margin) * self.velocity,
            acceleration=(1 - margin) * self.acceleration,
            effort=(1 - 2 * margin) * self.effort,
        )

    def utilization(self, q: Array, v: Array, a: Array, tau: Array | None = None) -> Array:
        """The largest share of each limit that a motion uses, 1 at the limit.

        Parameters
        ----------
        q, v, a, tau
            Shape (nv, N); without tau, the effort's share is 0.

        Returns
        -------
        Shape (4, nv), in the order of `QUANTITIES`.
        """
        shares = [
            np.abs(q - self.middle[:, None]) / self.half_range[:, None],
            np.abs(v) / self.velocity[:, None],
            np.abs(a) / self.acceleration[:, None],
            np.zeros_like(q) if tau is None else np.abs(tau) / self.effort[:, None],
        ]
        return np.array([share.max(axis=1) for share in shares])


def joint_limits(model: RobotModel, config: Config) -> Limits:
    """The limits of a model's joints; a floating base has none.

    Parameters
    ----------
    model
        The model. Limits of joints that mimic a moving one apply to that one.
    config
        Its `limits` tighten them.

    Raises
    ------
    ConfigError
        If the configuration names a joint that is not there, or no range is left to move in.
    """
    actuated = [j.name for j in model.robot.joints.values() if j.kind != "fixed" and j.mimic is None]
    for name in config.limits if isinstance(config.limits, Mapping) else ():
        if name not in actuated:
            raise ConfigError(f"limits: {name}", f"is not an actuated joint of the URDF; {suggestion(name, actuated)}")
    assumed: dict[str, list[str]] = {}
    joints = model.joints[: model.joint_count]
    limits = np.empty((5, len(joints)))
    for j, joint in enumerate(joints):
        limits[:, j] = _limits_of_joint(joint, config.limits_of(joint.name), assumed)
    _tighten_by_mimics(model, limits)
    lower, upper, velocity, acceleration, effort = limits
    for name, low, high in zip(model.joint_names, lower, upper, strict=True):
        if not low < high:
            what = f"leaves no range of motion: from {low:g} to {high:g}; widen it, or leave the joint out of joints"
            raise ConfigError(f"limits: {name}", what)
    advice = "give limits in the configuration"
    notices = tuple(
        Notice("limit_assumed", "warning", None, f"{what}: {join_names(names)}", advice)
        for what, names in assumed.items()
    )
    return Limits(model.joint_names, lower, upper, velocity, acceleration, effort, notices)


def _limits_of_joint(
    joint: UrdfJoint, own: JointLimits, assumed: dict[str, list[str]]
) -> tuple[float, float, float, float, float]:
    """Lower, upper, velocity, acceleration, effort; adds to the names of joints by assumption."""
    prismatic = joint.kind == "prismatic"
    per_second = "m/s" if prismatic else "rad/s"
    own_lower, own_upper = own.position or (-math.inf, math.inf)
    lower = max(own_lower, joint.lower)
    upper = min(own_upper, joint.upper)
    if not (math.isfinite(lower) and math.isfinite(upper)):
        if prismatic:
            raise ConfigError(
                f"limits: {joint.name}", "the URDF has no position limits for this joint; give `position: [a, b]`"
            )
        lower = max(lower, -DEFAULT_RANGE)
        upper = min(upper, DEFAULT_RANGE)
        assumed.setdefault("no position limit; ± half a turn is assumed", []).append(joint.name)
    velocity = min(own.velocity or math.inf, joint.velocity if joint.velocity > 0 else math.inf)
    if not math.isfinite(velocity):
        velocity = DEFAULT_VELOCITY[prismatic]
        assumed.setdefault(f"no velocity limit; {velocity:g} {per_second} is assumed", []).append(joint.name)
    effort = min(own.effort or math.inf, joint.effort if joint.effort > 0 else math.inf)
    rise_time = DEFAULT_RISE_TIME[math.isfinite(effort)]
    acceleration = own.acceleration or velocity / rise_time
    if own.acceleration is None:
        what = f"no acceleration limit; the acceleration that reaches the velocity limit in {rise_time:g} s is assumed"
        assumed.setdefault(what, []).append(f"{joint.name} {acceleration:g} {per_second}²")
    if not math.isfinite(effort):
        assumed.setdefault("no effort limit; the torque is not limited", []).append(joint.name)
    return lower, upper, velocity, acceleration, effort


def _tighten_by_mimics(model: RobotModel, limits: Array) -> None:
    """Tighten limits, shape (5, nv), by those of mimic joints; the mimic of a locked joint moves no body."""
    lower, upper, velocity, *_ = limits  # views of the rows
    bodies = {body.name: body for body in model.bodies}
    for joint in model.robot.joints.values():
        if joint.mimic is None or joint.child not in bodies:
            continue
        body = bodies[joint.child]
        j = int(np.argmax(np.abs(body.ratios)))
        ratio = body.ratios[j]
        first, last = sorted((end - body.offset) / ratio for end in (joint.lower, joint.upper))
        lower[j] = max(lower[j], first)
        upper[j] = min(upper[j], last)
        if joint.velocity > 0:
            velocity[j] = min(velocity[j], joint.velocity / abs(ratio))
