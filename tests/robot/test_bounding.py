"""Bounding ellipsoids of a URDF's links."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
import trimesh
from robots import random_urdf

from idtool.robot.bounding import bounding_ellipsoids, ellipsoids_config
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import Robot

Read = Callable[[str | bytes], Robot]

MASS = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'


def urdf(*links: tuple[str, str, str]) -> str:
    """Links in a chain: name, inertial, and what stands for its <collision>."""
    text = "".join(
        f'<link name="{name}">{inertial}<collision><geometry>{geometry}</geometry></collision></link>'
        if geometry
        else f'<link name="{name}">{inertial}</link>'
        for name, inertial, geometry in links
    )
    names = [name for name, _, _ in links]
    joints = "".join(
        f'<joint name="j{child}" type="fixed"><parent link="{parent}"/><child link="{child}"/></joint>'
        for parent, child in pairwise(names)
    )
    return f'<robot name="r">{text}{joints}</robot>'


def test_a_box_s_ellipsoid_is_root_three_times_its_half_sides_and_the_margin(robot_of: Read) -> None:
    robot = robot_of(urdf(("a", MASS, '<box size="0.2 0.4 0.6"/>')))
    for margin in (0.0, 0.05, 0.2):
        ellipsoids, reasons = bounding_ellipsoids(robot, margin)
        expected = (1 + margin) * np.sqrt(3) * np.array([0.1, 0.2, 0.3])
        np.testing.assert_allclose(np.sort(ellipsoids["a"].semi_axes), expected, rtol=1e-3)
        assert reasons == {}
    half = np.array(list(product((-0.1, 0.1), (-0.2, 0.2), (-0.3, 0.3))))
    assert bounding_ellipsoids(robot, 0.0)[0]["a"].contains(half).all()


@pytest.mark.parametrize("geometry", ['<sphere radius="0.3"/>', '<mesh filename="m.stl"/>'])
def test_a_ball_s_ellipsoid_is_the_ball(geometry: str, robot_of: Read, tmp_path: Path) -> None:
    trimesh.creation.icosphere(subdivisions=3, radius=0.3).export(tmp_path / "m.stl")
    ellipsoids, _ = bounding_ellipsoids(robot_of(urdf(("a", MASS, geometry))), 0.0)
    np.testing.assert_allclose(ellipsoids["a"].semi_axes, [0.3] * 3, rtol=0.012)
    np.testing.assert_allclose(ellipsoids["a"].center, [0, 0, 0], atol=1e-3)


def test_links_without_mass_are_left_out_and_those_without_geometry_said(robot_of: Read) -> None:
    ellipsoids, reasons = bounding_ellipsoids(
        robot_of(
            urdf(
                ("whole", MASS, '<box size="1 1 1"/>'),
                ("massless", "", '<box size="1 1 1"/>'),
                ("bare", MASS, ""),
                ("lost", MASS, '<mesh filename="package://p/lost.stl"/>'),
            )
        )
    )
    assert list(ellipsoids) == ["whole"]
    assert list(reasons) == ["bare", "lost"]
    assert reasons["bare"] == "the link has no collision or visual geometry in the URDF"
    assert reasons["lost"].startswith("line 1: mesh package://p/lost.stl is not found")


def test_a_link_of_which_a_part_is_lost_gets_no_ellipsoid_that_is_too_small(robot_of: Read) -> None:
    part = '<collision><geometry><mesh filename="lost.stl"/></geometry></collision>'
    text = urdf(("a", MASS, '<box size="1 1 1"/>')).replace("</link>", part + "</link>")
    ellipsoids, reasons = bounding_ellipsoids(robot_of(text))
    assert ellipsoids == {}
    assert "lost.stl is not found" in reasons["a"]


def test_the_configuration_takes_them_as_they_are(robot_of: Read) -> None:
    ellipsoids, _ = bounding_ellipsoids(robot_of(urdf(("a", MASS, '<cylinder radius="0.1" length="0.4"/>'))))
    config = parse_config({"bounding_ellipsoids": ellipsoids_config(ellipsoids)}, "robot.yaml")
    assert [bound.to_ellipsoid() for bound in config.bounding_ellipsoids["a"]] == [ellipsoids["a"]]


def test_a_robot_without_any_geometry_is_said_why(robot_of: Read, rng: np.random.Generator) -> None:
    robot = robot_of(random_urdf(rng))
    ellipsoids, reasons = bounding_ellipsoids(robot)
    assert ellipsoids == {}
    assert len(reasons) == sum(pi is not None for pi in robot.links.values())
