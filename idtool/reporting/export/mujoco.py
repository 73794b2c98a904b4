"""The identified model as MJCF."""

from __future__ import annotations

import math

from lxml import etree

from idtool.common.version import VERSION
from idtool.reporting.export.base import Export, Part
from idtool.reporting.export.identified import CONFIG, URDF, IdentifiedModel
from idtool.reporting.export.links import add_links
from idtool.reporting.export.mujoco_rotors import add_reflected_inertia, add_rotor_body, omitted_parts
from idtool.reporting.export.primitives import GROUPS
from idtool.reporting.export.rotors import averaged_rotors
from idtool.reporting.export.scene import Scene, comment, text
from idtool.robot.urdf.reading import parse_xml

FILE = "mujoco.xml"

# A time constant of two steps and an impedance next to one: a joint at rest is stopped within a step, and creeps by
# 1e-7 s times the acceleration that its friction withstands; a follower lags as little.
_SOLREF, _SOLIMP = "0.002 1", "0.9999 0.9999 0.001 0.5 2"


def to_mujoco(identified: IdentifiedModel, rotor_bodies: bool = False) -> Export:
    """The identified model as MJCF.

    Parameters
    ----------
    identified
        The model.
    rotor_bodies
        Whether a rotor that inertia on joints cannot carry in full becomes a body of its own.

    Raises
    ------
    ModelError
        If a moving body has an inertia that is not realizable, which MuJoCo rejects.
    """
    scene = Scene(identified)
    _add_effects(scene)
    rotors = averaged_rotors(identified)
    with_body = []
    for rotor in rotors:
        if rotor_bodies and omitted_parts(scene, rotor):
            with_body.append(rotor)
        else:
            add_reflected_inertia(scene, rotor)
    world = etree.Element("worldbody")
    add_links(scene, world)
    for rotor in with_body:
        add_rotor_body(scene, rotor)
    root = etree.Element("mujoco", model=_model_name(identified))
    root.append(comment(_header_lines(scene, bool(with_body))))
    _add_head(scene, root)
    scene.actuators.extend(scene.constants)
    sections = (world, scene.tendons, scene.equalities, scene.actuators)
    root.extend([section for section in sections if len(section)])
    if identified.config.controller is not None:
        root.append(comment(_controller_lines(scene)))
    content = bytes(etree.tostring(root, pretty_print=True, encoding="utf-8"))
    return Export(FILE, content, tuple(scene.carried), tuple(scene.not_carried))


def _add_effects(scene: Scene) -> None:
    """Add the effects on the joints."""
    identified = scene.identified
    scene.carried += [*identified.inertias, *identified.armatures, *identified.tilts, *identified.offsets]
    for j, forces in enumerate(scene.forces.values()):
        forces.armature = float(identified.mechanism.armature[j])
        forces.ref = -float(identified.mechanism.position_offset[j])
    not_carried = list(identified.others)
    for term in identified.terms:
        part = scene.forces.add_term(term)
        if part:
            scene.carried.append(part)
        else:
            not_carried.append(term.not_carried_part)
    scene.not_carried += dict.fromkeys(not_carried)  # an effect of several terms is one


def _add_head(scene: Scene, root: etree._Element) -> None:
    """Options and defaults."""
    gravity = text(scene.identified.gravity)
    scene.carried.append(Part("gravity", scene.identified.robot.root, gravity))
    explicit = {"autolimits": "false", "inertiafromgeom": "false", "balanceinertia": "false"}
    etree.SubElement(root, "compiler", explicit, angle="radian")
    etree.SubElement(root, "option", timestep="0.001", integrator="implicitfast", gravity=gravity)
    default = etree.SubElement(root, "default")
    etree.SubElement(default, "joint", solreffriction=_SOLREF, solimpfriction=_SOLIMP)
    etree.SubElement(default, "equality", solref=_SOLREF, solimp=_SOLIMP)
    for name, group in GROUPS.items():
        kind = etree.SubElement(default, "default", {"class": name})
        etree.SubElement(kind, "geom", group=group, contype="0", conaffinity="0")


def _header_lines(scene: Scene, has_rotor_bodies: bool) -> list[str]:
    needed = "3.7" if any(forces.drag for forces in scene.forces.values()) else "3.3.1"
    lines = [
        f"Written by idtool {VERSION} from {URDF} and {CONFIG}; needs MuJoCo {needed} or newer.",
        "rad, m, s, kg, N·m. ctrl is the torque or force at the joint.",
    ]
    if has_rotor_bodies:
        lines.append(
            "Before a simulation, set the positions and velocities of the rotors consistently with their joints."
        )
    if scene.not_carried:
        lines += ["Not exported:", *(f"  {part}" for part in scene.not_carried)]
    return lines


def _controller_lines(scene: Scene) -> list[str]:
    """The controller in words: a motor's control is a torque, so that any controller can drive it."""
    controller = scene.identified.config.controller
    if controller is None:
        return []
    lines = ["Controller of the robot: ctrl = kp (qcmd - q) + kd (vcmd - v),"]
    delay = controller.known_delay
    unknown = "with a delay that was not identified (controller.delay: auto)."
    lines.append(f"with a command that is delayed by {delay.value!r} s." if delay else unknown)
    for name in scene.forces:
        kp = controller.kp_of(name)
        if kp is not None and math.isfinite(kp + controller.kd_of(name)):
            lines.append(f"  {name}: kp {kp!r}, kd {controller.kd_of(name)!r}")
    return lines


def _model_name(identified: IdentifiedModel) -> str:
    name = parse_xml(identified.robot.path, identified.robot.text).get("name", "")
    return name if name.isprintable() and name else "robot"
