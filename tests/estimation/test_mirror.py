"""Bodies and joints that are copies of others, on rows that Pinocchio made of legs in each other's image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from legs import LEGS, LENGTH, Robots, copies, fit, image, legs, no_constraints, of_body, of_joint, uncertainty_with
from numpy.typing import NDArray
from reference import Reference
from robots import body
from sentences import sentences
from synthetic import points_in

from idtool.estimation.dataset.equality_constraints import with_equal_bounds
from idtool.robot.inertia import PI_SIZE

Array = NDArray[np.float64]


@pytest.mark.parametrize("names", [("FL", "FR"), tuple(LEGS)], ids=["two legs", "four legs"])
def test_mirrored_legs_are_recovered_from_torque_without_noise(robot_of: Robots, names: tuple[str, ...]) -> None:
    s = legs(robot_of, names, mirror=copies(names))
    ours = fit(s, s.tau)
    np.testing.assert_allclose(s.Y @ ours.theta, s.tau, rtol=0, atol=1e-6 * np.abs(s.tau).max())
    seen = uncertainty_with(s, s.equalities).identifiable
    assert 0.3 < seen.mean() < 1
    np.testing.assert_allclose(ours.theta[seen], s.theta[seen], rtol=1e-3, atol=1e-5)


def test_a_copy_is_its_originals_image_whatever_the_data(robot_of: Robots) -> None:
    """From torque that is mostly noise; by way of another copy too, and with each one's pieces."""
    s = legs(robot_of, tuple(LEGS), mirror=copies(tuple(LEGS)))
    ours = fit(s, s.noisy(3.0))
    for i in range(1, LENGTH + 1):
        original = ours.theta[of_body(s, f"FL_link{i}")]
        for name, signs in LEGS.items():
            own = of_body(s, f"{name}_link{i}")
            np.testing.assert_allclose(ours.theta[own], image(original, signs), rtol=1e-12, atol=1e-15)
            np.testing.assert_allclose(ours.pieces[own.start // PI_SIZE].sum(axis=0), ours.theta[own], atol=1e-12)


def test_in_pinocchio_a_mirrored_leg_takes_the_same_torque(robot_of: Robots) -> None:
    """All legs in the same joint angles, under a gravity that lies in both planes."""
    names = tuple(LEGS)
    s = legs(robot_of, names, mirror=copies(names))
    theta = fit(s, s.noisy(1.0)).theta
    reference = Reference(s.model.robot.text.decode(), s.model.names, {"gravity": [0.0, 0.0, -9.81]})
    bodies = [b.name for b in s.model.bodies]
    q, v, a = np.random.default_rng(1).normal(size=(3, LENGTH))
    Y = reference.regressor(bodies, *(np.tile(x, len(names)) for x in (q, v, a)))
    torque = (Y @ theta[: PI_SIZE * len(bodies)]).reshape(len(names), LENGTH)
    assert np.abs(torque[0]).min() > 1e-3
    np.testing.assert_allclose(torque, np.tile(torque[0], (len(names), 1)), rtol=1e-9)


@pytest.mark.parametrize(("names", "ratio"), [(("FL", "FR"), np.sqrt(2)), (tuple(LEGS), 2.0)], ids=["two", "four"])
def test_n_legs_are_n_times_the_data(robot_of: Robots, names: tuple[str, ...], ratio: float) -> None:
    """Where all legs move alike, standard errors shrink by the root of their number."""
    s = legs(robot_of, names, alike=True, mirror=copies(names))
    alone, together = uncertainty_with(s, no_constraints(s)), uncertainty_with(s, s.equalities)
    np.testing.assert_array_equal(alone.identifiable, together.identifiable)
    shared = together.identifiable & np.array([c.name != "offset" for c in s.linear.coefficients])
    np.testing.assert_allclose(alone.standard_error[shared] / together.standard_error[shared], ratio, rtol=1e-6)


def test_what_one_leg_shows_is_known_of_its_copy(robot_of: Robots) -> None:
    """The right leg rests; free, nothing but its weight would show."""
    names = ("FL", "FR")
    s = legs(robot_of, names, alike=True, mirror=copies(names))
    still = s.Y.copy()
    still[LENGTH:] = 0
    s = replace(s, Y=still)
    alone, together = uncertainty_with(s, no_constraints(s)), uncertainty_with(s, s.equalities)
    left, right = of_body(s, "FL_link2"), of_body(s, "FR_link2")
    assert not alone.identifiable[right].any()
    assert together.identifiable[left].any()
    np.testing.assert_array_equal(together.identifiable[right], together.identifiable[left])
    np.testing.assert_allclose(together.standard_error[right], together.standard_error[left], rtol=1e-12)


def test_mirrored_legs_are_found_more_exactly(robot_of: Robots) -> None:
    """The torque of the truth is met better than with each leg on its own, for every one of several noises."""
    names = tuple(LEGS)
    s = legs(robot_of, names, count=60, mirror=copies(names))
    for seed in range(4):
        tau = s.noisy(0.5, seed)
        errors = [
            np.square(s.Y @ (fit(s, tau, known).theta - s.theta)).sum() for known in (s.equalities, no_constraints(s))
        ]
        assert errors[0] < 0.6 * errors[1]


def test_without_a_plane_a_copy_is_equal(robot_of: Robots) -> None:
    equal = [{key: x for key, x in entry.items() if key != "plane"} for entry in copies(("FL", "FR"))]
    s = legs(robot_of, ("FL", "FR"), mirror=equal)
    theta = s.theta.copy()
    for i in (1, 2):
        theta[of_body(s, f"FR_link{i}")] = theta[of_body(s, f"FL_link{i}")]
    tau = s.Y @ theta
    ours = fit(s, tau)
    np.testing.assert_allclose(s.Y @ ours.theta, tau, rtol=0, atol=1e-6 * np.abs(tau).max())
    for i in (1, 2):
        np.testing.assert_array_equal(ours.theta[of_body(s, f"FR_link{i}")], ours.theta[of_body(s, f"FL_link{i}")])


def test_friction_is_shared_but_for_what_depends_on_the_direction(robot_of: Robots) -> None:
    s = legs(robot_of, ("FL", "FR"), mirror=[entry for entry in copies(("FL", "FR")) if "joint" in entry])
    exact, noisy = fit(s, s.tau).theta, fit(s, s.noisy(1.0)).theta
    for i in (1, 2):
        for term in ("viscous", "coulomb"):
            assert noisy[of_joint(s, f"FR{i}", term)] == noisy[of_joint(s, f"FL{i}", term)]
        left, right = (of_joint(s, f"{leg}{i}", "offset") for leg in ("FL", "FR"))
        assert noisy[left] != noisy[right]
        np.testing.assert_allclose(exact[[left, right]], s.theta[[left, right]], rtol=1e-4)
    assert not np.allclose(noisy[of_body(s, "FR_link2")], image(noisy[of_body(s, "FL_link2")], LEGS["FR"]))


def test_bodies_may_be_copies_where_joints_are_not(robot_of: Robots) -> None:
    s = legs(robot_of, ("FL", "FR"), mirror=copies(("FL", "FR"), joints=False))
    theta = fit(s, s.noisy(1.0)).theta
    np.testing.assert_allclose(theta[of_body(s, "FR_link2")], image(theta[of_body(s, "FL_link2")], LEGS["FR"]))
    assert theta[of_joint(s, "FR2", "viscous")] != theta[of_joint(s, "FL2", "viscous")]


def test_a_copy_is_bounded_as_its_original_is(robot_of: Robots) -> None:
    """Whatever its own bounds were."""
    rng = np.random.default_rng(0)
    s = legs(robot_of, ("FL", "HR"), mirror=[{"body": "HR_link1", "of": "FL_link1", "plane": "xz"}])
    first, copy = (body(with_equal_bounds(s.model, s.equalities), f"{leg}_link1") for leg in ("FL", "HR"))
    assert not body(s.model, "HR_link1").ellipsoids
    points = points_in(rng, first.ellipsoids[0], 200) * 1.5
    inside = first.ellipsoids[0].contains(points)
    assert 20 < np.count_nonzero(inside) < 180
    np.testing.assert_array_equal(copy.ellipsoids[0].contains(points * [1, -1, 1]), inside)


@pytest.mark.parametrize("turned", [False, True])
def test_bounds_that_a_copy_loses_are_said(robot_of: Robots, turned: bool) -> None:
    s = legs(robot_of, ("FL", "HR"), mirror=[{"body": "HR_link1", "of": "FL_link1", "plane": "xz"}])
    names = [b.name for b in s.model.bodies]
    of, copy = names.index("FL_link1"), names.index("HR_link1")
    bodies = list(s.model.bodies)
    own = bodies[of].ellipsoids[0].mirrored(np.array([1.0, 1.0 if turned else -1.0, 1.0]))
    bodies[copy] = replace(bodies[copy], ellipsoids=(own,))
    said = sentences(with_equal_bounds(replace(s.model, bodies=tuple(bodies)), s.equalities).notices)
    instead = "these copies get the bounds of their originals instead of their own from the configuration"
    assert [warning for warning in said if "HR_link1" in warning] == ([f"{instead}: HR_link1"] if turned else [])
