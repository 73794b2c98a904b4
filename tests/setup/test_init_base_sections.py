"""Base, contacts and wrench sensors that are proposed from the names of channels and links."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground.humanoid import SIDES, sensor_joint, true_humanoid
from ground.quadruped import JOINTS, true_quadruped
from ground.robot import urdf_text
from sensor_arm import CHANNELS, SENSOR, wrench_channels
from sensor_arm import JOINTS as ARM_JOINTS
from sensor_arm import urdf_text as arm_text

from idtool.data.base_sensors import ACCELEROMETER, GYROSCOPE, ORIENTATION
from idtool.data.logs import JointLog, make_log
from idtool.data.logs.log import Channel
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import Robot
from idtool.setup.base_sections import BaseSections, base_sections
from idtool.setup.name_matching import match

IMU = (*GYROSCOPE, *ACCELEROMETER, *ORIENTATION)
FEET = ("FL_foot", "FR_foot", "RL_foot", "RR_foot")
FLAGS = tuple(f"contact_{foot}" for foot in FEET)
BALL = '<collision><origin xyz="0.001 0 0"/><geometry><sphere radius="0.02"/></geometry></collision>'
SOLE = '<collision><geometry><box size="0.2 0.1 0.02"/></geometry></collision>'
QUADRUPED = urdf_text(true_quadruped(0))

Read = Callable[[str], Robot]


def log_with(channels: Sequence[str], joints: Sequence[str] = JOINTS, size: float = 1.0) -> JointLog:
    """A second of joints in motion, and of channels that change by about ``size``."""
    t = np.arange(1000) / 1000
    q = np.sin(7 * t)[:, None] * np.ones(len(joints))
    log = make_log(Path("run.csv"), t, tuple(joints), {"q": q, "tau": q})
    values = {name: Channel(t, size * np.sin((k + 3) * t)) for k, name in enumerate(channels)}
    return JointLog(**{**vars(log), "channels": values})


def proposed(robot: Robot, *logs: JointLog, imu_topics: Sequence[str] = (), **given: Any) -> BaseSections:
    """What is proposed for the logs of a robot."""
    return base_sections(robot, logs, parse_config(given, "given"), logs[0].joints, imu_topics)


def with_foot_geometry(text: str, geometry: str) -> str:
    """The quadruped whose feet have a geometry."""
    for foot in FEET:
        text = text.replace(f'<link name="{foot}"/>', f'<link name="{foot}">{geometry}</link>')
    return text


def comments(sections: BaseSections, key: str) -> str:
    """The comments of a section."""
    return " ".join(sections.sections[key].comments)


@pytest.mark.parametrize(
    ("name", "candidates", "link"),
    [
        ("FL_foot", ["FR_foot", "FL_foot"], "FL_foot"),
        ("fl/foot", ["FR_foot", "FL_foot"], "FL_foot"),
        ("FL", ["FR_foot", "FL_foot"], "FL_foot"),
        ("left_front", ["FR_foot", "FL_foot"], "FL_foot"),
        ("LH", ["FR_foot", "RearLeftFoot"], "RearLeftFoot"),
        ("left", ["r_sole", "l_sole"], "l_sole"),
        ("r_leg_ft", ["l_leg_ft_sensor", "r_leg_ft_sensor"], "r_leg_ft_sensor"),
        ("left", ["l_leg_ft_sensor", "r_leg_ft_sensor"], "l_leg_ft_sensor"),
        ("left", ["l_leg_ft_sensor", "l_arm_ft_sensor"], None),
        ("rope", ["trunk", "FL_foot"], None),
        ("foot", ["FR_foot", "FL_foot"], None),
    ],
)
def test_name_of_a_sensor_is_matched_by_its_place(name: str, candidates: list[str], link: str | None) -> None:
    assert match(name, candidates) == link


def test_base_floats_with_an_imu_and_feet_are_matched_to_their_flags(robot_of: Read) -> None:
    sections = proposed(robot_of(QUADRUPED), log_with([*IMU, *FLAGS, "contact_rope"]))
    values = sections.values()
    assert values["base"] == {"kind": "floating", "link": "trunk", "imu": {"link": "imu_link", "delay": "auto"}}
    feet = [{"name": foot, "link": foot, "kind": "point", "flag": f"contact_{foot}"} for foot in FEET]
    assert values["contacts"] == [*feet, {"name": "rope", "link": "trunk", "kind": "surface", "flag": "contact_rope"}]
    assert [item.key for item in sections.todo] == ["contacts.radius"]


def test_flags_of_other_names_are_matched_and_what_is_left_holds_the_base(robot_of: Read) -> None:
    flags = ["contact_LF", "contact_right_front", "contact_rl", "contact_foot_RR", "contact_gizmo"]
    contacts = proposed(robot_of(QUADRUPED), log_with([*IMU, *flags])).values()["contacts"]
    assert [contact["link"] for contact in contacts] == [*FEET, "trunk"]
    some = proposed(robot_of(QUADRUPED), log_with([*IMU, "contact_LF", "contact_gizmo"]))
    assert [contact["name"] for contact in some.values()["contacts"]] == ["LF", *FEET[1:]]
    assert "Channels that match no link: contact_gizmo" in comments(some, "contacts")


def test_feet_without_a_channel_are_detected_by_the_torque_of_their_legs(robot_of: Read) -> None:
    contacts = proposed(robot_of(QUADRUPED), log_with(IMU)).values()["contacts"]
    assert [contact["link"] for contact in contacts] == list(FEET)
    assert all(contact["flag"] == "auto" for contact in contacts)


def test_a_ball_has_its_radius_if_the_orientation_tells_its_lowest_point(robot_of: Read) -> None:
    robot = robot_of(with_foot_geometry(QUADRUPED, BALL))
    contact = proposed(robot, log_with([*IMU, *FLAGS])).values()["contacts"][0]
    assert (contact["kind"], contact["radius"], contact["point"]) == ("point", 0.02, [0.001, 0.0, 0.0])
    without = proposed(robot, log_with([*GYROSCOPE, *ACCELEROMETER, *FLAGS])).values()["contacts"][0]
    assert "radius" not in without
    assert without["point"] == [0.001, 0.0, 0.0]


def test_a_flat_foot_is_a_surface_and_always_closed_without_a_flag(robot_of: Read) -> None:
    sections = proposed(robot_of(with_foot_geometry(QUADRUPED, SOLE)), log_with([*IMU, FLAGS[0]]))
    contacts = sections.values()["contacts"]
    assert all(contact["kind"] == "surface" for contact in contacts)
    assert ["flag" in contact for contact in contacts] == [True, False, False, False]
    assert "Always closed without a flag" in comments(sections, "contacts")


def test_measured_forces_without_flags_are_used(robot_of: Read) -> None:
    force = [f"force_FL_foot_{axis}" for axis in "xyz"]
    moment = [f"force_FR_foot_{part}" for part in ("x", "y", "z", "mx", "my", "mz")]
    first, second, *_ = proposed(robot_of(QUADRUPED), log_with([*IMU, *force, *moment])).values()["contacts"]
    assert (first["kind"], first["force"], "flag" in first) == ("point", force, False)
    assert (second["kind"], second["force"], second["moment"]) == ("surface", moment[:3], moment[3:])


def test_base_is_fixed_where_the_imu_stands_still_or_the_root_is_the_world(robot_of: Read) -> None:
    still = proposed(robot_of(QUADRUPED), log_with(IMU, size=1e-3))
    assert still.values() == {"base": {"kind": "fixed"}}
    assert "the IMU stands still" in comments(still, "base")
    world = robot_of(QUADRUPED.replace('"trunk"', '"world"'))
    assert proposed(world, log_with([*IMU, *FLAGS])).values() == {"base": {"kind": "fixed"}}


def test_without_an_imu_in_every_log_contacts_are_only_mentioned(robot_of: Read) -> None:
    robot = robot_of(QUADRUPED)
    for logs in ([log_with(FLAGS)], [log_with([*IMU, *FLAGS]), log_with(FLAGS)]):
        sections = proposed(robot, *logs)
        assert sections.values() == {"base": {"kind": "fixed"}}
        assert [item.key for item in sections.todo] == ["base"]
    assert proposed(robot, log_with(())).sections == {}


def test_a_moving_base_without_feet_is_carried_by_a_surface(robot_of: Read) -> None:
    contacts = proposed(robot_of(QUADRUPED.replace("_foot", "_end")), log_with(IMU)).values()["contacts"]
    assert contacts == [{"name": "support", "link": "trunk", "kind": "surface"}]


def test_the_end_of_a_leg_stands_for_a_foot_that_is_no_link(robot_of: Read) -> None:
    text = QUADRUPED.replace("_foot", "_end")
    sections = proposed(robot_of(text), log_with([*IMU, "contact_FL_calf"]))
    assert sections.values()["contacts"][0]["link"] == "FL_calf"
    assert "contacts.point" in [item.key for item in sections.todo]


def test_channel_that_a_log_lacks_is_named(robot_of: Read) -> None:
    logs = (log_with([*IMU, *FLAGS, "contact_rope"]), log_with([*IMU, *FLAGS]))
    sections = proposed(robot_of(QUADRUPED), *logs)
    assert [contact["name"] for contact in sections.values()["contacts"]] == list(FEET)
    assert "some log lacks them: contact_rope" in comments(sections, "contacts")


def test_imu_without_a_link_is_named_as_missing(robot_of: Read) -> None:
    text = QUADRUPED.replace('"imu_link"', '"unit"')
    sections = proposed(robot_of(text), log_with([*IMU, *FLAGS]), imu_topics=("/imu", "/head/imu"))
    assert sections.values()["base"]["imu"] == {"link": "trunk", "topic": "/imu", "delay": "auto"}
    assert {"base.imu.link", "base.imu.topic"} <= {item.key for item in sections.todo}


def test_what_is_given_is_not_proposed(robot_of: Read) -> None:
    robot, log = robot_of(QUADRUPED), log_with([*IMU, *FLAGS])
    assert set(proposed(robot, log, base={"kind": "floating"}).values()) == {"contacts"}
    assert proposed(robot, log, base={"kind": "fixed"}).values() == {}
    contact = {"name": "foot", "link": "FL_foot"}
    assert set(proposed(robot, log, contacts=[contact]).values()) == {"base"}


@pytest.mark.parametrize(("name", "channel"), [(SENSOR, {}), ("wrist", {"channel": "wrist"})])
def test_a_wrench_sensor_between_links_is_found(robot_of: Read, name: str, channel: dict[str, str]) -> None:
    """By the name of the fixed joint, or as the only one."""
    log = log_with([own.replace(SENSOR, name) for own in CHANNELS], ARM_JOINTS)
    (sensor,) = proposed(robot_of(arm_text()), log).values()["wrench_sensors"]
    assert sensor == {"joint": SENSOR, **channel, "sign": 1, "offset": "fit"}


@pytest.mark.parametrize("name", ["{side}_ankle_ft", "ft_{side}"])
def test_a_sensor_in_the_ankle_is_no_contact(robot_of: Read, name: str) -> None:
    """Though its name also tells the foot, which has a flag of its own."""
    humanoid = true_humanoid(0)
    text = urdf_text(humanoid)
    for side in SIDES:
        text = text.replace(f'"{sensor_joint(side)}"', f'"{side}_ankle_ft"')
    names = [name.format(side=side) for side in SIDES]
    flags = [f"contact_{side}_foot" for side in SIDES]
    wrenches = [channel for sensor in names for channel in wrench_channels(sensor)]
    values = proposed(robot_of(text), log_with([*IMU, *flags, *wrenches], humanoid.joints)).values()
    assert [sensor["joint"] for sensor in values["wrench_sensors"]] == [f"{side}_ankle_ft" for side in SIDES]
    assert [contact["flag"] for contact in values["contacts"]] == flags
    assert not any("force" in contact for contact in values["contacts"])


def test_a_link_with_a_flag_has_no_second_contact(robot_of: Read) -> None:
    force = [f"force_left_front_{axis}" for axis in "xyz"]
    sections = proposed(robot_of(QUADRUPED), log_with([*IMU, *FLAGS, *force]))
    assert [contact["link"] for contact in sections.values()["contacts"]] == list(FEET)
    assert "The measured force of left_front is not needed" in comments(sections, "contacts")


def test_a_dead_wrench_sensor_and_one_without_moments_are_not_proposed(robot_of: Read) -> None:
    robot = robot_of(arm_text())
    assert proposed(robot, log_with(CHANNELS, ARM_JOINTS, size=0.0)).values() == {}
    assert proposed(robot, log_with(CHANNELS[:3], ARM_JOINTS)).values() == {}


def test_sign_of_a_wrench_sensor_that_the_logs_do_not_tell_has_to_be_checked(robot_of: Read) -> None:
    sections = proposed(robot_of(arm_text()), log_with(CHANNELS, ARM_JOINTS))
    for found, sign, has_todo in (({SENSOR: 1}, 1, False), ({SENSOR: -1}, -1, False), ({}, 1, True)):
        signed = sections.with_signs(found)
        assert signed.values()["wrench_sensors"][0]["sign"] == sign
        assert ("wrench_sensors.sign" in [item.key for item in signed.todo]) == has_todo
