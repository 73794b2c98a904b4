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
from scipy.spatial.transform import Rotation

from idtool.common.arrays import Array
from idtool.reporting.export.base import Part
from idtool.reporting.export.rotors import Rotor
from idtool.reporting.export.scene import Scene, quaternion, text


def reflect(scene: Scene, rotor: Rotor) -> None:
    """Carry a rotor as inertia on joints, and as dead weight of the body that it sits in."""
    body, names = rotor.body, scene.identified.model.names
    turning = _turning(rotor)
    scene.pi[body.mount.body] += rotor.pi if turning is rotor.ratios else rotor.without_spin
    joints = np.flatnonzero(turning)
    over = ", ".join(names[j] for j in joints)
    if len(joints) == 1:
        armature = rotor.inertia * float(turning[joints[0]]) ** 2
        scene.forces[over].armature += armature
        scene.carried.append(rotor.part(f"armature of {over}", armature))
    else:
        scene.add_tendon(body.name, {names[j]: turning[j] for j in joints}, {"armature": repr(rotor.inertia)})
        scene.carried.append(rotor.part(f"armature of a tendon over {over}", rotor.inertia))
    scene.not_carried += lacking(scene, rotor)


def _turning(rotor: Rotor) -> Array:
    """The rotor's speed per joint velocity as far as that is constant: with the carrier's rotation, or against it."""
    if rotor.carrier is None or not rotor.carrier.any():
        return rotor.ratios
    return rotor.ratios + rotor.carrier


def lacking(scene: Scene, rotor: Rotor) -> list[Part]:
    """What inertia on joints leaves out of a rotor."""
    found = [rotor.coupling()] if rotor.carrier is None else []
    apart = _apart(scene, rotor)
    if apart:
        found.append(rotor.part("the coupling between joints on different branches in the mass matrix", apart))
    return [*found, *rotor.imbalance(scene.identified.gravity)]


def _apart(scene: Scene, rotor: Rotor) -> float:
    """The largest entry between joints on different branches, where MuJoCo's mass matrix has none [kg·m²]."""
    turning = _turning(rotor)
    support = scene.identified.model.support()[list(scene.moving.values())]
    pairs = combinations(np.flatnonzero(turning), 2)
    sizes = [abs(turning[j] * turning[k]) for j, k in pairs if not (support[:, j] & support[:, k]).any()]
    return rotor.inertia * float(max(sizes, default=0.0))


def add_body(scene: Scene, rotor: Rotor) -> None:
    """Carry a rotor as a body with a hinge of its own.

    Raises
    ------
    ModelError
        If its inertia is not realizable.
    """
    body, mount = rotor.body, rotor.body.mount
    R = mount.R @ Rotation.from_rotvec(body.axis * body.offset).as_matrix()  # its angle is 0 where the joints' are
    name = _unused(body.name, {"world", *(str(element.get("name")) for element in scene.bodies.values())})
    scene.bodies[name] = etree.SubElement(
        scene.bodies[scene.carrier(mount.body)], "body", name=name, pos=text(mount.p), quat=quaternion(R)
    )
    scene.add_inertial(name, rotor.own, moves=True)
    hinge = _unused(body.name, scene.identified.robot.joints)
    etree.SubElement(scene.bodies[name], "joint", name=hinge, type="hinge", axis=text(body.axis), limited="false")
    joints = np.flatnonzero(rotor.ratios)
    names = scene.identified.model.names
    if len(joints) == 1:
        law = text([0.0, rotor.ratios[joints[0]], 0.0, 0.0, 0.0])
        held = {"joint1": hinge, "joint2": names[joints[0]]}
        etree.SubElement(scene.equalities, "joint", held, polycoef=law)
    else:
        tendon = scene.add_tendon(body.name, {**{names[j]: rotor.ratios[j] for j in joints}, hinge: -1.0})
        etree.SubElement(scene.equalities, "tendon", tendon1=tendon)
    over = ", ".join(names[j] for j in joints)
    scene.carried.append(rotor.part(f"a body that is coupled to {over} by a stiff constraint", rotor.inertia))


def _unused(name: str, taken: Collection[str]) -> str:
    """The name, with underscores behind it until nothing else bears it."""
    while name in taken:
        name += "_"
    return name
