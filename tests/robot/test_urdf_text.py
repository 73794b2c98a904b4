"""Writing into URDFs as people write them: what is marked below is replaced, every other byte stays."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from lxml import etree
from numpy.typing import NDArray

from idtool.robot.inertia import from_mass_com_inertia
from idtool.robot.urdf.reading import Robot
from idtool.robot.urdf.writing import JointDynamics, relocate_meshes, replace_parameters

Array = NDArray[np.float64]

PI = from_mass_com_inertia(2.0, [0.1, -0.2, 0.3], np.diag([0.03, 0.02, 0.04]))
DYNAMICS = JointDynamics(0.125, 0.375)

# What is to be replaced stands between ⟦ and ⟧, behind a letter that says by what:
# Inertial, Link with an inertial, Joint dynamics, Damping, Friction, lower case where they were not there.
INERTIAL = '⟦I<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>⟧'
NEW = {
    "I": r"\s*<inertial>\s*<origin [^<]*/>\s*<mass value=\"2\.0\"/>\s*<inertia [^<]*/>\s*</inertial>",
    "J": r'\s*<dynamics damping="0\.125" friction="0\.375"/>',
    "D": r'"0\.125"',
    "F": r'"0\.375"',
    "d": r' damping="0\.125"',
    "f": r' friction="0\.375"',
}
NEW["L"] = rf">{NEW['I']}\s*</link>"
DAMPED = '<dynamics damping=⟦D"1"⟧ friction=⟦F"2"⟧/>'

PLAIN = f"""<robot name="r">
  <link name="base"/>
  <link name="arm">
    {INERTIAL}
  </link>
  <joint name="j" type="revolute">
    <parent link="base"/><child link="arm"/><limit lower="-1" upper="1" effort="1" velocity="1"/>{DAMPED}
  </joint>
</robot>
"""
GAZEBO = """<gazebo reference="arm"><inertial><mass value="9"/></inertial><link name="arm"><inertial/></link></gazebo>
  <transmission name="t"><joint name="j"><dynamics damping="9"/></joint><actuator name="m"/></transmission>
  <ros2_control name="c"><joint name="j"><param name="dynamics">3</param></joint></ros2_control>
"""


def plain(old: str, new: str) -> str:
    assert old in PLAIN
    return PLAIN.replace(old, new)


ARM = '<link name="arm">'
MORE = f"""<dynamics x-damping="7" note=" damping='8'" {DAMPED[10:-2]} spring="3"><!-- worn --></dynamics>"""
FILES = {
    "plain": PLAIN,
    "CRLF": plain("\n", "\r\n"),
    "tabs": plain("  ", "\t"),
    "one line": plain("\n", ""),
    "no newline at the end": PLAIN.rstrip("\n"),
    "a byte order mark": "\ufeff" + PLAIN,
    "a declaration": '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n<?xml-model href="x"?>\n' + PLAIN,
    "single quotes": PLAIN.replace('"', "'").replace("⟦D'1'⟧", '⟦D"1"⟧'),
    "quotes in quotes": plain(ARM, """<link name="arm" a='say "hi"' b="it's">"""),
    "greater in an attribute": plain(ARM, '<link a="1 > 0 />" name="arm" b=">">'),
    "attributes over lines": plain(ARM, '<link\n    name\n  =\n  "arm"\n  >'),
    "space before the end of tags": PLAIN.replace("</link>", "</link  >").replace("</inertial>", "</inertial\n>"),
    "other alphabets": plain("<robot", "<!-- Größe 脚 🦿 -->\n<robot").replace('"base"', '"Sockel_足"'),
    "entities": plain(ARM, '<link note="&lt;inertial/&gt; &amp;" name="a&#114;m">'),
    "comments": plain(ARM, f"<!-- {ARM}<inertial/></link> -->{ARM}<!-- <inertial/> -->"),
    "character data": plain("</robot>", f"<x><![CDATA[{ARM}<inertial/></link>]]></x></robot>"),
    "tags of others": plain("</robot>", GAZEBO + "</robot>").replace("<robot name", "<robot xmlns:g='http://g' name"),
    "an inertial behind the visual": plain(INERTIAL, f"<visual/>\n\n\n      {INERTIAL}\n  <collision/>"),
    "a self-closing link": re.sub(r"<link name=\"arm\">.*?</link>", '<link name="arm"⟦L/>⟧', PLAIN, flags=re.DOTALL),
    "one with a space": re.sub(r"<link name=\"arm\">.*?</link>", '<link name="arm" ⟦L/>⟧', PLAIN, flags=re.DOTALL),
    "greater in a self-closing link": re.sub(
        r"<link name=\"arm\">.*?</link>", '<link a="1 > 0 />" name="arm" b=">"⟦L/>⟧', PLAIN, flags=re.DOTALL
    ),
    "an empty link": re.sub(r">\s*⟦I.*?⟧\s*<", ">⟦I⟧<", PLAIN, flags=re.DOTALL),
    "a link without inertial": re.sub(r">(\s*)⟦I.*?⟧", r">⟦I⟧\1<visual/>", PLAIN, flags=re.DOTALL),
    "a self-closing inertial": re.sub(r"⟦I.*?⟧", "⟦I<inertial/>⟧", PLAIN, flags=re.DOTALL),
    "no dynamics": plain(DAMPED, "").replace('type="revolute">', 'type="revolute">⟦J⟧'),
    "no dynamics and greater in an attribute": plain(DAMPED, "").replace('lute">', """lute" a='/>' b=">">⟦J⟧"""),
    "empty dynamics": plain(DAMPED, "<dynamics⟦d⟧⟦f⟧ />"),
    "damping only": plain(DAMPED, "<dynamics damping = ⟦D'1'⟧⟦f⟧></dynamics>"),
    "friction only": plain(DAMPED, "<dynamics friction=⟦F\"1\"⟧⟦d⟧\n/>"),
    "dynamics with more": plain(DAMPED, MORE),
}  # fmt: skip


@pytest.fixture(params=FILES, ids=[name.replace(" ", "-") for name in FILES])
def marked(request: pytest.FixtureRequest) -> str:
    """A file with marks."""
    return FILES[request.param]


def unmarked(marked: str) -> bytes:
    """The file as it is before."""
    return re.sub(r"⟦.(.*?)⟧", r"\1", marked, flags=re.DOTALL).encode()


def written(text: bytes) -> bytes:
    return replace_parameters(text, {"arm": PI}, {"j": DYNAMICS})


def same(pi: Array | None) -> bool:
    """Whether parameters are those written, but for rounding."""
    return pi is not None and np.allclose(pi, PI, rtol=1e-14, atol=1e-17)


def test_only_what_is_marked_is_replaced(marked: str) -> None:
    kept = re.split(r"⟦(.).*?⟧", marked, flags=re.DOTALL)
    pattern = "".join(NEW[part] if i % 2 else re.escape(part) for i, part in enumerate(kept))
    new = written(unmarked(marked))
    assert re.fullmatch(pattern, new.decode()), new.decode()


def test_the_new_file_is_read_with_the_new_numbers(marked: str, robot_of: Callable[[bytes], Robot]) -> None:
    robot, old = robot_of(written(unmarked(marked))), robot_of(unmarked(marked))
    assert same(robot.links["arm"])
    assert (robot.joints["j"].damping, robot.joints["j"].friction) == (0.125, 0.375)
    assert list(robot.links) == list(old.links)
    assert list(robot.joints) == list(old.joints)


def test_written_twice_is_written_once(marked: str) -> None:
    once = written(unmarked(marked))
    assert written(once) == once


def test_line_ends_are_the_files(marked: str) -> None:
    old, new = unmarked(marked), written(unmarked(marked))
    if b"\r\n" in old:
        assert new.count(b"\n") == new.count(b"\r\n")
    else:
        assert b"\r" not in new


@pytest.mark.parametrize("values", [JointDynamics(), JointDynamics(damping=0.5), JointDynamics(friction=0.5)])
def test_dynamics_that_are_not_given_stay(
    marked: str, values: JointDynamics, robot_of: Callable[[bytes], Robot]
) -> None:
    old = unmarked(marked)
    new = replace_parameters(old, {}, {"j": values})
    joint, before = robot_of(new).joints["j"], robot_of(old).joints["j"]
    assert joint.damping == (before.damping if values.damping is None else 0.5)
    assert joint.friction == (before.friction if values.friction is None else 0.5)
    assert new == old or values != JointDynamics()


def test_a_link_that_loses_its_mass_loses_nothing_else(marked: str, robot_of: Callable[[bytes], Robot]) -> None:
    old = unmarked(marked)
    new = replace_parameters(old, {"arm": None}, {})
    assert robot_of(new).links["arm"] is None
    left = re.sub(r"\s*⟦I.*?⟧", "", marked, flags=re.DOTALL)
    assert re.sub(rb"\s", b"", new) == re.sub(rb"\s", b"", unmarked(left))
    assert replace_parameters(new, {"arm": None}, {}) == new


def test_latin_1(robot_of: Callable[[bytes], Robot]) -> None:
    """Places are counted in bytes, however many characters they make."""
    text = '<?xml version="1.0" encoding="ISO-8859-1"?>\n<!-- Größe -->\n' + PLAIN.replace('"base"', '"Füße"')
    old = unmarked(text).decode().encode("latin-1")
    new = written(old)
    head = old[: old.index(b"<inertial>")]
    assert new.startswith(head)
    assert same(robot_of(new).links["arm"])


MESHES = """<robot name="r">
  <!-- <mesh filename="meshes/a.stl"/> -->
  <link name="a"><visual><geometry><mesh scale="1 1 1" filename = 'meshes/a &amp; é.stl'/></geometry></visual>
    <visual><geometry><mesh filename="package://r/meshes/b.stl"/></geometry></visual>
    <collision><geometry><mesh filename="meshes/none.stl"/></geometry></collision>
    <visual><geometry><mesh filename="/abs/b.stl"/></geometry>
      <material name="m"><texture filename="meshes/b.png"/></material></visual></link>
</robot>
"""


@pytest.mark.parametrize("encoding", ["UTF-8", "ISO-8859-1"])
def test_relative_names_of_meshes_hold_in_another_folder(tmp_path: Path, encoding: str) -> None:
    text = (f'<?xml version="1.0" encoding="{encoding}"?>\n' + MESHES).encode(encoding)
    (tmp_path / "robot" / "meshes").mkdir(parents=True)
    (tmp_path / "robot" / "meshes" / "a & é.stl").touch()
    (tmp_path / "robot" / "meshes" / "b.png").touch()
    urdf = tmp_path / "robot" / "r.urdf"
    new = relocate_meshes(text, urdf, tmp_path / "elsewhere" / "out")
    names = [element.get("filename") for element in etree.fromstring(new).iter("mesh", "texture")]
    up = "../../robot/meshes"
    assert names == [
        f"{up}/a & é.stl",
        "package://r/meshes/b.stl",
        "meshes/none.stl",
        "/abs/b.stl",
        f"{up}/b.png",
    ]
    (tmp_path / "elsewhere" / "out").mkdir(parents=True)
    back = relocate_meshes(new, tmp_path / "elsewhere" / "out" / "r.urdf", urdf.parent)
    assert back.replace(b"&#233;", "é".encode(encoding)) == text.replace(b"'", b'"')
    assert relocate_meshes(text, urdf, urdf.parent) == text
