"""The identified model as a URDF for Drake, whose rotors are inertia on single joints.

The identified URDF's text is kept but for what Drake reads otherwise: rotors that are no links of the URDF are dead
weight of the link that carries them, joints that do not move are fixed, and every moving joint has a transmission with
the rotor's inertia and gear ratio, as the parser's documentation gives them (drake:rotor_inertia, drake:gear_ratio).
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from idtool.common.arrays import Array
from idtool.dynamics.effects.simulator_element import Damping
from idtool.reporting.export.base import Export, Part
from idtool.reporting.export.identified import NO_EQUIVALENT, EffectTorque, IdentifiedModel
from idtool.reporting.export.inertia_check import is_acceptable, unrealizable_error
from idtool.reporting.export.rotors import Rotor, averaged_rotors
from idtool.reporting.export.transmissions import transmissions
from idtool.robot.inertia import PI_SIZE
from idtool.robot.rotation import rotation_about, rpy_from_rotation
from idtool.robot.urdf.reading import UrdfJoint
from idtool.robot.urdf.text import Edit, Element, apply_edits, root_element, set_attribute
from idtool.robot.urdf.writing import JointDynamics, replace_parameters

FILE = "drake.urdf"

_WORLD = "world"  # Drake's name for what stands still
_DRAKE_GRAVITY = (0.0, 0.0, -9.81)  # m/s², Drake's own
_ROUNDING = 1e-12  # relative


def to_drake(identified: IdentifiedModel) -> Export:
    """The identified model as a URDF with Drake's rotor inertias and gear ratios.

    Raises
    ------
    ModelError
        If a body has an inertia that is not realizable: Drake would replace it.
    """
    rotors = averaged_rotors(identified)
    moving = {body.name for body in identified.model.bodies if body.kind == "link"}
    fixed = [j for j in identified.robot.joints.values() if j.kind != "fixed" and j.child not in moving]
    text = replace_parameters(identified.robot.text, _link_parameters(identified, rotors), _dynamics(identified))
    root = root_element(text)
    edits: list[Edit] = []
    elements = {element.name: element for element in root.with_tag("joint")}
    for joint in fixed:
        edits += _fix_joint(text, elements[joint.name], joint, identified.value(joint))
    edits += transmissions(text, root, _transmission_values(identified, rotors))
    if "xmlns:drake" not in root.attributes:
        after = root.start + len(b"<robot")
        edits.append(Edit(after, after, b' xmlns:drake="http://drake.mit.edu"'))
    carried, not_carried = _list_parts(identified, rotors, fixed)
    return Export(FILE, apply_edits(text, edits), tuple(carried), tuple(not_carried))


def _link_parameters(identified: IdentifiedModel, rotors: tuple[Rotor, ...]) -> dict[str, Array | None]:
    """New parameters of links, in their frames: with what the URDF does not know of in the body that they carry."""
    robot, model = identified.robot, identified.model
    more = {-1: np.zeros(PI_SIZE)}
    for i, body in enumerate(model.bodies):
        if body.kind == "link":
            known = [member.pi_in_body for member in body.members if member.link in robot.links]
            more[i] = identified.pi[i] - sum(known, np.zeros(PI_SIZE))
    for rotor in rotors:
        if rotor.body.name not in robot.links:
            more[rotor.body.mount.body] += rotor.pi
    links: dict[str, Array | None] = {}
    for i, pi in more.items():
        link = robot.root if i < 0 else model.bodies[i].name
        if link == _WORLD:  # Drake's own, which has no mass
            continue
        own = robot.links[link]
        own = np.zeros(PI_SIZE) if own is None else own
        if (np.abs(pi) > _ROUNDING * max(1.0, float(np.abs(own).max()))).any():
            links[link] = own + pi
        if i >= 0:
            links |= _merge_links(identified, i, own + pi)
    return links


def _merge_links(identified: IdentifiedModel, index: int, own: Array) -> dict[str, Array | None]:
    """Move all mass of a body whose links cannot each exist alone to the link that carries the others.

    Parameters
    ----------
    identified
        The model.
    index
        Of the body.
    own
        New parameters of the carrying link, shape (10,).
    """
    body, robot = identified.model.bodies[index], identified.robot
    others = [member for member in body.members[1:] if member.link in robot.links]
    if all(is_acceptable(pi) for pi in (own, *(member.pi for member in others))):
        return {}
    whole = own + sum((member.pi_in_body for member in others), np.zeros(PI_SIZE))
    if not is_acceptable(whole):
        raise unrealizable_error(robot, body.name)
    return {body.name: whole, **{member.link: None for member in others}}


def _dynamics(identified: IdentifiedModel) -> dict[str, JointDynamics]:
    """Damping where it is not the URDF's."""
    damping = dict.fromkeys(identified.robot.joints, 0.0)
    for term in identified.terms:
        if _is_damping(term):
            for element in term.elements:
                if isinstance(element, Damping):
                    damping[identified.model.names[element.joint]] += element.coefficient
    moving = {body.name for body in identified.model.bodies}
    joints = [j for j in identified.robot.joints.values() if j.child in moving and j.damping != damping[j.name]]
    return {j.name: JointDynamics(damping=damping[j.name]) for j in joints}


def _is_damping(term: EffectTorque) -> bool:
    """True for torque that a URDF carries."""
    return bool(term.elements) and all(isinstance(element, Damping) for element in term.elements)


def _fix_joint(text: bytes, element: Element, joint: UrdfJoint, value: float) -> list[Edit]:
    """The edits that make a joint a fixed one, at its value."""
    edits = [set_attribute(text, element, "type", "fixed")]
    edits += [Edit(child.start, child.stop, b"") for child in element.with_tag("mimic")]
    if value:
        R, p = joint.R, joint.p
        if joint.kind == "prismatic":
            p = p + R @ joint.axis * value
        else:
            R = R @ rotation_about(joint.axis, value)
        xyz, rpy = (" ".join(repr(float(x)) for x in values) for values in (p, rpy_from_rotation(R)))
        origin = f'<origin xyz="{xyz}" rpy="{rpy}"/>'.encode()
        old = element.first("origin")
        place = (old.start, old.stop) if old else (element.content, element.content)
        edits.append(Edit(*place, origin))
    return edits


def _transmission_values(identified: IdentifiedModel, rotors: tuple[Rotor, ...]) -> dict[str, tuple[float, float]]:
    """Rotor inertia [kg·m²] and gear ratio by joint; inertia times ratio² is all that reflects there."""
    gears = {}
    for j, name in enumerate(identified.model.joint_names):
        total = 0.0
        largest = -np.inf
        ratio = 1.0  # that of the rotor with the largest reflected inertia
        for rotor in rotors:
            rotor_ratio = float(rotor.ratios[j])
            reflected = rotor.inertia * rotor_ratio**2
            total += reflected
            if reflected > largest:
                largest = reflected
                ratio = rotor_ratio
        total += float(identified.mechanism.armature[j])
        ratio = ratio or 1.0
        gears[name] = (total / ratio**2, ratio)
    return gears


def _list_parts(
    identified: IdentifiedModel, rotors: tuple[Rotor, ...], fixed: list[UrdfJoint]
) -> tuple[list[Part], list[Part]]:
    """The parts that are carried and those that are not."""
    robot, model = identified.robot, identified.model
    links = {body.name: pi for body, pi in zip(model.bodies, identified.pi, strict=True) if body.kind == "link"}
    carried = [
        Part("inertial", link, "mass including everything fixed to it", float(pi[0]), "kg")
        for link, pi in links.items()
    ]
    carried += [*identified.inertias, *identified.armatures]
    not_carried = [*identified.others, *(replace(part, detail=NO_EQUIVALENT) for part in identified.offsets)]
    for term in identified.terms:
        if _is_damping(term):
            carried.append(term.part("damping"))
        else:
            not_carried.append(term.not_carried_part)
    not_carried = list(dict.fromkeys(not_carried))  # an effect of several terms is one
    for rotor in rotors:
        carried += [
            rotor.part(f"reflected inertia on {name}", rotor.inertia * float(ratio) ** 2)
            for name, ratio in zip(model.names, rotor.ratios, strict=True)
            if ratio
        ]
        not_carried += _omitted_rotor_parts(identified, rotor)
    carried += [Part("locked_joint", joint.name, f"fixed at {identified.value(joint):g}") for joint in fixed]
    for joint in robot.joints.values():
        if joint.name in model.names and not joint.effort > 0:
            not_carried.append(
                Part("actuator", joint.name, "the effort limit is 0, so Drake ignores the actuator and its rotors")
            )
        if joint.mimic is not None and joint.child in links:
            not_carried.append(Part("mimic", joint.name, "Drake supports it only in a discrete plant"))
    if tuple(identified.gravity) != _DRAKE_GRAVITY:
        values = ", ".join(f"{x:.6g}" for x in identified.gravity)
        not_carried.append(
            Part(
                "gravity",
                robot.root,
                f"gravity is a property of Drake's plant; set the plant's gravity vector to [{values}]",
            )
        )
    is_free_in_drake = robot.root != _WORLD
    if model.has_floating_base and is_free_in_drake:
        carried.append(Part("floating_base", robot.root, "free, as Drake has every root link that is not welded"))
    elif model.has_floating_base:
        not_carried.append(Part("floating_base", robot.root, "Drake holds a link of this name; rename the link"))
    elif is_free_in_drake:
        not_carried.append(Part("fixed_base", robot.root, "the base is free in Drake; weld it to the world"))
    return carried, not_carried


def _omitted_rotor_parts(identified: IdentifiedModel, rotor: Rotor) -> list[Part]:
    """The parts of a rotor that reflected inertia leaves out."""
    parts = []
    entries = [abs(a * b) for a, b in combinations(rotor.ratios, 2)]
    if any(entries):
        parts.append(rotor.part("the coupling between joints in the mass matrix", rotor.inertia * float(max(entries))))
    if rotor.carrier is None or rotor.carrier.any():
        parts.append(rotor.coupling())
    return [*parts, *rotor.imbalance(identified.gravity)]
