"""Transmissions of a URDF as Drake reads them: one a joint, with the rotor's inertia and the gear ratio."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from idtool.robot.urdf.text import Edit, Element, quoted_attribute


def transmissions(text: bytes, root: Element, gears: Mapping[str, tuple[float, float]]) -> list[Edit]:
    """The edits that give every joint one transmission, in place of those it has; an actuator keeps its name.

    Parameters
    ----------
    text, root
        A URDF.
    gears
        Rotor inertia [kg·m²] and gear ratio by joint.
    """
    edits = []
    names: dict[str, str] = {}
    used_names: set[str] = set()
    for transmission in root.with_tag("transmission"):
        actuators = [actuator.name for actuator in transmission.with_tag("actuator")]
        joint = _joint_of(text, transmission, gears)
        if joint is None:
            used_names.update(actuators)
        else:
            edits.append(Edit(transmission.start, transmission.stop, b""))
            names.setdefault(joint, next(filter(None, actuators), joint))
    end = b"\r\n" if b"\r\n" in text[: root.content + 2] else b"\n"
    new_text = b""
    for joint, (inertia, ratio) in gears.items():
        name = names.get(joint, joint)
        while name in used_names:
            name += "_"
        used_names.add(name)
        new_text += end.join([*_transmission_lines(joint, name, inertia, ratio), b""])
    last = text.rindex(b"</", root.start, root.stop)
    return [*edits, Edit(last, last, new_text)]


def _joint_of(text: bytes, element: Element, joints: Collection[str]) -> str | None:
    """The joint, of those given, whose transmission this is in Drake's eyes."""
    names = [joint.name for joint in element.with_tag("joint")]
    is_simple = b"SimpleTransmission" in text[element.start : element.stop]
    if is_simple and len(names) == 1 and names[0] in joints:
        return names[0]
    return None


def _transmission_lines(joint: str, actuator: str, inertia: float, ratio: float) -> list[bytes]:
    return [
        b"  <transmission name=" + quoted_attribute(f"{actuator}_transmission") + b">",
        b"    <type>transmission_interface/SimpleTransmission</type>",
        b"    <joint name=" + quoted_attribute(joint) + b"/>",
        b"    <actuator name=" + quoted_attribute(actuator) + b">",
        f'      <drake:rotor_inertia value="{inertia!r}"/>'.encode(),
        f'      <drake:gear_ratio value="{ratio!r}"/>'.encode(),
        b"    </actuator>",
        b"  </transmission>",
    ]
