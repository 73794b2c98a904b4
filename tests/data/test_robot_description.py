"""Robots as ROS gives them: on a bag's topic `robot_description`."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from commands import LEG, refuse
from descriptions import OTHER, TEXT, described, recorded, same
from mcap.records import Schema
from recordings import Channel, bag, ros2, states, write_mcap
from robots import chain, link

from idtool.common.exceptions import LogError, ModelError
from idtool.data.logs import read_log
from idtool.data.logs.payloads import text_decoder_for
from idtool.data.robot_source import read_robot_and_logs
from idtool.robot.geometry import link_geometry
from idtool.robot.urdf.reading import read_robot


@pytest.mark.parametrize("encoding", ["cdr", "json", "bare json", "protobuf"])
@pytest.mark.parametrize("topic", ["/robot_description", "/arm/robot_description", "robot_description"])
def test_a_bag_tells_its_robot(tmp_path: Path, encoding: str, topic: str) -> None:
    path = recorded(tmp_path, described(TEXT, topic=topic, encoding=encoding))
    robot, logs = read_robot_and_logs(path, [])
    assert same(robot, read_robot(LEG))
    assert logs == [path]
    assert robot.path == path / topic.lstrip("/")
    assert robot.text == TEXT.encode()
    assert len(read_log(path)) == 20


def test_big_endian(tmp_path: Path) -> None:
    payload = b"\0\0\0\0" + (len(TEXT.encode()) + 1).to_bytes(4, "big") + TEXT.encode() + b"\0"
    path = recorded(tmp_path, replace(described(TEXT), payloads=[payload]))
    assert same(read_robot_and_logs(path, [])[0], read_robot(LEG))


def test_a_urdf_that_is_given_goes_first(tmp_path: Path) -> None:
    path = recorded(tmp_path, described(OTHER))
    robot, logs = read_robot_and_logs(LEG, [path])
    assert (robot.path, logs) == (LEG, [path])
    assert same(robot, read_robot(LEG))


def test_the_robot_may_be_in_another_log(tmp_path: Path) -> None:
    first, second = recorded(tmp_path), recorded(tmp_path, described(TEXT), name="run2.mcap")
    (tmp_path / "run3.csv").write_text("t,q_hip\n0,0\n1,1\n")
    robot, logs = read_robot_and_logs(first, [tmp_path / "run3.csv", second])
    assert robot.path == second / "robot_description"
    assert logs == [first, tmp_path / "run3.csv", second]


def test_a_rosbag2_folder_tells_its_robot(tmp_path: Path) -> None:
    items = states(60)
    folder = bag(tmp_path / "run", items[:30], items[30:])
    write_mcap(folder / "run_1.mcap", ros2(items[30:]), described(TEXT))
    assert same(read_robot_and_logs(folder, [])[0], read_robot(LEG))
    assert len(read_log(folder)) == 60


def test_a_description_that_is_repeated(tmp_path: Path) -> None:
    path = recorded(
        tmp_path, described("", TEXT, TEXT + "\n", " " + TEXT), described(TEXT, topic="/a/robot_description")
    )
    assert same(read_robot_and_logs(path, [path])[0], read_robot(LEG))


def test_a_channel_is_told_by_its_number_in_its_file(tmp_path: Path) -> None:
    """In the second file that number is another topic's."""
    items = states(60)
    folder = bag(tmp_path / "run", items[:30], items[30:])
    write_mcap(folder / "run_0.mcap", described(TEXT), ros2(items[:30]))
    write_mcap(folder / "run_1.mcap", described("no robot", topic="/chatter"), ros2(items[30:]), described(TEXT))
    assert same(read_robot_and_logs(folder, [])[0], read_robot(LEG))


IMU = Channel("/imu", [1], [b"x" * 40], schema=("sensor_msgs/msg/Imu", "ros2msg", b"float64 x"))
REFUSED: dict[str, tuple[list[Channel], str]] = {
    "none": (
        [IMU],
        "run1.mcap: no topic /robot_description carries a URDF (std_msgs/msg/String); available: "
        "/imu (sensor_msgs/msg/Imu, cdr), /joint_states (sensor_msgs/msg/JointState, cdr); give a URDF before the log",
    ),
    "of another type": (
        [replace(IMU, topic="/robot_description")],
        "available: /robot_description (sensor_msgs/msg/Imu, cdr), /joint_states",
    ),
    "of another name": (
        [described(TEXT, topic="/robot_description_semantic")],
        "/robot_description_semantic (std_msgs",
    ),
    "no message": ([described()], "topic /robot_description has no messages; give a URDF before the log"),
    "an empty message": ([described("")], "topic /robot_description has no messages"),
    "two": (
        [described(TEXT, OTHER)],
        "topic /robot_description contains a different robot description from topic",
    ),
    "two topics": (
        [described(TEXT), described(OTHER, topic="/arm/robot_description")],
        "topic /arm/robot_description contains a different robot description from topic /robot_description; give",
    ),
    "no CDR": ([replace(described(TEXT), payloads=[b"<robot/>"])], "a message of /robot_description is not plain CDR"),
    "cut CDR": (
        [replace(described(TEXT), payloads=[b"\0\1\0\0\xff\0\0\0<robot/>"])],
        "ends within a field, after 16 bytes",
    ),
    "no JSON": (
        [replace(described(TEXT, encoding="json"), payloads=[b"<robot/>"])],
        "has no text in a field called data",
    ),
    "no text": ([replace(described(TEXT, encoding="json"), payloads=[b'{"data": 3}'])], "has no text in a field"),
    "half a character": (
        [replace(described(TEXT, encoding="json"), payloads=[b'{"data": "\\ud800"}'])],
        "has no text in a field",
    ),
    "no protobuf": ([replace(described(TEXT, encoding="protobuf"), payloads=[b"\xff"])], "does not match its schema"),
    "no XML": ([described("robot")], "run1.mcap/robot_description: is not XML"),
    "no robot": (
        [described("<sdf/>", topic="/arm/robot_description")],
        "run1.mcap/arm/robot_description: is not a URDF",
    ),
    "xacro": ([described("<robot><xacro:leg/></robot>")], "contains xacro macros"),
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
    different = "contains a different robot description from"
    said = f"run2.mcap: topic /robot_description {different} topic /robot_description of run1.mcap"
    with pytest.raises(LogError, match=said):
        read_robot_and_logs(first, [second])


def test_a_description_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("idtool.robot.urdf.reading._MAX_BYTES", 1 << 10)
    with pytest.raises(ModelError, match="is larger than"):
        read_robot_and_logs(recorded(tmp_path, described(TEXT)), [])


def test_a_description_is_read_in_its_own_size() -> None:
    (message,) = described(TEXT + " " * (1 << 22)).payloads
    decode = text_decoder_for("cdr", Schema(id=1, name="std_msgs/msg/String", encoding="ros2msg", data=b""))
    assert decode
    tracemalloc.start()
    text = decode(message)
    assert tracemalloc.get_traced_memory()[1] < 2.5 * len(message)  # a slice, and that without the zero at its end
    tracemalloc.stop()
    assert text.decode().strip() == TEXT.strip()


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
    robot, _ = read_robot_and_logs(recorded(tmp_path / "bags", described(text)), [])
    found = link_geometry(robot, "l1")
    assert (found.unreadable, len(found.parts_read)) == ((), 2)
    np.testing.assert_allclose(np.abs(found.points).max(axis=0), [0.1, 0.2, 0.3])
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    assert "package://meshes2/box.stl is not found" in link_geometry(robot, "l1").unreadable[0]
