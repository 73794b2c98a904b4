"""The motors of a MuJoCo model, one a joint, and the tendons through which torque acts on joints."""

from __future__ import annotations

import math

from lxml import etree

from idtool.reporting.export.joints import JointForces
from idtool.reporting.export.scene import Scene, text
from idtool.robot.urdf.reading import UrdfJoint

_FAR = 1e10  # rad or m: beyond what a joint reaches


def add_motor(scene: Scene, joint: UrdfJoint) -> None:
    """The motor of a joint, whose control is the torque or force there, with what else needs an actuator or tendon.

    A constant torque is a bias of the motor, so that there is one control a joint. Only where the motor drives a
    tendon, its torque acting on other joints too, is it an actuator of its own, behind the motors.
    """
    forces = scene.forces[joint.name]
    motor = {"name": joint.name, "joint": joint.name, "ctrllimited": "false"}
    if 0 < joint.effort < math.inf:
        motor["ctrlrange"] = text([-joint.effort, joint.effort])
    if forces.torque_shares:
        del motor["joint"]
        motor["tendon"] = scene.add_tendon(f"{joint.name}_drive", {joint.name: 1.0, **forces.torque_shares})
        if forces.bias:
            name = f"{joint.name}_offset"
            while name in scene.identified.robot.joints:
                name += "_"
            constant = {"name": name, "joint": joint.name, "ctrllimited": "false", "gaintype": "fixed", "gainprm": "0"}
            scene.constants.append(etree.Element("general", constant | _bias(forces)))
    elif forces.bias:
        motor |= {"gaintype": "fixed", "gainprm": "1", **_bias(forces)}
    etree.SubElement(scene.actuators, "general" if "gaintype" in motor else "motor", motor)
    for side, position, stiffness in forces.stops:
        slack = text([-_FAR, position] if side > 0 else [position, _FAR])
        spring = {"stiffness": repr(stiffness), "springlength": slack}
        scene.add_tendon(f"{joint.name}_stop", {joint.name: 1.0}, spring)


def _bias(forces: JointForces) -> dict[str, str]:
    return {"biastype": "affine", "biasprm": text([forces.bias, 0.0, 0.0])}
