"""The URDF's links as MuJoCo's bodies, in the links' frames and under their names, with joints and actuators.

A link on a fixed or locked joint is a body without mass of its own: its mass is part of the body that carries it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from lxml import etree

from idtool.reporting.export.base import Part
from idtool.reporting.export.motors import add_motor
from idtool.reporting.export.primitives import primitives
from idtool.reporting.export.scene import Scene, quaternion, text
from idtool.robot.rotation import rotation_about
from idtool.robot.urdf.reading import UrdfJoint

_WORLD = "world"  # MuJoCo's name for what stands still
_FAR = 1e10  # rad or m: MuJoCo has no limit on one side only


def add_links(scene: Scene, world: etree._Element) -> None:
    """Put all links into the world, with joints, inertials, geometry and actuators."""
    robot = scene.identified.robot
    scene.bodies[robot.root] = world
    geoms = _collect_geoms(scene)
    has_floating_base = scene.identified.model.has_floating_base
    if robot.root != _WORLD or has_floating_base:
        name = _body_name(scene, robot.root)
        scene.bodies[robot.root] = etree.SubElement(world, "body", name=name)
        if has_floating_base:
            etree.SubElement(scene.bodies[robot.root], "freejoint")
            scene.carried.append(Part("floating_base", robot.root, "free joint"))
            scene.add_inertial(robot.root, scene.pi[scene.moving[robot.root]], moves=True)
        else:
            scene.add_inertial(robot.root, scene.pi[-1], moves=False)
    lumped = {member.link for body in scene.identified.model.bodies for member in body.members}
    _add_geoms(scene, robot.root, geoms)
    for joint in robot.joints.values():
        link = joint.child
        _add_body(scene, joint)
        if link in scene.moving:
            scene.add_inertial(link, scene.pi[scene.moving[link]], moves=True)
            if joint.kind != "fixed":  # else it carries a wrench sensor
                _add_joint(scene, joint)
        elif link not in lumped and link not in scene.identified.config.rotors:  # it is fixed to the root
            scene.add_inertial(link, scene.urdf_parameters(link), moves=False)
        _add_geoms(scene, link, geoms)


def _add_body(scene: Scene, joint: UrdfJoint) -> None:
    """The body of a joint's child; a joint that is locked is built into its place."""
    R, p = joint.R, joint.p
    if joint.kind != "fixed" and joint.child not in scene.moving:
        value = scene.identified.value(joint)
        scene.carried.append(Part("locked_joint", joint.name, f"fixed at {value:g}"))
        if joint.kind == "prismatic":
            p = p + R @ joint.axis * value
        else:
            R = R @ rotation_about(joint.axis, value)
    name = _body_name(scene, joint.child)
    scene.bodies[joint.child] = etree.SubElement(
        scene.bodies[joint.parent], "body", name=name, pos=text(p), quat=quaternion(R)
    )


def _body_name(scene: Scene, link: str) -> str:
    """Name of a link's body: the link's, unless it is reserved in MuJoCo."""
    if link != _WORLD:
        return link
    name = link
    while name in scene.identified.robot.links:
        name += "_"
    scene.not_carried.append(Part("name", link, f"this name is reserved in MuJoCo; the body is called {name}"))
    return name


def _add_joint(scene: Scene, joint: UrdfJoint) -> None:
    """A joint that moves, with its limits and what drives it."""
    kind = "slide" if joint.kind == "prismatic" else "hinge"
    element = etree.SubElement(scene.bodies[joint.child], "joint", name=joint.name, type=kind, axis=text(joint.axis))
    if joint.lower < joint.upper and not math.isinf(joint.upper - joint.lower):
        limits = text([max(joint.lower, -_FAR), min(joint.upper, _FAR)])
        element.set("limited", "true")
        element.set("range", limits)
        scene.carried.append(Part("joint_limit", joint.name, f"range {joint.lower:g} to {joint.upper:g}"))
    if joint.mimic is not None:
        _add_follower(scene, joint)
        return
    for name, value in scene.forces[joint.name].attributes().items():
        element.set(name, value)
    add_motor(scene, joint)


def _add_follower(scene: Scene, joint: UrdfJoint) -> None:
    """Hold a mimic joint to the joint at the head of its chain."""
    model = scene.identified.model
    body = model.bodies[scene.moving[joint.child]]
    head = int(np.flatnonzero(body.ratios)[0])
    law = text([body.offset, body.ratios[head], 0.0, 0.0, 0.0])
    etree.SubElement(scene.equalities, "joint", joint1=joint.name, joint2=model.names[head], polycoef=law)
    how = f"coupled to {model.names[head]} by a stiff constraint; it has its own coordinate"
    scene.carried.append(Part("mimic", joint.name, how))


def _collect_geoms(scene: Scene) -> dict[str, list[dict[str, str]]]:
    """The geoms of every link; geometry that is no primitive is listed as not carried."""
    geoms: dict[str, list[dict[str, str]]] = {}
    links_without: dict[str, None] = {}
    for link, geom in primitives(scene.identified.robot):
        if geom is None:
            links_without[link] = None
        else:
            geoms.setdefault(link, []).append(geom)
    if geoms:
        scene.carried.append(Part("geometry", ", ".join(geoms), "primitives, without contact"))
    if links_without:
        scene.not_carried.append(
            Part("geometry", ", ".join(links_without), "meshes and other shapes that are not primitives")
        )
    return geoms


def _add_geoms(scene: Scene, link: str, geoms: Mapping[str, list[dict[str, str]]]) -> None:
    for geom in geoms.get(link, ()):
        etree.SubElement(scene.bodies[link], "geom", geom)
