"""Limits: the URDF's, tightened by the configuration, with what mimicking joints add and what is assumed."""

from __future__ import annotations

import numpy as np
import pytest
from exciting import arm, body, joint, robot

from idtool.common.exceptions import ConfigError
from idtool.excitation.limits import Limits, joint_limits
from idtool.robot.config import parse_config
from idtool.robot.model import RobotModel, build_model
from idtool.robot.urdf.reading import read_robot


def model_of(text: str, tmp_path, *joints: str) -> RobotModel:  # type: ignore[no-untyped-def]
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return build_model(read_robot(path), parse_config({}, "c"), joints)


def limits(text: str, tmp_path, *joints: str, **given: dict[str, object]) -> Limits:  # type: ignore[no-untyped-def]
    return joint_limits(model_of(text, tmp_path, *joints), parse_config({"limits": given}, "c"))


def test_the_urdfs_limits(tmp_path) -> None:  # type: ignore[no-untyped-def]
    found = limits(arm(), tmp_path, "a", "b")
    assert (found.lower.tolist(), found.upper.tolist()) == ([-1.5, -1.5], [2, 2])
    assert (found.velocity.tolist(), found.effort.tolist()) == ([4, 4], [30, 30])
    assert found.acceleration.tolist() == [40, 40]
    assert tuple(notice.message for notice in found.notices) == (
        "no acceleration limit; the acceleration that reaches the velocity limit in 0.1 s is assumed: "
        "a 40 rad/s², b 40 rad/s²",
    )


def test_the_configuration_tightens_and_never_widens(tmp_path) -> None:  # type: ignore[no-untyped-def]
    wide = {"position": [-9, 1], "velocity": 100, "acceleration": 7, "effort": 1e3}
    found = limits(arm(), tmp_path, "a", "b", a=wide, b={"velocity": 1.0, "effort": 2.0})
    assert (found.lower.tolist(), found.upper.tolist()) == ([-1.5, -1.5], [1, 2])
    assert found.velocity.tolist() == [4, 1]
    assert found.acceleration.tolist() == [7, 10]
    assert found.effort.tolist() == [30, 2]


def test_limits_of_a_mimicking_joint_count_for_the_one_it_follows(tmp_path) -> None:  # type: ignore[no-untyped-def]
    finger = joint(
        "m",
        "upper",
        "tip",
        limit='lower="-1" upper="1" velocity="2" effort="1"',
        extra='<mimic joint="a" multiplier="-2" offset="0.5"/>',
    )
    text = robot(body("upper"), body("tip"), joint("a", "base", "upper"), finger)
    found = limits(text, tmp_path, "a")
    assert found.lower[0] == pytest.approx(-0.25)  # -2 a + 0.5 <= 1
    assert found.upper[0] == pytest.approx(0.75)
    assert found.velocity[0] == pytest.approx(1.0)


def test_joints_without_limits(tmp_path) -> None:  # type: ignore[no-untyped-def]
    found = limits(robot(body("upper"), joint("a", "base", "upper", kind="continuous", limit="")), tmp_path, "a")
    assert (found.lower[0], found.upper[0]) == (-np.pi, np.pi)
    assert found.velocity[0] == 3
    assert np.isinf(found.effort[0])
    assert [notice.message.partition(":")[0].partition(";")[0] for notice in found.notices] == [
        "no position limit", "no velocity limit", "no acceleration limit", "no effort limit",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"aa": {"velocity": 1}}, "limits: aa: is not an actuated joint of the URDF; did you mean a?"),
        ({"a": {"position": [2.5, 3]}}, "limits: a: leaves no range of motion: from 2.5 to 2"),
        ({"a": {"position": [1, -1]}}, "give the lower limit first: -1 is not above 1"),
        ({"a": {"velocity": 0}}, "limits.a.velocity: input should be greater than 0"),
        ({"a": {"speed": 1}}, "unknown key 'speed'; did you mean"),
    ],
)
def test_contradictory_limits_are_refused(tmp_path, given: dict[str, dict[str, object]], told: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ConfigError) as caught:
        limits(arm(), tmp_path, "a", "b", **given)
    assert told in str(caught.value)


def test_a_slide_needs_its_limits(tmp_path) -> None:  # type: ignore[no-untyped-def]
    text = robot(body("upper"), joint("a", "base", "upper", kind="prismatic", limit='velocity="1" effort="5"'))
    with pytest.raises(ConfigError, match="has no position limits"):
        limits(text, tmp_path, "a")
    assert limits(text, tmp_path, "a", a={"position": [0, 0.4]}).upper[0] == 0.4


def test_a_margin_of_every_limit_is_left(tmp_path) -> None:  # type: ignore[no-untyped-def]
    full = limits(arm(), tmp_path, "a", "b")
    inner = full.with_margin(0.1)
    assert inner.middle == pytest.approx(full.middle)
    assert inner.half_range == pytest.approx(0.9 * full.half_range)
    assert inner.velocity == pytest.approx(0.9 * full.velocity)
    assert inner.effort == pytest.approx(0.8 * full.effort)
    q, v, a, tau = np.array([[2.0, -1.5], [0.25, 0.25]]), np.full((2, 2), -2.0), np.zeros((2, 2)), np.full((2, 2), 15.0)
    assert full.utilization(q, v, a, tau) == pytest.approx(np.array([[1, 0], [0.5, 0.5], [0, 0], [0.5, 0.5]]))
