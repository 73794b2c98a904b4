"""A quadruped with twelve joints and feet that are balls."""

from __future__ import annotations

import numpy as np

from ground.robot import Array, Body, Foot, Imu, Mount, Robot, Softness

LEGS = ("FL", "FR", "RL", "RR")
PARTS = ("hip", "thigh", "calf")
JOINTS = tuple(f"{leg}_{part}_joint" for leg in LEGS for part in PARTS)
FEET = tuple(f"{leg}_foot" for leg in LEGS)
FOOT_RADIUS = 0.022  # m
GEAR = 8.0

_HIP = np.array([0.19, 0.05, 0.0])  # m, of the left front leg
_THIGH_OFFSET = 0.08  # m
_THIGH = _CALF = 0.21  # m


def true_quadruped(seed: int) -> Robot:
    """A robot with bodies and friction of its own."""
    rng = np.random.default_rng([seed, 1])
    links = {"trunk": Body.ellipsoid(7.5, np.array([0.01, 0.0, 0.005]), np.array([0.26, 0.13, 0.08]))}
    for leg in LEGS:
        left = 1.0 if leg[1] == "L" else -1.0
        hip, thigh = np.array([0.0, 0.01 * left, 0.0]), np.array([0.0, 0.0, -0.07])
        links[f"{leg}_hip"] = Body.ellipsoid(0.6, hip, np.array([0.06, 0.06, 0.06]))
        links[f"{leg}_thigh"] = Body.ellipsoid(1.0, thigh, np.array([0.05, 0.05, 0.15]))
        links[f"{leg}_calf"] = Body.ellipsoid(0.22, np.array([0.0, 0.0, -0.1]), np.array([0.04, 0.04, 0.14]))
    mounts = _mounts()
    axes = {joint: mount.axis for joint, mount in mounts.items() if mount.axis is not None}
    return Robot(
        name="quadruped",
        links={name: body.perturbed(0.1, rng) for name, body in links.items()},
        mounts=mounts,
        rotors={joint: Body.rotor(axis, 0.09, 8e-5, 5e-5) for joint, axis in axes.items()},
        gear=GEAR,
        feet=tuple(_foot(leg) for leg in LEGS),
        imu=Imu(np.array([0.06, -0.025, 0.04]), 0.3),
        viscous=rng.uniform(0.02, 0.08, 12),
        coulomb=rng.uniform(0.15, 0.5, 12),
        wrench_sensors={},
        fallen_height=0.15,
    )


def _mounts() -> dict[str, Mount]:
    found = {}
    for leg in LEGS:
        forward, left = (1.0 if leg[0] == "F" else -1.0), (1.0 if leg[1] == "L" else -1.0)
        found[f"{leg}_hip_joint"] = Mount("trunk", f"{leg}_hip", _HIP * [forward, left, 1.0], np.array([1.0, 0.0, 0.0]))
        offset = np.array([0.0, left * _THIGH_OFFSET, 0.0])
        found[f"{leg}_thigh_joint"] = Mount(f"{leg}_hip", f"{leg}_thigh", offset, np.array([0.0, 1.0, 0.0]))
        below = np.array([0.0, 0.0, -_THIGH])
        found[f"{leg}_calf_joint"] = Mount(f"{leg}_thigh", f"{leg}_calf", below, np.array([0.0, 1.0, 0.0]))
    return found


def _foot(leg: str) -> Foot:
    center: Array = np.array([0.0, 0.0, -_CALF])
    return Foot(f"{leg}_foot", f"{leg}_calf", center, np.zeros((1, 3)), FOOT_RADIUS, Softness())
