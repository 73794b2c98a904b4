"""Rotors: where they sit, what they turn with, and what is left of the links that carry them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from robots import body, chain, link, link_pi
from scipy.spatial.transform import Rotation

from idtool.common.exceptions import ConfigError
from idtool.robot.inertia import from_mass_com_inertia, parameter_transform
from idtool.robot.model import Frame, RobotModel

Build = Callable[..., RobotModel]
LEG_JOINTS = ("abad", "hip", "knee")
ROTOR = {"joint": "hip", "gear_ratio": 10.604, "inertial": {"mass": 0.5, "inertia": [0.002, 0, 0.001, 0, 0, 0.002]}}


def in_root(model: RobotModel, frame: Frame) -> Frame:
    """A frame's place in the root link, every phi at its offset."""
    if frame.body < 0:
        return frame
    carrier = model.bodies[frame.body]
    moved = np.zeros(3), Rotation.from_rotvec(carrier.axis * carrier.offset).as_matrix()
    if carrier.prismatic:
        moved = carrier.axis * carrier.offset, np.eye(3)
    return in_root(model, carrier.mount.compose(moved[1], moved[0])).compose(frame.R, frame.p)


def test_a_rotor_stands_at_its_joint_unless_it_is_placed(build: Build, leg: str) -> None:
    model = build(leg, LEG_JOINTS, rotors={"motor": ROTOR})
    rotor, thigh = body(model, "motor"), body(model, "thigh")
    assert [b.kind for b in model.bodies] == ["link", "link", "link", "rotor"]
    assert rotor.mount.body == thigh.mount.body
    np.testing.assert_allclose(rotor.mount.R, thigh.mount.R)
    np.testing.assert_allclose(rotor.mount.p, thigh.mount.p)
    np.testing.assert_allclose(rotor.axis, thigh.axis)
    np.testing.assert_allclose(rotor.ratios, [0, 10.604, 0])
    np.testing.assert_allclose(rotor.pi, from_mass_com_inertia(0.5, np.zeros(3), np.diag([0.002, 0.001, 0.002])))
    np.testing.assert_array_equal(model.support()[3], [True, True, False])


def test_a_rotor_that_is_placed(build: Build, leg: str, rng: np.random.Generator) -> None:
    """In the foot, which is lumped into the shank, turning about an axis of its own."""
    foot = build(leg, LEG_JOINTS).bodies[2].members[1].frame
    placed = {"parent": "foot", "origin": {"xyz": [0.1, 0.2, 0.3], "rpy": [0.4, 0.5, 0.6]}, "axis": [0, 3, 4]}
    rotor = body(build(leg, LEG_JOINTS, rotors={"motor": ROTOR | placed}), "motor")
    R = Rotation.from_euler("xyz", [0.4, 0.5, 0.6]).as_matrix()
    np.testing.assert_allclose(rotor.mount.R, foot.R @ R)
    np.testing.assert_allclose(rotor.mount.p, foot.p + foot.R @ [0.1, 0.2, 0.3])
    np.testing.assert_allclose(rotor.axis, [0, 0.6, 0.8])
    assert rotor.mount.body == 2


def test_a_rotor_may_be_bounded_and_its_centre_known_as_any_body(build: Build, leg: str) -> None:
    model = build(
        leg,
        LEG_JOINTS,
        rotors={"hip_motor": {"joint": "hip", "gear_ratio": 8}},
        bounding_shapes={"hip_motor": [{"kind": "cylinder", "radius": 0.04, "length": 0.02}]},
        known_com={"hip_motor": [0, 0, 0.01]},
    )
    rotor = body(model, "hip_motor")
    assert [shape.kind for shape in rotor.shapes] == ["cylinder"]
    np.testing.assert_array_equal(rotor.shapes[0].contains([[0, 0.03, 0], [0, 0, 0.03]]), [True, False])
    assert rotor.com == (0, 0, 0.01)
    assert not body(model, "abad_link").shapes


def test_a_rotor_without_axis_turns_about_its_joints(build: Build, leg: str) -> None:
    """In the root's frame, all joints at zero, its axis is the knee's, although it sits in another link."""
    placed = {"joint": "knee", "parent": "abad_link", "origin": {"xyz": [0, 0.1, 0], "rpy": [1, 2, 3]}}
    model = build(leg, LEG_JOINTS, rotors={"motor": ROTOR | placed})
    rotor, shank = body(model, "motor"), body(model, "shank")
    np.testing.assert_allclose(
        in_root(model, rotor.mount).R @ rotor.axis, in_root(model, shank.mount).R @ shank.axis, atol=1e-12
    )


def test_a_urdf_link_named_as_rotor_is_taken_out_of_the_lump(build: Build, leg: str) -> None:
    plain = body(build(leg, LEG_JOINTS), "abad_link")
    model = build(leg, LEG_JOINTS, rotors={"hip_motor": {"joint": "hip", "gear_ratio": 8}})
    rotor, carrier = body(model, "hip_motor"), body(model, "abad_link")
    assert plain.lumped_links == ("hip_motor",)
    assert carrier.lumped_links == ()
    frame = plain.members[1].frame
    np.testing.assert_allclose(rotor.pi, link_pi(leg, "hip_motor"), atol=1e-12)
    np.testing.assert_allclose(rotor.mount.R, frame.R)
    np.testing.assert_allclose(rotor.mount.p, frame.p)
    np.testing.assert_allclose(carrier.pi + parameter_transform(frame.R, frame.p) @ rotor.pi, plain.pi, atol=1e-12)
    assert [member.link for member in rotor.members] == ["hip_motor"]


def test_a_rotor_whose_joint_is_locked_is_dead_weight(build: Build, leg: str) -> None:
    """Turned to where the locked joint puts it: 10.604 × 0.3 rad about its axis."""
    locked = {"rotors": {"motor": ROTOR | {"bounding_ellipsoid": {"semi_axes": [0.1, 0.1, 0.1]}}}}
    plain = build(leg, ["abad"], locked_joints={"hip": 0.3})
    (carrier,) = build(leg, ["abad"], locked_joints={"hip": 0.3}, **locked).bodies
    thigh = body(build(leg, LEG_JOINTS), "thigh")
    R = thigh.mount.R @ Rotation.from_rotvec(thigh.axis * 10.604 * 0.3).as_matrix()
    own = from_mass_com_inertia(0.5, np.zeros(3), np.diag([0.002, 0.001, 0.002]))
    np.testing.assert_allclose(carrier.pi, plain.bodies[0].pi + parameter_transform(R, thigh.mount.p) @ own, atol=1e-12)
    np.testing.assert_allclose(carrier.ellipsoids[0].center, thigh.mount.p)


def test_a_urdf_link_named_as_rotor_of_a_locked_joint_stays_in_the_lump(build: Build, leg: str) -> None:
    plain = body(build(leg, ["abad"]), "abad_link")
    with_rotor = body(build(leg, ["abad"], rotors={"hip_motor": {"joint": "hip", "gear_ratio": 8}}), "abad_link")
    np.testing.assert_allclose(with_rotor.pi, plain.pi, atol=1e-12)
    heavier = {"mass": 3, "inertia": [0.1, 0, 0.1, 0, 0, 0.1]}
    rotors = {"hip_motor": {"joint": "hip", "gear_ratio": 8, "inertial": heavier}}
    mass = plain.pi[0] - link_pi(leg, "hip_motor")[0] + 3
    assert body(build(leg, ["abad"], rotors=rotors), "abad_link").pi[0] == pytest.approx(mass)


def test_a_rotor_on_a_belt_and_one_on_a_mimic_joint(build: Build) -> None:
    text = chain(link(1), link(2), link(3, '<mimic joint="j1" multiplier="-2" offset="0.1"/>'))
    inertial_of = {"inertial": ROTOR["inertial"]}
    rotors = {
        "belt": {"coupling": {"j1": 10, "j2": -7}, **inertial_of},
        "follower": {"joint": "j3", "gear_ratio": 5, **inertial_of},
    }
    model = build(text, ["j1", "j2"], rotors=rotors)
    np.testing.assert_allclose(body(model, "belt").ratios, [10, -7])
    np.testing.assert_allclose(body(model, "follower").ratios, [-10, 0])
    assert body(model, "follower").offset == pytest.approx(0.5)
    half = body(build(text, ["j1"], rotors=rotors, locked_joints={"j2": 0.2}), "belt")
    np.testing.assert_allclose(half.ratios, [10])
    assert half.offset == pytest.approx(-1.4)


@pytest.mark.parametrize(
    ("rotor", "expected"),
    [
        ({"motor": ROTOR | {"joint": "hipp"}}, "rotors.motor: hipp is not a moving joint; did you mean hip?"),
        ({"motor": ROTOR | {"joint": "ankle"}}, "rotors.motor: ankle is not a moving joint"),
        ({"motor": ROTOR | {"parent": "abad"}}, "rotors.motor.parent: abad is not a link; did you mean abad_link?"),
        ({"motor": ROTOR | {"parent": "shank"}}, "rotors.motor.origin: is missing"),
        ({"motor": {"joint": "hip", "gear_ratio": 8}}, "rotors.motor.inertial: is missing"),
        ({"thigh": ROTOR}, "rotors.thigh: has the name of a moving link"),
        ({"base": ROTOR}, "rotors.base: is a URDF link that carries other links"),
        ({"hip_motor": ROTOR | {"parent": "base"}}, "rotors.hip_motor: has the name of a URDF link"),
        ({"hip_motor": ROTOR | {"origin": {}}}, "rotors.hip_motor: has the name of a URDF link"),
    ],
)
def test_a_rotor_that_cannot_be(build: Build, leg: str, rotor: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build(leg, LEG_JOINTS, rotors=rotor)
    assert str(caught.value).startswith(expected)
