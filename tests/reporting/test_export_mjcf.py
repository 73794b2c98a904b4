"""The exported MJCF as a file: bodies, names, inertials, limits, geometry."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from exported import EXACT, InMujoco, arm, mass_and_bias, model_of, state, unsupported_parts
from lxml import etree
from reference import Reference
from robots import chain, link

from idtool.common.exceptions import ModelError
from idtool.reporting.export import to_drake, to_mujoco
from idtool.robot.urdf.reading import read_robot


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """Where a test writes its robot."""
    return tmp_path / "identified.urdf"


def test_links_that_are_fixed_are_bodies_in_their_frames(rng: np.random.Generator, leg: str, urdf: Path) -> None:
    urdf.write_text(leg)
    names = ["abad", "hip", "knee"]
    export = to_mujoco(model_of(urdf, joints=names, locked_joints={"tail": 0.3}))
    found = InMujoco(export, names)
    tree = pin.buildModelFromXML(leg)
    data, q = tree.createData(), pin.neutral(tree)
    own = rng.uniform(-2, 2, 3)
    for name, angle in zip((*names, "tail"), (*own, 0.3), strict=True):
        q[tree.joints[tree.getJointId(name)].idx_q] = angle
    found.set(own, np.zeros(3))
    pin.framesForwardKinematics(tree, data, q)
    for name in read_robot(urdf).links:
        placement = data.oMf[tree.getFrameId(name)]
        body = found.data.body(name)
        np.testing.assert_allclose(body.xpos, placement.translation, atol=1e-12)
        np.testing.assert_allclose(body.xmat.reshape(3, 3), placement.rotation, atol=1e-12)
    assert found.model.body("foot").mass[0] == 0


@pytest.mark.parametrize("name", ['say "hip"', "a&b", "<hip>", "it's", "x--y---z-", "]]>", "Hüfte 腰", " "])
def test_names_may_be_anything_that_xml_can_say(urdf: Path, name: str) -> None:
    text = chain(link(1), link(2)).replace('"j1"', quoteattr(name)).replace('"l1"', quoteattr(name))
    urdf.write_text(text, encoding="utf-8")
    rotor = {
        "joint": name,
        "gear_ratio": 9,
        "parent": "l0",
        "inertial": {"mass": 0.1, "inertia": [1e-4, 0, 1e-4, 0, 0, 1e-4]},
    }
    controller = {"kp": {name: 3.0}, "delay": 0.01}
    export = to_mujoco(model_of(urdf, rotors={name + "_": rotor}, controller=controller), rotor_bodies=True)
    found = mujoco.MjModel.from_xml_string(export.text.decode())
    assert found.joint(name).id == found.actuator(name).id == 0
    assert found.body(name).id > 0


@pytest.mark.parametrize("place", ["l0", "l1", "l2"])
def test_mujocos_own_word_for_what_stands_still(urdf: Path, place: str) -> None:
    urdf.write_text(chain(link(1), link(2)).replace(f'"{place}"', '"world"'))
    export = to_mujoco(model_of(urdf))
    assert mujoco.MjModel.from_xml_string(export.text.decode()).nv == 2
    assert [part.of for part in export.not_carried if part.what == "name"] == (["world"] if place != "l0" else [])


def test_a_moving_link_without_mass_gets_a_trace(rng: np.random.Generator, urdf: Path) -> None:
    text = arm(rng, "0 0 1", "0 1 0")
    bare = etree.fromstring(text)
    bare.find("link[@name='l1']").remove(bare.find("link[@name='l1']/inertial"))
    urdf.write_bytes(etree.tostring(bare))
    export = to_mujoco(model_of(urdf))
    assert [(part.of, part.value) for part in unsupported_parts(export, "inertial")] == [("l1", 1e-12)]
    q, v = state(rng, 2)
    reference = Reference(urdf.read_text(), ["j1", "j2"], {"gravity": [0, 0, -9.81]})
    for ours, theirs in zip(
        InMujoco(export, ["j1", "j2"]).mass_and_bias(q, v), mass_and_bias(reference, q, v), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, **EXACT)


@pytest.mark.parametrize("moment", [0.0, 1e-9])
def test_inertia_on_the_border_of_what_can_exist_is_taken(urdf: Path, moment: float) -> None:
    thin = (
        f'<inertial><mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="{moment}"/></inertial>'
    )
    urdf.write_text(chain(link(1)).replace('<link name="l1"/>', f'<link name="l1">{thin}</link>'))
    found = mujoco.MjModel.from_xml_string(to_mujoco(model_of(urdf)).text.decode())
    np.testing.assert_allclose(sorted(found.body("l1").inertia), [moment, 0.1, 0.1], atol=1e-11)


@pytest.mark.parametrize("izz", [0.3, -0.01])
def test_an_inertia_that_no_body_can_have_is_refused(urdf: Path, izz: float) -> None:
    bad = f'<inertial><mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="{izz}"/></inertial>'
    urdf.write_text(chain(link(1)).replace('<link name="l1"/>', f'<link name="l1">{bad}</link>'))
    for export in (to_mujoco, to_drake):
        with pytest.raises(ModelError, match=r"identified\.urdf: l1: has an inertia that is not physically realizable"):
            export(model_of(urdf))


def test_primitives_are_drawn_and_touch_nothing(urdf: Path) -> None:
    shapes = (
        '<visual><origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/>'
        '<geometry><box size="0.2 0.4 0.6"/></geometry></visual>'
        '<visual><geometry><mesh filename="none.stl"/></geometry></visual>'
        '<collision><geometry><cylinder radius="0.1" length="0.8"/></geometry></collision>'
        '<collision><geometry><sphere radius="0.3"/></geometry></collision>'
        '<collision><geometry><sphere radius="nan"/></geometry></collision>'
        '<collision><geometry><box size="1 1"/></geometry></collision>'
    )
    urdf.write_text(chain(link(1)).replace('<link name="l1"/>', f'<link name="l1">{shapes}</link>'))
    export = to_mujoco(model_of(urdf))
    found = mujoco.MjModel.from_xml_string(export.text.decode())
    kinds = [mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_SPHERE]
    assert found.geom_type.tolist() == [int(kind) for kind in kinds]
    np.testing.assert_allclose(found.geom_size[:, 0], [0.1, 0.1, 0.3])
    np.testing.assert_allclose(found.geom_size[:2, 1], [0.2, 0.4])
    np.testing.assert_allclose(found.geom_pos[0], [1, 2, 3])
    np.testing.assert_allclose(found.geom_quat[0], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    assert not found.geom_contype.any()
    assert not found.geom_conaffinity.any()
    assert [part.of for part in unsupported_parts(export, "geometry")] == ["l1"]


def test_a_config_without_joints_moves_all_that_are_not_locked(urdf: Path) -> None:
    urdf.write_text(chain(link(1), link(2), link(3)))
    found = mujoco.MjModel.from_xml_string(to_mujoco(model_of(urdf, locked_joints={"j2": 0.5})).text.decode())
    assert [found.joint(i).name for i in range(found.njnt)] == ["j1", "j3"]


def test_limits_are_carried_and_act_on_nothing_within(urdf: Path) -> None:
    joints = (link(1), link(2).replace('lower="-3"', 'lower="0"').replace('upper="3"', 'upper="0"'))
    urdf.write_text(chain(*joints, link(3, kind="continuous")))
    found = mujoco.MjModel.from_xml_string(to_mujoco(model_of(urdf)).text.decode())
    assert found.jnt_limited.tolist() == [1, 0, 0]
    np.testing.assert_allclose(found.jnt_range[0], [-3, 3])
    assert found.jnt_margin.tolist() == [0, 0, 0]
    np.testing.assert_allclose(found.actuator_ctrlrange, [[-100, 100]] * 3)
    assert not found.actuator_ctrllimited.any()


def test_the_controller_is_told_in_words(urdf: Path) -> None:
    urdf.write_text(chain(link(1), link(2)))
    controller = {"kp": {"j1": 20.0, "j2": 30.0}, "kd": {"j1": 1.5}, "delay": 0.005}
    text = to_mujoco(model_of(urdf, controller=controller)).text.decode()
    assert "j1: kp 20.0, kd 1.5\n" in text
    assert "j2: kp 30.0, kd 0.0\n" in text
    assert "delayed by 0.005 s" in text
