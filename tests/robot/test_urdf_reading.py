"""URDFs as they are read, and URDFs that are wrong or hostile."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
import yourdfpy
from robots import chain, inertial, joint, link, random_urdf
from scipy.spatial.transform import Rotation

from idtool.common.exceptions import ModelError
from idtool.robot.inertia import from_mass_com_inertia
from idtool.robot.urdf.reading import Robot, read_robot

SAMPLES = Path(__file__).parents[2] / "sample_logs"
Read = Callable[[str | bytes], Robot]


def test_the_urdf_is_read_as_written(robot_of: Read) -> None:
    text = chain(
        '<joint name="j1" type="prismatic"><parent link="l0"/><child link="l1"/>'
        '<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/><axis xyz="0 3 4"/><dynamics damping="0.4" friction="0.5"/>'
        '<limit lower="-1" upper="2" velocity="3" effort="4"/></joint>',
        '<joint name="j2" type="continuous"><parent link="l1"/><child link="l2"/></joint>',
    )
    first, second = robot_of("<?xml version='1.0'?><!-- a comment -->" + text).joints.values()
    np.testing.assert_allclose(first.R, Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_matrix())
    np.testing.assert_allclose(first.p, [1, 2, 3])
    np.testing.assert_allclose(first.axis, [0, 0.6, 0.8])
    limits = first.damping, first.friction, first.lower, first.upper, first.velocity, first.effort
    assert limits == (0.4, 0.5, -1.0, 2.0, 3.0, 4.0)
    np.testing.assert_array_equal(second.axis, [1, 0, 0])
    assert (second.lower, second.upper, second.effort, second.damping) == (-np.inf, np.inf, np.inf, 0.0)


def test_joints_on_one_branch_carry_each_other(robot_of: Read) -> None:
    """A trunk with two legs, one of two joints; by Pinocchio, torque couples joints of a branch and no others."""
    moments = 'ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"'
    mass = f'<inertial><origin xyz="0.1 0.2 0.3"/><mass value="1"/><inertia {moments}/></inertial>'
    limit = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'
    ends = {"hip": ("trunk", "thigh"), "knee": ("thigh", "shank"), "other": ("trunk", "stick")}
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>{limit}</joint>'
        for name, (parent, child) in ends.items()
    )
    links = "".join(f'<link name="{child}">{mass}</link>' for _, child in ends.values())
    text = f'<robot name="r"><link name="trunk"/>{links}{joints}</robot>'
    robot, model = robot_of(text), pin.buildModelFromXML(text)
    coupled = np.triu(pin.crba(model, model.createData(), np.zeros(3)))
    for i, one in enumerate(model.names[1:]):
        for j, another in enumerate(model.names[1:]):
            assert robot.on_same_branch(one, another) == (coupled[i, j] + coupled[j, i] != 0)
    assert robot.path_to_root("knee") == ["knee", "hip"]


def test_an_inertial_frame_is_turned_into_the_links(robot_of: Read, rng: np.random.Generator) -> None:
    text = chain(link(1)).replace('<link name="l1"/>', f'<link name="l1">{inertial(rng)}</link>')
    (expected,) = [i.toDynamicParameters() for i in list(pin.buildModelFromXML(text).inertias)[1:]]
    pi = robot_of(text).links["l1"]
    assert pi is not None
    np.testing.assert_allclose(pi, expected, atol=1e-12)


def test_what_is_not_needed_is_not_read(robot_of: Read) -> None:
    """Visuals, plugins and transmissions, however strange, and a name in another alphabet."""
    strange = '<visual><geometry><mesh filename="package://x.dae" scale="big"/></geometry></visual>'
    text = chain(link(1)).replace('<link name="l0"/>', f'<link name="l0">{strange}</link>').replace("j1", "膝")
    extra = "<gazebo><plugin name='x'/></gazebo><transmission/><material/><?php none?></robot>"
    assert list(robot_of(text.replace("</robot>", extra)).joints) == ["膝"]


@pytest.mark.parametrize("source", ["leg", "belt_arm", *range(8)])
def test_another_parser_reads_the_same(robot_of: Read, source: str | int) -> None:
    """The sample robots and random ones, by yourdfpy, which is not particular about what it reads."""
    if isinstance(source, int):
        text = random_urdf(np.random.default_rng(source), size=9, massless=0.3)
    else:
        text = (SAMPLES / f"{source}.urdf").read_text()
    robot = robot_of(text)
    other = yourdfpy.URDF.load(io.StringIO(text), build_scene_graph=False, load_meshes=False).robot
    assert robot.links.keys() == {link.name for link in other.links}
    assert robot.joints.keys() == {joint.name for joint in other.joints}
    for theirs in other.links:
        pi = robot.links[theirs.name]
        assert (pi is None) == (theirs.inertial is None)
        if pi is not None:
            T = np.eye(4) if theirs.inertial.origin is None else theirs.inertial.origin
            moments = T[:3, :3] @ theirs.inertial.inertia @ T[:3, :3].T
            expected = from_mass_com_inertia(theirs.inertial.mass, T[:3, 3], moments)
            np.testing.assert_allclose(pi, expected, rtol=1e-12, atol=1e-15)
    for theirs in other.joints:
        ours = robot.joints[theirs.name]
        T = np.eye(4) if theirs.origin is None else theirs.origin
        np.testing.assert_allclose(ours.R, T[:3, :3], rtol=0, atol=1e-15)
        np.testing.assert_array_equal(ours.p, T[:3, 3])
        assert (ours.kind, ours.parent, ours.child) == (theirs.type, theirs.parent, theirs.child)
        if theirs.limit is not None and theirs.type != "continuous":
            assert (ours.lower, ours.upper, ours.effort) == (
                theirs.limit.lower,
                theirs.limit.upper,
                theirs.limit.effort,
            )


XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
ENTITIES = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 10))
INERTIAL = '<inertial><mass value="{}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
PAIR = '<robot name="r"><link name="l0"/><link name="l1">{}</link>{}</robot>'


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is not XML"),
        ("joint: hip", "is not XML"),
        (b"\x00\x01\x02", "is not XML"),
        (chain(link(1))[:-9], "is not XML"),
        (
            "<robot>\n<link\n<a/></robot>",
            "is not XML: error parsing attribute name (line 3, column 1); correct the file there",
        ),
        ("<robot>\n<ge", "is not XML: Couldn't find end of Start Tag ge (line 2, column 4)"),
        ("<a>" * 2000 + "</a>" * 2000, "is not XML"),
        ("<html/>", "its root element is <html>, not <robot>"),
        (f"<!DOCTYPE robot>{chain(link(1))}", "declares a document type"),
        ('<!DOCTYPE r [<!ENTITY e SYSTEM "file:///etc/passwd">]><robot name="r"><a>&e;</a></robot>', "declares a doc"),
        (
            f'<!DOCTYPE r [<!ENTITY e0 "ha">{ENTITIES}]><robot name="r"><a>&e9;</a></robot>',
            "is not XML",
        ),
        (f'<!DOCTYPE r [<!ENTITY e0 "ha">{ENTITIES}]><robot name="&e9;"/>', "is not XML"),
        (f'<robot {XACRO} name="r"><xacro:leg name="l"/></robot>', "run xacro"),
        (f'<robot {XACRO} name="r"><xacro:property name="x" value="1"/><link name="${{x}}"/></robot>', "run xacro"),
        ('<robot name="r"/>', "no root link"),
        (chain(link(1)).replace("</robot>", '<link name="x"/></robot>'), "has 2 root links (l0, x)"),
        (chain(link(1)).replace("</robot>", joint("j2", "fixed", "l1", "l0") + "</robot>"), "no root link"),
        (chain(link(1), joint("j2", "fixed", "l2", "l2")), "loop"),
        (chain(link(1), link(2), joint("j3", "fixed", "l0", "l2")), "link l2 is the child of two joints"),
        (chain(link(1), joint("j1", "fixed", "l1", "l2")), "; rename all but one"),
        (chain(link(1)).replace("</robot>", '<link name="l0"/></robot>'), "; rename all but one"),
        (chain(joint("j1", "fixed", "l0", "thigh")), "names link thigh, which the URDF does not define"),
        (chain(link(1, kind="floating")), "type floating is not supported"),
        (chain(link(1)).replace('type="revolute"', ""), "type None is not supported"),
        (chain(link(1)).replace('<child link="l1"/>', ""), "joint j1: has no child link"),
        (chain(link(1)).replace('<parent link="l0"/>', "<parent/>"), "joint j1: has no parent link"),
        (chain(link(1)).replace('name="j1"', ""), "has no name"),
        (chain(link(1)).replace('<link name="l1"/>', "<link/>"), "has no name"),
        (chain(link(1, axis="0 0 0")), "joint j1: its axis is zero"),
        (chain(link(1, axis="0 0 nan")), "not consist of three finite numbers"),
        (chain(link(1, axis="0 1")), "joint j1: its axis xyz '0 1' should be three finite numbers"),
        (chain(link(1, '<origin xyz="0 0 inf"/>')), "not consist of three finite numbers"),
        (chain(link(1, '<origin rpy="nan 0 0"/>')), "not consist of three finite numbers"),
        (chain(link(1, '<origin xyz="0 0"/>')), "joint j1: its origin xyz '0 0' should be three finite numbers"),
        (chain(link(1, '<origin xyz="0 0 up"/>')), "joint j1: its origin xyz '0 0 up' should be three finite numbers"),
        (chain(link(1, '<origin rpy="0 0 0 0"/>')), "its origin rpy '0 0 0 0' should be three finite numbers"),
        (chain(link(1, '<dynamics friction="some"/>')), "its dynamics friction 'some' should be a finite number"),
        (chain(link(1, '<origin xyz="0 0 ${x}"/>')), "run xacro"),
        (
            chain(link(1, '<dynamics damping="nan"/>')),
            "joint j1: its dynamics or mimic has a value that is not a fin",
        ),
        (chain(link(1), link(2, '<mimic joint="j1" multiplier="inf"/>')), "joint j2: its dynamics or mimic has"),
        (PAIR.format(INERTIAL.format("nan"), link(1)), "link l1: its inertial has a value that is not a finite"),
        (PAIR.format(INERTIAL.format("heavy"), link(1)), "link l1: its mass value 'heavy' should be a finite number"),
        (PAIR.format(INERTIAL.format("1").replace('iyy="1" ', ""), link(1)), "link l1: its inertia lacks iyy"),
    ],
)
def test_a_urdf_that_makes_no_robot(robot_of: Read, text: str | bytes, expected: str) -> None:
    with pytest.raises(ModelError) as caught:
        robot_of(text)
    message = str(caught.value)
    assert expected in message
    assert "robot.urdf: " in message
    assert "\n" not in message


def test_a_urdf_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot be read"):
        read_robot(tmp_path / "none.urdf")
    with pytest.raises(ModelError, match="is a folder; give a URDF"):
        read_robot(tmp_path)
    (tmp_path / "identified.urdf").touch()
    with pytest.raises(ModelError, match=r"is a folder; give .*/identified\.urdf"):
        read_robot(tmp_path)


@pytest.mark.parametrize("name", ["log.csv", "log.urdf"])
def test_a_log_in_its_place(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"t,q_a" if name == "log.csv" else b"\x89MCAP0\r\n")
    with pytest.raises(ModelError, match="is a log; give the URDF first"):
        read_robot(tmp_path / name)


def test_a_configuration_in_its_place(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("gravity: [0, 0, -9.81]")
    with pytest.raises(ModelError, match="is not a URDF, which is XML; give the URDF first"):
        read_robot(tmp_path / "robot.yaml")
