"""Masses and centres of mass that are known otherwise: the estimate, and its standard errors by elimination."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from legs import Robots, copies, fit, legs, no_constraints, of_body, uncertainty_with
from numpy.typing import NDArray
from robots import random_urdf
from synthetic import Synthetic, synthetic

from idtool.common.exceptions import ConfigError, SolverError
from idtool.estimation.dataset.weights import free_noise
from idtool.robot.config import Regularization
from idtool.robot.inertia import PI_SIZE

Array = NDArray[np.float64]

NONE = Regularization(kind="none")


@pytest.fixture
def slides(robot_of: Robots) -> Callable[..., Synthetic]:
    """A robot that slides along three axes, whose torque determines every mass and all friction, and nothing else."""

    def make(**config: Any) -> Synthetic:
        rng = np.random.default_rng(3)
        robot = robot_of(random_urdf(rng, size=3, kinds=("prismatic",), mimic=0, massless=0))
        return synthetic(rng, robot, 300, config)

    return make


@pytest.fixture
def arm(robot_of: Robots) -> Callable[..., Synthetic]:
    """A robot of three revolute joints, whose torque determines no mass."""

    def make(**config: Any) -> Synthetic:
        rng = np.random.default_rng(3)
        robot = robot_of(random_urdf(rng, size=3, kinds=("revolute",), mimic=0, massless=0))
        return synthetic(rng, robot, 300, config)

    return make


MASSES = PI_SIZE * np.arange(3)


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_an_exact_mass_is_met_to_the_last_digit(arm: Callable[..., Synthetic], noise: float) -> None:
    s = arm(known={"mass": {"link1": 1.234, "link3": 0.777}})
    ours = fit(s, s.noisy(noise), kind="full")
    np.testing.assert_allclose(ours.theta[MASSES[[0, 2]]], [1.234, 0.777], rtol=1e-12)
    assert ours.certificate.certified


def test_the_true_masses_do_not_stand_in_the_way_of_the_truth(arm: Callable[..., Synthetic]) -> None:
    truth = arm().theta[MASSES]
    s = arm(known={"mass": {f"link{i + 1}": float(m) for i, m in enumerate(truth)}, "total_mass": float(truth.sum())})
    ours = fit(s, s.tau, kind="full")
    np.testing.assert_allclose(ours.theta[MASSES], truth, rtol=1e-12)
    np.testing.assert_allclose(s.Y @ ours.theta, s.tau, rtol=0, atol=1e-6 * np.abs(s.tau).max())


def test_an_exact_total_is_met_to_the_last_digit(arm: Callable[..., Synthetic]) -> None:
    s = arm(known={"total_mass": 5.5})
    ours, plain = fit(s, s.noisy(1.0), kind="full"), fit(s, s.noisy(1.0), no_constraints(s), kind="full")
    assert ours.theta[MASSES].sum() == pytest.approx(5.5, rel=1e-12)
    assert abs(plain.theta[MASSES].sum() - 5.5) > 0.1


def test_a_soft_mass_is_one_more_row_of_least_squares(slides: Callable[..., Synthetic]) -> None:
    """Weighted by its standard error against the samples by theirs; by numpy, on the columns that are not zero."""
    for error in (1e-3, 1e-2, 0.1):
        facts = {"mass": {"link2": {"value": 3.0, "standard_error": error}}}
        s = slides(known=facts, friction={"viscous": False, "coulomb": False})
        tau = s.noisy(0.5)
        ours = fit(s, tau, kind="none", prior=NONE)
        sigma = free_noise(s.linear, s.reduction(tau))
        rows = np.vstack([(s.Y[:, :, MASSES] / sigma[:, None, None]).reshape(-1, 3), [[0, 1 / error, 0]]])
        expected = np.linalg.lstsq(rows, np.append((tau / sigma[:, None]).ravel(), 3.0 / error), rcond=None)[0]
        np.testing.assert_allclose(ours.theta[MASSES], expected, rtol=2e-3)


def test_a_soft_mass_of_tiny_error_is_exact_and_of_huge_error_nothing(slides: Callable[..., Synthetic]) -> None:
    tau = slides().noisy(0.5)
    plain = fit(slides(), tau, kind="full")
    value = 1.5 * float(plain.theta[MASSES[1]])
    exact = slides(known={"mass": {"link2": value}})
    hard = fit(exact, tau, kind="full")
    tiny, huge = (slides(known={"mass": {"link2": {"value": value, "standard_error": error}}}) for error in (1e-7, 1e5))
    scale = np.abs(plain.theta).max()
    np.testing.assert_allclose(fit(tiny, tau, kind="full").theta, hard.theta, rtol=0, atol=1e-5 * scale)
    np.testing.assert_allclose(fit(huge, tau, kind="full").theta, plain.theta, rtol=0, atol=1e-5 * scale)
    assert abs(hard.theta[MASSES] - plain.theta[MASSES]).max() > 1e-2 * scale


@pytest.mark.parametrize("kind", ["none", "known_com", "ellipsoid"])
def test_a_known_centre_of_mass_is_met(arm: Callable[..., Synthetic], kind: str) -> None:
    """From data whose truth has it elsewhere."""
    centers = {"link1": [0.02, -0.03, 0.05], "link3": [0.0, 0.04, 0.0]}
    bounds = {link: [{"center": c, "semi_axes": [0.2, 0.3, 0.1]}] for link, c in centers.items()}
    s = arm(known_com=centers, bounding_ellipsoids=bounds)
    ours = fit(s, s.noisy(0.5), kind=kind)
    for link, center in centers.items():
        mass, *h = ours.theta[of_body(s, link)][:4]
        np.testing.assert_allclose(np.array(h) / mass, center, rtol=0, atol=1e-9)
    assert ours.certificate.violation <= 0


def test_a_centre_that_is_known_rightly_is_no_hindrance(arm: Callable[..., Synthetic]) -> None:
    pi = arm().theta[:PI_SIZE]
    s = arm(known_com={"link1": (pi[1:4] / pi[0]).tolist()})
    ours = fit(s, s.tau, kind="known_com")
    np.testing.assert_allclose(s.Y @ ours.theta, s.tau, rtol=0, atol=1e-6 * np.abs(s.tau).max())


@pytest.mark.parametrize(
    ("config", "label"),
    [
        ({"known": {"mass": {"FL_link1": 1, "FL_link2": 1, "FR_link1": 1, "FR_link2": 1}, "total_mass": 5}}, "known."),
        ({"known": {"mass": {"FL_link1": 1, "FR_link1": 1.1}}, "mirror": copies(("FL", "FR"))}, "known.mass: F"),
        ({"known_com": {"FL_link1": [0, 0.1, 0], "FR_link1": [0, 0.1, 0]}, "known": {"mass": {"FL_link1": 1}}}, ""),
    ],
    ids=["masses and total", "masses of copies", "centres of copies"],
)
def test_facts_that_contradict_each_other_are_refused(robot_of: Robots, config: Mapping[str, Any], label: str) -> None:
    s = legs(robot_of, ("FL", "FR"), **{"mirror": copies(("FL", "FR")) if not label else [], **config})
    with pytest.raises(ConfigError, match=f"^{label}.*contradicts another exactly known value; give one of them") as e:
        fit(s, s.tau, kind="full")
    assert "\n" not in str(e.value)


def test_facts_that_say_the_same_are_not(robot_of: Robots) -> None:
    """Of copies, and of a total that is the sum of all."""
    masses = {"FL_link1": 0.9, "FR_link1": 0.9, "FL_link2": 1.1}
    s = legs(robot_of, ("FL", "FR"), mirror=copies(("FL", "FR")), known={"mass": masses, "total_mass": 4.0})
    theta = fit(s, s.noisy(0.3), kind="full").theta
    for name, mass in (*masses.items(), ("FR_link2", 1.1)):
        assert theta[of_body(s, name)][0] == pytest.approx(mass, rel=1e-12)


def test_masses_beyond_their_total_leave_nothing(arm: Callable[..., Synthetic]) -> None:
    s = arm(known={"mass": {"link1": 3.0, "link2": 2.0}, "total_mass": 4.0})
    with pytest.raises(SolverError, match="relax"):
        fit(s, s.tau, kind="full")


def test_a_copys_mass_is_its_originals(robot_of: Robots) -> None:
    s = legs(robot_of, ("FL", "FR"), mirror=copies(("FL", "FR")), known={"mass": {"FR_link2": 0.95}})
    theta = fit(s, s.noisy(0.3), kind="ellipsoid").theta
    assert theta[of_body(s, "FL_link2")][0] == pytest.approx(0.95, rel=1e-12)
    found = uncertainty_with(s, s.equalities)
    for leg in ("FL", "FR"):
        assert found.standard_error[of_body(s, f"{leg}_link2")][0] == 0
        assert found.identifiable[of_body(s, f"{leg}_link2")][0]


def covariance(X: Array) -> Array:
    return np.asarray(np.linalg.inv(X.T @ X))


def seen_columns(s: Synthetic) -> tuple[Array, NDArray[np.intp]]:
    """The rows of all joints in the columns of masses and friction, and which these are."""
    seen = np.concatenate([MASSES, np.arange(3 * PI_SIZE, len(s.theta))])
    return s.Y[:, :, seen].reshape(-1, len(seen)), seen


def test_with_an_exact_mass_the_errors_are_those_without_its_column(slides: Callable[..., Synthetic]) -> None:
    s = slides(known={"mass": {"link2": 1.0}})
    X, seen = seen_columns(s)
    found, plain = uncertainty_with(s, s.equalities, 0.7), uncertainty_with(s, no_constraints(s), 0.7)
    expected = 0.7 * np.sqrt(np.diag(covariance(np.delete(X, 1, axis=1))))
    np.testing.assert_allclose(found.standard_error[np.delete(seen, 1)], expected, rtol=1e-8)
    assert found.standard_error[MASSES[1]] < 1e-12
    assert found.identifiable[seen].all()
    assert (expected < plain.standard_error[np.delete(seen, 1)]).all()
    np.testing.assert_array_equal(np.delete(found.identifiable, seen), False)


def test_with_an_exact_total_one_mass_is_the_total_less_the_others(slides: Callable[..., Synthetic]) -> None:
    s = slides(known={"total_mass": 3.0})
    X, seen = seen_columns(s)
    reduced = np.delete(X, 2, axis=1)
    reduced[:, :2] -= X[:, [2]]
    C = covariance(reduced)
    third = C[0, 0] + C[1, 1] + 2 * C[0, 1]
    expected = np.sqrt(np.insert(np.diag(C), 2, third))
    np.testing.assert_allclose(uncertainty_with(s, s.equalities).standard_error[seen], expected, rtol=1e-8)


def test_a_soft_mass_is_one_more_measurement(slides: Callable[..., Synthetic]) -> None:
    s = slides(known={"mass": {"link2": {"value": 1.0, "standard_error": 0.02}}})
    X, seen = seen_columns(s)
    row = np.zeros((1, X.shape[1]))
    row[0, 1] = 1 / 0.02
    expected = np.sqrt(np.diag(covariance(np.vstack([X / 3.0, row]))))
    np.testing.assert_allclose(uncertainty_with(s, s.equalities, 3.0).standard_error[seen], expected, rtol=1e-8)
    assert expected[1] < 0.02


def test_a_mass_that_no_torque_shows_is_determined_where_it_is_known(arm: Callable[..., Synthetic]) -> None:
    """Exactly, or as far as it is."""
    known = {"mass": {"link1": 1.0, "link2": {"value": 1.0, "standard_error": 0.05}}}
    s = arm(known=known)
    found, plain = uncertainty_with(s, s.equalities), uncertainty_with(s, no_constraints(s))
    assert not plain.identifiable[MASSES].any()
    np.testing.assert_array_equal(found.identifiable[MASSES], [True, True, False])
    np.testing.assert_allclose(found.standard_error[MASSES[:2]], [0, 0.05], rtol=1e-6, atol=1e-12)
    assert np.isinf(found.standard_error[MASSES[2]])
    assert found.identifiable.sum() == plain.identifiable.sum() + 2
