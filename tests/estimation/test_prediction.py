"""The predicted torque's standard error against matrices written out, and on motions that the data do not determine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from robots import chain, inertial, joint

from idtool.data.logs import make_log, write_log
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.experiment import Experiment, Run, prepare
from idtool.estimation.dataset.reduction import Factor
from idtool.estimation.uncertainty.prediction import Prediction, prediction
from idtool.estimation.uncertainty.standard_errors import Uncertainty, least_squares_uncertainty
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]

P = 5
ACTIVE = (np.array([0, 1, 2]), np.array([1, 2, 3, 4]))
SIGMA = np.array([0.3, 2.0])
SIZES = np.array([1.0, 50.0, 0.03, 2.0, 1e-4])


class Rows:
    """An experiment whose rows are given: (2, n, P) to fit and as many to predict, in batches of 40."""

    def __init__(self, train: Array, held_out: Array) -> None:
        self.equation = SimpleNamespace(
            joints=("one", "two"),
            coefficients=(SimpleNamespace(scale=None),) * P,
            active=lambda: ACTIVE,
            block=self._block,
        )
        self._of = {"train": train, "held out": held_out}
        self._held_out = (slice(0, held_out.shape[1]),)
        signals: Any = SimpleNamespace(log=SimpleNamespace(path=Path("a.csv")), batches=self._batches)
        self.runs = (Run(signals, (slice(0, train.shape[1]),), self._held_out),)

    def _batches(self, parts: tuple[slice, ...]) -> list[SimpleNamespace]:
        Y = self._of["held out" if parts is self._held_out else "train"]
        pieces = [Y[:, i : i + 40] for i in range(0, Y.shape[1], 40)]
        return [SimpleNamespace(Y=Y, motion=SimpleNamespace(t=np.zeros(Y.shape[1])), before=0, after=0) for Y in pieces]

    def _block(self, batch: SimpleNamespace) -> list[Array]:
        pairs = zip(batch.Y, ACTIVE, strict=True)
        return [np.vstack([Y[:, active].T, np.full(len(Y), np.nan)]) for Y, active in pairs]  # the torque is not asked

    def found(self, redundancy: float = 1.0) -> Uncertainty:
        """What the rows to fit say."""
        pairs = zip(self._of["train"], ACTIVE, strict=True)
        data = tuple(
            Factor.from_columns(np.vstack([Y[:, active].T, np.zeros(len(Y))]), redundancy) for Y, active in pairs
        )
        return least_squares_uncertainty(self.equation, data, SIGMA)  # type: ignore[arg-type]

    def asked(self, found: Uncertainty, held_out: bool) -> Prediction:
        return prediction(self, found, held_out, lambda stage, share: None)  # type: ignore[arg-type]


def random_rows(n: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    Y = np.zeros((2, n, P))
    for j, active in enumerate(ACTIVE):
        Y[j][:, active] = rng.normal(size=(n, len(active))) * SIZES[active]
    return Y


def covariance(Y: Array, redundancy: float = 1.0) -> Array:
    W = (Y / SIGMA[:, None, None]).reshape(-1, P)
    return np.asarray(redundancy * np.linalg.inv(W.T @ W))


@pytest.mark.parametrize("held_out", [False, True])
@pytest.mark.parametrize("redundancy", [1.0, 3.5])
def test_it_is_the_parameters_covariance_seen_by_the_rows(held_out: bool, redundancy: float) -> None:
    """√ of the diagonal of Y C Yᵀ, joint by joint; the last batch is short."""
    train, other = random_rows(100, 1), 3 * random_rows(130, 2)
    rows = Rows(train, other)
    ahead = rows.asked(rows.found(redundancy), held_out)
    C = covariance(train, redundancy)
    variance = np.array([np.diag(Y @ C @ Y.T) for Y in (other if held_out else train)])
    np.testing.assert_allclose(ahead.rms, np.sqrt(variance.mean(axis=1)), rtol=1e-7)
    np.testing.assert_allclose(ahead.largest, np.sqrt(variance.max(axis=1)), rtol=1e-7)
    np.testing.assert_array_equal(ahead.unknown, 0)


def test_on_the_fitted_rows_it_is_the_number_of_unknowns() -> None:
    """Σ over joints of n rms² / sigma² is the trace of the hat matrix: as many as there are coefficients."""
    rows = Rows(random_rows(300, 4), random_rows(3, 5))
    ahead = rows.asked(rows.found(), False)
    assert np.sum(300 * np.square(ahead.rms / SIGMA)) == pytest.approx(P, rel=1e-9)


def test_it_is_the_scatter_of_predictions() -> None:
    """Of least squares on 500 noises, on other rows."""
    train, other = random_rows(60, 6), random_rows(50, 7)
    rng = np.random.default_rng(8)
    W = (train / SIGMA[:, None, None]).reshape(-1, P)
    errors = np.linalg.lstsq(W, rng.normal(size=(len(W), 500)), rcond=None)[0]
    rows = Rows(train, other)
    ahead = rows.asked(rows.found(), True)
    for j in range(2):
        assert ahead.rms[j] == pytest.approx(np.sqrt(np.mean(np.square(other[j] @ errors))), rel=0.1)


def test_any_spread_of_the_estimate_is_taken_as_it_is() -> None:
    """Not only one that is round."""
    rows = Rows(random_rows(100, 1), random_rows(90, 2))
    found = rows.found()
    A = np.random.default_rng(3).normal(size=(P, 2))
    found = replace(found, covariance_y=A @ A.T)
    V = found.directions.observable
    C = V @ A @ A.T @ V.T
    expected = [np.sqrt(np.mean(np.diag(Y @ C @ Y.T))) for Y in rows._of["held out"]]
    np.testing.assert_allclose(rows.asked(found, True).rms, expected, rtol=1e-7)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_a_direction_that_was_never_seen_shows_as_unknown(share: float, unit: float) -> None:
    """Two columns alike while fitting, of which a share of the other rows moves one alone; the rest is as before."""
    train, other = random_rows(100, 1), random_rows(200, 2)
    for Y in (train, other):
        Y[1][:, 3] = Y[1][:, 4] * unit
    alone = slice(0, round(share * 200))
    other[1][alone, 3] *= np.random.default_rng(4).uniform(2, 3, alone.stop)
    rows = Rows(train, other)
    found = rows.found()
    np.testing.assert_array_equal(found.identifiable, [True, True, True, False, False])
    ahead = rows.asked(found, True)
    np.testing.assert_allclose(ahead.unknown, [0.0, share], atol=0.01)
    assert not rows.asked(found, False).unknown.any()
    seen = [0, 1, 2, 4]
    W = (train / SIGMA[:, None, None])[:, :, seen].reshape(-1, 4)
    C = np.linalg.inv(W.T @ W)
    known = [other[0][:, seen], other[1][alone.stop :, seen]]
    for j, Y in enumerate(known):
        variance = np.diag(Y @ C @ Y.T)
        assert ahead.rms[j] == pytest.approx(np.sqrt(variance.mean()) if len(Y) else 0.0, rel=1e-4)
        assert ahead.largest[j] == pytest.approx(np.sqrt(variance.max(initial=0.0)), rel=1e-4)


def test_a_column_that_was_zero_is_not_known() -> None:
    train, other = random_rows(100, 1), random_rows(200, 2)
    train[1][:, 3] = 0.0
    other[1][50:, 3] = 0.0
    rows = Rows(train, other)
    np.testing.assert_allclose(rows.asked(rows.found(), True).unknown, [0, 0.25], atol=0.005)


def test_what_the_data_hardly_see_does_not_hide_what_they_do_not_see() -> None:
    """Two columns differ by a hundred thousandth while fitting, two not at all; then all of them go their own ways."""
    train, other = random_rows(100, 1), random_rows(200, 2)
    both = np.concatenate([train[0][:, 1], train[1][:, 1]])
    near = (both * (1 + 1e-5 * np.random.default_rng(5).normal(size=200))).reshape(2, 100)
    train[:, :, 2] = near / 1000
    train[1][:, 3] = train[1][:, 4] * SIZES[3] / SIZES[4]
    rows = Rows(train, other)
    found = rows.found()
    np.testing.assert_array_equal(found.identifiable, [True, True, True, False, False])
    ahead = rows.asked(found, True)
    np.testing.assert_allclose(ahead.unknown, [0, 1], atol=0.01)
    assert ahead.rms[0] > 1e3 * rows.asked(found, False).rms[0]


def spun(seconds: float, accelerates: bool) -> tuple[Array, Array]:
    """A turntable's angle and that of an arm on it; the turntable turns evenly, or not."""
    t = np.arange(0, seconds, 1e-3)
    turn = 0.7 * t + (0.5 * np.sin(5 * t) if accelerates else 0.0)
    return np.array([turn, 0.4 + 0.8 * np.sin(7 * t) + 0.3 * np.cos(11 * t)]), t


def table_and_arm(robot_of: Callable[[str], Robot], tmp_path: Path) -> Experiment:
    rng = np.random.default_rng(1)
    text = chain(joint("j1", "revolute", "l0", "l1"), joint("j2", "revolute", "l1", "l2", '<axis xyz="0 1 0"/>'))
    for name in ("l1", "l2"):
        text = text.replace(f'<link name="{name}"/>', f'<link name="{name}">{inertial(rng)}</link>')
    robot = robot_of(text)
    paths = []
    for name, accelerates in (("even", False), ("uneven", True)):
        q, t = spun(4.0, accelerates)
        tau = rng.normal(size=q.shape)
        path = tmp_path / f"{name}.csv"
        write_log(path, make_log(path, t, ("j1", "j2"), {"q": q.T, "tau": tau.T}))
        paths.append(path)
    config = parse_config({"friction": {"viscous": False, "coulomb": False}}, "")
    return prepare(robot, config, paths[:1], paths[1:])


def test_a_joint_that_only_now_accelerates(robot_of: Callable[[str], Robot], tmp_path: Path) -> None:
    """Of a table that turned evenly nobody knows the inertia: the torque that speeds it up cannot be told."""
    experiment = table_and_arm(robot_of, tmp_path)
    data = experiment.reduce(lambda stage, share: None)
    found = least_squares_uncertainty(experiment.equation, data, np.ones(2), EqualityConstraints.none(20))
    even, uneven = (prediction(experiment, found, held_out, lambda stage, share: None) for held_out in (False, True))
    assert even.rms.max() < 0.5
    assert uneven.unknown[0] > 0.9 or uneven.rms[0] > 1e3 * even.rms[0]
    assert uneven.unknown[1] < 0.05
    assert uneven.rms[1] < 20 * even.rms[1]
