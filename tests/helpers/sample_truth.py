"""The torque that Pinocchio gives for the sample robots with their true parameters.

Letters: q [rad], v [rad/s], a [rad/s^2], tau [N m], each (N, nj); C the rotors' coupling (nr, nj).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray
from paths import SAMPLES
from scipy.signal import butter, sosfiltfilt

Array = NDArray[np.float64]

TRUTH = yaml.safe_load((SAMPLES / "truth.yaml").read_text())
LOGS = ["leg_train", "leg_validate", "belt_arm_train", "belt_arm_validate"]
RATE, BAND = 1000, 40.0
FILTER = butter(4, BAND, fs=RATE, output="sos")
EDGE = slice(200, -200)  # the filter's ends


def config_of(robot: str) -> dict[str, Any]:
    return dict(yaml.safe_load((SAMPLES / f"{robot}.yaml").read_text()))


def low_pass(x: Array) -> Array:
    return np.asarray(sosfiltfilt(FILTER, x, axis=0))


def inertia_of(body: dict[str, Any]) -> pin.Inertia:
    xx, xy, yy, xz, yz, zz = body["inertia"]
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return pin.Inertia(body["mass"], np.array(body["com"]), matrix)


def add_rotor(model: pin.Model, name: str, rotor: dict[str, Any], inertia: pin.Inertia) -> int:
    frame = model.frames[model.getFrameId(rotor["parent"])]
    origin = pin.SE3(pin.rpy.rpyToMatrix(*map(float, rotor["origin"]["rpy"])), np.array(rotor["origin"]["xyz"], float))
    axis = np.array(rotor["axis"], float)
    placement = frame.placement * origin
    joint = model.addJoint(frame.parentJoint, pin.JointModelRevoluteUnaligned(axis), placement, name)
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    return int(model.joints[joint].idx_v)


def rigid_torque(robot: str, bodies: dict[str, Any], q: Array, v: Array, a: Array) -> Array:
    """Torque (N, nj) of links and rotors, the rotors as bodies of their own behind rigid gears."""
    config = config_of(robot)
    model = pin.buildModelFromUrdf(str(SAMPLES / f"{robot}.urdf"))
    for name in config["bounding_ellipsoids"]:
        model.inertias[model.frames[model.getFrameId(name)].parentJoint] = inertia_of(bodies[name])
    links = [model.joints[model.getJointId(name)].idx_v for name in config["joints"]]
    rotors = [add_rotor(model, name, rotor, inertia_of(bodies[name])) for name, rotor in config["rotors"].items()]
    turns = [r.get("coupling") or {r["joint"]: r["gear_ratio"]} for r in config["rotors"].values()]
    C = np.array([[turn.get(joint, 0.0) for joint in config["joints"]] for turn in turns])
    full = np.zeros((3, len(q), model.nv))
    for motion, x in zip(full, (q, v, a), strict=True):
        motion[:, links], motion[:, rotors] = x, x @ C.T
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *motion) for motion in full.swapaxes(0, 1)])
    return np.asarray(tau[:, links] + tau[:, rotors] @ C)
