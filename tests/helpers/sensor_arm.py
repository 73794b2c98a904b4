"""An arm of three joints in MuJoCo with a sensor of force and moment between two halves of its second link.

Its hand may be pushed by a wrench that is logged too.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

JOINTS = ("turn", "lift", "bend")
SENSOR = "upper_ft"
COULOMB = 0.1  # N m


@dataclass(frozen=True)
class Link:
    """A link: its parent, where it is attached [m], its joint or None, and its mass [kg], com [m] and inertia."""

    name: str
    parent: str
    position: tuple[float, float, float]
    joint: str | None
    axis: tuple[float, float, float]
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float]


LINKS = (
    Link("shoulder", "base", (0, 0, 0.1), "turn", (0, 0, 1), 1.5, (0.01, 0.0, 0.1), (0.006, 0.007, 0.004)),
    Link("lower", "shoulder", (0, 0, 0.2), "lift", (0, 1, 0), 0.6, (0.08, 0.01, 0.0), (0.004, 0.006, 0.007)),
    Link("upper", "lower", (0.15, 0, 0.01), None, (0, 0, 0), 0.5, (0.07, 0.0, 0.01), (0.004, 0.005, 0.006)),
    Link("hand", "upper", (0.15, 0, 0), "bend", (0, 1, 0), 0.8, (0.12, 0.02, 0.0), (0.004, 0.008, 0.007)),
)


def wrench_channels(name: str) -> tuple[str, ...]:
    """Channels of a wrench, the force first."""
    return tuple(f"force_{name}_{part}" for part in ("x", "y", "z", "mx", "my", "mz"))


CHANNELS = wrench_channels(SENSOR)


def urdf_text() -> str:
    """URDF of the arm."""
    parts = ['<robot name="arm"><link name="base"/>']
    for link in LINKS:
        ixx, iyy, izz = link.inertia
        parts.append(
            f'<link name="{link.name}"><inertial><origin xyz="{_text(link.com)}"/><mass value="{link.mass}"/>'
            f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        name, kind = (link.joint, "revolute") if link.joint else (f"{link.name}_ft", "fixed")
        parts.append(
            f'<joint name="{name}" type="{kind}"><origin xyz="{_text(link.position)}"/><parent link="{link.parent}"/>'
            f'<child link="{link.name}"/><axis xyz="{_text(link.axis) if link.joint else "1 0 0"}"/>'
            '<limit lower="-3" upper="3" effort="50" velocity="20"/></joint>'
        )
    return "\n".join([*parts, "</robot>"])


@dataclass(frozen=True)
class Push:
    """A wrench on the hand that comes and goes.

    Attributes
    ----------
    size
        Amplitude of each component along the axes of the base, shape (6,) [N, N m].
    point
        Where its force acts, in the hand's frame, shape (3,) [m].
    """

    size: Array
    point: Array
    period = 2.0  # s
    share = 0.4  # of the time

    def is_touched(self, t: Array) -> NDArray[np.bool_]:
        """True while something touches the hand, shape (N,)."""
        return np.asarray(t % self.period < self.share * self.period)

    def wrench(self, t: Array) -> Array:
        """Force and moment on the hand along the axes of the base, shape (N, 6)."""
        envelope = np.sin(np.pi * (t % self.period) / (self.share * self.period)) ** 2 * self.is_touched(t)
        components = 1 + 0.5 * np.sin(2 * np.pi * np.outer(t, 0.3 + 0.2 * np.arange(6)))
        return np.asarray(envelope[:, None] * components * self.size)


def write_log(
    path: Path,
    seconds: float,
    offset: Array,
    with_torque: bool = True,
    seed: int = 3,
    push: Push | None = None,
    gravity: tuple[float, float, float] = (0, 0, -9.81),
) -> None:
    """Write a log of the arm in motion, its sensor read with an offset, shape (6,) [N, N m].

    With a push, it has the channels ``contact_tool``, ``force_base_…`` along the axes of the base, and ``force_hand_…``
    along those of the hand.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * 1000)) / 1000
    q, v, a = np.zeros((3, len(t), 3))
    for j in range(3):
        for _ in range(5):
            w = 2 * np.pi * rng.uniform(0.1, 1.2)
            amplitude, phase = rng.uniform(0.1, 0.5) / (1 + w / 4), rng.uniform(0, 2 * np.pi)
            q[:, j] += amplitude * np.sin(w * t + phase)
            v[:, j] += amplitude * w * np.cos(w * t + phase)
            a[:, j] -= amplitude * w * w * np.sin(w * t + phase)
    tau, wrench, pushed = _torque_and_wrench(q, v, a, t, push, gravity)
    columns: dict[str, Any] = {"t": t}
    for j, name in enumerate(JOINTS):
        columns[f"q_{name}"] = q[:, j] + 1e-5 * rng.normal(size=len(t))
        if with_torque:
            columns[f"tau_{name}"] = tau[:, j] + COULOMB * np.sign(v[:, j]) + 0.02 * rng.normal(size=len(t))
    noise = np.array([0.2, 0.2, 0.2, 0.01, 0.01, 0.01])
    for name, own in zip(CHANNELS, (wrench + offset + noise * rng.normal(size=wrench.shape)).T, strict=True):
        columns[name] = own
    if push is not None:
        columns["contact_tool"] = push.is_touched(t)
        for frame, own_wrench in pushed.items():
            measured = own_wrench + noise * rng.normal(size=wrench.shape)
            columns |= dict(zip(wrench_channels(frame), measured.T, strict=True))
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(columns), comments="")


def mujoco_arm(gravity: tuple[float, float, float]) -> Any:
    """The arm as a model of MuJoCo."""
    spec = mujoco.MjSpec()
    spec.option.gravity = gravity
    bodies = {"base": spec.worldbody}
    for link in LINKS:
        body = bodies[link.parent].add_body(name=link.name, pos=link.position)
        bodies[link.name] = body
        body.mass, body.ipos, body.inertia, body.explicitinertial = link.mass, link.com, link.inertia, True
        if link.joint:
            body.add_joint(name=link.joint, type=mujoco.mjtJoint.mjJNT_HINGE, axis=link.axis)
    bodies["upper"].add_site(name="sensor")
    for name in ("force", "torque"):
        kind = getattr(mujoco.mjtSensor, f"mjSENS_{name.upper()}")
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="sensor")
    return spec.compile()


def _torque_and_wrench(
    q: Array, v: Array, a: Array, t: Array, push: Push | None, gravity: tuple[float, float, float]
) -> tuple[Array, Array, dict[str, Array]]:
    """Torque of the joints, shape (N, 3), and the wrench on the upper half, as MuJoCo's sensors read it, (N, 6).

    And what pushes the hand, along the axes of the ``base`` and of the ``hand``, (N, 6).
    """
    model = mujoco_arm(gravity)
    data = mujoco.MjData(model)
    hand = model.body("hand").id
    tau, wrench = np.zeros((len(q), 3)), np.zeros((len(q), 6))
    on_hand = np.zeros((len(q), 6)) if push is None else push.wrench(t)
    in_hand = np.zeros_like(on_hand)
    for i in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[i], v[i], a[i]
        mujoco.mj_inverse(model, data)
        tau[i] = data.qfrc_inverse
        if push is not None:
            R = data.xmat[hand].reshape(3, 3)
            point = data.xpos[hand] + R @ push.point
            force, moment = on_hand[i, :3], on_hand[i, 3:]
            by_push = np.zeros(3)
            mujoco.mj_applyFT(model, data, force, moment, point, hand, by_push)
            tau[i] -= by_push
            at_center_of_mass = moment + np.cross(point - data.xipos[hand], force)
            data.xfrc_applied[hand] = [*force, *at_center_of_mass]
            in_hand[i] = [*(R.T @ force), *(R.T @ moment)]
        data.qfrc_applied[:] = tau[i]
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qacc, a[i], atol=1e-6)
        wrench[i] = data.sensordata
    return tau, wrench, {"base": on_hand, "hand": in_hand}


def _text(numbers: tuple[float, float, float]) -> str:
    return " ".join(f"{x:g}" for x in numbers)
