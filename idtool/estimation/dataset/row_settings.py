"""Settings that the rows of the torque equation depend on: data reduced with others cannot be used.

All else may differ: bounds, constraints, known masses, copies, the prior's kind and weight, the solver, and the
inertias of the URDF and of the rotors.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, cast

from idtool.robot.config import Config
from idtool.robot.model import RobotModel
from idtool.robot.urdf.reading import UrdfJoint

_SECTIONS = ("gravity", "locked_joints", "log", "velocity", "effects")  # of the configuration
_OF_ROTOR = {"joint", "gear_ratio", "coupling", "parent", "origin", "axis"}


def row_settings(model: RobotModel, config: Config, band_hz: float) -> dict[str, Any]:
    """The settings as plain data that JSON can hold.

    Parameters
    ----------
    model
        The tree of bodies.
    config
        Its configuration.
    band_hz
        Cut-off of the low-pass [Hz].
    """
    settings: dict[str, Any] = {"joints": list(model.joint_names)}
    data = config.model_dump(mode="json")
    settings |= {section: data[section] for section in _SECTIONS}
    settings["filter"] = {**data["filter"], "cutoff_hz": band_hz}
    friction = {}
    for joint in model.joint_names:
        friction[joint] = [name for name, term in config.friction_of(joint) if term is not False]
    settings["friction"] = friction
    rotors = {name: rotor.model_dump(mode="json", include=_OF_ROTOR) for name, rotor in config.rotors.items()}
    settings["rotors"] = rotors
    controller = data["controller"]
    if config.controller is not None:
        known = config.controller.known_delay
        controller = {**controller, "delay": known.value if known else None}
    settings["controller"] = controller
    urdf_joints = {}
    for urdf_joint in model.robot.joints.values():
        urdf_joints[urdf_joint.name] = _geometry(urdf_joint)
    settings["urdf"] = urdf_joints
    return cast("dict[str, Any]", json.loads(json.dumps(settings)))


def _geometry(joint: UrdfJoint) -> dict[str, Any]:
    """Place of a joint in the robot."""
    mimic = joint.mimic
    return {
        "kind": joint.kind,
        "parent": joint.parent,
        "child": joint.child,
        "rotation": joint.R.tolist(),
        "position": joint.p.tolist(),
        "axis": joint.axis.tolist(),
        "mimic": None if mimic is None else [mimic.joint, mimic.multiplier, mimic.offset],
    }


def first_difference(old: Any, new: Any, key: str = "") -> tuple[str, Any, Any] | None:
    """Key of the first value that differs between two nested settings, and both values; None: none does."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for name in dict.fromkeys([*old, *new]):
            difference = first_difference(old.get(name), new.get(name), f"{key}.{name}" if key else str(name))
            if difference is not None:
                return difference
        return None
    return None if old == new else (key, old, new)
