"""What `idtool init` writes: templates that load once filled in, strange names that stay in comments, refusals."""

from __future__ import annotations

import re
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
import yaml
from commands import idtool, refuse
from recordings import json_channel, write_mcap
from robots import joint
from spatial_arm import ARM
from starts import arm, as_csv, as_states, filled, init, robot

from idtool.robot.config.schema import config_schema

TRANSMISSION = (
    '<transmission name="t"><type>SimpleTransmission</type><joint name="lift"/>'
    '<actuator name="m"><mechanicalReduction>-6.5</mechanicalReduction></actuator></transmission>'
    '<transmission name="u"><joint name="roll"/><actuator name="n"><mechanicalReduction>many</mechanicalReduction>'
    "</actuator></transmission>"
)
ROTOR = (
    '<link name="lift_rotor"><inertial><mass value="0.1"/><inertia ixx="1e-4" ixy="0" ixz="0" iyy="2e-4" iyz="0" '
    'izz="1e-4"/></inertial></link>' + joint("lift_rotor_joint", "fixed", "turret", "lift_rotor", "")
)
HOSTILE = "knee: # \"'{[&*!|>%@`, - ?"  # all that YAML gives a meaning


def test_every_template_loads_once_it_is_filled_in(tmp_path: Path) -> None:
    urdf = robot(tmp_path, ARM.replace("</robot>", f"{TRANSMISSION}{ROTOR}</robot>"))
    report = init(urdf, as_csv(tmp_path / "run.csv", arm()))
    config = filled(Path(report["file"]).read_text(), 0.5)
    ratios = {name: rotor.gear_ratio for name, rotor in config.rotors.items()}
    assert ratios == {"turn_rotor": 0.5, "lift_rotor": -6.5, "roll_rotor": 0.5}
    assert config.rotors["lift_rotor"].parent is None  # the URDF's link has its place
    assert config.rotors["roll_rotor"].parent == "upper"
    assert config.known.total_mass is not None
    assert set(config.bounding_ellipsoids) == {"turret", "upper", "fore", "tool", "lift_rotor"}
    assert "(<transmission>): lift: -6.5. " in Path(report["file"]).read_text()


def test_template_of_a_rotor_stands_where_the_urdf_has_the_joint(tmp_path: Path) -> None:
    report = init(robot(tmp_path), as_csv(tmp_path / "run.csv", arm()))
    rotor = filled(Path(report["file"]).read_text(), 0.5).rotors["roll_rotor"]
    assert rotor.origin is not None
    assert rotor.origin.xyz == pytest.approx((0.3, 0, 0.05))
    assert rotor.origin.rpy == pytest.approx((0, 0.2, 0.4), abs=1e-5)
    assert rotor.axis == pytest.approx((0, 0.6, 0.8))


def test_template_of_an_ellipsoid_is_the_solid_one_with_the_urdfs_inertia(tmp_path: Path) -> None:
    """That of a ball of 2 kg with 0.1 m of radius is 2/5 m r²."""
    inertia = 'ixx="0.008" ixy="0" ixz="0" iyy="0.008" iyz="0" izz="0.008"'
    text = re.sub(r'<inertia [^>]*/>(?=</inertial></link>\n<link name="upper")', f"<inertia {inertia}/>", ARM)
    assert inertia in text
    report = init(robot(tmp_path, text), as_csv(tmp_path / "run.csv", arm()))
    ball = filled(Path(report["file"]).read_text()).bounding_ellipsoids["turret"][0]
    assert ball.semi_axes == pytest.approx((0.1, 0.1, 0.1))
    assert ball.center == pytest.approx((0.02, 0.01, 0.05))


def test_bodies_with_geometry_are_bounded_and_of_others_it_is_said_what_is_missing(tmp_path: Path) -> None:
    box = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>'
    mesh = '<visual><geometry><mesh filename="package://arm/&#10;evil: 1.stl"/></geometry></visual></link>'
    text = ARM.replace('</inertial></link>\n<link name="upper"', f'</inertial>{box}\n<link name="upper"')
    text = text.replace('</inertial></link>\n<link name="fore"', f'</inertial>{mesh}\n<link name="fore"')
    text = text.replace('</inertial></link>\n<link name="flange"', f'</inertial>{box}\n<link name="flange"')
    report = init(robot(tmp_path, text), as_csv(tmp_path / "run.csv", arm()))
    assert set(report["config"]["bounding_ellipsoids"]) == {"turret"}  # the tool, on the forearm, lies outside its
    written = Path(report["file"]).read_text()
    assert r"mesh package://arm/\nevil: 1.stl is not found" in written
    where = f"searched in {tmp_path} and the folders above, ROS_PACKAGE_PATH (not set)"
    assert where in written.replace("\n# ", " ")
    (left,) = (left["what"] for left in report["left"] if left["key"] == "bounding_ellipsoids")
    assert left.startswith("ellipsoids of upper, tool; meshes of upper could not be read (upper: line ")
    assert where in left
    assert "# tool: the link has no collision or visual geometry in the URDF" in written
    assert set(filled(written).bounding_ellipsoids) == {"turret", "upper", "fore", "tool"}


def test_names_with_a_meaning_in_yaml_stay_names(tmp_path: Path) -> None:
    text = ARM.replace('"roll"', quoteattr(HOSTILE)).replace('"fore"', quoteattr(f"{HOSTILE} link"))
    log = arm(6.0)
    log["q"][:, 0] = 0.1
    log["v"][:, 0] = 0.0
    csv = as_csv(tmp_path / "run # \n x: 1.csv", log, ("turn", "lift", "odd"))
    head, _, rows = csv.read_text().partition("\n")
    csv.write_text(head.replace("odd", HOSTILE.replace('"', '""')) + "\n" + rows)
    report = init(robot(tmp_path, text), csv)
    assert report["config"]["joints"] == ["lift", HOSTILE]
    config = filled(Path(report["file"]).read_text())
    assert [rotor.joint for rotor in config.rotors.values()] == ["lift", HOSTILE]
    assert f"{HOSTILE} link" in config.bounding_ellipsoids


def test_topics_with_ends_of_lines_stay_in_their_comment(tmp_path: Path) -> None:
    topics = ["/a\nseed: 5", "/b\nseed: 6\u2028seed: 7\x85"]
    channels = [json_channel(as_states(arm(2.0)), topic) for topic in topics]
    report = init(robot(tmp_path), write_mcap(tmp_path / "run.mcap", *channels))
    assert report["config"]["log"] == {"topic": topics[0]}
    assert "seed" not in report["config"]


def test_file_that_is_there_is_left_alone_unless_forced(tmp_path: Path) -> None:
    urdf, run = robot(tmp_path), as_csv(tmp_path / "run.csv", arm(4.0))
    file = urdf.with_suffix(".yaml")
    file.write_text("seed: 1\n")
    refuse(tmp_path, "init", urdf, run, naming="already exists; use --force", file="arm.yaml")
    assert file.read_text() == "seed: 1\n"
    init(urdf, run, "--out", tmp_path / "deeper" / "other.yaml")
    assert file.read_text() == "seed: 1\n"
    report = init(urdf, run, "--force")
    assert report["config"] == yaml.safe_load(file.read_text())
    assert "seed" not in report["config"]
    assert report["next"] == f"idtool fit {urdf} {run}"


@pytest.mark.parametrize("name", ["arm.urdf", "run.csv"])
def test_what_is_read_is_never_written_over(tmp_path: Path, name: str) -> None:
    urdf, run = robot(tmp_path), as_csv(tmp_path / "run.csv", arm(1.0))
    refuse(tmp_path, "init", urdf, run, "--out", tmp_path / name, "--force", naming="is an input file", file=name)


def test_logs_of_another_robot_are_refused(tmp_path: Path) -> None:
    run = as_csv(tmp_path / "run.csv", arm(1.0), ("left", "right", "up"))
    naming = "none of its actuated joints is in the logs; it has turn, lift, roll, the logs have left, right, up"
    refuse(tmp_path, "init", robot(tmp_path), run, naming=naming, file="arm.urdf")


def test_logs_in_which_nothing_moves_are_refused(tmp_path: Path) -> None:
    log = arm(2.0)
    log["q"][:], log["v"][:] = 0.1, 0.0
    run = as_csv(tmp_path / "run.csv", log)
    refuse(tmp_path, "init", robot(tmp_path), run, naming="does not move: turn, lift, roll", file="run.csv")


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    urdf, run = robot(tmp_path), as_csv(tmp_path / "run.csv", arm(1.0))
    (tmp_path / "list.yaml").write_text("[1, 2]")
    (tmp_path / "wrong.yaml").write_text("frictoin: {}")
    for arguments, naming in (
        ((tmp_path / "none.urdf", run), "none.urdf"),
        ((urdf, tmp_path / "none.mcap"), "none.mcap"),
        ((run, urdf), "run.csv"),
        ((urdf, run, "--config", tmp_path / "none.yaml"), "none.yaml"),
        ((urdf, run, "--config", tmp_path / "list.yaml"), "is not a configuration"),
        ((urdf, run, "--config", tmp_path / "wrong.yaml"), "did you mean 'friction'?"),
    ):
        done = idtool("init", *arguments)
        assert (done.code, done.out) == (2, "")
        assert naming in done.err
        assert done.err.startswith("error: ")
        assert done.err[:-1].isprintable()
    assert not urdf.with_suffix(".yaml").exists()


def test_log_too_short_for_a_trial_still_gives_a_configuration(tmp_path: Path) -> None:
    log = {name: x[:120] for name, x in arm(1.0).items()}
    report = init(robot(tmp_path), as_csv(tmp_path / "run.csv", log))
    assert report["rms"] is None
    assert any(left["what"].startswith("nothing was tried") for left in report["left"])


def test_terminal_ends_with_what_was_found_what_is_left_and_the_next_command(tmp_path: Path) -> None:
    urdf, run = robot(tmp_path), as_csv(tmp_path / "run.csv", arm(4.0))
    lines = idtool("init", urdf, run).out.splitlines()
    kinds = [line.partition(":")[0] for line in lines if line.startswith(("found", "to fill in", "written", "next"))]
    assert list(dict.fromkeys(kinds)) == ["found", "to fill in", "written", "next"]
    assert lines[-1] == f"next: idtool fit {urdf} {run}"
    assert idtool("init", urdf, run, "--force", "--quiet").out == ""


def test_the_first_line_names_the_schema_beside_the_file(tmp_path: Path) -> None:
    report = init(robot(tmp_path), as_csv(tmp_path / "run.csv", arm(4.0)), "--out", tmp_path / "deeper" / "first.yaml")
    file = Path(report["file"])
    first, _, _ = file.read_text().partition("\n")
    assert first == "# yaml-language-server: $schema=idtool.schema.json"
    assert (file.parent / "idtool.schema.json").read_text() == config_schema()
