"""A floating base: its body, its coordinates, and what it requires of a configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground.quadruped import JOINTS, true_quadruped
from ground.robot import prior_robot
from standing_quadruped import PinocchioQuadruped, quadruped_model, random_state

from idtool.common.exceptions import ConfigError
from idtool.dynamics.effects.rigid_body import RigidBodies
from idtool.dynamics.regressor import LinearModel
from idtool.dynamics.regrouping import regrouped
from idtool.robot.inertia import PI_SIZE
from idtool.robot.inverse_dynamics import inverse_dynamics
from idtool.robot.kinematics import body_placements
from idtool.robot.model import BASE_COORDINATES

ROBOT = true_quadruped(0)


def test_base_is_a_body_with_six_coordinates_after_the_joints(tmp_path: Path) -> None:
    model, _ = quadruped_model(tmp_path, ROBOT)
    assert model.has_floating_base
    assert (model.joint_names, model.names) == (JOINTS, (*JOINTS, *BASE_COORDINATES))
    assert model.bodies[0].name == "trunk"
    assert model.bodies[0].pi[0] == pytest.approx(ROBOT.links["trunk"].mass)
    assert model.support()[:, 12:].all()  # the base moves everything
    assert [model.units[name] for name in BASE_COORDINATES] == 3 * ["N"] + 3 * ["N·m"]
    assert sum(body.pi[0] for body in model.bodies) == pytest.approx(sum(b.mass for b in ROBOT.links.values()))
    R, p = body_placements(model, np.zeros((18, 1)))[0]
    np.testing.assert_array_equal(R[0], np.eye(3))
    np.testing.assert_array_equal(p[0], 0)


def test_torque_is_that_of_pinocchio(tmp_path: Path, rng: np.random.Generator) -> None:
    """Of any orientation and velocity: a uniform motion of the whole robot takes no force."""
    model, _ = quadruped_model(tmp_path, prior_robot(ROBOT, 0))
    reference = PinocchioQuadruped(tmp_path / "quadruped.urdf")
    motion = random_state(rng)
    expected = np.stack([reference.torque(motion, k) for k in range(5)], axis=1)
    pi = np.stack([body.pi for body in model.bodies])
    np.testing.assert_allclose(inverse_dynamics(model, pi, motion.q, motion.v, motion.a), expected, atol=1e-10)

    bodies = RigidBodies(model)
    columns = [np.empty((len(active), 5)) for active in bodies.active]
    bodies.columns(motion, columns)
    by_columns = [pi.ravel()[active] @ own for active, own in zip(bodies.active, columns, strict=True)]
    np.testing.assert_allclose(by_columns, expected, atol=1e-10)
    assert len(bodies.active[12]) == PI_SIZE * len(model.bodies)

    equation = LinearModel(model.names, (bodies,))
    kept = regrouped(equation)
    by_regrouped = kept.equation.torque(motion, kept.regrouped_values(pi.ravel()))
    np.testing.assert_allclose(by_regrouped, expected, atol=1e-10)
    for i, (columns_kept, all_columns) in enumerate(
        zip(kept.equation.columns(motion), equation.columns(motion), strict=True)
    ):
        np.testing.assert_allclose(kept.all_columns(i, columns_kept.T).T, all_columns, atol=1e-10)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"base": {"kind": "flying"}}, "base.kind"),
        ({"base": {"kind": "floating", "link": "torso"}}, "base.link: torso"),
        ({"base": {"kind": "floating", "imu": {"link": "FL_foot"}}}, "moves against the root link trunk"),
        ({"base": {"kind": "fixed"}}, "trunk: is moved by no joint"),
        ({"contacts": [{"name": "a", "link": "paw"}]}, "is not a link of the URDF"),
        ({"contacts": [{"name": "a", "link": "FL_foot"}] * 2}, "a is listed twice"),
        ({"contacts": [{"name": "a", "link": "FL_foot", "moment": ["x", "y", "z"]}]}, "has a moment and no force"),
        (
            {"contacts": [{"name": "a", "link": "FL_foot", "force": ["x"] * 3, "moment": ["x"] * 3}]},
            "which takes no moment",
        ),
        (
            {"contacts": [{"name": "a", "link": "FL_foot", "kind": "surface", "force": ["x"] * 3}]},
            "whose moment is needed too",
        ),
    ],
)
def test_configuration_that_cannot_be_used_is_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        quadruped_model(tmp_path, ROBOT, **change)
