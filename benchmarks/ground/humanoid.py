"""A humanoid of 35 kg with 23 joints, flat feet, and a force/torque sensor in each ankle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ground.robot import Array, Body, Foot, Hook, Imu, Mount, Robot, Softness

SIDES = ("l", "r")
LEG_PARTS = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
WAIST_PARTS = ("waist_yaw", "waist_roll", "waist_pitch")
ARM_PARTS = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow")

_AXES = {"roll": np.array([1.0, 0.0, 0.0]), "pitch": np.array([0.0, 1.0, 0.0]), "yaw": np.array([0.0, 0.0, 1.0])}
_GEAR = 14.0
_SOLE = np.array([0.03, 0.0, -0.02])  # m, its middle in the foot
_HOOK = np.array([-0.02, 0.0, 0.4])  # m, in the torso, behind its neck
_HALF_LENGTH, _HALF_WIDTH = 0.09, 0.045  # m, of the sole
_SOLE_SOFTNESS = Softness(stiffness=3e5, damping=300.0, shear_stiffness=1.5e5, shear_damping=300.0)


class _Link(NamedTuple):
    """Where a link is mounted on its parent [m], its mass [kg], and the ellipsoid that bounds it [m]; a left one."""

    position: tuple[float, float, float]
    mass: float
    center: tuple[float, float, float]
    semi_axes: tuple[float, float, float]


_PELVIS = _Link((0.0, 0.0, 0.0), 3.6, (0.0, 0.0, -0.03), (0.1, 0.12, 0.1))
_FOOT = _Link((0.0, 0.0, -0.02), 0.5, (0.03, 0.0, -0.005), (0.14, 0.05, 0.03))
_LINKS = {
    "hip_pitch": _Link((0.0, 0.06, -0.1), 1.2, (0.0, 0.03, -0.02), (0.07, 0.07, 0.07)),
    "hip_roll": _Link((0.0, 0.03, -0.03), 1.3, (0.01, 0.0, -0.05), (0.07, 0.07, 0.1)),
    "hip_yaw": _Link((0.0, 0.0, -0.11), 1.7, (0.0, 0.0, -0.07), (0.07, 0.07, 0.14)),
    "knee": _Link((0.0, 0.0, -0.18), 1.8, (0.01, 0.0, -0.11), (0.07, 0.06, 0.2)),
    "ankle_pitch": _Link((0.0, 0.0, -0.3), 0.15, (0.0, 0.0, 0.0), (0.03, 0.03, 0.03)),
    "ankle_roll": _Link((0.0, 0.0, -0.02), 0.35, (0.01, 0.0, 0.0), (0.06, 0.04, 0.03)),
    "waist_yaw": _Link((0.0, 0.0, 0.05), 0.35, (0.0, 0.0, 0.01), (0.05, 0.05, 0.04)),
    "waist_roll": _Link((0.0, 0.0, 0.04), 0.35, (0.0, 0.0, 0.01), (0.05, 0.05, 0.04)),
    "waist_pitch": _Link((0.0, 0.0, 0.02), 7.6, (0.0, 0.0, 0.17), (0.12, 0.15, 0.3)),
    "shoulder_pitch": _Link((0.0, 0.11, 0.24), 0.7, (0.0, 0.03, 0.0), (0.06, 0.06, 0.06)),
    "shoulder_roll": _Link((0.0, 0.05, 0.0), 0.6, (0.0, 0.01, -0.04), (0.05, 0.05, 0.08)),
    "shoulder_yaw": _Link((0.0, 0.01, -0.09), 0.7, (0.0, 0.0, -0.05), (0.05, 0.05, 0.1)),
    "elbow": _Link((0.01, 0.0, -0.11), 0.9, (0.06, 0.0, -0.02), (0.16, 0.06, 0.06)),
}


def true_humanoid(seed: int) -> Robot:
    """A robot with bodies, friction and sensor offsets of its own."""
    rng = np.random.default_rng([seed, 1])
    links = {"pelvis": _body(_PELVIS)}
    mounts: dict[str, Mount] = {}
    for side in SIDES:
        _append_chain(links, mounts, "pelvis", [f"{side}_{part}" for part in LEG_PARTS])
        foot = f"{side}_foot"
        links[foot] = _body(_FOOT)
        mounts[sensor_joint(side)] = Mount(f"{side}_ankle_roll", foot, np.array(_FOOT.position))
    _append_chain(links, mounts, "pelvis", list(WAIST_PARTS))
    for side in SIDES:
        _append_chain(links, mounts, WAIST_PARTS[-1], [f"{side}_{part}" for part in ARM_PARTS])
    axes = {joint: mount.axis for joint, mount in mounts.items() if mount.axis is not None}
    return Robot(
        name="humanoid",
        links={name: body.perturbed(0.1, rng) for name, body in links.items()},
        mounts=mounts,
        rotors={joint: Body.rotor(axis, 0.15, 1e-4, 6e-5) for joint, axis in axes.items()},
        gear=_GEAR,
        feet=tuple(_foot(side) for side in SIDES),
        imu=Imu(np.array([0.05, -0.03, 0.06]), 0.3),
        viscous=rng.uniform(0.02, 0.1, len(axes)),
        coulomb=rng.uniform(0.15, 0.6, len(axes)),
        wrench_sensors={sensor_joint(side): rng.uniform(-1, 1, 6) * [5, 5, 5, 0.3, 0.3, 0.3] for side in SIDES},
        fallen_height=0.5,
        hook=Hook(WAIST_PARTS[-1], _HOOK),
    )


def sensor_joint(side: str) -> str:
    """Fixed joint between ankle and foot, with a force/torque sensor."""
    return f"{side}_leg_ft_sensor"


def _append_chain(links: dict[str, Body], mounts: dict[str, Mount], parent: str, names: list[str]) -> None:
    """Append links one after the other, and the joints before them, mirrored on the right."""
    for name in names:
        side, part = name.split("_", 1) if name[:2] in ("l_", "r_") else ("l", name)
        mirror = np.array([1.0, 1.0 if side == "l" else -1.0, 1.0])
        link = _LINKS[part]
        axis = _AXES.get(part.split("_")[-1], _AXES["pitch"])  # knee and elbow
        links[name] = _body(link, mirror)
        mounts[f"{name}_joint"] = Mount(parent, name, np.array(link.position) * mirror, axis)
        parent = name


def _body(link: _Link, mirror: Array | None = None) -> Body:
    center = np.array(link.center) * (1.0 if mirror is None else mirror)
    return Body.ellipsoid(link.mass, center, np.array(link.semi_axes))


def _foot(side: str) -> Foot:
    corners = np.array([[x, y, 0.0] for x in (-_HALF_LENGTH, _HALF_LENGTH) for y in (-_HALF_WIDTH, _HALF_WIDTH)])
    return Foot(f"{side}_sole", f"{side}_foot", _SOLE, corners, 0.0, _SOLE_SOFTNESS)
