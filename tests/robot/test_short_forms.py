"""Short forms of the configuration: one number for all joints, and rotors by the inertia about their axis alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from robots import body

from idtool.common.exceptions import ConfigError
from idtool.data.controller import JointController
from idtool.data.logs.log import make_log
from idtool.robot.config import Config, MeasuredValue
from idtool.robot.inertia import mass_com_inertia
from idtool.robot.model import RobotModel

Read = Callable[[str | bytes], Config]
Refusal = Callable[[str | bytes], str]
Build = Callable[..., RobotModel]
JOINTS = ("abad", "hip", "knee")
ROTOR = {"joint": "hip", "gear_ratio": 9.0, "inertia": 6e-4}


@pytest.mark.parametrize("text", ["controller: {kp: 25, kd: 1}", "controller: {kp: 25, kd: {hip: 1, knee: 1}}"])
def test_one_gain_is_that_of_every_joint(read: Read, text: str) -> None:
    zeros = np.zeros((5, 2))
    log = make_log("log", np.arange(5) / 1000, ("hip", "knee"), {"q": zeros, "qcmd": zeros})
    controller = JointController.from_log(log, log.joints, read(text).controller)
    np.testing.assert_array_equal(controller.kp, [[25], [25]])
    np.testing.assert_array_equal(controller.kd, [[1], [1]])


def test_gains_by_joint_are_of_these_joints_only(read: Read) -> None:
    controller = read("controller: {kp: {hip: 25}}").controller
    assert controller is not None
    assert (controller.kp_of("hip"), controller.kd_of("hip"), controller.kp_of("knee")) == (25, 0, None)


def test_limits_for_all_joints_alike(read: Read) -> None:
    config = read("limits: {velocity: 5, position: [-1, 1]}")
    assert config.limits_of("hip") == config.limits_of("knee")
    assert (config.limits_of("hip").velocity, config.limits_of("hip").position) == (5, (-1, 1))
    by_joint = read("limits: {velocity: {velocity: 5}}")  # a joint of that name
    assert (by_joint.limits_of("velocity").velocity, by_joint.limits_of("hip").velocity) == (5, None)


@pytest.mark.parametrize(
    ("text", "hip", "knee"),
    [
        ("armature: auto", "auto", "auto"),
        ("armature: 0.05", 0.05, 0.05),
        ("armature: {value: 0.05, standard_error: 0.01}", (0.05, 0.01), (0.05, 0.01)),
        ("armature: {hip: 0.05}", 0.05, None),
        ("armature: {hip: auto, knee: {value: 0.05, standard_error: 0.01}}", "auto", (0.05, 0.01)),
        ("{}", None, None),
    ],
)
def test_forms_of_an_armature(read: Read, text: str, hip: Any, knee: Any) -> None:
    config = read(text)
    for joint, expected in (("hip", hip), ("knee", knee)):
        armature = config.armature_of(joint)
        if isinstance(armature, MeasuredValue):
            value, error = expected if isinstance(expected, tuple) else (expected, None)
            assert (armature.value, armature.standard_error) == (value, error)
        else:
            assert armature == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("armature: {hip: none}", "armature.hip.value: input should be a valid number"),
        ("armature: -1", "armature.value: input should be greater than 0"),
        ("controller: {kp: stiff}", "controller.kp: stiff is not a gain; give a number, or fit"),
        ("controller: {kp: -1}", "controller.kp: input should be greater than or equal to 0"),
        ("log: {scale: {tau: 0}}", "log.scale.tau: a scale of 0 removes the signal"),
        ("limits: {hip: 3}", "limits.hip: input should be a mapping"),
        ("rotors: {r: {joint: hip, gear_ratio: 9, inertia: 0}}", "rotors.r.inertia: input should be greater than 0"),
        (
            "rotors: {r: {joint: hip, gear_ratio: 9, inertia: 1, inertial: {mass: 1, inertia: [1, 0, 1, 0, 0, 1]}}}",
            "rotors.r: give either inertia, about the axis, or inertial",
        ),
    ],
)
def test_short_forms_that_do_not_fit_name_their_key(refusal: Refusal, text: str, expected: str) -> None:
    assert refusal(text).startswith(expected)


@pytest.mark.parametrize("axis", [None, [3, 0, 4]])
def test_the_rest_of_a_rotor_is_filled_in(build: Build, leg: str, axis: list[float] | None) -> None:
    rotor = ROTOR if axis is None else ROTOR | {"axis": axis}
    model = build(leg, JOINTS, rotors={"motor": rotor})
    motor, thigh = body(model, "motor"), body(model, "thigh")
    np.testing.assert_allclose(motor.mount.p, thigh.mount.p)
    if axis is None:
        np.testing.assert_allclose(motor.axis, thigh.axis)
    mass, com, inertia = mass_com_inertia(motor.pi)
    assert motor.axis @ inertia @ motor.axis == pytest.approx(6e-4)
    radius = np.sqrt(2 * 6e-4 / mass)  # of a disc
    assert mass == pytest.approx(1200 * np.pi * radius**3 / 2)
    assert np.trace(inertia) == pytest.approx(6e-4 + 2 * mass * (3 + 0.25) * radius**2 / 12)
    np.testing.assert_array_equal(com, 0)
    (bound,) = motor.ellipsoids
    np.testing.assert_allclose(bound.semi_axes, 1.5 * radius)
    (notice,) = [notice for notice in model.notices if notice.code == "rotor_filled_in"]
    assert notice.subject == "motor"
    assert f"mass {mass:.3g} kg" in notice.message
    assert f"radius {1.5 * radius:.3g} m" in notice.message


def test_what_is_given_of_a_rotor_is_not_filled_in(build: Build, leg: str) -> None:
    own = {"semi_axes": [0.1, 0.2, 0.3]}
    inside = build(leg, JOINTS, rotors={"motor": ROTOR | {"bounding_ellipsoid": own}})
    beside = build(leg, JOINTS, rotors={"hip_motor": ROTOR}, bounding_ellipsoids={"hip_motor": [own]})
    for model, name in ((inside, "motor"), (beside, "hip_motor")):
        (bound,) = body(model, name).ellipsoids
        np.testing.assert_allclose(bound.semi_axes, [0.1, 0.2, 0.3])
        (notice,) = [notice for notice in model.notices if notice.code == "rotor_filled_in"]
        assert "ellipsoid" not in notice.message


@pytest.mark.parametrize("key", ["armature", "controller"])
def test_a_joint_of_a_short_form_that_the_urdf_has_not(build: Build, leg: str, key: str) -> None:
    section = {"hop": 1.0} if key == "armature" else {"kp": {"hop": 1.0}}
    with pytest.raises(ConfigError, match=r"hop: is not an actuated joint of the URDF; did you mean hip\?"):
        build(leg, JOINTS, **{key: section})
