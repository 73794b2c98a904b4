"""Robots as ROS gives them: on a bag's topic `robot_description`; xacro, which is no URDF; and its output, which is."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from commands import LEG, config_with, files, idtool, refuse
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from mcap_ros2.writer import Writer as Ros2Writer
from recordings import Channel, ros2, states, write_mcap
from robots import chain, link
from test_logs_rosbag2 import bag

from idtool.description import robot_and_logs
from idtool.exceptions import IdtoolError, LogError, ModelError
from idtool.geometry import link_geometry
from idtool.inertia import from_mass_com_inertia
from idtool.logs import read_log
from idtool.robot import Robot, read_robot
from idtool.urdf import JointDynamics, rewrite

TEXT = LEG.read_text()
OTHER = TEXT.replace('<mass value="1.5"/>', '<mass value="1.6"/>')
NAME = "std_msgs/msg/String"
SCHEMAS = {
    "cdr": (NAME, "ros2msg", b"string data"),
    "json": ("robot.Text", "jsonschema", b'{"type": "object", "properties": {"data": {"type": "string"}}}'),
    "bare json": ("std_msgs/msg/String", "", b""),
}


def cdr(texts: Sequence[str]) -> list[bytes]:
    """Texts as mcap_ros2 encodes them."""
    stream = BytesIO()
    writer = Ros2Writer(stream)
    schema = writer.register_msgdef(NAME, "string data")
    for i, text in enumerate(texts):
        writer.write_message("/x", schema, {"data": text}, log_time=i)
    writer.finish()  # type: ignore[no-untyped-call]
    return [message.data for _, _, message in make_reader(BytesIO(stream.getvalue())).iter_messages()]


def protobuf(text: str) -> tuple[tuple[str, str, bytes], bytes]:
    """A schema of one string, whose number is not that of others, and a message."""
    described = descriptor_pb2.FileDescriptorSet()
    file = described.file.add(name="text.proto", package="robot", syntax="proto3")
    message = file.message_type.add(name="Text")
    message.field.add(name="stamp", number=1, label=1, type=3)
    message.field.add(name="data", number=7, label=1, type=9)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    kind: Any = message_factory.GetMessageClass(pool.FindMessageTypeByName("robot.Text"))
    schema = ("robot.Text", "protobuf", described.SerializeToString())
    return schema, kind(stamp=5, data=text).SerializeToString()


def described(*texts: str, topic: str = "/robot_description", encoding: str = "cdr") -> Channel:
    """A topic with texts."""
    if encoding == "protobuf":
        schema = protobuf(TEXT)[0]
        payloads = [protobuf(text)[1] for text in texts]
    else:
        schema = SCHEMAS[encoding]
        payloads = cdr(texts) if encoding == "cdr" else [json.dumps({"data": text}).encode() for text in texts]
    return Channel(topic, range(len(texts)), payloads, encoding.removeprefix("bare "), schema)


def recorded(folder: Path, *channels: Channel, name: str = "run1.mcap") -> Path:
    """A log of the leg with more topics."""
    return write_mcap(folder / name, *channels, ros2(states(20)))


def same(robot: Robot, other: Robot) -> bool:
    return list(robot.joints) == list(other.joints) and all(
        np.array_equal(robot.links[name], pi) if pi is not None else robot.links[name] is None
        for name, pi in other.links.items()
    )


@pytest.mark.parametrize("encoding", ["cdr", "json", "bare json", "protobuf"])
@pytest.mark.parametrize("topic", ["/robot_description", "/arm/robot_description", "robot_description"])
def test_a_bag_tells_its_robot(tmp_path: Path, encoding: str, topic: str) -> None:
    path = recorded(tmp_path, described(TEXT, topic=topic, encoding=encoding))
    robot, logs = robot_and_logs(path, [])
    assert same(robot, read_robot(LEG))
    assert logs == [path]
    assert robot.path == path / topic.lstrip("/")
    assert robot.text == TEXT.encode()
    assert len(read_log(path)) == 20


def test_big_endian(tmp_path: Path) -> None:
    payload = b"\0\0\0\0" + (len(TEXT.encode()) + 1).to_bytes(4, "big") + TEXT.encode() + b"\0"
    path = recorded(tmp_path, replace(described(TEXT), payloads=[payload]))
    assert same(robot_and_logs(path, [])[0], read_robot(LEG))


def test_a_urdf_that_is_given_goes_first(tmp_path: Path) -> None:
    path = recorded(tmp_path, described(OTHER))
    robot, logs = robot_and_logs(LEG, [path])
    assert (robot.path, logs) == (LEG, [path])
    assert same(robot, read_robot(LEG))


def test_the_robot_may_be_in_another_log(tmp_path: Path) -> None:
    first, second = recorded(tmp_path), recorded(tmp_path, described(TEXT), name="run2.mcap")
    (tmp_path / "run3.csv").write_text("t,q_hip\n0,0\n1,1\n")
    robot, logs = robot_and_logs(first, [tmp_path / "run3.csv", second])
    assert robot.path == second / "robot_description"
    assert logs == [first, tmp_path / "run3.csv", second]


def test_a_rosbag2_folder_tells_its_robot(tmp_path: Path) -> None:
    items = states(60)
    folder = bag(tmp_path / "run", items[:30], items[30:])
    write_mcap(folder / "run_1.mcap", ros2(items[30:]), described(TEXT))
    assert same(robot_and_logs(folder, [])[0], read_robot(LEG))
    assert len(read_log(folder)) == 60


def test_a_description_that_is_repeated(tmp_path: Path) -> None:
    path = recorded(
        tmp_path, described("", TEXT, TEXT + "\n", " " + TEXT), described(TEXT, topic="/a/robot_description")
    )
    assert same(robot_and_logs(path, [path])[0], read_robot(LEG))


def test_a_channel_is_told_by_its_number_in_its_file(tmp_path: Path) -> None:
    """In the second file that number is another topic's."""
    items = states(60)
    folder = bag(tmp_path / "run", items[:30], items[30:])
    write_mcap(folder / "run_0.mcap", described(TEXT), ros2(items[:30]))
    write_mcap(folder / "run_1.mcap", described("no robot", topic="/chatter"), ros2(items[30:]), described(TEXT))
    assert same(robot_and_logs(folder, [])[0], read_robot(LEG))


IMU = Channel("/imu", [1], [b"x" * 40], schema=("sensor_msgs/msg/Imu", "ros2msg", b"float64 x"))
REFUSED: dict[str, tuple[list[Channel], str]] = {
    "none": (
        [IMU],
        "run1.mcap: no topic /robot_description carries the robot's URDF (std_msgs/msg/String); there are: "
        "/imu (sensor_msgs/msg/Imu, cdr), /joint_states (sensor_msgs/msg/JointState, cdr); give a URDF before the log",
    ),
    "of another type": (
        [replace(IMU, topic="/robot_description")],
        "there are: /robot_description (sensor_msgs/msg/Imu, cdr), /joint_states",
    ),
    "of another name": (
        [described(TEXT, topic="/robot_description_semantic")],
        "/robot_description_semantic (std_msgs",
    ),
    "no message": ([described()], "topic /robot_description holds no message; give a URDF before the log"),
    "an empty message": ([described("")], "topic /robot_description holds no message"),
    "two": ([described(TEXT, OTHER)], "topic /robot_description holds another robot description than /robot_descr"),
    "two topics": (
        [described(TEXT), described(OTHER, topic="/arm/robot_description")],
        "topic /arm/robot_description holds another robot description than /robot_description; give the URDF",
    ),
    "no CDR": ([replace(described(TEXT), payloads=[b"<robot/>"])], "a message of /robot_description is not plain CDR"),
    "cut CDR": ([replace(described(TEXT), payloads=[b"\0\1\0\0\xff\0\0\0<robot/>"])], "ends after 16 bytes"),
    "no JSON": (
        [replace(described(TEXT, encoding="json"), payloads=[b"<robot/>"])],
        "is no text in a field called data",
    ),
    "no text": ([replace(described(TEXT, encoding="json"), payloads=[b'{"data": 3}'])], "is no text in a field"),
    "half a character": (
        [replace(described(TEXT, encoding="json"), payloads=[b'{"data": "\\ud800"}'])],
        "is no text in a field",
    ),
    "no protobuf": ([replace(described(TEXT, encoding="protobuf"), payloads=[b"\xff"])], "is not what its schema says"),
    "no XML": ([described("robot")], "run1.mcap/robot_description: is not XML"),
    "no robot": (
        [described("<sdf/>", topic="/arm/robot_description")],
        "run1.mcap/arm/robot_description: is not a URDF",
    ),
    "xacro": ([described("<robot><xacro:leg/></robot>")], "holds xacro macros"),
    "an entity": ([described(f'<!DOCTYPE r [<!ENTITY e "x">]>{TEXT[22:]}')], "declares a document type"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused(tmp_path: Path, case: str) -> None:
    channels, naming = REFUSED[case]
    recorded(tmp_path, *channels)
    for command in ("adapt", "study"):
        refuse(tmp_path, command, "run1.mcap", naming=naming, file="run1.mcap")
        (tmp_path / "out").rename(tmp_path / command)


def test_two_bags_of_different_robots(tmp_path: Path) -> None:
    first = recorded(tmp_path, described(TEXT))
    second = recorded(tmp_path, described(OTHER), name="run2.mcap")
    said = (
        "run2.mcap: topic /robot_description holds another robot description than run1.mcap, topic /robot_description"
    )
    with pytest.raises(LogError, match=said):
        robot_and_logs(first, [second])


def test_a_description_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("idtool.robot._MOST_BYTES", 1 << 10)
    with pytest.raises(ModelError, match="is larger than"):
        robot_and_logs(recorded(tmp_path, described(TEXT)), [])


def test_a_bag_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "run.db3").write_bytes(b"SQLite format 3\0" + bytes(100))
    refuse(tmp_path, "adapt", "run.db3", naming="ros2 bag convert")


def test_packages_are_looked_for_in_the_search_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}/install/legs")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path}/src")
    places = {"meshes2": tmp_path / "install/legs/share/meshes2", "meshes1": tmp_path / "src/meshes1"}
    visuals = ""
    for package, folder in places.items():
        folder.mkdir(parents=True)
        trimesh.creation.box((0.2, 0.4, 0.6)).export(folder / "box.stl")
        visuals += f'<collision><geometry><mesh filename="package://{package}/box.stl"/></geometry></collision>'
    text = chain(link(1)).replace('<link name="l1"/>', f'<link name="l1">{visuals}</link>')
    (tmp_path / "bags").mkdir()
    robot, _ = robot_and_logs(recorded(tmp_path / "bags", described(text)), [])
    found = link_geometry(robot, "l1")
    assert (found.missing, len(found.read)) == ((), 2)
    np.testing.assert_allclose(np.abs(found.points).max(axis=0), [0.1, 0.2, 0.3])
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    assert "package://meshes2/box.stl is not found" in link_geometry(robot, "l1").missing[0]


# --- on the command line ---


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second of the leg, without a robot and with one; and a configuration without rotors."""
    from commands import csv_text, sample_table

    folder = tmp_path_factory.mktemp("user")
    (folder / "log.csv").write_text(csv_text(sample_table(1300)))
    log = read_log(folder / "log.csv")
    items = [
        replace(state, position=q, velocity=v, effort=tau, stamp=round(t * 1e9), logged=round(t * 1e9))
        for state, t, q, v, tau in zip(
            states(len(log), log.joints),
            log.t.tolist(),
            *(log.signals[s].tolist() for s in ("q", "v", "tau")),
            strict=True,
        )
    ]
    write_mcap(folder / "run.mcap", described(TEXT), ros2(items))
    write_mcap(folder / "more.mcap", ros2(items))
    (folder / "leg.urdf").write_text(TEXT)
    for name in ("leg", "run", "split"):
        config_with(folder / f"{name}.yaml", LEG.with_suffix(".yaml"), rotors=None)
    split = bag(folder / "split", items[:600], items[600:])
    write_mcap(split / "split_0.mcap", described(TEXT), ros2(items[:600]))
    return folder


def adapted(folder: Path, *arguments: str) -> dict[str, Any]:
    done = idtool("adapt", *arguments, "--json", "--quiet", folder=folder)
    assert (done.code, done.err) == (0, "")
    return done.json


def test_a_command_takes_the_robot_from_the_bag(folder: Path) -> None:
    """The same as with the URDF, and with the configuration beside the bag."""
    expected = adapted(folder, "leg.urdf", "run.mcap")
    for name, log in (("run", "run.mcap"), ("split", "split")):
        report = adapted(folder, log)
        assert report["theta"] == expected["theta"]
        assert report["logs"] == [log]
        assert report["urdf"] == f"{log}/robot_description"
        assert set(files(folder / f"{name}_idtool")) == {"adapt.json", "adapt.html"}


def test_split_files_are_logs_of_their_own(folder: Path) -> None:
    both = [f"split/split_{i}.mcap" for i in range(2)]
    report = adapted(folder, *both, "--config", "leg.yaml", "--out", "both")
    assert report["logs"] == both
    assert report["urdf"] == "split/split_0.mcap/robot_description"
    assert report["theta"] != adapted(folder, "split")["theta"]


def test_a_study_takes_the_robot_from_the_bag(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("idtool.study.LOCAL", {})
    done = idtool("study", "run.mcap", "--draws", "5", "--json", "--quiet", folder=folder)
    assert (done.code, done.err) == (0, "")
    assert (done.json["urdf"], done.json["logs"]) == ("run.mcap/robot_description", ["run.mcap"])
    assert set(files(folder / "run_idtool")) >= {"study.json", "study.html"}


def test_in_the_folder_of_the_bag(folder: Path) -> None:
    done = idtool("validate", ".", "--no-simulation", "--quiet", folder=folder / "split")
    assert (done.code, done.err) == (0, "")
    assert (folder / "split" / "split_idtool" / "validation.html").exists()
    report = adapted(folder / "split", ".")
    assert report["theta"] == adapted(folder, "split")["theta"]
    assert (folder / "split" / "split_idtool" / "adapt.json").exists()


@pytest.mark.parametrize("log", ["run.mcap", "split", "run_1.5kg"])
def test_a_first_configuration_is_written_beside_the_bag_where_fit_finds_it(folder: Path, log: str) -> None:
    if not (folder / log).exists():
        shutil.copytree(folder / "split", folder / log)
    file = folder / f"{log.removesuffix('.mcap')}.yaml"
    known = "known.yaml"
    (folder / known).write_text("filter: {cutoff_hz: 33}\nrotors: {}\n")
    done = idtool("init", log, "--config", known, "--force", "--json", "--quiet", folder=folder)
    assert (done.code, done.err) == (0, "")
    assert (done.json["file"], done.json["next"]) == (file.name, f"idtool fit {log}")
    fitted = idtool("fit", log, "--quick", "--json", "--quiet", folder=folder)
    assert (fitted.code, fitted.err, fitted.json["band_hz"]) == (0, "", 33)
    assert (folder / f"{log.removesuffix('.mcap')}_idtool" / "report.html").exists()


def test_a_bag_without_a_robot_needs_one(folder: Path) -> None:
    for arguments, naming in (
        (["more.mcap"], "more.mcap: no topic /robot_description carries"),
        (["leg.urdf"], "missing argument 'LOG'"),
        (["log.csv"], "missing argument 'LOG'"),
        (["none.mcap"], "none.mcap: there is no such file"),
        ([], "missing argument 'URDF'"),
    ):
        done = idtool("adapt", *arguments, folder=folder)
        assert (done.code, done.out) == (2, "")
        assert naming in done.err


# --- xacro ---

XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
BANNER = """\
<?xml version="1.0" ?>
<!-- =================================================================================== -->
<!-- |    This document was autogenerated by xacro from leg.urdf.xacro                 | -->
<!-- |    EDITING THIS FILE BY HAND IS NOT RECOMMENDED                                 | -->
<!-- =================================================================================== -->
"""
BODY = TEXT[TEXT.index("<robot") :]
MACROS: dict[str, tuple[str, str]] = {
    "robot.urdf.xacro": (
        f'<robot {XACRO} name="r"><xacro:leg side="l"/></robot>',
        "xacro robot.urdf.xacro > robot.urdf",
    ),
    "leg.xacro": (BODY, "xacro leg.xacro > leg.urdf"),  # by its name
    "my leg.xacro": ("", "xacro 'my leg.xacro' > 'my leg.urdf'"),
    "robot.urdf": (
        f'<robot {XACRO} name="r"><link name="a"><xacro:inertia/></link></robot>',
        "xacro robot.urdf > robot_",
    ),
    "former.urdf": ('<robot xmlns:x="http://ros.org/wiki/xacro"><x:leg/></robot>', "xacro former.urdf > former_exp"),
    "undeclared.urdf": ('<robot name="r"><xacro:leg/></robot>', "xacro undeclared.urdf > undeclared_expanded.urdf"),
    "sums.urdf": (BODY.replace('xyz="0 0 ', 'xyz="${2 * x} 0 ', 1), "xacro sums.urdf > sums_expanded.urdf"),
    "names.urdf": (BODY.replace('name="hip"', 'name="${side}_hip"'), "xacro names.urdf > names_expanded.urdf"),
}


@pytest.mark.parametrize("name", MACROS)
def test_xacro_is_to_be_expanded(tmp_path: Path, name: str) -> None:
    text, command = MACROS[name]
    assert text != BODY or name.endswith(".xacro")
    (tmp_path / name).write_text(text)
    refuse(tmp_path, "adapt", name, "log.csv", file=f"{name}: holds xacro macros; run xacro", naming=command)


def test_a_xacro_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(IdtoolError, match=r"cannot be read \(No such file"):
        read_robot(tmp_path / "robot.urdf.xacro")


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_what_xacro_makes_is_read_and_kept(robot_of: Callable[[str | bytes], Robot], end: str) -> None:
    text = BANNER + BODY.replace("<robot", f"<!-- <xacro:leg/> ${{x}} --><robot {XACRO}", 1)
    text = text.replace("</robot>", '<gazebo><plugin filename="$(find x)/y"/></gazebo></robot>').replace("\n", end)
    robot = robot_of(text)
    assert same(robot, read_robot(LEG))
    pi = from_mass_com_inertia(2.5, np.array([0.01, 0.02, 0.03]), np.diag([0.1, 0.2, 0.25]))
    new = rewrite(robot.text, {"thigh_link": pi}, {"knee": JointDynamics(damping=0.7)}).decode()
    before, after = text.split(end), new.split(end)
    thigh, knee = '<link name="thigh_link">', '<joint name="knee"'
    assert (
        after[: before.index(next(x for x in before if thigh in x)) + 1]
        == before[: after.index(next(x for x in after if thigh in x)) + 1]
    )
    assert after[-5:] == before[-5:]
    changed = [line for line in after if line not in before]
    assert 0 < len(changed) < 8
    again = robot_of(new)
    np.testing.assert_allclose(again.links["thigh_link"], pi, rtol=1e-12)
    assert again.joints["knee"].damping == 0.7
    assert knee in new
