"""What questions cost for robots of many joints: memory, and work that is done once."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from paths import SAMPLES

from idtool.estimation.dataset.experiment import prepare
from idtool.estimation.fit import fit
from idtool.estimation.uncertainty import UncertaintyAnalysis, cluster_robust
from idtool.estimation.uncertainty.standard_errors import Directions, Uncertainty
from idtool.reporting.fit_report import fit_report
from idtool.robot.config import read_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

SEEN, BLOCKS = 120, 64


def peak(work: Callable[[], object]) -> float:
    """The most memory that numpy holds at a time meanwhile [MiB]."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module")
def shares() -> Array:
    x = np.random.default_rng(0).normal(size=(BLOCKS, SEEN, SEEN))
    found = x @ x.transpose(0, 2, 1)
    return np.asarray(found / np.trace(found.sum(axis=0)) * SEEN)


def test_the_bootstrap_takes_little_more_than_the_blocks(shares: Array) -> None:
    """Its 400 draws at a time would take 44 MiB."""
    s = np.random.default_rng(1).normal(size=(BLOCKS, SEEN))
    rng = np.random.default_rng(2)
    assert peak(lambda: cluster_robust._bootstrap_covariance(shares, s, np.zeros((SEEN, SEEN)), rng)) < 12


def test_degrees_of_freedom_are_satterthwaites(shares: Array) -> None:
    """By their definition, row by row."""
    rows = np.random.default_rng(3).normal(size=(3, SEEN))
    eye = np.eye(SEEN)
    seen = Directions(eye, np.zeros((SEEN, 0)), np.ones(SEEN), np.zeros((SEEN, SEEN)), 1.0, 1000.0)
    found = Uncertainty(seen, np.ones(SEEN, dtype=bool), eye, shares)
    held = np.array([[row @ share @ row for share in shares] for row in rows])
    expected = held.sum(axis=1) ** 2 / np.square(held).sum(axis=1) - 1
    np.testing.assert_allclose(found.degrees_of_freedom(rows), expected, rtol=1e-9)


@pytest.mark.parametrize("known_share", [0.3, 0.9, 1.0])
def test_a_variance_of_which_part_is_known_has_more_degrees_of_freedom(shares: Array, known_share: float) -> None:
    """Satterthwaite's definition, 2 E² / Var, on many draws of the variance that the clusters tell."""
    cluster_information = (1 - known_share) * shares
    constraints = np.eye(SEEN) - cluster_information.sum(axis=0)
    seen = Directions(np.eye(SEEN), np.zeros((SEEN, 0)), np.ones(SEEN), constraints, 1.0, 1000.0)
    found = Uncertainty(seen, np.ones(SEEN, dtype=bool), np.eye(SEEN), cluster_information)
    row = np.random.default_rng(3).normal(size=(1, SEEN))
    held = np.array([float(row[0] @ own @ row[0]) for own in cluster_information])
    known = float(row[0] @ constraints @ row[0])
    draws = np.square(np.random.default_rng(4).normal(size=(20_000, len(held)))) @ held + known
    freedom = found.degrees_of_freedom(row)[0]
    if known_share == 1:
        assert freedom == np.inf
    else:
        expected = 2 * draws.mean() ** 2 / draws.var()
        assert freedom == pytest.approx(expected, rel=0.1)


def test_a_report_asks_for_all_intervals_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not once a body."""
    experiment = prepare(
        read_robot(SAMPLES / "leg.urdf"), read_config(SAMPLES / "leg.yaml"), [SAMPLES / "leg_train.mcap"]
    )
    found = fit(experiment, lambda *_: None)
    count, asked = len(found.estimate.theta), []
    interval = UncertaintyAnalysis.interval
    monkeypatch.setattr(
        UncertaintyAnalysis, "interval", lambda self, rows: asked.append(len(rows)) or interval(self, rows)
    )
    report = fit_report(found).to_json()
    assert asked.count(count) == 1
    half = found.uncertainty.of(np.eye(count)) * found.uncertainty.coverage_factor(np.eye(count))
    pairs = [pair for body in report["bodies"].values() for pair in body["interval"]]
    for pair, reach in zip(pairs, half, strict=False):
        assert (pair is None) == np.isinf(reach)
        assert pair is None or pair[1] - pair[0] >= 2 * reach * (1 - 1e-9)
