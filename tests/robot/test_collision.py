"""Self-collision: distances by hand and by Pinocchio, and which pairs are worth a look."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from numpy.typing import NDArray
from paths import REAL
from reference import Reference
from robots import actuated, joint, origin, random_urdf
from sentences import sentences
from touching import BOX, LOWER, SPHERE, UPPER, Build, arm, checked, place, solid, with_swinging_sphere

from idtool.common.exceptions import ModelError
from idtool.robot import collision
from idtool.robot.collision import SelfCollision
from idtool.robot.config import parse_config
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

GO2 = REAL / "go2" / "go2.urdf"


def test_two_spheres_on_a_hinge_by_the_law_of_cosines(build: Build, rng: np.random.Generator) -> None:
    """Whatever j1; folded, they penetrate by what the radii are more than the distance of the centres."""
    found = checked(build(arm(solid(SPHERE.format(0.15)), "", solid(SPHERE.format(0.1))), ["j1", "j2"]))
    q = np.stack([rng.uniform(-3, 3, 50), np.linspace(-np.pi, np.pi, 50)])
    centres = np.sqrt(UPPER**2 + LOWER**2 + 2 * UPPER * LOWER * np.cos(q[1]))
    assert found.pairs == (("base", "tip"),)
    assert found.clearance(q) == pytest.approx(centres - 0.25, abs=1e-5)
    assert found.clearance(q).min() == pytest.approx(-0.05, abs=1e-5)
    pair, distance, index = found.nearest(q[:, 10:40])
    assert (pair, index) == (("base", "tip"), int(np.argmin(centres[10:40])))
    assert distance == pytest.approx((centres - 0.25)[10:40].min(), abs=1e-5)


def test_two_boxes_on_a_slide(build: Build) -> None:
    """The base's ends at x = 0.1; the tip's is 0.04 wide along x, turned by a quarter from y, and 0.8 from the base."""
    tip = solid(BOX.format(0.3, 0.04, 0.1), rpy=f"0 0 {np.pi / 2}")
    found = checked(build(arm(solid(BOX.format(0.2, 0.4, 0.2)), "", tip, "prismatic"), ["j1", "j2"]))
    slide = np.array([0.3, 0.0, -0.5, -0.68, -0.7])
    q = np.stack([np.zeros(5), slide])
    assert found.clearance(q) == pytest.approx(0.8 + slide - 0.1 - 0.02, abs=1e-5)
    assert found.clearance(q)[-1] == pytest.approx(-0.02, abs=1e-5)


def planar(q: Array, lengths: Sequence[float]) -> Array:
    """Corners of a planar chain, shape (links + 1, 2)."""
    angle = np.cumsum(q)
    steps = np.array(lengths)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def apart(a: Array, b: Array, c: Array, d: Array) -> float:
    """Distance of the segments ab and cd in the plane."""

    def side(x: Array, y: Array, z: Array) -> float:
        return float(np.sign((y - x)[0] * (z - x)[1] - (y - x)[1] * (z - x)[0]))

    if side(a, b, c) != side(a, b, d) and side(c, d, a) != side(c, d, b):
        return 0.0

    def off(x: Array, y: Array, z: Array) -> float:
        share = np.clip((z - x) @ (y - x) / ((y - x) @ (y - x)), 0, 1)
        return float(np.linalg.norm(x + share * (y - x) - z))

    return min(off(a, b, c), off(a, b, d), off(c, d, a), off(c, d, b))


def test_a_planar_chain_that_folds_onto_itself(build: Build, rng: np.random.Generator) -> None:
    """Capsules of radius 0.03: the third link against the first, and all against a post beside the base."""
    lengths = (0.4, 0.25, 0.5)
    links = [solid(f'<capsule radius="0.03" length="{x}"/>', f"{x / 2} 0 0", f"0 {np.pi / 2} 0") for x in lengths]
    parts = ['<robot name="r"><link name="base">', solid(SPHERE.format(0.05), "-0.6 0 0"), "</link>"]
    parts += [f'<link name="link{i}">{link}</link>' for i, link in enumerate(links)]
    parts += [
        joint(f"j{i}", "continuous", f"link{i - 1}" if i else "base", f"link{i}", place(x))
        for i, x in enumerate((0.0, 0.4, 0.25))
    ]
    found = checked(build("".join([*parts, "</robot>"]), ["j0", "j1", "j2"]))
    assert set(found.pairs) == {("base", "link1"), ("base", "link2"), ("link0", "link2")}
    q = rng.uniform(-np.pi, np.pi, (3, 200))
    post = np.array([[-0.6, 0.0], [-0.6, 1e-9]])
    least = []
    for x in planar_all(q, lengths):
        least.append(min(apart(x[0], x[1], x[2], x[3]) - 0.06, *(apart(*post, x[i], x[i + 1]) - 0.08 for i in (1, 2))))
    crossing = np.array(least) < -0.0599  # deeper than the capsules' axes: no depth by hand
    clearance = found.clearance(q)
    assert 5 < crossing.sum() < 100
    assert clearance[~crossing] == pytest.approx(np.array(least)[~crossing], abs=1e-5)
    assert (clearance[crossing] < -0.0599).all()
    square = np.array([[0.3], [np.pi / 2], [np.pi / 2]])
    assert found.nearest(square)[:2] == (("link0", "link2"), pytest.approx(0.25 - 0.06, abs=1e-5))


def planar_all(q: Array, lengths: Sequence[float]) -> list[Array]:
    return [planar(x, lengths) for x in q.T]


def with_solids(text: str, rng: np.random.Generator) -> str:
    """A box, a cylinder or a sphere in every link, at any place."""
    for i in range(text.count("<link ")):
        small, middle, large = rng.uniform(0.05, 0.15, 3)
        shape = (
            f'<box size="{small} {middle} {large}"/>',
            f'<cylinder radius="{small}" length="{3 * large}"/>',
            f'<sphere radius="{middle}"/>',
        )[i % 3]
        element = f"<collision>{origin(rng)}<geometry>{shape}</geometry></collision>"
        text = text.replace(f'<link name="link{i}">', f'<link name="link{i}">{element}')
    return text


@pytest.mark.parametrize("seed", range(6))
def test_random_trees_against_pinocchio(build: Build, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The frames of all links, the choice of the nearest pair, and its distance; in more than one block."""
    monkeypatch.setattr(collision, "_BLOCK", 300)
    rng = np.random.default_rng(seed)
    text = with_solids(random_urdf(rng, 9, kinds=("revolute", "prismatic", "fixed")), rng)
    model = build(text, [f"joint{i}" for i in range(1, 10)])
    found = checked(model)
    tree = Reference(text, model.names, {"gravity": [0, 0, -9.81]})
    geometry = pin.buildGeomFromUrdfString(tree.tree, text, pin.COLLISION)
    of = {tree.tree.frames[x.parentFrame].name: i for i, x in enumerate(geometry.geometryObjects)}
    for a, b in found.pairs:
        geometry.addCollisionPair(pin.CollisionPair(of[a], of[b]))
    data, places = tree.tree.createData(), geometry.createData()
    reach = np.array([0.2 if x.kind == "prismatic" else 3.0 for x in model.joints])
    q = reach[:, None] * rng.uniform(-1, 1, (len(model.joints), 100))
    expected = np.empty((len(found.pairs), 100))
    for n in range(100):
        pin.computeDistances(tree.tree, data, geometry, places, tree.G @ q[:, n] + tree.offset)
        expected[:, n] = [result.min_distance for result in places.distanceResults]
    assert expected.min() < 0 < expected.min(axis=0).max()
    assert found.clearance(q) == pytest.approx(expected.min(axis=0), abs=1e-5)
    pair, distance, index = found.nearest(q)
    assert (found.pairs.index(pair), index) == np.unravel_index(expected.argmin(), expected.shape)
    assert distance == pytest.approx(expected.min(), abs=1e-5)


MOTOR = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'


def test_what_is_not_checked(build: Build) -> None:
    """Links of one body, neighbours, rotors, and what is made to touch: there the upper arm's far end and the tip."""
    small = solid(SPHERE.format(0.05))
    extra = f'<link name="motor">{MOTOR}{small}</link>' + joint("mount", "fixed", "upper", "motor", place(0.1, 0.2))
    extra += f'<link name="box"/><link name="lid">{small}</link>'
    extra += joint("j8", "fixed", "upper", "box", place(0, 1)) + joint("j9", "fixed", "box", "lid", place(0, 1))
    text = arm(small, solid(SPHERE.format(0.4), "0.4 0 0"), small, extra=extra)
    text = text.replace('<link name="elbow"/>', f'<link name="elbow">{small}</link>')
    plain, lid = checked(build(text, ["j1", "j2"])), {("base", "lid"), ("elbow", "lid"), ("tip", "lid")}
    moving = {("base", "elbow"), ("base", "tip")}
    assert set(plain.pairs) == {*moving, *lid, ("base", "motor"), ("elbow", "motor"), ("tip", "motor")}
    message = "links that touch in all poses are not checked for collision: upper and tip"
    assert sentences(plain.notices) == (message,)
    rotor = {"motor": {"joint": "j2", "gear_ratio": 5.0}}
    assert set(checked(build(text, ["j1", "j2"], rotors=rotor)).pairs) == moving | lid


def test_links_that_touch_almost_anywhere_are_made_to(build: Build) -> None:
    """The tip, 0.8 m from the base's origin at j2 = 0, leaves a ball around x = -0.8 only where the arm is straight."""
    text = arm(solid(SPHERE.format(1.4), "-0.8 0 0"), "", solid(SPHERE.format(0.05)))
    assert SelfCollision.from_model(build(text, ["j1", "j2"])) is None
    seldom = text.replace('radius="1.4"', 'radius="0.4"')
    assert checked(build(seldom, ["j1", "j2"])).clearance(np.zeros((2, 1))) == pytest.approx([1.15], abs=1e-5)


def test_links_that_touch_at_zero_alone_are_made_to(build: Build) -> None:
    """And where zero is beyond the limits, at the nearest position within them."""
    x, y = planar(np.array([0.0, 1.0]), (UPPER, LOWER))[-1]
    bent = arm(solid(SPHERE.format(0.05), f"{x} {y} 0"), "", solid(SPHERE.format(0.05)))
    assert checked(build(bent, ["j1", "j2"])).pairs == (("base", "tip"),)
    bent = bent.replace('lower="-3" upper="3"', 'lower="1" upper="3"')
    bent = bent.replace('lower="1" upper="3"', 'lower="-3" upper="3"', 1)  # of j1
    assert SelfCollision.from_model(build(bent, ["j1", "j2"])) is None


def test_nothing_to_check(build: Build) -> None:
    """Neighbours, links of one body, one link, none."""
    small = solid(SPHERE.format(0.05))
    for text in (arm(small, small, ""), arm("", small, ""), arm("", "", "")):
        assert SelfCollision.from_model(build(text, ["j1", "j2"])) is None


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_joint_held_still_is_where_the_configuration_says(build: Build, kind: str) -> None:
    """On the root, where nothing moves with it, too."""
    text = arm(solid(SPHERE.format(0.05)), "", solid(SPHERE.format(0.05)), kind)
    still = {"j2": 0.4}
    away = np.sqrt(UPPER**2 + LOWER**2 + 2 * UPPER * LOWER * np.cos(0.4)) if kind == "revolute" else 1.2
    model = build(text, ["j1"], locked_joints=still)
    assert checked(model, still).clearance(np.zeros((1, 3))) == pytest.approx(np.full(3, away - 0.1), abs=1e-5)
    straight = checked(build(text, ["j1"])).clearance(np.zeros((1, 1)))
    assert straight == pytest.approx([0.7], abs=1e-5)
    model = build(with_swinging_sphere(arm("", "", solid(SPHERE.format(0.05)), kind)), ["j4"], locked_joints=still)
    tip = planar(np.array([0.0, 0.4]), (UPPER, LOWER))[-1] if kind == "revolute" else np.array([1.2, 0])
    apart = np.linalg.norm(tip - [np.cos(1.5), 3 - np.sin(1.5)]) - 0.1
    pair, distance, _ = checked(model, still).nearest(np.array([[-1.5]]))
    assert (set(pair), distance) == ({"tip", "end"}, pytest.approx(apart, abs=1e-5))


def test_a_held_joint_holds_those_that_follow_it(build: Build) -> None:
    text, follows = arm("", "", solid(SPHERE.format(0.05))), '<mimic joint="j1" multiplier="2" offset="0.1"/>'
    still = {"j1": 0.3}
    model = build(with_swinging_sphere(text.replace(place(UPPER), place(UPPER) + follows)), ["j4"], locked_joints=still)
    tip = planar(np.array([0.3, 0.7]), (UPPER, LOWER))[-1]
    apart = np.linalg.norm(tip - [1, 3]) - 0.1
    assert checked(model, still).clearance(np.zeros((1, 1))) == pytest.approx([apart], abs=1e-5)


def test_a_robot_of_too_many_parts_is_refused(build: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    small = solid(SPHERE.format(0.05))
    model = build(arm(small, "", small), ["j1", "j2"])
    for name in ("_MAX_PAIRS", "_MAX_LINKS"):
        with monkeypatch.context() as few:
            few.setattr(collision, name, 0)
            with pytest.raises(ModelError, match=r"robot\.urdf: has "):
                SelfCollision.from_model(model)


@pytest.mark.skipif(not GO2.is_file(), reason=f"the real robot is not in {GO2.parent}")
def test_go2s_legs_meet_when_its_hips_turn_in() -> None:
    """Standing, no leg is near another; with the hips turned in, those of a side meet."""
    robot = read_robot(GO2)
    model = build_model(robot, parse_config({}, "go2.yaml"), actuated(robot))
    found = checked(model)
    assert ("FL_calf", "FR_calf") in found.pairs
    assert not {frozenset(("FL_thigh", "FL_calf")), frozenset(("FL_calf", "FL_foot"))} & set(
        map(frozenset, found.pairs)
    )
    assert any(
        "FL_hip, FR_hip" in warning and "hip.dae is not found" in warning for warning in sentences(found.notices)
    )
    standing = np.tile([0.0, 0.8, -1.6], 4)[:, None]
    assert found.clearance(standing)[0] > 0.005
    closing = np.zeros((12, 50))
    closing[1::3], closing[2::3] = 0.8, -1.6
    for leg, side in enumerate(name[1] for name in model.names[::3]):
        closing[3 * leg] = np.linspace(0, 1.0, 50) * (-1 if side == "L" else 1)
    pair, distance, index = found.nearest(closing)
    assert distance < 0
    assert index > 25
    assert {name[1] for name in pair} == {"L", "R"}
