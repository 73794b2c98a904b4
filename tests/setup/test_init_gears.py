"""What `idtool init` reads of motors and bodies in a URDF: gear ratios, rotors, bounding ellipsoids."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from robots import joint
from scipy.spatial.transform import Rotation
from spatial_arm import ARM
from starts import arm, as_csv, filled, init, robot

from idtool.robot.config import Config
from idtool.robot.inertia import from_mass_com_inertia
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import Robot
from idtool.setup.bounds import find_bounds
from idtool.setup.transmissions import gear_ratios, rotor_links, rotor_template, solid_ellipsoid

Read = Callable[[str | bytes], Robot]

INERTIAL = '<inertial><mass value="0.1"/><inertia ixx="1e-4" ixy="0" ixz="0" iyy="2e-4" iyz="0" izz="1e-4"/></inertial>'


def with_links(*links: tuple[str, str], inertial: str = INERTIAL, text: str = ARM) -> str:
    """The arm with links on fixed joints: name and parent."""
    more = (
        f'<link name="{name}">{inertial}</link>{joint(f"{name}_joint", "fixed", parent, name, "")}'
        for name, parent in links
    )
    return text.replace("</robot>", "".join(more) + "</robot>")


def transmission(joints: str, ratio: str) -> str:
    named = "".join(f'<joint name="{name}"/>' for name in joints.split())
    reduction = f"<mechanicalReduction>{ratio}</mechanicalReduction>"
    return f'<transmission name="of_{joints}">{named}<actuator name="m">{reduction}</actuator></transmission>'


def test_ratio_of_one_joint_is_taken_and_that_of_a_differential_is_not(robot_of: Read) -> None:
    both = transmission("lift roll", "7") + transmission("turn", "-3")
    assert gear_ratios(robot_of(ARM.replace("</robot>", both + "</robot>"))) == {"turn": -3.0}


def test_ratio_of_1_stands_where_nothing_is_known_and_is_not_taken_over(tmp_path: Path) -> None:
    more = transmission("turn", "1") + transmission("lift", "6.5")
    report = init(robot(tmp_path, ARM.replace("</robot>", more + "</robot>")), as_csv(tmp_path / "run.csv", arm(3.0)))
    text = Path(report["file"]).read_text()
    assert "Gear ratios in the URDF (<transmission>): lift: 6.5. " in text
    assert "A gear ratio of 1 was ignored, because it usually means that the ratio is unknown: turn." in text
    assert {name: rotor.gear_ratio for name, rotor in filled(text, 0.5).rotors.items()} == {
        "turn_rotor": 0.5,
        "lift_rotor": 6.5,
        "roll_rotor": 0.5,
    }
    assert "gear ratios of lift" in report["found"]


def test_rotor_is_that_of_the_joint_whose_name_is_most_like_its_own(robot_of: Read) -> None:
    """Two joints on one link, whose rotors' names are in the other order."""
    text = ARM.replace('<parent link="turret"/><child link="upper"/>', '<parent link="base"/><child link="upper"/>')
    found = rotor_links(
        robot_of(with_links(("m1_turn_rotor", "base"), ("m2_lift_rotor", "base"), text=text)), ["lift", "turn"]
    )
    assert found == {"turn": "m1_turn_rotor", "lift": "m2_lift_rotor"}


def test_one_rotor_is_not_that_of_two_joints(robot_of: Read) -> None:
    text = ARM.replace('<parent link="turret"/><child link="upper"/>', '<parent link="base"/><child link="upper"/>')
    assert rotor_links(robot_of(with_links(("lift_rotor", "base"), text=text)), ["turn", "lift"]) == {
        "lift": "lift_rotor"
    }


@pytest.mark.parametrize(
    ("name", "parent", "inertial"), [("lift_cover", "turret", INERTIAL), ("lift_rotor", "fore", INERTIAL)]
)
def test_other_links_are_no_rotors(name: str, parent: str, inertial: str, robot_of: Read) -> None:
    assert rotor_links(robot_of(with_links((name, parent), inertial=inertial)), ["turn", "lift", "roll"]) == {}


def test_link_without_mass_is_no_rotor(robot_of: Read) -> None:
    assert rotor_links(robot_of(with_links(("lift_rotor", "turret"), inertial="")), ["lift"]) == {}


def test_name_of_a_rotor_that_a_link_has_is_not_given_twice(tmp_path: Path) -> None:
    text = with_links(("turn_rotor", "fore"), ("turn_rotor_", "fore"))
    report = init(robot(tmp_path, text), as_csv(tmp_path / "run.csv", arm(3.0)))
    assert set(filled(Path(report["file"]).read_text(), 0.5).rotors) == {"turn_rotor__", "lift_rotor", "roll_rotor"}


def test_solid_ellipsoid_has_the_second_moments_of_the_inertia() -> None:
    """m a² / 5 along each axis, Σ = (tr(I)/2) 1 − I about the centre of mass."""
    R = Rotation.from_euler("zyx", [0.5, -0.9, 1.3]).as_matrix()
    mass, com, axes = 1.7, np.array([0.1, -0.2, 0.3]), np.array([0.05, 0.12, 0.3])
    moments = R @ np.diag(mass * axes**2 / 5) @ R.T
    entry = solid_ellipsoid(from_mass_com_inertia(mass, com, np.trace(moments) * np.eye(3) - moments))
    assert entry is not None
    S = Rotation.from_euler("xyz", entry["rpy"]).as_matrix()
    np.testing.assert_allclose(S @ np.diag(mass * np.square(entry["semi_axes"]) / 5) @ S.T, moments, atol=1e-4)
    np.testing.assert_allclose(entry["center"], com)


def test_inertia_of_no_body_has_no_solid_ellipsoid() -> None:
    pi = from_mass_com_inertia(1.0, np.zeros(3), np.diag([0.1, 0.1, 0.3]))
    assert solid_ellipsoid(pi) is None


def test_joint_that_is_pitched_upright_has_its_rotor_where_it_is(robot_of: Read) -> None:
    """Roll and yaw turn about one axis there, which is no reason for a warning; warnings are errors here."""
    text = ARM.replace('rpy="0 0.2 0.4"', 'rpy="0.3 1.5707963267948966 0"')
    found = robot_of(text).joints["roll"]
    R = Rotation.from_euler("xyz", rotor_template(robot_of(text), found, None, None)["origin"]["rpy"]).as_matrix()
    np.testing.assert_allclose(R, found.R, atol=1e-5)


def bounded(text: str, read: Read) -> tuple[dict[str, float], set[str]]:
    """Least semi-axes of ellipsoids that were found, and links that have none."""
    own = read(text)
    bounds = find_bounds(own, build_model(own, Config(), ["turn", "lift", "roll"]))
    return {name: min(entry[0]["semi_axes"]) for name, entry in bounds.ellipsoids.items()}, set(bounds.missing)


def test_part_whose_centre_of_mass_lies_in_anothers_ellipsoid_needs_none(robot_of: Read) -> None:
    box = '<collision><geometry><box size="{0} {0} {0}"/></geometry></collision></link>'
    for side, missing in ((2.0, {"turret", "upper"}), (0.01, {"turret", "upper", "tool"})):
        text = ARM.replace(
            '</inertial></link>\n<link name="flange"', f'</inertial>{box.format(side)}\n<link name="flange"'
        )
        found, lacking = bounded(text, robot_of)
        assert lacking == missing
        assert set(found) == ({"fore"} if side == 2.0 else set())


def test_semi_axes_are_never_rounded_down(robot_of: Read) -> None:
    """A ball's are 5 % longer than its radius, and by what the polyhedron around it is larger, up to 1 %."""
    ball = '<collision><geometry><sphere radius="0.100019"/></geometry></collision></link>'
    text = ARM.replace('</inertial></link>\n<link name="upper"', f'</inertial>{ball}\n<link name="upper"')
    found, _ = bounded(text, robot_of)
    exact = min(_ball(robot_of(text)))
    assert exact <= found["turret"] < exact + 1e-4
    assert found["turret"] != pytest.approx(exact, abs=1e-9)


def _ball(own: Robot) -> tuple[float, float, float]:
    from idtool.robot.bounding import bounding_ellipsoids

    return bounding_ellipsoids(own)[0]["turret"].semi_axes


def test_armature_is_offered_to_joints_without_a_rotor(tmp_path: Path) -> None:
    given = tmp_path / "given.yaml"
    given.write_text("rotors: {lift_rotor: {joint: lift, gear_ratio: 9, inertia: 1.0e-5}}\n")
    urdf, log = robot(tmp_path), as_csv(tmp_path / "run.csv", arm(4.0))
    report = init(urdf, log, "--config", given)
    text = Path(report["file"]).read_text()
    assert "# Joints without one: turn, roll.\n# armature: auto\n" in text
    assert filled(text).armature == "auto"
    given.write_text("armature: {lift: 0.01}\n")
    report = init(urdf, log, "--config", given, "--force")
    assert report["config"]["armature"] == {"lift": 0.01}
    assert not [trial for trial in report["trials"] if trial["effect"] == "rotor_inertia"]
    assert "rotors" not in {item["key"] for item in report["left"]}


def test_what_stands_still_is_to_be_subtracted_from_the_total_mass(tmp_path: Path) -> None:
    heavy = '<link name="trunk"><inertial><mass value="6.9"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    text = with_links(("plate", "base")).replace(
        "</robot>", f"{heavy}</inertial></link>{joint('trunk_joint', 'fixed', 'base', 'trunk', '')}</robot>"
    )
    report = init(robot(tmp_path, text), as_csv(tmp_path / "run.csv", arm(4.0)))
    (left,) = [item["what"] for item in report["left"] if item["key"] == "known.total_mass"]
    assert left.endswith("if you weigh the whole robot, subtract plate, trunk, 7 kg in the URDF")
    assert "subtract plate, trunk, 7 kg in the URDF." in Path(report["file"]).read_text().replace("\n# ", " ")
