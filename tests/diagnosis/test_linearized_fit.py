"""What a model leaves, block by block, against fitting it again without the block."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cvxpy as cp
import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
from numpy.typing import NDArray
from prescribed_motions import Log, prescribed_motion, silent, stacked, with_noise, with_torque
from reference import Reference
from spatial_arm import ARM, JOINTS, NOISE, experiment, in_band, written

from idtool.diagnosis.held_out_error import held_out_mean_squares
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

FREE: dict[str, Any] = {"constraints": "none", "regularization": {"kind": "none"}}
OFFSET = {"viscous": False, "coulomb": False, "offset": True}
MUCH = 0.3  # N·m, of noise that leaves much


@pytest.fixture(scope="module")
def log() -> Log:
    """The arm with offsets, and a kink that no model of it has."""
    plain = prescribed_motion(6.0)
    bent = with_torque(with_torque(plain, 1, 0.4 + 0.5 * np.abs(plain["q"][:, 1])), 2, np.full(len(plain["t"]), -0.2))
    return with_noise(bent, MUCH)


def grounded(folder: Path, log: Log, **config: Any) -> tuple[Experiment, LinearizedFit]:
    """A fit to a log."""
    tried = experiment(*written(folder, log), fitted=True, **config)
    return tried, linearize_fit(tried, silent)


def test_what_is_left_of_a_block_is_what_least_squares_without_it_leaves(tmp_path: Path, log: Log) -> None:
    tried, fitted = grounded(tmp_path, log, friction=OFFSET, **FREE)
    rows = stacked(tried, fitted.noise, fitted.block_length)
    expected, _ = rows.left()
    assert fitted.block_count == rows.block.max() + 1 > 10
    np.testing.assert_allclose(fitted.cv_squared_error, expected, rtol=1e-5)
    assert (expected / fitted.sse.sum(axis=1)).max() > 1.02  # leaving it out tells
    assert fitted.sse.sum() == pytest.approx(np.square(rows.tau - rows.Y @ fitted.theta).sum(), rel=1e-9)
    np.testing.assert_array_equal(fitted.row_counts.sum(axis=1), np.bincount(rows.block))


def test_the_blocks_are_those_of_several_logs(tmp_path: Path, log: Log) -> None:
    first, second = prescribed_motion(2.5, seed=1), prescribed_motion(4.0, seed=2)
    paths = [written(tmp_path / str(i), with_noise(x, MUCH, i)) for i, x in enumerate((first, second))]
    config = parse_config({"friction": OFFSET, **FREE}, "")
    tried = prepare(read_robot(paths[0][0]), config, [csv for _, csv in paths], holdout=0)
    fitted = linearize_fit(tried, silent)
    counts = [sum(len(batch.t) for batch in run.signals.batches(run.train)) for run in tried.runs]
    assert fitted.block_count == sum(-(-count // fitted.block_length) for count in counts)
    np.testing.assert_allclose(
        fitted.cv_squared_error, stacked(tried, fitted.noise, fitted.block_length).left()[0], rtol=1e-5
    )
    alone = [linearize_fit(prepare(read_robot(urdf), config, [csv], holdout=0), silent, fitted) for urdf, csv in paths]
    assert fitted.sse.sum() > sum(one.sse.sum() for one in alone)  # a model of both logs fits neither as well
    assert fitted.row_counts.sum() == sum(one.row_counts.sum() for one in alone)


@pytest.mark.parametrize("damping", [0.2, -0.2])
def test_a_bound_is_stiff_where_it_is_reached_and_nothing_elsewhere(tmp_path: Path, log: Log, damping: float) -> None:
    """Damping below zero: without a block, the fit is that of a model that has no damping."""
    torque = damping * log["v"][:, 0]
    friction = {"turn": {"viscous": True, "coulomb": False, "offset": True}, "lift": OFFSET, "roll": OFFSET}
    tried, fitted = grounded(tmp_path, with_torque(log, 0, torque), friction=friction, **FREE)
    index = next(i for i, c in enumerate(tried.equation.coefficients) if c.name == "viscous")
    rows = stacked(tried, fitted.noise, fitted.block_length)
    keep = np.arange(rows.Y.shape[1]) != index
    with_it, without = rows.left()[0], rows.left(keep=keep)[0]
    np.testing.assert_allclose(fitted.cv_squared_error, without if damping < 0 else with_it, rtol=1e-3)
    assert np.abs(with_it / without - 1).min() > 0.05  # one is not the other
    moves = np.ptp(fitted.jackknife_shift @ fitted.directions[index])
    assert moves < 1e-5 if damping < 0 else moves > 1e-3


TOO_LONG = np.array([0.06, 0, -0.006, 0, 0, -0.006])  # kg·m², on top of the fore part's inertia


def pseudo_inertia(pi: Any) -> Any:
    """J of [m, h, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz], cvxpy's or numbers."""
    xx, xy, yy, xz, yz, zz = (pi[k] for k in range(4, 10))
    rows = [
        [(yy + zz - xx) / 2, -xy, -xz, pi[1]],
        [-xy, (xx + zz - yy) / 2, -yz, pi[2]],
        [-xz, -yz, (xx + yy - zz) / 2, pi[3]],
        [pi[1], pi[2], pi[3], pi[0]],
    ]
    return cp.bmat(rows)


def refit(Y: Array, tau: Array) -> Array:
    """Least squares over three bodies that could exist, (30,)."""
    R = np.linalg.qr(np.column_stack([Y, tau]), mode="r")
    size = np.tile([1, *[0.2] * 3, *[0.04] * 6], 3)
    x = cp.Variable(30)
    cost = cp.sum_squares(R[:, :-1] / np.linalg.norm(R) * size @ x - R[:, -1] / np.linalg.norm(R))
    least = [pseudo_inertia(cp.multiply(size, x)[10 * i : 10 * i + 10]) >> 0 for i in range(3)]
    cp.Problem(cp.Minimize(cost + 1e-9 * cp.sum_squares(x)), least).solve(solver=cp.CLARABEL)
    return np.asarray(size * x.value)


def test_where_bodies_lie_on_their_limits_the_others_are_as_free_as_they_are(tmp_path: Path) -> None:
    """An arm whose fore part no body could be, against cvxpy's fits without a block."""
    tree = pin.buildModelFromXML(ARM)
    found, data = tree.createData(), prescribed_motion(6.0)
    states = zip(data["q"], data["v"], data["a"], strict=True)
    wrong = [pin.computeJointTorqueRegressor(tree, found, *state)[:, -6:] @ TOO_LONG for state in states]
    data = with_noise({**data, "tau": data["tau"] + wrong}, MUCH)
    tried, fitted = grounded(tmp_path, data, constraints="full", regularization={"kind": "none"})
    rows = stacked(tried, fitted.noise, fitted.block_length)
    inside = fitted.sse.sum(axis=1)
    at, expected = np.argsort(fitted.cv_squared_error / inside)[-4:], []
    for f in at:
        out = rows.block == f
        theta = refit(rows.Y[~out], rows.tau[~out])
        expected.append(np.square(rows.tau[out] - rows.Y[out] @ theta).sum())
    np.testing.assert_allclose((fitted.cv_squared_error - inside)[at], expected - inside[at], rtol=0.1)
    assert (rows.left()[0][at] < 0.8 * inside[at]).all()  # bodies that cannot be would have fitted far better


def test_what_is_held_out_is_judged_by_pinocchio(tmp_path: Path, log: Log) -> None:
    urdf, csv = written(tmp_path, log)
    tried = prepare(read_robot(urdf), parse_config({"friction": OFFSET, **FREE}, ""), [csv], holdout=0.4)
    fitted = linearize_fit(tried, silent)
    found = Reference(ARM, JOINTS, {"gravity": [0, 0, -9.81]})
    bodies, offset = fitted.estimate.theta[:-3], fitted.estimate.theta[-3:]
    names = [body.name for body in tried.model.bodies]
    states = zip(log["q"], log["v"], log["a"], strict=True)
    torque = np.array([found.regressor(names, *state) @ bodies for state in states]) + offset
    (part,) = tried.runs[0].held_out
    assert part.start / len(log["t"]) == pytest.approx(0.6, abs=0.02)
    error = in_band(log["tau"] - torque)[part]
    expected = np.mean(np.square(error), axis=0) / fitted.noise**2
    found_errors = held_out_mean_squares(fitted, tried.equation) / fitted.noise**2
    np.testing.assert_allclose(found_errors, expected, rtol=0.03)
    assert np.isnan(held_out_mean_squares(grounded(tmp_path, log)[1], tried.equation)).all()


def test_another_fit_counts_the_same_rows_in_the_same_units(tmp_path: Path, log: Log) -> None:
    """A joint's samples at rest, where Coulomb friction is unknown, count only for a model without it."""
    still = {**log, "v": log["v"].copy(), "q": log["q"].copy()}
    half = len(log["t"]) // 2
    still["q"][half:, 0], still["v"][half:, 0] = still["q"][half, 0], 0
    dry = {"turn": {"viscous": False, "coulomb": True, "offset": True}, "lift": OFFSET, "roll": OFFSET}
    _, first = grounded(tmp_path, still, friction=dry, **FREE)
    tried, second = grounded(tmp_path, still, friction=OFFSET, **FREE)
    assert first.row_counts.sum(axis=0)[0] < 0.6 * second.row_counts.sum(axis=0)[0]
    assert second.noise[0] > NOISE
    alike = linearize_fit(tried, silent, first)
    np.testing.assert_array_equal(alike.row_counts, first.row_counts)
    np.testing.assert_array_equal(alike.noise, first.noise)
    np.testing.assert_array_equal(linearize_fit(tried, silent, first, own_rows=True).row_counts, second.row_counts)
