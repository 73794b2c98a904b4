"""Which of a URDF's links no body can have, and the nearest URDF: MuJoCo, which refuses such bodies, as the judge."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from paths import REAL
from robots import joint, random_urdf, rotation
from synthetic import point_parameters
from triangles import triangle_margin
from unreal_links import LINKS, WRONG, compiles, links_urdf, without_inertial

from idtool.common.exceptions import ConfigError
from idtool.common.provenance import InputFile
from idtool.estimation.problem.link_check import check_links, nearest_bodies, repaired
from idtool.robot.config import Config, parse_config
from idtool.robot.inertia import from_mass_com_inertia, mass_com_inertia, pseudo_inertia
from idtool.robot.urdf.reading import Robot, read_robot

Array = NDArray[np.float64]
Read = Callable[[str | bytes], Robot]


def found(robot: Robot, **config: object) -> dict[str, tuple[str, ...]]:
    return {c.body.name: c.violations for c in check_links(robot, parse_config(config, "robot.yaml"))}


def test_every_link_with_an_inertial_is_judged(robot_of: Read) -> None:
    robot = robot_of(links_urdf(LINKS))
    violations = found(robot)
    assert list(violations) == list(LINKS)
    for name, (*_, said) in LINKS.items():
        assert violations[name] == ((said,) if said else ())


def test_links_without_an_inertial_or_mass_are_left_out(robot_of: Read) -> None:
    zero = '<inertial><mass value="0"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>'
    robot = robot_of(
        f'<robot name="r"><link name="a"/><link name="b">{zero}</link>{joint("j", "fixed", "a", "b")}</robot>'
    )
    assert found(robot) == {}


def test_random_bodies_that_can_exist_are_not_complained_of(robot_of: Read) -> None:
    for seed in range(10):
        robot = robot_of(random_urdf(np.random.default_rng(seed)))
        assert not any(found(robot).values())
        assert nearest_bodies(check_links(robot, Config())) == {}
        assert repaired(robot, {}) == robot.text


def test_a_link_outside_its_ellipsoid_is_told_by_how_much(robot_of: Read) -> None:
    robot = robot_of(links_urdf({"sound"}, turned=False))
    wide, narrow = ({"sound": [{"center": [0, 0.1, 0], "semi_axes": [a, a, a]}]} for a in (0.3, 0.08))
    assert found(robot, bounding_ellipsoids=wide) == {"sound": ()}
    (said,) = found(robot, bounding_ellipsoids=narrow)["sound"]
    spread = np.sqrt(0.5 * (0.012 + 0.016 + 0.02) / 1.5)  # rms distance of the mass from its centre
    farther = re.search(r"at least ([\d.]+) % farther", said)
    assert farther
    assert float(farther[1]) == pytest.approx(100 * (spread / 0.08 - 1), rel=1e-2)


def test_bounds_of_every_kind_are_heeded(robot_of: Read) -> None:
    """A union holds what neither of its ellipsoids does, and a box with the same middle is too small or not."""
    mass = np.full(8, 0.1)
    places = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.05, 0.05) for z in (-0.05, 0.05)])
    places += np.array([0.0, 0.02, 0.0]) * np.arange(8)[:, None] / 8
    m, com, inertia = mass_com_inertia(point_parameters(mass, places))
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.tolist()
    text = (
        f'<robot name="r"><link name="a"><inertial><origin xyz="{com[0]} {com[1]} {com[2]}"/><mass value="{m}"/>'
        f'<inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/></inertial></link></robot>'
    )
    robot = robot_of(text)
    ends = [{"center": [x, 0, 0], "semi_axes": [0.15, 0.15, 0.15]} for x in (-0.5, 0.5)]
    boxes = [[{"kind": "box", "size": [x, 0.2, 0.2]}] for x in (1.2, 0.8)]
    assert found(robot, bounding_ellipsoids={"a": ends}) == {"a": ()}
    assert found(robot, bounding_ellipsoids={"a": ends[:1]})["a"]
    assert found(robot, bounding_shapes={"a": boxes[0]}) == {"a": ()}
    assert found(robot, bounding_shapes={"a": boxes[1]})["a"]


@pytest.mark.parametrize("key", ["bounding_ellipsoids", "bounding_shapes"])
def test_bounds_of_a_link_that_is_not_there_are_an_error(robot_of: Read, key: str) -> None:
    bound = {"semi_axes": [1, 1, 1]} if key == "bounding_ellipsoids" else {"kind": "box", "size": [1, 1, 1]}
    with pytest.raises(ConfigError) as caught:
        found(robot_of(links_urdf(LINKS)), **{key: {"sond": [bound]}})
    assert str(caught.value) == f"{key}: sond: is not a link of the URDF; did you mean sound?"


def repair(robot: Robot, **config: object) -> bytes:
    return repaired(robot, nearest_bodies(check_links(robot, parse_config(config, "robot.yaml"))))


def test_only_what_cannot_be_is_written_anew(robot_of: Read) -> None:
    before = robot_of(links_urdf(LINKS)).text
    after = repair(robot_of(links_urdf(LINKS)))
    assert after != before
    for link in WRONG:
        assert without_inertial(after, link) != after
        before, after = without_inertial(before, link), without_inertial(after, link)
    assert after == before


@pytest.mark.parametrize("name", LINKS)
def test_mujoco_refuses_what_is_broken_and_takes_what_is_repaired(robot_of: Read, name: str) -> None:
    """But for the plate, of whose moments it allows for no rounding."""
    text = links_urdf({name}, turned=name != "plate")
    assert compiles(text) is (name not in WRONG)
    assert compiles(repair(robot_of(text)))


def test_the_repaired_urdf_passes_the_check(robot_of: Read) -> None:
    after = robot_of(repair(robot_of(links_urdf(LINKS))))
    assert set(found(after).values()) == {()}
    assert repair(after) == after.text


@pytest.mark.parametrize("name", ["broken", "just", "inside_out"])
def test_mass_and_centre_stay_where_only_the_moments_are_wrong(robot_of: Read, name: str) -> None:
    robot = robot_of(links_urdf({name}))
    before, after = robot.links[name], robot_of(repair(robot)).links[name]
    assert before is not None
    assert after is not None
    mass, com, inertia = mass_com_inertia(after)
    np.testing.assert_allclose([mass, *com], [before[0], *(before[1:4] / before[0])], rtol=1e-12, atol=1e-12)
    assert 0 < triangle_margin(after) < 1e-4 * np.trace(inertia)
    old_axes, new_axes = (np.linalg.eigh(mass_com_inertia(pi)[2])[1] for pi in (before, after))
    if name == "broken":  # three moments apart
        np.testing.assert_allclose(np.abs(np.sum(old_axes * new_axes, axis=0)), 1, rtol=1e-6)


seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@given(seeds, st.floats(1e-3, 0.9))
def test_the_moments_move_least_in_the_pullback_metric(rng: np.random.Generator, share: float) -> None:
    """The eigenvalue of Sigma_C that is negative becomes next to nothing, and the others stay."""
    axes, spread = rotation(rng), np.sort(rng.uniform(0.01, 0.1, 3) ** 2)
    sigma = axes @ np.diag([-share * spread[0], *spread[1:]]) @ axes.T
    pi = from_mass_com_inertia(1.2, rng.normal(size=3), 1.2 * (np.trace(sigma) * np.eye(3) - sigma))
    robot = Robot(Path("r.urdf"), b"", "a", {"a": pi}, {}, InputFile("URDF", "r.urdf", None))
    nearest = nearest_bodies(check_links(robot, Config()))["a"]
    inertia = mass_com_inertia(nearest)[2]
    mu = np.linalg.eigvalsh(0.5 * np.trace(inertia) * np.eye(3) - inertia) / 1.2
    np.testing.assert_allclose(mu[1:], spread[1:], rtol=1e-5)
    assert 0 < mu[0] < 1e-5 * spread[2]


def test_a_repaired_link_is_within_its_bounds(robot_of: Read) -> None:
    bounds = {"broken": [{"center": [0, 0, 0.3], "semi_axes": [0.05, 0.06, 0.07]}]}
    after = repair(robot_of(links_urdf({"broken"})), bounding_ellipsoids=bounds)
    assert found(robot_of(after), bounding_ellipsoids=bounds) == {"broken": ()}
    pi = robot_of(after).links["broken"]
    assert pi is not None
    center = np.array([0, 0, 0.3])
    A = np.diag(np.array([0.05, 0.06, 0.07]) ** -2.0)
    Q = np.block([[-A, (A @ center)[:, None]], [(center @ A)[None], np.array([[1 - center @ A @ center]])]])
    assert np.trace(pseudo_inertia(pi) @ Q) >= 0
    assert compiles(after)


@pytest.mark.parametrize("folder", ["go2", "panda"])
def test_real_robots(folder: str) -> None:
    path = REAL / folder / f"{folder}.urdf"
    if not path.exists():
        pytest.skip("the real robots' files are not here")
    robot = read_robot(path)
    violations = found(robot)
    assert len(violations) > 10
    expected = {link: triangle_margin(pi) < 0 for link, pi in robot.links.items() if pi is not None and pi.any()}
    assert {link: bool(said) for link, said in violations.items()} == expected
