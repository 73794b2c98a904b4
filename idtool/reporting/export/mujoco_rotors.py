"""Rotors in MuJoCo.

A rotor becomes the joint's armature; where it turns with several joints, or its carrier's rotation adds to its own, the
armature of a fixed tendon: the same constant part of the mass matrix as the rotor itself has. What that leaves out
(`rotors`) is carried by a rotor with a body and a hinge of its own, which a stiff constraint holds to the joints. It
doubles the coordinates, all of which have to be set at the start, so it is done only if asked for.
"""

from __future__ import annotations

from collections.abc import Collection
from itertools import combinations

import numpy as np
from lxml import etree

from idtool.common.arrays import Array
from idtool.reporting.export.base import Part
from idtool.reporting.export.rotors import Rotor
from idtool.reporting.export.scene import Scene, quaternion, text
from idtool.robot.rotation import rotation_about


def add_reflected_inertia(scene: Scene, rotor: Rotor) -> None:
    """Carry a rotor as inertia on joints, and as dead weight of the body that it sits in."""
    body, names = rotor.body, scene.identified.model.names
    ratios = _rotor_ratios(rotor)
    scene.pi[body.mount.body] += rotor.pi if ratios is rotor.ratios else rotor.without_spin
    joints = np.flatnonzero(ratios)
    joint_names = ", ".join(names[j] for j in joints)
    if len(joints) == 1:
        armature = rotor.inertia * float(ratios[joints[0]]) ** 2
        scene.forces[joint_names].armature += armature
        scene.carried.append(rotor.part(f"armature of {joint_names}", armature))
    else:
        coefficients = {names[j]: ratios[j] for j in joints}
        scene.add_tendon(body.name, coefficients, {"armature": repr(rotor.inertia)})
        scene.carried.append(rotor.part(f"armature of a tendon over {joint_names}", rotor.inertia))
    scene.not_carried += omitted_parts(scene, rotor)


def _rotor_ratios(rotor: Rotor) -> Array:
    """The rotor's speed per joint velocity as far as that is constant: with the carrier's rotation, or against it."""
    if rotor.carrier is None or not rotor.carrier.any():
        return rotor.ratios
    return rotor.ratios + rotor.carrier


def omitted_parts(scene: Scene, rotor: Rotor) -> list[Part]:
    """The parts of a rotor that inertia on joints leaves out."""
    parts = []
    if rotor.carrier is None:
        parts.append(rotor.coupling())
    coupling = _omitted_coupling(scene, rotor)
    if coupling:
        parts.append(rotor.part("the coupling between joints on different branches in the mass matrix", coupling))
    return [*parts, *rotor.imbalance(scene.identified.gravity)]


def _omitted_coupling(scene: Scene, rotor: Rotor) -> float:
    """The largest entry between joints on different branches, where MuJoCo's mass matrix has none [kg·m²]."""
    ratios = _rotor_ratios(rotor)
    support = scene.identified.model.support()[list(scene.moving.values())]
    largest = 0.0
    for j, k in combinations(np.flatnonzero(ratios), 2):
        if not (support[:, j] & support[:, k]).any():
            largest = max(largest, abs(ratios[j] * ratios[k]))
    return rotor.inertia * float(largest)


def add_rotor_body(scene: Scene, rotor: Rotor) -> None:
    """Carry a rotor as a body with a hinge of its own.

    Raises
    ------
    ModelError
        If its inertia is not realizable.
    """
    body, mount = rotor.body, rotor.body.mount
    R = mount.R @ rotation_about(body.axis, body.offset)  # its angle is 0 where the joints' are
    name = _unused_name(body.name, {"world", *(str(element.get("name")) for element in scene.bodies.values())})
    scene.bodies[name] = etree.SubElement(
        scene.bodies[scene.carrier(mount.body)], "body", name=name, pos=text(mount.p), quat=quaternion(R)
    )
    scene.add_inertial(name, rotor.own_pi, moves=True)
    hinge = _unused_name(body.name, scene.identified.robot.joints)
    etree.SubElement(scene.bodies[name], "joint", name=hinge, type="hinge", axis=text(body.axis), limited="false")
    joints = np.flatnonzero(rotor.ratios)
    names = scene.identified.model.names
    if len(joints) == 1:
        law = text([0.0, rotor.ratios[joints[0]], 0.0, 0.0, 0.0])
        coupled_joints = {"joint1": hinge, "joint2": names[joints[0]]}
        etree.SubElement(scene.equalities, "joint", coupled_joints, polycoef=law)
    else:
        tendon = scene.add_tendon(body.name, {**{names[j]: rotor.ratios[j] for j in joints}, hinge: -1.0})
        etree.SubElement(scene.equalities, "tendon", tendon1=tendon)
    joint_names = ", ".join(names[j] for j in joints)
    scene.carried.append(rotor.part(f"a body that is coupled to {joint_names} by a stiff constraint", rotor.inertia))


def _unused_name(name: str, used_names: Collection[str]) -> str:
    """The name, with underscores appended until it is unique."""
    while name in used_names:
        name += "_"
    return name
