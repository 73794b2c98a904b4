"""Standard errors against the scatter of many fits, and what data can determine against arms worked out by hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from robots import chain, joint, random_urdf
from synthetic import synthetic

from idtool.data.filters import LowPass
from idtool.data.signals import Batch, Motion
from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.reduction import Factor, Reduction
from idtool.estimation.problem.estimate import estimate
from idtool.estimation.uncertainty.standard_errors import least_squares_uncertainty
from idtool.robot.config import Regularization, parse_config
from idtool.robot.inertia import PARAMETER_NAMES
from idtool.robot.model import RobotModel
from idtool.robot.sets import constraint_sets
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
Build = Callable[..., RobotModel]

RATE, SECONDS = 1000.0, 12
NO_FRICTION = {"viscous": False, "coulomb": False}
ARM = chain(
    joint("j1", "revolute", "l0", "l1"),
    joint("j2", "revolute", "l1", "l2", '<origin xyz="0.4 0 0"/><axis xyz="0 0 1"/>'),
)


def equation(build: Build, text: str, joints: list[str], **config: Any) -> tuple[RobotModel, LinearModel]:
    model = build(text, joints, **config)
    return model, LinearModel(model.names, build_effects(model, parse_config(config, "")))


def random_motion(rng: np.random.Generator, nv: int, count: int = 400) -> Motion:
    q, v, a = rng.normal(size=(3, nv, count))
    nothing = np.zeros((nv, count))
    return Motion(np.arange(float(count)), q, 3 * v, 20 * a, nothing, nothing, np.full(nv, 1e-6), 1.0)


def reduced(blocks: list[Array], redundancy: float = 1.0) -> Reduction:
    return tuple(Factor.from_columns(block, redundancy) for block in blocks)


def determined(build: Build, text: str, joints: list[str], **config: Any) -> dict[str, set[str]]:
    """Names of the coefficients that random states of a robot determine, by their owner."""
    _, linear = equation(build, text, joints, **config)
    motion = random_motion(np.random.default_rng(0), len(joints))
    found = least_squares_uncertainty(linear, reduced(linear.columns(motion)), np.ones(len(joints)))
    names: dict[str, set[str]] = {c.owner: set() for c in linear.coefficients}
    for coefficient, known, error in zip(linear.coefficients, found.identifiable, found.standard_error, strict=True):
        assert known == np.isfinite(error)
        if known:
            names[coefficient.owner].add(coefficient.name)
    return names


def test_a_planar_arm_across_gravity(build: Build) -> None:
    """By hand: I₁ + m₂ l², mc_x₁ + m₂ l, mc_y₁, I₂, mc_x₂, mc_y₂, of which the first two are sums."""
    names = determined(build, ARM, ["j1", "j2"], gravity=[0, -9.81, 0], friction=NO_FRICTION)
    assert names == {"l1": {"mc_y"}, "l2": {"mc_x", "mc_y", "I_zz"}}


def test_a_planar_arm_that_gravity_does_not_move(build: Build) -> None:
    """By hand: I₁ + m₂ l², I₂, mc_x₂, mc_y₂."""
    names = determined(build, ARM, ["j1", "j2"], gravity=[0, 0, -9.81], friction=NO_FRICTION)
    assert names == {"l1": set(), "l2": {"mc_x", "mc_y", "I_zz"}}


@pytest.mark.parametrize(
    ("gravity", "expected"),
    [([0, 0, -9.81], {"I_zz"}), ([0, -9.81, 0], {"I_zz", "mc_x", "mc_y"}), ([0, 0, 0], {"I_zz"})],
)
def test_a_single_joint(build: Build, gravity: list[float], expected: set[str]) -> None:
    """Along gravity only the inertia about the axis shows; across it, the static moment about the axis too."""
    one = chain(joint("j1", "revolute", "l0", "l1"))
    assert determined(build, one, ["j1"], gravity=gravity, friction=NO_FRICTION) == {"l1": expected}


def test_a_slide_shows_its_mass_and_nothing_else(build: Build) -> None:
    slide = chain(joint("j1", "prismatic", "l0", "l1"))
    assert determined(build, slide, ["j1"], friction=NO_FRICTION) == {"l1": {"m"}}


def test_friction_shows_at_every_joint_that_moves(build: Build) -> None:
    names = determined(build, ARM, ["j1", "j2"], friction={"offset": True})
    assert names["j1"] == names["j2"] == {"viscous", "coulomb", "offset"}


def test_a_rotor_on_the_first_joint_cannot_be_told_from_its_link(build: Build) -> None:
    """Both have one column, the inertia about the axis times the acceleration."""
    rotor = {"joint": "j1", "gear_ratio": 10, "inertial": {"mass": 0.2, "inertia": [1e-4, 0, 1e-4, 0, 0, 1e-4]}}
    one = chain(joint("j1", "revolute", "l0", "l1"))
    assert determined(build, one, ["j1"], rotors={"r": rotor}, friction=NO_FRICTION) == {"l1": set(), "r": set()}


@pytest.mark.parametrize("seed", range(6))
def test_a_coefficient_is_determined_where_its_column_adds_to_the_rank(
    robot_of: Callable[[str], Robot], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    s = synthetic(rng, robot_of(random_urdf(rng, size=4, mimic=0, massless=0)), 200)
    found = least_squares_uncertainty(s.linear, s.reduction(s.tau), np.ones(len(s.Y)))
    rows = s.Y.reshape(-1, s.Y.shape[-1])
    size = np.linalg.norm(rows, axis=0)
    rows = rows / np.where(size > 1e-9 * size.max(), size, np.inf)
    rank = np.linalg.matrix_rank(rows, tol=1e-8)
    adds = [np.linalg.matrix_rank(np.delete(rows, i, axis=1), tol=1e-8) < rank for i in range(rows.shape[1])]
    np.testing.assert_array_equal(found.identifiable, adds)
    assert 0 < sum(adds) < len(adds)


def test_without_data_nothing_is_determined(build: Build) -> None:
    _, linear = equation(build, ARM, ["j1", "j2"])
    nothing = reduced([np.zeros((len(active) + 1, 0)) for active in linear.active()])
    found = least_squares_uncertainty(linear, nothing, np.ones(2))
    assert not found.identifiable.any()
    assert np.isinf(found.standard_error).all()


def test_a_column_alone_has_the_textbooks_standard_error(build: Build) -> None:
    """sigma / ‖column‖, and √redundancy times as much where samples repeat each other."""
    slide = chain(joint("j1", "prismatic", "l0", "l1"))
    _, linear = equation(build, slide, ["j1"], friction=NO_FRICTION, gravity=[0, 0, 0])
    motion = random_motion(np.random.default_rng(1), 1)
    for redundancy in (1.0, 6.5):
        found = least_squares_uncertainty(linear, reduced(linear.columns(motion), redundancy), np.array([0.3]))
        expected = 0.3 * np.sqrt(redundancy) / np.linalg.norm(motion.a[0])
        assert found.standard_error[PARAMETER_NAMES.index("m")] == pytest.approx(expected)


def filtered_swing(linear: LinearModel, low_pass: LowPass) -> list[Array]:
    """Columns of an arm's swing in the band, the torque's row empty."""
    t = np.arange(RATE * SECONDS) / RATE
    w = 2 * np.pi * np.array([[0.31, 0.83, 1.7], [0.47, 1.1, 2.3]])[:, :, None]
    phase = np.array([[0.2, 1.0, 2.0], [0.5, 1.7, 0.1]])[:, :, None]
    q, v, a = (np.sum(0.5 * w**k * np.sin(w * t + phase + k * np.pi / 2), axis=1) for k in range(3))
    nothing = np.zeros_like(q)
    batch = Batch(Motion(t, q, v, a, nothing, nothing, np.full(2, 3e-3), 1 / RATE), 0, 0, low_pass)
    return [batch.filter(columns) for columns in linear.columns(batch.motion)]


def test_standard_errors_are_the_scatter_of_fits_to_many_noises(build: Build) -> None:
    """300 times white noise on the logged torque, filtered and decimated like everything else."""
    friction = {"viscous": 0.4, "coulomb": 2.0}
    model, linear = equation(build, ARM, ["j1", "j2"], gravity=[0, -9.81, 0], friction=friction)
    low_pass = LowPass(40.0, 4, 1 / RATE, stride=6)
    columns = filtered_swing(linear, low_pass)
    rng = np.random.default_rng(5)
    truth = np.where([c.effect == "rigid_body" for c in linear.coefficients], 0.3, linear.prior)
    sigma = np.array([[1.5], [0.2]])
    z = []
    for _ in range(300):
        noise = low_pass(sigma * rng.normal(size=(2, int(RATE * SECONDS))), 0, 0)
        for block, active, row in zip(columns, linear.active(), noise, strict=True):
            block[-1] = truth[active] @ block[:-1] + row
        reduction = reduced(columns, low_pass.redundancy)
        sets = [constraint_sets()["none"]] * 2
        solution = estimate(linear, model.bodies, reduction, sets, Regularization(kind="none"))
        found = least_squares_uncertainty(linear, reduction, solution.noise)
        known = found.identifiable
        z.append((solution.theta - truth)[known] / found.standard_error[known])
    scores = np.array(z)
    assert scores.shape == (300, 8)
    assert 0.9 < scores.std() < 1.1
    assert (np.abs(scores.std(axis=0) - 1) < 0.2).all(), scores.std(axis=0)
    assert (np.abs(scores.mean(axis=0)) < 4 / np.sqrt(300)).all(), scores.mean(axis=0)
