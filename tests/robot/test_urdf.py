"""The identified URDF: what was identified is in it, and every other byte is the user's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from robots import actuated, body, link_pi, random_urdf
from synthetic import true_body

from idtool.robot.body import Body
from idtool.robot.config import Config
from idtool.robot.inertia import WRITTEN_DIGITS, from_mass_com_inertia, pseudo_inertia
from idtool.robot.model import RobotModel, build_model
from idtool.robot.urdf.reading import Robot
from idtool.robot.urdf.writing import JointDynamics, identified_urdf, link_parameters, replace_parameters

Build = Callable[..., RobotModel]

ODD = b"""<?xml version='1.0' encoding="utf-8"?>\r
<!-- <link name="a"><inertial/></link> -->\r
<robot name='r' xmlns:x="http://x">\r
\t<link\r
\t   name='a'  note="1 > 0" >\r
\t\t<!-- kept --><visual><geometry><box size="1 1 1"/></geometry></visual>\r
\t\t<inertial><!-- goes --><mass value="1"/>\r
\t\t</inertial>\r
\t</link>\r
  <link name="b"/><link name="c"></link>
  <joint name="j" type="revolute"><parent link="a"/><child link="b"/>
    <limit lower="-1" upper='1' effort="1" velocity="1"/>
    <dynamics damping="0.5"   friction='0.25'/></joint>
  <joint name="k" type="fixed"><parent link="b"/><child link="c"/></joint>
  <gazebo reference="a"><link name="a"><inertial><mass value="7"/></inertial></link></gazebo>
  <transmission name="t"><joint name="j"><dynamics damping="9"/></joint></transmission>
</robot>"""

WRITTEN = 10.0 ** (1 - WRITTEN_DIGITS)  # relative precision of what files hold
PI = from_mass_com_inertia(2.0, [0.1, -0.2, 0.3], np.diag([0.03, 0.02, 0.04]))


def test_what_is_not_replaced_stays_byte_for_byte() -> None:
    written = replace_parameters(ODD, {"a": PI}, {"j": JointDynamics(0.1, None)})
    start = ODD.index(b"<inertial><!-- goes")
    stop = ODD.index(b"</inertial>\r\n\t</link>") + len(b"</inertial>")
    assert written.startswith(ODD[:start] + b"<inertial>")
    rest = ODD[stop:].replace(b'damping="0.5"', b'damping="0.1"')
    assert written.endswith(b"</inertial>" + rest)


def test_nothing_to_replace_changes_nothing() -> None:
    assert replace_parameters(ODD, {}, {}) == ODD
    assert replace_parameters(ODD, {"stranger": PI}, {"stranger": JointDynamics(1.0, 1.0)}) == ODD


def test_what_was_not_there_is_put_in() -> None:
    written = replace_parameters(ODD, {"b": PI, "c": PI}, {"k": JointDynamics(0.1, 0.2)})
    assert written.count(b"<inertial>") == ODD.count(b"<inertial>") + 2
    assert b'<dynamics damping="0.1" friction="0.2"/>' in written
    model = pin.buildModelFromXML(written.decode())
    # b moves and carries c, whose frame is b's.
    np.testing.assert_allclose(model.inertias[1].toDynamicParameters(), 2 * PI, rtol=1e-12, atol=1e-15)


def test_a_link_can_lose_its_mass() -> None:
    written = replace_parameters(ODD, {"a": None}, {})
    assert b"<!-- goes -->" not in written
    assert b"<!-- kept -->" in written
    pin.buildModelFromXML(written.decode())


def test_written_twice_is_written_once() -> None:
    links, joints = {"a": PI, "b": PI}, {"j": JointDynamics(0.1, 0.2)}
    once = replace_parameters(ODD, links, joints)
    assert replace_parameters(once, links, joints) == once


LUMPED = """<robot name="r"><link name="base"/>
<link name="arm"><inertial><mass value="2"/><inertia ixx=".1" ixy="0" ixz="0" iyy=".1" iyz="0" izz=".1"/></inertial>
</link>
<link name="tool"><inertial><origin xyz="0.1 0 0" rpy="0.3 0.2 0.1"/><mass value="0.5"/>
<inertia ixx=".01" ixy="0" ixz="0" iyy=".02" iyz="0" izz=".02"/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="9" velocity="9"/></joint>
<joint name="flange" type="fixed"><origin xyz="0 0 0.4" rpy="1 2 3"/><parent link="arm"/><child link="tool"/></joint>
</robot>"""


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("heavy", [True, False])
def test_pinocchio_reads_from_random_robots_what_was_identified(
    robot_of: Callable[[str | bytes], Robot], seed: int, heavy: bool
) -> None:
    """Of bodies heavier than what is lumped into them, and of bodies so light that the lumped links must give way."""
    rng = np.random.default_rng(seed)
    text = random_urdf(rng, size=9, massless=0.3)
    robot = robot_of(text)
    model = build_model(robot, Config(), actuated(robot))
    factor = 300.0 if heavy else 0.01
    identified = {body.name: (body, factor * true_body(rng, body)) for body in model.bodies}
    dynamics = {joint.name: JointDynamics(*rng.uniform(0, 2, 2)) for joint in model.joints}
    written = identified_urdf(robot, identified, dynamics)
    before, after = pin.buildModelFromXML(text), pin.buildModelFromXML(written.decode())
    assert list(after.names) == list(before.names)
    for index, name in enumerate(after.names):
        ours = before.inertias[0].toDynamicParameters()
        if index:
            _, ours = identified[robot.joints[name].child]
            assert after.jointPlacements[index] == before.jointPlacements[index]
        scale = np.abs(ours).max()
        np.testing.assert_allclose(after.inertias[index].toDynamicParameters(), ours, rtol=0, atol=1e-11 * scale)
    again = robot_of(written)
    for name, expected in dynamics.items():
        written_out = (again.joints[name].damping, again.joints[name].friction)
        assert written_out == pytest.approx((expected.damping, expected.friction), rel=WRITTEN)
    assert all(np.linalg.eigvalsh(pseudo_inertia(pi))[0] > 0 for pi in again.links.values() if pi is not None)


def test_a_rotor_that_is_a_link_is_written_there(build: Build, leg: str, rng: np.random.Generator) -> None:
    model = build(leg, ["abad", "hip", "knee"], rotors={"hip_motor": {"joint": "hip", "gear_ratio": 8.0}})
    rotor = body(model, "hip_motor")
    pi = true_body(rng, rotor)
    written = identified_urdf(model.robot, {"hip_motor": (rotor, pi)}, {})
    np.testing.assert_allclose(link_pi(written.decode(), "hip_motor"), pi, rtol=0, atol=WRITTEN * pi.max())
    for link in ("abad_link", "thigh", "shank", "foot", "base"):
        np.testing.assert_array_equal(link_pi(written.decode(), link), link_pi(leg, link))


@pytest.mark.parametrize(("mass", "keeps_the_tool"), [(5.0, True), (0.3, False)])
def test_the_links_of_a_body_sum_to_it(build: Build, mass: float, keeps_the_tool: bool) -> None:
    model = build(LUMPED, ["j"])
    arm: Body = model.bodies[0]
    assert arm.lumped_links == ("tool",)
    identified = from_mass_com_inertia(mass, [0.0, 0.05, 0.1], mass * np.diag([0.2, 0.25, 0.1]))
    links = link_parameters(arm, identified, model.robot.links)
    written = pin.buildModelFromXML(replace_parameters(model.robot.text, links, {}).decode())
    np.testing.assert_allclose(written.inertias[1].toDynamicParameters(), identified, rtol=0, atol=WRITTEN * mass)
    assert ("tool" not in links) == keeps_the_tool
    for pi in links.values():
        assert pi is None or np.linalg.eigvalsh(pseudo_inertia(pi))[0] > 0


def test_a_locked_rotor_that_is_no_link_stays_in_the_configuration(build: Build) -> None:
    inertial = {"mass": 0.4, "inertia": [1e-3, 0, 1e-3, 0, 0, 1e-3]}
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    text = LUMPED.replace('name="flange" type="fixed"', 'name="flange" type="revolute"')
    text = text.replace('<child link="tool"/></joint>', f'<child link="tool"/>{limit}</joint>')
    rotor = {"joint": "flange", "gear_ratio": 10.0, "axis": [1, 0, 0], "inertial": inertial}
    model = build(text, ["j"], rotors={"spin": rotor})
    arm = model.bodies[0]
    own = next(member for member in arm.members if member.link == "spin").pi_in_body
    for mass in (9.0, 0.5):
        identified = from_mass_com_inertia(mass, [0, 0, 0.1], mass * np.diag([0.2, 0.25, 0.1]))
        links = link_parameters(arm, identified, model.robot.links)
        assert "spin" not in links
        again = build(replace_parameters(model.robot.text, links, {}).decode(), ["j"], rotors={"spin": rotor})
        np.testing.assert_allclose(again.bodies[0].pi, identified, rtol=0, atol=WRITTEN * mass)
    assert own.any()
