"""Transmissions of a URDF as Drake reads them: one a joint, with the rotor's inertia and the gear ratio."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from idtool.reporting.export.spans import Span, quoted


def transmissions(text: bytes, root: Span, gears: Mapping[str, tuple[float, float]]) -> list[tuple[int, int, bytes]]:
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
    taken: set[str] = set()
    for span in root.named("transmission"):
        actuators = [child.attributes.get("name", "") for child in span.named("actuator")]
        joint = _joint(text, span, gears)
        if joint is None:
            taken.update(actuators)
        else:
            edits.append((span.start, span.stop, b""))
            names.setdefault(joint, next(filter(None, actuators), joint))
    end = b"\r\n" if b"\r\n" in text[: root.opened + 2] else b"\n"
    written = b""
    for joint, (inertia, ratio) in gears.items():
        name = names.get(joint, joint)
        while name in taken:
            name += "_"
        taken.add(name)
        written += end.join([*_rows(joint, name, inertia, ratio), b""])
    last = text.rindex(b"</", root.start, root.stop)
    return [*edits, (last, last, written)]


def _joint(text: bytes, span: Span, joints: Collection[str]) -> str | None:
    """The joint, of those given, whose transmission this is in Drake's eyes."""
    found = [child.attributes.get("name", "") for child in span.named("joint")]
    is_simple = b"SimpleTransmission" in text[span.start : span.stop]
    return found[0] if is_simple and len(found) == 1 and found[0] in joints else None


def _rows(joint: str, actuator: str, inertia: float, ratio: float) -> list[bytes]:
    return [
        b"  <transmission name=" + quoted(f"{actuator}_transmission") + b">",
        b"    <type>transmission_interface/SimpleTransmission</type>",
        b"    <joint name=" + quoted(joint) + b"/>",
        b"    <actuator name=" + quoted(actuator) + b">",
        f'      <drake:rotor_inertia value="{inertia!r}"/>'.encode(),
        f'      <drake:gear_ratio value="{ratio!r}"/>'.encode(),
        b"    </actuator>",
        b"  </transmission>",
    ]
