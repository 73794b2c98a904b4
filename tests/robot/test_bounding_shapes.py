"""Boxes, cylinders, capsules and hulls from the configuration: in the model, in a fit, and mirrored."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from commands import LEG, SAMPLES, config_with, csv_text, fitted, refuse, sample_table
from hypothesis import given
from hypothesis import strategies as st
from legs import COPIES, LEGS, Robots, image, legs, of_body
from legs import fit as fit_legs
from numpy.typing import NDArray
from robots import body, chain, joint, rotation
from scipy.spatial.transform import Rotation
from solids import inside, kinds, random_shape, seeds
from synthetic import bounded_body, point_parameters, random_ellipsoid

from idtool.estimation.dataset.equality_constraints import with_equal_bounds
from idtool.estimation.problem.realizability import check_realizability
from idtool.robot.config import parse_config
from idtool.robot.inertia import parameter_reflection
from idtool.robot.model import RobotModel
from idtool.robot.shapes import known_shapes

Array = NDArray[np.float64]

LEG_YAML = yaml.safe_load(LEG.with_suffix(".yaml").read_text())
TRAIN = SAMPLES / "leg_train.mcap"
MIDDLE = [0, 0, -0.1725]
PLACE = {"center": [0.1, -0.2, 0.3], "rpy": [0.4, -0.5, 0.6]}

KINDS: dict[str, dict[str, Any]] = {
    "box": {"kind": "box", "size": [0.2, 0.3, 0.4], **PLACE},
    "cylinder": {"kind": "cylinder", "radius": 0.2, "length": 0.5, **PLACE},
    "capsule": {"kind": "capsule", "radius": 0.2, "length": 0.5, **PLACE},
}


def local(points: Array) -> Array:
    """Points in the frame at `PLACE`, written out."""
    R = Rotation.from_euler("xyz", PLACE["rpy"]).as_matrix()
    return np.asarray((points - PLACE["center"]) @ R)


def is_inside(kind: str, points: Array) -> NDArray[np.bool_]:
    """The definition of each solid."""
    x, y, z = local(points).T
    if kind == "box":
        return np.asarray((np.abs(x) <= 0.1) & (np.abs(y) <= 0.15) & (np.abs(z) <= 0.2))
    if kind == "cylinder":
        return np.asarray((np.hypot(x, y) <= 0.2) & (np.abs(z) <= 0.25))
    beyond = z - np.clip(z, -0.25, 0.25)
    return np.asarray(x**2 + y**2 + beyond**2 <= 0.2**2)


def around(rng: np.random.Generator, count: int = 4000) -> Array:
    return np.asarray(PLACE["center"] + rng.uniform(-0.6, 0.6, (count, 3)))


@pytest.fixture
def build(build: Callable[..., RobotModel]) -> Callable[..., RobotModel]:
    """A model of two links in a row and one fixed to the second, turned and a metre away."""
    fixed = joint("j3", "fixed", "l2", "l3", '<origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/>')
    text = chain(joint("j1", "revolute", "l0", "l1"), joint("j2", "revolute", "l1", "l2"), fixed)
    return lambda **config: build(text, ["j1", "j2"], **config)


@pytest.mark.parametrize("kind", KINDS)
def test_a_shape_is_where_the_configuration_puts_it(
    build: Callable[..., RobotModel], rng: np.random.Generator, kind: str
) -> None:
    (shape,) = body(build(bounding_shapes={"l1": [KINDS[kind]]}), "l1").shapes
    points = around(rng)
    expected = is_inside(kind, points)
    assert 20 < np.count_nonzero(expected) < len(points) / 2
    np.testing.assert_array_equal(shape.contains(points), expected)
    plain = shape.to_dict()
    assert plain.keys() == KINDS[kind].keys()
    assert all(plain[key] == (x if key == "kind" else pytest.approx(x, rel=1e-12)) for key, x in KINDS[kind].items())
    assert known_shapes()[kind].from_dict(plain) == shape


@pytest.mark.parametrize("kind", KINDS)
def test_a_shape_of_a_link_on_a_fixed_joint_moves_with_it(
    build: Callable[..., RobotModel], rng: np.random.Generator, kind: str
) -> None:
    (shape,) = body(build(bounding_shapes={"l3": [KINDS[kind]]}), "l2").shapes
    points = around(rng)
    turned = points @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]]) + [0, 0, 1]  # x, y, z -> −y, x, z + 1
    np.testing.assert_array_equal(shape.contains(turned), is_inside(kind, points))


def test_shapes_and_ellipsoids_are_one_union(build: Callable[..., RobotModel]) -> None:
    ball = {"semi_axes": [0.3, 0.3, 0.3]}
    both = build(bounding_shapes={"l1": [KINDS["box"], KINDS["capsule"]]}, bounding_ellipsoids={"l1": [ball]})
    first, second = body(both, "l1"), body(both, "l2")
    assert [shape.kind for shape in first.shapes] == ["box", "capsule"]
    assert first.bounds == (*first.ellipsoids, *first.shapes)
    assert len(first.ellipsoids) == 1
    assert second.bounds == ()


CORNERS = np.array([[x, y, z] for x in (-0.03, 0.03) for y in (-0.03, 0.03) for z in (-0.171, 0.171)])


def test_a_hull_is_that_of_the_urdfs_own_geometry_or_of_a_file(tmp_path: Path) -> None:
    """The thigh is drawn as a box; a mesh is given from the URDF's folder."""
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.2)
    (tmp_path / "meshes").mkdir()
    mesh.export(tmp_path / "meshes" / "ball.stl")
    (tmp_path / "leg.urdf").write_text(LEG.read_text())
    shapes = {"thigh_link": [{"kind": "hull"}], "shank_link": [{"kind": "hull", "file": "meshes/ball.stl"}]}
    config = config_with(tmp_path / "leg.yaml", LEG.with_suffix(".yaml"), bounding_shapes=shapes)
    bodies = fitted(tmp_path / "out", tmp_path / "leg.urdf", TRAIN, "--config", config)["bodies"]
    (thigh,), (shank,) = (bodies[link]["shapes"] for link in shapes)
    assert thigh["kind"] == shank["kind"] == "hull"
    np.testing.assert_allclose(np.unique(thigh["vertices"], axis=0), np.unique(CORNERS - [0, 0, 0.171], axis=0))
    assert {tuple(x) for x in np.round(shank["vertices"], 6)} == {tuple(x) for x in np.round(mesh.vertices, 6)}


def leg_with(folder: Path, **changes: Any) -> dict[str, Any]:
    """The report of a fit of the leg with another configuration."""
    config = config_with(folder / "other.yaml", LEG.with_suffix(".yaml"), **changes)
    return fitted(folder / "out", LEG, TRAIN, "--config", config)


WIDE: dict[str, dict[str, Any]] = {  # around the shank's ellipsoid
    "box": {"kind": "box", "center": MIDDLE, "size": [0.09, 0.09, 0.6]},
    "cylinder": {"kind": "cylinder", "center": MIDDLE, "radius": 0.045, "length": 0.6},
    "capsule": {"kind": "capsule", "center": MIDDLE, "radius": 0.045, "length": 0.5},
}


@pytest.mark.parametrize("kind", WIDE)
def test_a_fit_within_a_shape_around_the_ellipsoid_is_as_good(tmp_path: Path, kind: str) -> None:
    plain = leg_with(tmp_path)
    ellipsoids = {link: e for link, e in LEG_YAML["bounding_ellipsoids"].items() if link != "shank_link"}
    report = leg_with(tmp_path, bounding_shapes={"shank_link": [WIDE[kind]]}, bounding_ellipsoids=ellipsoids)
    shank = report["bodies"]["shank_link"]
    assert (shank["constraints"], shank["realizable"], shank["violations"]) == ("shape", True, [])
    assert (shank["ellipsoids"], shank["ellipsoid_margin"]) == ([], None)
    (shape,) = shank["shapes"]
    assert shape == {**WIDE[kind], "rpy": [0, 0, 0]}
    assert report["bodies"]["thigh_link"]["constraints"] == "ellipsoid"
    assert abs(report["solver"]["duality_gap"]) < 1e-6
    assert report["rms"]["validation"]["overall"] == pytest.approx(plain["rms"]["validation"]["overall"], rel=0.01)
    assert (shank["split"] is None) is (kind != "capsule")  # a cylinder and two balls


@pytest.mark.parametrize("kind", [*WIDE, "hull"])
def test_a_shape_that_is_too_small_is_kept_to_and_felt(tmp_path: Path, kind: str) -> None:
    """Far below the shank: its mass is moved into it, and the torque tells."""
    low = {"center": [0, 0, -0.6], "rpy": [0.1, 0.2, 0.3]}
    if kind == "hull":
        trimesh.creation.box(extents=[0.1, 0.1, 0.1]).apply_translation(low["center"]).export(tmp_path / "low.stl")
        shape: dict[str, Any] = {"kind": "hull", "file": str(tmp_path / "low.stl")}
        low["rpy"] = [0, 0, 0]
    else:
        shape = {**WIDE[kind], **low, **({"size": [0.1] * 3} if kind == "box" else {"radius": 0.05, "length": 0.1})}
    ellipsoids = {link: e for link, e in LEG_YAML["bounding_ellipsoids"].items() if link != "shank_link"}
    changes = {"bounding_ellipsoids": ellipsoids, "bounding_shapes": {"shank_link": [shape]}}
    report, plain = leg_with(tmp_path, **changes), leg_with(tmp_path)
    shank = report["bodies"]["shank_link"]
    (found,) = shank["shapes"]
    solid = known_shapes()[kind].from_dict(found)
    assert solid.contains(shank["com"], tolerance=1e-6)
    assert not solid.contains(plain["bodies"]["shank_link"]["com"])
    assert report["rms"]["train"]["overall"] > 1.05 * plain["rms"]["train"]["overall"]
    assert (shank["realizable"], shank["violations"]) == (True, [])
    spread = np.array(shank["deviation_ellipsoid"]["semi_axes"])
    assert np.sqrt(np.sum(spread**2)) < 0.15


def test_a_fit_in_a_hull_fulfils_its_conditions(tmp_path: Path) -> None:
    report = leg_with(tmp_path, bounding_shapes={"thigh_link": [{"kind": "hull"}]}, bounding_ellipsoids=None)
    thigh = report["bodies"]["thigh_link"]
    assert (thigh["constraints"], thigh["realizable"]) == ("shape", True)
    assert abs(report["solver"]["duality_gap"]) < 1e-6
    (hull,) = (known_shapes()["hull"].from_dict(shape) for shape in thigh["shapes"])
    assert np.ptp(hull.grid(8), axis=0) == pytest.approx([0.06, 0.06, 0.342])
    assert hull.contains(thigh["com"])
    assert check_realizability(bounded_body(hull), np.array(thigh["pi"])).violations == ()
    assert thigh["witness"] is None


def test_a_union_of_an_ellipsoid_and_a_box_is_split(tmp_path: Path) -> None:
    box = {"kind": "box", "center": [0, 0, -0.4], "size": [0.05, 0.05, 0.05]}
    shank = leg_with(tmp_path, bounding_shapes={"shank_link": [box]})["bodies"]["shank_link"]
    assert len(shank["split"]) == 2
    parts = np.array([part["pi"] for part in shank["split"]])
    np.testing.assert_allclose(parts.sum(axis=0), shank["pi"], rtol=1e-9, atol=1e-12)
    assert all(part["mass"] == part["pi"][0] >= 0 for part in shank["split"])
    center = parts[1, 1:4] / parts[1, 0]
    assert (np.abs(center - box["center"]) <= 0.025 * (1 + 1e-6)).all()


REFUSALS: dict[str, tuple[Any, str]] = {
    "an unknown link": (
        {"shank": [KINDS["box"]]},
        "bounding_shapes: shank: is not a link of the URDF; did you mean shank_link?",
    ),
    "a rotor": ({"hip_rotor": [KINDS["box"]]}, "bounding_shapes: hip_rotor: is not a link of the URDF"),
    "an unknown kind": (
        {"shank_link": [{"kind": "cone", "radius": 1}]},
        "bounding_shapes.shank_link.0: needs a kind that is one of box, cylinder, capsule, hull, not cone",
    ),
    "no kind": ({"shank_link": [{"radius": 1}]}, "bounding_shapes.shank_link.0: needs a kind"),
    "a shape that is no list": ({"shank_link": KINDS["box"]}, "bounding_shapes.shank_link"),
    "another kind's key": (
        {"shank_link": [{**KINDS["box"], "radius": 1}]},
        "unknown key 'radius': it is a key of another kind",
    ),
    "a box of two sides": ({"shank_link": [{"kind": "box", "size": [1, 1]}]}, "bounding_shapes.shank_link.0"),
    "a side of nothing": ({"shank_link": [{"kind": "box", "size": [1, 1, 0]}]}, "bounding_shapes.shank_link.0"),
    "a radius below nothing": (
        {"shank_link": [{"kind": "capsule", "radius": -1, "length": 1}]},
        "bounding_shapes.shank_link.0",
    ),
    "no length": ({"shank_link": [{"kind": "cylinder", "radius": 1}]}, "bounding_shapes.shank_link.0"),
    "a place that is not finite": (
        {"shank_link": [{"kind": "box", "size": [1, 1, 1], "center": [0, 0, float("nan")]}]},
        "bounding_shapes.shank_link.0",
    ),
    "a mesh that is not there": ({"shank_link": [{"kind": "hull", "file": "no.stl"}]}, "no.stl"),
    "a mesh that is none": ({"shank_link": [{"kind": "hull", "file": "words.stl"}]}, "words.stl"),
    "a mesh of another kind": ({"shank_link": [{"kind": "hull", "file": "leg.py"}]}, "leg.py"),
    "a link without geometry": ({"foot": [{"kind": "hull"}]}, "foot"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_what_cannot_be_used_is_one_line(tmp_path: Path, case: str) -> None:
    shapes, naming = REFUSALS[case]
    (tmp_path / "log.csv").write_text(csv_text(sample_table(1200)))
    (tmp_path / "leg.urdf").write_text(LEG.read_text())
    (tmp_path / "leg.py").write_text("import os")
    (tmp_path / "words.stl").write_text("a word or two")
    (tmp_path / "bad.yaml").write_text(yaml.safe_dump({**copy.deepcopy(LEG_YAML), "bounding_shapes": shapes}))
    refuse(tmp_path, "fit", "leg.urdf", "log.csv", "--config", "bad.yaml", "--out", "out", naming=naming)


PLANES = {"xy": (1, 1, -1), "xz": (1, -1, 1), "yz": (-1, 1, 1), "": (1, 1, 1), "two": (-1, -1, 1)}


@given(seeds, kinds, st.sampled_from(sorted(PLANES)))
def test_a_bodys_bounds_as_anothers_are_their_image(rng: np.random.Generator, kind: str, plane: str) -> None:
    signs = np.array(PLANES[plane], dtype=float)
    shape, ellipsoid = random_shape(rng, kind), random_ellipsoid(rng)
    ours = bounded_body(random_ellipsoid(rng)).with_mirrored_bounds(bounded_body(shape, ellipsoid), signs)
    assert (len(ours.shapes), len(ours.ellipsoids)) == (1, 1)
    near = np.concatenate([inside(rng, shape, 200, reach) for reach in (1.3, 0.9)])
    points = near[shape.contains(near, 1e-7) == shape.contains(near, -1e-7)]  # none whose place rounding decides
    np.testing.assert_array_equal(ours.shapes[0].contains(points * signs), shape.contains(points))
    places = ellipsoid.center + 1.5 * max(ellipsoid.semi_axes) * rng.uniform(-1, 1, (200, 3))
    np.testing.assert_array_equal(ours.ellipsoids[0].contains(places * signs), ellipsoid.contains(places))
    assert ours.shapes[0].volume == pytest.approx(shape.volume, rel=1e-9)
    assert ours.name == "body"


@given(seeds, kinds)
def test_what_a_body_may_be_its_image_may(rng: np.random.Generator, kind: str) -> None:
    """And what it may not, not."""
    signs = np.array([1.0, -1.0, 1.0])
    shape = random_shape(rng, kind)
    first = bounded_body(shape)
    second = first.with_mirrored_bounds(first, signs)
    for reach in (0.7, 2.5):
        places = inside(rng, shape, 30, reach)
        if kind == "hull" and reach > 1:
            places = places + 3 * np.ptp(places, axis=0)
        pi = point_parameters(rng.uniform(0.1, 1, 30), places)
        verdicts = check_realizability(first, pi), check_realizability(second, parameter_reflection(signs) @ pi)
        assert [bool(v.violations) for v in verdicts] == [reach > 1] * 2


def test_a_mirrored_leg_is_bounded_by_mirrored_shapes(robot_of: Robots, rng: np.random.Generator) -> None:
    """Whatever the copy's own bounds were; found through the configuration."""
    place = {"center": [0.05, 0.1, -0.15], "rpy": [0.3, 0.5, -0.2]}
    shapes = [
        {"kind": "box", "size": [0.1, 0.2, 0.3], **place},
        {"kind": "capsule", "radius": 0.1, "length": 0.2, **place},
    ]
    mirror = [{"body": f"FR_link{i}", "of": f"FL_link{i}", "plane": COPIES["FR"][1]} for i in (1, 2)]
    own = {"FL_link1": shapes, "FR_link1": [{"kind": "cylinder", "radius": 1, "length": 1}]}
    s = legs(robot_of, ("FL", "FR"), mirror=mirror, bounding_shapes=own)
    model = with_equal_bounds(s.model, s.equalities)
    first, second = body(model, "FL_link1"), body(model, "FR_link1")
    assert [shape.kind for shape in second.shapes] == ["box", "capsule"]
    points = np.array(place["center"]) + rng.uniform(-0.4, 0.4, (2000, 3))
    signs = np.array(LEGS["FR"])
    for original, mirrored_one in zip(first.bounds, second.bounds, strict=True):
        inside_it = original.contains(points)
        assert 20 < np.count_nonzero(inside_it) < 1980
        np.testing.assert_array_equal(mirrored_one.contains(points * signs), inside_it)
    ours = fit_legs(replace(s, model=model), s.noisy(1.0), kind="shape")
    left, right = (ours.theta[of_body(s, f"{leg}_link1")] for leg in ("FL", "FR"))
    np.testing.assert_allclose(right, image(left, LEGS["FR"]), rtol=1e-12, atol=1e-15)
    parts = ours.pieces[[b.name for b in model.bodies].index("FR_link1")]
    assert check_realizability(second, right, parts).violations == ()
    assert check_realizability(first, left).violations == ()


def test_a_shape_in_a_turned_frame_is_the_same_solid(rng: np.random.Generator) -> None:
    for kind in KINDS:
        R, p = rotation(rng), rng.normal(size=3)
        config = parse_config({"bounding_shapes": {"a": [KINDS[kind]]}}, "")
        (bound,) = config.bounding_shapes["a"]
        shape = known_shapes()[kind].from_dict(bound.model_dump())
        points = around(rng)
        np.testing.assert_array_equal(shape.transformed(R, p).contains(points @ R.T + p), is_inside(kind, points))
