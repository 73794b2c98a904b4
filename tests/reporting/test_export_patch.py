"""A simulator's own file with the values of an identified model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from exported import model_of
from simulator_pair import JOINTS, MJCF, URDF

from idtool.common.exceptions import ModelError
from idtool.reporting.export import Export, patch_file
from idtool.reporting.results.diagnosis import ChangeReport, ComparedParameter

STIFF = """<default class="stiff"><joint frictionloss="0.3"/><default class="stiffer"/></default>
  </default>
  <worldbody>"""
FRICTION = {
    "yaw": {"viscous": 0.3, "coulomb": 0.2},
    "shoulder": {"viscous": 0.1, "coulomb": 0.0},
    "elbow": {"viscous": 0.2, "coulomb": 0.1},
}


def export(
    folder: Path,
    text: str,
    changes: list[ChangeReport] | None,
    *effects: dict[str, Any],
    name: str = "scene.xml",
    **config: Any,
) -> Export:
    (folder / "model.urdf").write_text(URDF)
    identified = model_of(folder / "model.urdf", friction=FRICTION, effects=list(effects), **config)
    (folder / name).write_text(text)
    return patch_file(identified, folder / name, changes)


def change(effect: str, owner: str | None, link: str | None = None, **values: tuple[Any, Any]) -> ChangeReport:
    parameters = {}
    for name, (simulator, robot) in values.items():
        parameters[name] = ComparedParameter(
            simulator=simulator, simulator_standard_error=None, robot=robot, robot_standard_error=None, unit=None
        )
    return ChangeReport(effect=effect, joint=owner, link=link, parameters=parameters, share=0.5, reason="")


def loaded(result: Export) -> Any:
    return mujoco.MjModel.from_xml_string(result.text.decode())


def test_without_changes_every_value_is_written(tmp_path: Path) -> None:
    rotor = {"effect": "rotor_inertia", "joint": "elbow", "parameters": {"inertia": 0.05}}
    offset = {"effect": "torque_offset", "joint": "elbow", "parameters": {"offset": 0.3}}
    result = export(tmp_path, MJCF, None, rotor, offset)
    model = loaded(result)
    for joint, friction in FRICTION.items():
        dof = model.joint(joint).dofadr[0]
        assert model.dof_damping[dof].ravel()[0] == friction["viscous"]
        if friction["coulomb"]:
            assert model.dof_frictionloss[dof] == friction["coulomb"]
    assert model.dof_armature.tolist() == [0.0, 0.0, 0.05]
    assert [(part.what, part.of) for part in result.not_carried] == [("torque_offset", "elbow")]
    np.testing.assert_allclose(model.body_mass[1:], [3, 2, 1])


@pytest.mark.parametrize(("angle", "unit"), [("radian", 1.0), ("degree", np.degrees(1.0)), (None, np.degrees(1.0))])
def test_a_spring_is_in_the_units_of_the_file(tmp_path: Path, angle: str | None, unit: float) -> None:
    compiler = f'<compiler angle="{angle}"/>' if angle else "<compiler/>"
    text = MJCF.replace('<compiler angle="radian"/>', compiler)
    text = text.replace('name="elbow" axis="0 1 0"', f'name="elbow" axis="0 1 0" ref="{float(0.1 * unit)!r}"')
    values = {"stiffness": 7.0, "rest_position": 0.4}
    spring = change("parallel_spring", "elbow", **{name: (None, value) for name, value in values.items()})
    result = export(tmp_path, text, [spring], {"effect": "parallel_spring", "joint": "elbow", "parameters": values})
    model = loaded(result)
    at = model.joint("elbow").id
    assert model.jnt_stiffness[at].ravel()[0] == 7.0
    assert model.qpos_spring[at] == pytest.approx(0.5, rel=1e-5)  # 0.4 from the URDF's zero, which is at ref


def test_the_zero_and_the_kind_of_a_joint_may_come_from_its_class(tmp_path: Path) -> None:
    """A slide's spring is in metres whatever the file's angles are in."""
    values = {"stiffness": 7.0, "rest_position": 0.4}
    spring = change("parallel_spring", "elbow", **{name: (None, value) for name, value in values.items()})
    effect = {"effect": "parallel_spring", "joint": "elbow", "parameters": values}
    text = MJCF.replace('<compiler angle="radian"/>', "<compiler/>")
    for attributes, rest in (('ref="10"', 0.4 + np.radians(10)), ('type="slide" ref="0.1"', 0.5)):
        own_class = f'<default class="own"><joint {attributes}/></default></default>\n  <worldbody>'
        classed = text.replace("</default>\n  <worldbody>", own_class)
        classed = classed.replace('name="elbow" axis', 'name="elbow" class="own" axis')
        model = loaded(export(tmp_path, classed, [spring], effect))
        assert model.qpos_spring[model.joint("elbow").id] == pytest.approx(rest, rel=1e-5)


def test_values_that_the_file_has_already_are_no_changes(tmp_path: Path) -> None:
    rotor = {"effect": "rotor_inertia", "joint": "elbow", "parameters": {"inertia": 0.05}}
    for name, root in (("scene.xml", MJCF), ("arm.urdf", URDF)):
        first = export(tmp_path, root, None, rotor, name=name)
        assert {part.what for part in first.carried} >= {"viscous_friction", "coulomb_friction"}
        assert "inertial" not in {part.what for part in first.carried}  # they are those of the URDF
        assert ("coulomb_friction", "shoulder") not in {
            (part.what, part.of) for part in first.carried
        }  # 0, the default
        again = export(tmp_path, first.text.decode(), None, rotor, name=name)
        assert again.carried == ()
        assert again.text == first.text
        assert [part.what for part in again.not_carried] == [part.what for part in first.not_carried]


def test_a_value_that_is_not_written_is_that_of_the_default_class(tmp_path: Path) -> None:
    """As MuJoCo reads it: classes inherit, and the innermost body or frame gives the class."""
    for old, new in (
        ("", ""),
        ('<body name="upper"', '<body name="upper" childclass="stiff"'),
        ('<joint name="shoulder"', '<joint name="shoulder" class="stiff"'),
        ('<joint name="shoulder"', '<joint name="shoulder" class="main"'),
        (' childclass="arm"', ""),
        ('<joint damping="0.2"/>', '<joint damping="0.2"/></default><default class="main"><joint damping="0.4"/>'),
    ):
        text = MJCF.replace("</default>\n  <worldbody>", STIFF).replace(old, new)
        present = mujoco.MjModel.from_xml_string(text).joint("shoulder")
        for effect, parameter, attribute in (
            ("coulomb_friction", "coulomb", "frictionloss"),
            ("viscous_friction", "viscous", "damping"),
        ):
            value = getattr(present, attribute).ravel()[0]
            result = export(tmp_path, text, [change(effect, "shoulder", **{parameter: (value, 0.7)})])
            assert [part.detail for part in result.carried] == [f"{attribute} {value:g} → 0.7"]
            assert getattr(loaded(result).joint("shoulder"), attribute).ravel()[0] == 0.7
            same = change(effect, "shoulder", **{parameter: (0.3, value)})
            assert export(tmp_path, text, [same]).text.decode() == text


def test_a_default_of_another_file_is_not_known(tmp_path: Path) -> None:
    text = MJCF.replace("<default>", '<include file="defaults.xml"/><default>')
    result = export(tmp_path, text, [change("rotor_inertia", "elbow", inertia=(None, 0.1))])
    assert [part.detail for part in result.carried] == ["armature default → 0.1"]


@pytest.mark.parametrize("old", ["1.0", "1.0000000001", "1.001"])
def test_an_inertial_is_a_change_if_it_differs_from_what_is_written(tmp_path: Path, old: str) -> None:
    for name, root, mass in (("scene.xml", MJCF, 'mass="1" '), ("arm.urdf", URDF, '<mass value="1"/>')):
        assert mass in root
        result = export(tmp_path, root.replace(mass, mass.replace('"1"', f'"{old}"')), None, name=name)
        assert ("inertial" in {part.what for part in result.carried}) == (old == "1.001")


def test_what_the_robot_has_not_is_removed(tmp_path: Path) -> None:
    changes = [
        change("rotor_inertia", "elbow", inertia=(0.1, None)),
        change("coulomb_friction", "yaw", coulomb=(0.4, 0.0)),
        change("parallel_spring", "elbow", stiffness=(5.0, None), rest_position=(0.2, None)),
    ]
    text = MJCF.replace('name="elbow"', 'name="elbow" armature="0.1" stiffness="5" springref="0.2"')
    model = loaded(export(tmp_path, text, changes))
    assert not model.dof_armature.any()
    assert not model.jnt_stiffness.any()
    assert model.dof_frictionloss[0] == 0.0
    assert model.dof_damping.ravel()[0] == 0.5  # as it was: nothing said that it changes


def test_the_values_are_those_of_the_changes_and_other_effects_on_the_attribute_are_kept(tmp_path: Path) -> None:
    drag = {"effect": "quadratic_drag", "joint": "elbow", "parameters": {"drag": 0.01}}
    result = export(tmp_path, MJCF, [change("viscous_friction", "elbow", viscous=(0.2, 0.7))], drag)
    assert 'damping="0.7 0.01"' in result.text.decode()


def test_gravity_is_an_option_of_the_file(tmp_path: Path) -> None:
    tilt = change("gravity_tilt", None, gravity=(None, [0.5, 0.0, -9.797]))
    for text in (MJCF, MJCF.replace("<worldbody>", '<option gravity="0 0 -9.81" timestep="0.002"/><worldbody>')):
        result = export(tmp_path, text, [tilt])
        model = loaded(result)
        np.testing.assert_allclose(model.opt.gravity, [0.5, 0.0, -9.797])
        assert model.opt.timestep == 0.002


def test_gravity_that_the_file_has_already_is_no_change(tmp_path: Path) -> None:
    for tilted in ([0.123456789, 0.0, -9.8], [0.0, 0.0, -9.81]):
        tilt = change("gravity_tilt", None, gravity=([1.0, 0.0, -9.76], tilted))
        first = export(tmp_path, MJCF, [tilt])
        again = export(tmp_path, first.text.decode(), [tilt])
        assert (again.text, again.carried) == (first.text, ())
        assert len(first.carried) == (tilted[0] != 0)


def test_a_tilt_of_the_simulator_alone_is_removed(tmp_path: Path) -> None:
    tilt = change("gravity_tilt", None, gravity=([0.5, 0.0, -9.797], None))
    text = MJCF.replace("<worldbody>", '<option gravity="0.5 0 -9.797"/><worldbody>')
    result = export(tmp_path, text, [tilt])
    assert loaded(result).opt.gravity.tolist() == [0.0, 0.0, -9.81]
    assert result.not_carried == ()


def test_without_changes_a_tilt_is_written_too(tmp_path: Path) -> None:
    tilt = {"effect": "gravity_tilt", "parameters": {"gravity": [0.5, 0.0, -9.797]}}
    result = export(tmp_path, MJCF, None, tilt)
    assert loaded(result).opt.gravity.tolist() == [0.5, 0.0, -9.797]
    assert ("gravity_tilt", "base") in {(part.what, part.of) for part in result.carried}
    urdf = export(tmp_path, URDF, None, tilt, name="arm.urdf")
    assert [part.what for part in urdf.not_carried] == ["gravity_tilt"]


def test_gravity_is_not_written_where_the_file_turns_the_base(tmp_path: Path) -> None:
    tilt = change("gravity_tilt", None, gravity=(None, [0.5, 0.0, -9.797]))
    for turn, is_turned in (
        ('quat="0.7071 0.7071 0 0"', True),
        ('euler="0 0 1.5708"', True),
        ('quat="1 0 0 0"', False),
        ("", False),
    ):
        mounted = MJCF.replace('<body name="column"', f'<body name="base" {turn}><body name="column"')
        mounted = mounted.replace("</worldbody>", "</body></worldbody>")
        hung = MJCF.replace('<body name="column"', f'<body name="column" {turn}')
        for text, body in ((mounted, "base"), (hung, "column")):
            result = export(tmp_path, text, [tilt])
            np.testing.assert_allclose(loaded(result).opt.gravity, [0, 0, -9.81] if is_turned else [0.5, 0, -9.797])
            if is_turned:
                (part,) = result.not_carried
                assert f"the file turns body {body}" in part.detail
                assert "[0.5000, 0.000, -9.797]" in part.detail


PAYLOAD = {"mass": 0.5, "com": [0.0, 0.0, -0.12], "inertia": [0.008, 0.0, 0.008, 0.0, 0.0, 0.001]}


def test_a_payload_of_the_simulator_alone_is_removed(tmp_path: Path) -> None:
    payload = change("payload", None, "lower", **{name: (value, None) for name, value in PAYLOAD.items()})
    laden = MJCF.replace('mass="1" diaginertia="0.008 0.008 0.001"', 'mass="1.5" diaginertia="0.016 0.016 0.002"')
    result = export(tmp_path, laden, [payload])
    assert loaded(result).body("lower").mass[0] == 1.0
    np.testing.assert_allclose(loaded(result).body("lower").inertia, [0.008, 0.008, 0.001])
    bare = export(tmp_path, MJCF, [payload])
    assert bare.text.decode() == MJCF
    (part,) = bare.not_carried
    assert part.detail.startswith("the file's inertial, 1.000 kg")
    assert "is not the URDF's with the simulator's payload, 1.500 kg" in part.detail


def test_a_payload_on_a_lumped_link_is_in_the_body_that_carries_it(tmp_path: Path) -> None:
    payload = change("payload", None, "tool", **{name: (None, value) for name, value in PAYLOAD.items()})
    flange = '<joint name="flange" type="fixed"><parent link="lower"/><child link="tool"/></joint></robot>'
    tool = f'<link name="tool"/>{flange}'
    entry = {"effect": "payload", "link": "tool", "parameters": PAYLOAD}
    (tmp_path / "model.urdf").write_text(URDF.replace("</robot>", tool))
    identified = model_of(tmp_path / "model.urdf", friction=FRICTION, effects=[entry])
    (tmp_path / "scene.xml").write_text(MJCF)
    result = patch_file(identified, tmp_path / "scene.xml", [payload])
    assert result.not_carried == ()
    assert loaded(result).body("lower").mass[0] == pytest.approx(1.5)


def test_friction_is_written_beside_drag_that_a_urdf_has_no_place_for(tmp_path: Path) -> None:
    drag = {"effect": "quadratic_drag", "joint": "elbow", "parameters": {"drag": 0.05}}
    coulomb = change("coulomb_friction", "elbow", coulomb=(0.0, 0.1))
    viscous = change("viscous_friction", "elbow", viscous=(0.0, 0.2))
    result = export(tmp_path, URDF, [coulomb, viscous], drag, name="arm.urdf")
    assert [part.what for part in result.carried] == ["coulomb_friction"]
    assert [part.what for part in result.not_carried] == ["viscous_friction"]


def test_a_joint_of_the_world_is_refused(tmp_path: Path) -> None:
    text = MJCF.replace("<worldbody>", '<worldbody><joint name="base_joint"/>').replace('"yaw"', '"other"')
    tilt = change("gravity_tilt", None, gravity=(None, [0.5, 0.0, -9.797]))
    with pytest.raises(ModelError, match="joint yaw is in no body"):
        export(tmp_path, text.replace("base_joint", "yaw"), [tilt])


def test_identified_rotors_are_listed(tmp_path: Path) -> None:
    rotor = {
        "joint": "elbow",
        "gear_ratio": 10.0,
        "parent": "upper",
        "origin": {"xyz": [0.0, 0.0, -0.3], "rpy": [0.0, 0.0, 0.0]},
        "axis": [0, 1, 0],
        "inertial": {"mass": 0.3, "com": [0.0, 0.0, 0.0], "inertia": [1e-4, 0.0, 2e-4, 0.0, 0.0, 1e-4]},
    }
    for name, text in (("scene.xml", MJCF), ("arm.urdf", URDF)):
        result = export(tmp_path, text, None, name=name, rotors={"elbow_rotor": rotor})
        (part,) = result.not_carried
        assert (part.what, part.of, part.value, part.unit) == ("rotor", "elbow_rotor", 2e-4, "kg·m²")


def test_an_inertial_in_another_frame_is_left_alone(tmp_path: Path) -> None:
    body = change(
        "rigid_body",
        None,
        "lower",
        mass=(1.0, 1.2),
        com=([0.0, 0.0, -0.12], [0.0, 0.0, -0.13]),
        inertia_com=([0.008, 0.0, 0.008, 0.0, 0.0, 0.001], [0.009, 0.0, 0.009, 0.0, 0.0, 0.001]),
    )
    result = export(tmp_path, MJCF, [body])
    at = loaded(result).body("lower")
    assert (at.mass[0], at.ipos[2]) == (1.2, -0.13)
    turned = MJCF.replace('pos="0 0 -0.12"', 'pos="0 0.123456789 0"')
    left = export(tmp_path, turned, [body])
    assert left.text.decode() == turned
    (part,) = left.not_carried
    expected = "the file's inertial, 1.000 kg at [0.0 0.1235 0.0] m, is not the URDF's, 1.000 kg at [0.0 0.0 -0.12] m"
    assert part.detail == f"{expected}, so its frame is unknown"
    drawn = MJCF.replace('<inertial pos="0 0 -0.12" mass="1" diaginertia="0.008 0.008 0.001"/>', "")
    (part,) = export(tmp_path, drawn, [body]).not_carried
    assert part.detail == "the file has no inertial of this body"


def test_numbers_that_are_none_are_refused(tmp_path: Path) -> None:
    spring = change("parallel_spring", "elbow", stiffness=(None, 7.0), rest_position=(None, 0.4))
    for ref in ("zero", "1 2"):
        with pytest.raises(ModelError, match=rf"scene\.xml: joint elbow: ref is not a number: {ref}"):
            export(tmp_path, MJCF.replace('name="elbow"', f'name="elbow" ref="{ref}"'), [spring])
    with pytest.raises(ModelError, match=r"scene\.xml: inertial: mass is not a number: 1 2"):
        export(tmp_path, MJCF.replace('mass="1" ', 'mass="1 2" '), None)
    with pytest.raises(ModelError, match=r"scene\.xml: inertial: pos is not 3 numbers: 0 -0.12"):
        export(tmp_path, MJCF.replace('pos="0 0 -0.12"', 'pos="0 -0.12"'), None)


def test_names_elsewhere_in_the_file_are_not_joints(tmp_path: Path) -> None:
    """An equality may bear the name of a joint; only the joint is changed."""
    equality = '<equality><joint name="elbow" joint1="yaw" joint2="elbow" active="false"/></equality></mujoco>'
    text = MJCF.replace("</mujoco>", equality)
    result = export(tmp_path, text, [change("viscous_friction", "elbow", viscous=(0.2, 0.7))])
    assert result.text.decode().count("damping=") == text.count("damping=") + 1
    assert equality in result.text.decode()
    assert loaded(result).joint("elbow").damping.ravel()[0] == 0.7


def test_what_has_no_place_is_listed_with_both_values(tmp_path: Path) -> None:
    stribeck = change("stribeck_friction", JOINTS[0], stribeck=(None, 0.5), velocity=(None, 0.1))
    slow = change("stribeck_friction", "elbow", stribeck=(0.001, 0.5), velocity=(None, 0.1))  # not fitted there
    delay = change("command_delay", None, delay=(0.001, 0.006))
    result = export(tmp_path, MJCF, [stribeck, slow, delay])
    assert result.text.decode() == MJCF
    assert [part.of for part in result.not_carried] == ["yaw", "elbow", "the controller"]
    assert "stribeck none → 0.5000, velocity none → 0.1000" in result.not_carried[0].detail
    assert "stribeck 0.001000 → 0.5000, velocity 0.1000;" in result.not_carried[1].detail
    assert "delay 0.001000 → 0.006000" in result.not_carried[2].detail
