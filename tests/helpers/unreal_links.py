"""Links with inertias that no body can have, beside sound ones, and MuJoCo's word on them."""

from __future__ import annotations

import re
from collections.abc import Mapping

import mujoco  # type: ignore[import-untyped]
from robots import joint

OFF = '<mujoco><compiler balanceinertia="false" fusestatic="false" discardvisual="true"/></mujoco>'

# Mass, centre of mass, principal moments, and what is said of the link.
LINKS: dict[str, tuple[float, tuple[float, float, float], tuple[float, float, float], str]] = {
    "sound": (1.5, (0.0, 0.1, 0.0), (0.012, 0.016, 0.02), ""),
    "plate": (1.0, (0.2, 0.0, 0.0), (0.01, 0.02, 0.03), ""),
    "broken": (2.0, (0.05, -0.02, 0.3), (0.01, 0.02, 0.05), "I1 + I2 < I3: 0.01 + 0.02 < 0.05 kg·m² (by 40 %)"),
    "just": (0.8, (0.0, 0.0, 0.1), (0.01, 0.01, 0.0201), "I1 + I2 < I3: 0.01 + 0.01 < 0.0201 kg·m² (by 0.5 %)"),
    "inside_out": (1.0, (0.0, 0.0, 0.0), (-0.01, 0.02, 0.025), "principal moment I1 is negative: -0.01 kg·m²"),
    "balloon": (-0.3, (0.0, 0.0, 0.0), (0.01, 0.01, 0.01), "mass is not positive: -0.3 kg"),
}
WRONG = {name for name, (*_, said) in LINKS.items() if said}


def links_urdf(names: Mapping[str, object] | set[str], turned: bool = True) -> str:
    """Links one after the other on a base without mass, their inertials turned against their frames."""
    links, joints, parent = [], [], "base"
    for name in LINKS:
        if name in names:
            mass, com, moments, _ = LINKS[name]
            rpy = "0.4 -0.7 1.1" if turned else "0 0 0"
            place = f'<origin xyz="{com[0]} {com[1]} {com[2]}" rpy="{rpy}"/>'
            inertia = '<inertia ixx="{}" iyy="{}" izz="{}" ixy="0" ixz="0" iyz="0"/>'.format(*moments)
            inside = f"<inertial>{place}\n    <mass value='{mass}'/>{inertia}</inertial>"
            links.append(f'  <link name="{name}"> <!-- a comment -->\n    {inside}\n  </link>')
            joints.append("  " + joint(f"{name}_joint", "revolute", parent, name))
            parent = name
    return "\n".join(['<robot name="r">', OFF, '  <link name="base"/>', *links, *joints, "</robot>", ""])


def compiles(text: str | bytes) -> bool:
    """Whether MuJoCo, told not to mend inertias, takes a URDF."""
    try:
        mujoco.MjModel.from_xml_string(text if isinstance(text, str) else text.decode())
    except ValueError as error:
        assert "inertia" in str(error) or "mass" in str(error)  # noqa: PT017
        return False
    return True


def without_inertial(text: bytes, link: str) -> bytes:
    """The text with a link's inertial taken out."""
    pattern = rb'(<link name="' + link.encode() + rb'">.*?)<inertial>.*?</inertial>'
    found = re.subn(pattern, rb"\1", text, count=1, flags=re.DOTALL)
    assert found[1] == 1
    return found[0]
