"""The weight that `auto` takes: its path against the conic solver's, its choice against what a user wants of it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import LEG, TRAIN
from robots import random_urdf
from synthetic import Synthetic, bounds, synthetic

import idtool
from idtool.common import processes
from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.blocks import Blocks
from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.identification import choose_sets
from idtool.estimation.problem import regularization_path as path_module
from idtool.estimation.problem.estimate import estimate
from idtool.estimation.problem.prior_bodies import hull_centre_and_covariance, placeholder_reasons
from idtool.estimation.problem.regularization_path import (
    WEIGHTS,
    RegularizationPath,
    _largest_accepted,
    _standard_error,
    regularization_path,
)
from idtool.robot.config import WEAK_PRIOR, Config, Regularization, parse_config
from idtool.robot.inertia import PI_SIZE
from idtool.robot.model import build_model
from idtool.robot.shapes.box import Box
from idtool.robot.shapes.cylinder import Cylinder
from idtool.robot.urdf.reading import Robot, parse_robot

Array = np.ndarray[Any, np.dtype[np.float64]]
ROWS = 40  # of a block


@pytest.fixture
def arm(robot_of: Callable[[str], Robot]) -> Synthetic:
    """Three joints, bounding ellipsoids, friction; its prior is another body than the truth."""
    rng = np.random.default_rng(5)
    read = robot_of(random_urdf(rng, size=3, kinds=("revolute",), mimic=0, massless=0))
    return synthetic(rng, read, 20 * ROWS, bounds(rng, read))


def blocks_of(s: Synthetic, tau: Array, count: int) -> Blocks:
    """The samples in so many blocks of a second each."""
    parts = []
    for rows in np.array_split(np.arange(tau.shape[1]), count):
        block = replace(s, Y=s.Y[:, rows])
        parts.append(block.reduction(tau[:, rows]))
    return Blocks("log", tuple(parts), 1.0)


def path_of(s: Synthetic, tau: Array, count: int = 20, **prior: Any) -> RegularizationPath:
    blocks = blocks_of(s, tau, count)
    sets = choose_sets(s.model.bodies, None)
    noise = free_noise(s.linear, blocks.total, s.equalities)
    regularization = Regularization.model_validate(prior)
    return regularization_path(s.linear, s.model.bodies, [blocks], sets, regularization, s.equalities, noise)


@pytest.mark.parametrize("kind", ["entropic", "euclidean", "pullback"])
def test_every_point_of_the_path_is_the_solvers_optimum(arm: Synthetic, kind: str) -> None:
    tau = arm.noisy(0.1)
    path = path_of(arm, tau, kind=kind)
    total = blocks_of(arm, tau, 20).total
    sets = choose_sets(arm.model.bodies, None)
    noise = free_noise(arm.linear, total, arm.equalities)
    unweighted = Regularization.model_validate({"kind": kind})
    for point in path.points[2::3]:
        own = estimate(
            arm.linear, arm.model.bodies, total, sets, unweighted.with_weight(point.weight), arm.equalities, noise=noise
        )
        rows = sum(factor.rows for factor in total)
        factors = zip(total, arm.linear.active(), noise, strict=True)
        error = sum(factor.squared_error(own.theta[columns]) / sigma**2 for factor, columns, sigma in factors) / rows
        assert point.train_error == pytest.approx(np.sqrt(error), rel=1e-3)


@pytest.mark.parametrize("kind", ["entropic", "pullback"])
def test_a_body_and_its_copy_count_both(robot_of: Callable[[str], Robot], kind: str) -> None:
    rng = np.random.default_rng(5)
    read = robot_of(random_urdf(rng, size=3, kinds=("revolute",), mimic=0, massless=0))
    copied = {"mirror": [{"body": "link2", "of": "link1"}], **bounds(rng, read)}
    arm = synthetic(rng, read, 20 * ROWS, copied)
    test_every_point_of_the_path_is_the_solvers_optimum(arm, kind)


def test_folds_are_the_same_in_copies_of_the_process(arm: Synthetic, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "process_count", lambda: 2)
    own = path_of(arm, arm.noisy(0.1))
    monkeypatch.setattr(path_module, "_FEWEST_SHARED", 0)
    assert path_of(arm, arm.noisy(0.1)) == own


def test_errors_grow_and_distances_shrink_with_the_weight(arm: Synthetic) -> None:
    path = path_of(arm, arm.noisy(0.1))
    weights = [point.weight for point in path.points]
    errors = [point.train_error for point in path.points]
    distances = [point.distance for point in path.points]
    assert weights == sorted(WEIGHTS)
    assert all(b > a - 1e-4 for a, b in pairwise(errors))
    assert all(b < a * (1 + 1e-3) for a, b in pairwise(distances))
    assert path.weaker.distance > path.chosen.distance > path.stronger.distance
    assert path.chosen.weight == pytest.approx(10 * path.weaker.weight) == pytest.approx(path.stronger.weight / 10)


def test_the_chosen_weight_moves_the_fit_by_3_5_standard_errors_and_is_no_smaller_than_the_best(arm: Synthetic) -> None:
    path = path_of(arm, arm.noisy(0.1))
    best = next(point for point in path.points if point.weight == path.best)
    closest = min(point.train_error for point in path.points)
    assert path.weight >= path.best * (1 - 1e-9)
    independent = 2 / (path.standard_error / best.validation_error**2) ** 2
    moved = np.sqrt(independent * ((path.chosen.train_error / closest) ** 2 - 1))
    assert path.limit == "significance"
    assert moved == pytest.approx(3.5, rel=0.1)
    assert path.chosen.validation_error**2 <= best.validation_error**2 + 1.01 * path.standard_error


def test_the_criterion_that_is_crossed_first_limits_the_weight() -> None:
    """Of validation, a quarter of the way to the firmest weight, and significance, half of it, though it rises more."""
    train, validation = np.ones(len(WEIGHTS)), np.ones(len(WEIGHTS))
    standard_error = 0.01
    allowed = 3.5**2 * standard_error**2 / 2
    validation[0] = 1 + 4 * standard_error
    train[1], train[0] = 1 - 1e-12, 1 + 2 * allowed
    weight, limit = _largest_accepted(train, validation, len(WEIGHTS) - 1, standard_error)
    assert limit == "validation"
    assert weight == pytest.approx(WEIGHTS[1] * (WEIGHTS[0] / WEIGHTS[1]) ** 0.25)


def test_white_noise_is_worth_as_many_samples_as_there_are(arm: Synthetic) -> None:
    path = path_of(arm, arm.noisy(0.1))
    best = next(point for point in path.points if point.weight == path.best)
    independent = 2 / (path.standard_error / best.validation_error**2) ** 2
    samples = sum(factor.rows for factor in blocks_of(arm, arm.noisy(0.1), 20).total)
    assert 0.4 * samples < independent < 2.5 * samples


def test_with_more_noise_bodies_stay_nearer_to_the_prior(arm: Synthetic) -> None:
    quiet, loud = (path_of(arm, arm.noisy(noise)).chosen.distance for noise in (0.01, 1.0))
    assert loud < 0.8 * quiet


def test_a_prior_that_is_the_truth_is_kept(arm: Synthetic) -> None:
    """Next to nothing contradicts it, whatever the weight."""
    own = arm.theta[: PI_SIZE * len(arm.model.bodies)].reshape(-1, PI_SIZE)
    bodies = tuple(replace(body, pi=pi) for body, pi in zip(arm.model.bodies, own, strict=True))
    model = replace(arm.model, bodies=bodies)
    right = replace(arm, model=model, linear=LinearModel(model.names, build_effects(model, arm.config)))
    path = path_of(right, right.noisy(0.1))
    assert path.weight > 1
    assert path.chosen.distance < 0.01


def test_a_log_too_short_to_leave_out_a_part_is_said_to_be(arm: Synthetic) -> None:
    path = path_of(arm, arm.noisy(0.1), count=3)
    assert path.limit == "untested"
    assert np.isnan(path.best)
    assert WEIGHTS[-1] <= path.weight <= WEIGHTS[0]


def leg_with(change: Callable[[dict[str, Any]], None]) -> idtool.Model:
    config = idtool.Model(LEG).config
    change(config)
    return idtool.Model(LEG, config)


def masses(result: Any) -> dict[str, float]:
    return {name: body.mass for name, body in result.bodies.items()}


@pytest.fixture(scope="module")
def leg() -> Any:
    return idtool.fit(LEG, TRAIN, quick=True)


def test_the_result_tells_the_weight_and_its_path(leg: Any) -> None:
    told = leg.to_json()["regularization"]
    assert told["kind"] == "entropic"
    assert told["weight"] == told["automatic"]["chosen"]["weight"]
    assert told["automatic"]["limit"] in ("validation", "significance")
    assert len(told["automatic"]["path"]) == len(WEIGHTS)


def test_a_number_is_taken_as_it_is() -> None:
    model = leg_with(lambda config: config.update(regularization={"weight": 1e-3}))
    told = idtool.fit(model, TRAIN, quick=True).to_json()["regularization"]
    assert (told["weight"], told["mass_precision"], told["automatic"]) == (1e-3, 1.0, None)


def test_a_weight_is_auto_or_a_number() -> None:
    assert parse_config({"regularization": {"weight": "auto"}}, "x").regularization.is_automatic
    with pytest.raises(idtool.IdtoolError, match=r"regularization\.weight: "):
        parse_config({"regularization": {"weight": "firm"}}, "x")
    none = Regularization(kind="none")
    assert not none.is_automatic
    assert (none.numeric_weight, none.fixed_or_weak().weight) == (0.0, 0.0)
    assert Regularization().fixed_or_weak() == WEAK_PRIOR
    with pytest.raises(idtool.IdtoolError, match="units: si needs a number"):
        parse_config({"regularization": {"kind": "euclidean", "units": "si"}}, "x")


def placeholders(inertia: Sequence[float], mass: float) -> Callable[[str], str]:
    """A URDF's text in which every link has the same mass and inertia."""
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    own = " ".join(f'{name}="{value}"' for name, value in zip(names, inertia, strict=True))

    def change(text: str) -> str:
        text = re.sub(r"<inertia [^>]*/>", f"<inertia {own}/>", text)
        return re.sub(r'<mass value="[^"]*"/>', f'<mass value="{mass}"/>', text)

    return change


@pytest.mark.parametrize(
    ("inertia", "mass"),
    [((1, 0, 0, 1, 0, 1), 1.0), ((1e-6, 0, 0, 1e-6, 0, 1e-6), 1e-6), ((0.01, 0, 0, 0.02, 0, 0.01), 2.0)],
)
def test_placeholders_give_way_to_geometry(inertia: Sequence[float], mass: float, leg: Any, tmp_path: Any) -> None:
    """Unit inertias, next to none, all alike: the torque is predicted nearly as well as with a real prior."""
    urdf = tmp_path / "leg.urdf"
    urdf.write_text(placeholders(inertia, mass)(LEG.read_text()))
    config = {**idtool.Model(LEG).config, "known": {"total_mass": 4.04}}
    result = idtool.fit(idtool.Model(urdf, config), TRAIN, quick=True)
    assert any("inertia of abad_link" in warning and "a placeholder" in warning for warning in result.warnings)
    assert result.rms.validation["overall"] < 1.05 * leg.rms.validation["overall"]
    assert sum(masses(result).values()) == pytest.approx(4.04, rel=1e-6)


def test_links_of_one_kind_that_are_alike_are_no_placeholders() -> None:
    """The same module three times; the same inertia for links of other lengths is another matter."""
    joint = '<joint name="j{0}" type="revolute"><parent link="l{1}"/><child link="l{0}"/><origin xyz="{2} 0 0"/>'
    joint += '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint>'
    body = '<link name="l{}"><inertial><origin xyz="0.15 0 0"/><mass value="2"/>'
    body += '<inertia ixx="0.002" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>'

    def reasons(lengths: Sequence[float]) -> dict[str, str]:
        bodies = "".join(body.format(i) for i in range(1, 4))
        joints = "".join(joint.format(i, i - 1, lengths[i - 1]) for i in range(1, 4))
        urdf = f'<robot name="modular"><link name="l0"/>{bodies}{joints}</robot>'
        robot = parse_robot(Path("modular.urdf"), urdf.encode())
        return placeholder_reasons(build_model(robot, Config(), ["j1", "j2", "j3"]).bodies)

    assert reasons([0.1, 0.3, 0.3]) == {}
    assert set(reasons([0.1, 0.3, 0.6])) == {"l1", "l2", "l3"}


@pytest.mark.parametrize(
    ("points", "covariance"),
    [
        (Box((0, 0, 0), (1, 1, 0.2)).grid(500), np.diag([1, 1, 0.04]) / 12),
        (Cylinder((0, 0, 0), 0.1, 1.0).grid(2000), np.diag([0.0025, 0.0025, 1 / 12])),
    ],
    ids=["box", "cylinder"],
)
def test_a_shape_is_filled_evenly(points: Array, covariance: Array) -> None:
    center, found = hull_centre_and_covariance(points + np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(center, [1, 2, 3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found, covariance, rtol=0.05, atol=1e-9)


def test_a_mass_that_is_hardly_known_leaves_the_prior_where_it_is() -> None:
    def heaviest(standard_error: float | None) -> float:
        def weigh(config: dict[str, Any]) -> None:
            config["known"] = {"mass": {"abad_link": {"value": 3.0, "standard_error": standard_error}}}

        result = idtool.fit(leg_with(weigh), TRAIN, quick=True, simulation=False)
        return result.bodies["abad_link"].mass

    assert heaviest(None) == pytest.approx(3.0)
    assert heaviest(30.0) < 2.0


def test_a_real_urdf_is_no_placeholder(arm: Synthetic) -> None:
    assert placeholder_reasons(arm.model.bodies) == {}


def test_masses_that_are_known_take_the_priors_inertia_along(leg: Any) -> None:
    """Twice the weight: nobody keeps a link's inertia and doubles its mass."""
    heavy = leg_with(lambda config: config.update(known={"mass": {"thigh_link": 2 * leg.bodies["thigh_link"].mass}}))
    result = idtool.fit(heavy, TRAIN, quick=True)
    assert result.bodies["thigh_link"].mass == pytest.approx(2 * leg.bodies["thigh_link"].mass, rel=1e-9)
    assert result.rms.validation["overall"] < 1.1 * leg.rms.validation["overall"]


def test_that_one_log_has_larger_errors_than_another_is_no_scatter() -> None:
    rng = np.random.default_rng(5)
    means = rng.normal(1.0, 0.1, 40)
    rows = rng.uniform(0.5, 1.5, 40)
    apart = means + np.repeat([0.0, 3.0], 20)
    own = _standard_error(means, rows, [20, 20])
    assert _standard_error(apart, rows, [20, 20]) == pytest.approx(own)
    assert own == pytest.approx(0.1 / np.sqrt(40), rel=0.5)
    assert _standard_error(apart, rows, [40]) > 5 * own
