"""URDF and configuration to bodies, against Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from robots import actuated, body, chain, joint, link, link_pi, random_urdf
from scipy.spatial.transform import Rotation
from sentences import sentences

from idtool.common.exceptions import ConfigError, IdtoolError, ModelError
from idtool.robot.config import parse_config
from idtool.robot.model import RobotModel, build_model

Build = Callable[..., RobotModel]
LEG_JOINTS = ("abad", "hip", "knee")


@pytest.mark.parametrize("seed", range(20))
def test_links_on_fixed_joints_are_lumped_as_pinocchio_does(robot_of: Any, seed: int) -> None:
    """Every joint of Pinocchio's tree, mimic joints included, is a body; the root is none."""
    text = random_urdf(np.random.default_rng(seed), size=10, massless=0.3)
    robot = robot_of(text)
    model = build_model(robot, parse_config({}, ""), actuated(robot))
    reference = pin.buildModelFromXML(text)
    assert sorted(b.name for b in model.bodies) == sorted(robot.joints[n].child for n in list(reference.names)[1:])
    for name, index in zip(reference.names, range(reference.njoints), strict=True):
        if index:
            expected = reference.inertias[index].toDynamicParameters()
            np.testing.assert_allclose(body(model, robot.joints[name].child).pi, expected, atol=1e-12)
    total = sum(pi[0] for pi in robot.links.values() if pi is not None)
    lumped = sum(b.pi[0] for b in model.bodies)
    assert lumped + reference.inertias[0].mass == pytest.approx(total)


@pytest.mark.parametrize("seed", range(10))
def test_locked_joints_are_pinocchios_reduced_model(robot_of: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    text = random_urdf(rng, size=10, mimic=0)
    robot = robot_of(text)
    names = actuated(robot)
    moving = sorted(rng.choice(names, size=len(names) // 2, replace=False).tolist())
    at = {name: float(rng.normal()) for name in names if name not in moving}
    model = build_model(robot, parse_config({"locked_joints": at}, ""), moving)
    full = pin.buildModelFromXML(text)
    q = pin.neutral(full)
    for name, value in at.items():
        index = full.joints[full.getJointId(name)]
        q[index.idx_q : index.idx_q + index.nq] = [value] if index.nq == 1 else [np.cos(value), np.sin(value)]
    reduced = pin.buildReducedModel(full, [full.getJointId(name) for name in at], q)
    assert sorted(model.names) == sorted(list(reduced.names)[1:])
    for name in model.names:
        index, ours = reduced.getJointId(name), body(model, robot.joints[name].child)
        np.testing.assert_allclose(ours.pi, reduced.inertias[index].toDynamicParameters(), atol=1e-12)
        np.testing.assert_allclose(ours.mount.R, reduced.jointPlacements[index].rotation, atol=1e-12)
        np.testing.assert_allclose(ours.mount.p, reduced.jointPlacements[index].translation, atol=1e-12)
        parent = robot.joints[reduced.names[reduced.parents[index]]].child if reduced.parents[index] else None
        assert (model.bodies[ours.mount.body].name if ours.mount.body >= 0 else None) == parent


def test_the_root_link_and_what_is_fixed_to_it_are_not_identified(build: Build, leg: str) -> None:
    model = build(leg, ["hip", "knee"])
    assert [b.name for b in model.bodies] == ["thigh", "shank"]
    assert model.bodies[0].mount.body == -1
    assert model.bodies[1].lumped_links == ("foot",)
    assert any("abad at 0, tail at 0" in warning for warning in sentences(model.notices))


def test_a_lumped_body_says_of_what_it_is_made(build: Build, leg: str) -> None:
    shank = body(build(leg, LEG_JOINTS), "shank")
    assert [member.link for member in shank.members] == ["shank", "foot"]
    for member in shank.members:
        np.testing.assert_allclose(member.pi, link_pi(leg, member.link), atol=1e-12)
    np.testing.assert_allclose(sum(member.pi_in_body for member in shank.members), shank.pi, atol=1e-12)


def test_joints_stand_in_the_configurations_order_and_only_those(build: Build, leg: str) -> None:
    assert build(leg, [*LEG_JOINTS, "tail", "arm"]).names == ("abad", "hip", "knee", "tail")
    model = build(leg, [*LEG_JOINTS, "tail"], joints=["knee", "hip"])
    assert model.names == ("knee", "hip")
    np.testing.assert_array_equal(model.support(), [[False, True], [True, True]])
    warnings = " ".join(sentences(build(leg, ["hip", "arm"]).notices))
    assert "ignored: arm" in warnings


def test_gravity_is_down_unless_the_configuration_says_otherwise(build: Build, leg: str) -> None:
    np.testing.assert_array_equal(build(leg, LEG_JOINTS).gravity, [0, 0, -9.81])
    np.testing.assert_array_equal(build(leg, LEG_JOINTS, gravity=[1, 2, 3]).gravity, [1, 2, 3])


def test_a_link_without_mass_is_said_to_have_an_empty_prior(build: Build, rng: np.random.Generator) -> None:
    model = build(random_urdf(rng, size=3, kinds=["revolute"], mimic=0, massless=1.0), ["joint1", "joint2", "joint3"])
    assert not np.any([b.pi for b in model.bodies])
    assert sum("no mass in the URDF" in warning for warning in sentences(model.notices)) == 3


def test_a_mimic_joint_of_a_mimic_joint(build: Build) -> None:
    """phi2 = 3 phi3 + 0.5 and phi3 = −2 q1 + 0.1, the follower before its source: phi2 = −6 q1 + 0.8."""
    model = build(
        chain(
            link(1),
            link(2, '<mimic joint="j3" multiplier="3" offset="0.5"/>'),
            link(3, '<mimic joint="j1" multiplier="-2" offset="0.1"/>'),
            link(4, '<mimic joint="j1"/>'),
        ),
        ["j1"],
    )
    assert model.names == ("j1",)
    np.testing.assert_allclose([b.ratios[0] for b in model.bodies], [1, -6, -2, 1])
    np.testing.assert_allclose([b.offset for b in model.bodies], [0, 0.8, 0.1, 0])
    np.testing.assert_allclose([b.axis for b in model.bodies], [[0, 0, 1]] * 4)


def test_a_mimic_joint_of_a_locked_joint_is_locked_where_that_puts_it(build: Build) -> None:
    text = chain(
        link(1),
        link(2, '<mimic joint="j1" multiplier="2" offset="0.3"/>'),
        link(3, '<mimic joint="j1" multiplier="-1"/>', kind="prismatic"),
        link(4),
    )
    (last,) = build(text, ["j4"], locked_joints={"j1": 0.25}).bodies
    np.testing.assert_allclose(last.mount.R, Rotation.from_rotvec([0, 0, 0.25 + 0.8]).as_matrix())
    np.testing.assert_allclose(last.mount.p, [0, 0, -0.25])


@pytest.mark.parametrize(("first", "second"), [("nobody", "j1"), ("j2", "j2"), ("j3", "j2")])
def test_a_mimic_joint_that_leads_nowhere(build: Build, first: str, second: str) -> None:
    text = chain(link(1), link(2, f'<mimic joint="{first}"/>'), link(3, f'<mimic joint="{second}"/>'))
    with pytest.raises(ModelError, match="does not exist or itself mimics this joint"):
        build(text, ["j1"])


def test_bounding_ellipsoids_move_with_their_link(build: Build, leg: str, rng: np.random.Generator) -> None:
    bounds = {"shank": [{"semi_axes": [0.1, 0.2, 0.3]}], "foot": [{"semi_axes": [0.3, 0.1, 0.2], "rpy": [1, 2, 3]}]}
    shank = body(build(leg, LEG_JOINTS, bounding_ellipsoids=bounds), "shank")
    points = rng.uniform(-0.5, 0.5, (500, 3))
    for member, ours in zip(shank.members, shank.ellipsoids, strict=True):
        bound = parse_config({"bounding_ellipsoids": bounds}, "").bounding_ellipsoids[member.link][0].to_ellipsoid()
        in_body = points @ member.frame.R.T + member.frame.p
        np.testing.assert_array_equal(ours.contains(in_body), bound.contains(points))
        assert bound.contains(points).any()


SHAPES: dict[str, dict[str, Any]] = {
    "box": {"kind": "box", "size": [0.5, 0.3, 0.7]},
    "cylinder": {"kind": "cylinder", "radius": 0.3, "length": 0.6},
    "capsule": {"kind": "capsule", "radius": 0.2, "length": 0.5},
}


def in_shape(kind: str, points: Any) -> Any:
    """Whether points in the shape's own frame are in it, written out."""
    x, y, z = points.T
    if kind == "box":
        return (abs(x) < 0.25) & (abs(y) < 0.15) & (abs(z) < 0.35)
    if kind == "cylinder":
        return (np.hypot(x, y) < 0.3) & (abs(z) < 0.3)
    return np.hypot(np.hypot(x, y), abs(z) - np.minimum(abs(z), 0.25)) < 0.2


@pytest.mark.parametrize("kind", SHAPES)
def test_bounding_shapes_move_with_their_link(build: Build, leg: str, rng: np.random.Generator, kind: str) -> None:
    """Of a lumped link too, in the union with what bounds its carrier."""
    place = {"center": [0.1, -0.2, 0.05], "rpy": [0.4, -0.8, 1.1]}
    model = build(
        leg,
        LEG_JOINTS,
        bounding_shapes={"foot": [{**SHAPES[kind], **place}]},
        bounding_ellipsoids={"shank": [{"semi_axes": [0.1, 0.1, 0.1]}]},
    )
    shank = body(model, "shank")
    (shape,) = shank.shapes
    assert shank.bounds == (*shank.ellipsoids, shape)
    assert shape.kind == kind
    own = rng.uniform(-0.6, 0.6, (2000, 3))
    in_foot = own @ Rotation.from_euler("xyz", place["rpy"]).as_matrix().T + place["center"]
    frame = shank.members[1].frame
    inside = in_shape(kind, own)
    assert 50 < np.count_nonzero(inside) < 1000
    np.testing.assert_array_equal(shape.contains(in_foot @ frame.R.T + frame.p), inside)


def test_a_hull_of_a_mesh_that_is_not_there(build: Build, leg: str) -> None:
    with pytest.raises(IdtoolError, match=r"shank\.stl"):
        build(leg, LEG_JOINTS, bounding_shapes={"shank": [{"kind": "hull", "file": "shank.stl"}]})


def test_a_known_centre_of_mass_is_its_bodys(build: Build, leg: str) -> None:
    model = build(leg, LEG_JOINTS, known_com={"shank": [0.1, 0.2, 0.3]})
    assert [b.com for b in model.bodies] == [None, None, (0.1, 0.2, 0.3)]
    with pytest.raises(ConfigError, match="known_com: foot: is not a body of the model"):  # it is part of the shank
        build(leg, LEG_JOINTS, known_com={"foot": [0, 0, 0]})


def test_an_ellipsoid_on_a_link_that_looks_straight_up(build: Build) -> None:
    fixed = joint("up", "fixed", "l1", "l2", '<origin xyz="0 0 1" rpy="0 1.5707963267948966 0"/>')
    text = chain(link(1), fixed)
    (only,) = build(text, ["j1"], bounding_ellipsoids={"l2": [{"semi_axes": [1, 2, 3]}]}).bodies
    np.testing.assert_allclose(only.ellipsoids[0].Q_s, np.diag([9, 4, 1]), atol=1e-5)


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        ({"joints": ["hip", "kne"]}, "joints: kne: is not an actuated joint of the URDF; did you mean knee?"),
        ({"joints": ["ankle"]}, "joints: ankle: is not an actuated joint"),
        ({"joints": ["tail"]}, "joints: tail: is not in every log"),
        (
            {"locked_joints": {"tial": 0}},
            "locked_joints: tial: is not an actuated joint of the URDF; did you mean tail?",
        ),
        ({"locked_joints": {"ankle": 0}}, "locked_joints: ankle: is not an actuated joint"),
        ({"locked_joints": {"hip": 0}}, "locked_joints: hip: is also listed as a moving joint"),
        (
            {"bounding_ellipsoids": {"thihg": [{"semi_axes": [1, 1, 1]}]}},
            "bounding_ellipsoids: thihg: is not a link of the URDF; did you mean thigh?",
        ),
        (
            {"friction": {"hop": {"viscous": 1}}},
            "friction: hop: is not an actuated joint of the URDF; did you mean hip?",
        ),
    ],
)
def test_a_name_that_is_not_there(build: Build, leg: str, config: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build(leg, LEG_JOINTS, **config)
    assert str(caught.value).startswith(expected)


def test_logs_of_another_robot(build: Build, leg: str) -> None:
    with pytest.raises(ModelError, match="it has abad, hip, knee, tail, the logs have arm"):
        build(leg, ["arm"])
