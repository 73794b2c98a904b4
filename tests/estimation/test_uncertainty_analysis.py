"""How far to trust a fit: intervals and pulls by hand, and what is said of the sample logs, whole, short or spoilt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from leg_truth import true_theta
from numpy.typing import NDArray
from paths import SAMPLES
from scipy import stats
from sentences import texts

from idtool.data.logs import JointLog, make_log, read_log, write_log
from idtool.estimation.dataset import blocks
from idtool.estimation.dataset.blocks import merge_reductions
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.dataset.reduction import Factor
from idtool.estimation.fit import Fit, fit
from idtool.estimation.identification import estimate_from_logs
from idtool.estimation.instruments import instrumented_blocks, instruments
from idtool.estimation.uncertainty import UncertaintyAnalysis, bias, uncertainty_analysis
from idtool.estimation.uncertainty.cluster_robust import ClusterRobustEstimate, cluster_robust_estimate
from idtool.estimation.uncertainty.standard_errors import Uncertainty, least_squares_uncertainty
from idtool.robot.config import WEAK_PRIOR, read_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

TRAIN, OTHER = SAMPLES / "leg_train.mcap", SAMPLES / "leg_validate.mcap"


def silent(stage: str, share: float) -> None:
    """No progress to show."""


def experiment(*logs: Path, holdout: float = 0.0) -> Experiment:
    return prepare(read_robot(SAMPLES / "leg.urdf"), read_config(SAMPLES / "leg.yaml"), list(logs), holdout=holdout)


@cache
def fitted() -> Fit:
    """The sample leg, the whole log, and what it rests on."""
    return fit(experiment(TRAIN), silent, analyze_uncertainty=True)


def held(theta: Array, free: Array, blocks: int = 0) -> tuple[UncertaintyAnalysis, Array]:
    """Three coefficients, the last two felt only as their sum; standard errors of the first and of the sum."""
    equation = SimpleNamespace(coefficients=(SimpleNamespace(scale=None),) * 3, active=lambda: (np.arange(3),))
    x = np.random.default_rng(0).normal(size=(40, 2)) * [1.0, 30.0]
    Y = np.column_stack([x, x[:, 1]])
    data = (Factor.from_columns(np.column_stack([Y, np.zeros(40)]).T),)
    found = least_squares_uncertainty(equation, data, np.array([0.3]))  # type: ignore[arg-type]
    if blocks:
        found = replace(found, cluster_information=np.tile(np.eye(2) / blocks, (blocks, 1, 1)))
    analysis = fitted().uncertainty_analysis
    analysis = replace(
        analysis, theta=theta, uncertainty=found, cluster_robust=replace(analysis.cluster_robust, theta=free)
    )
    return analysis, 0.3 * np.sqrt(np.diag(np.linalg.inv(x.T @ x)))


ROWS = np.array([[1.0, 0, 0], [0, 1, 1], [2, -1, -1], [0, 1, 0]])


@pytest.mark.parametrize("blocks", [0, 5, 40])
def test_an_interval_is_around_the_datas_value_and_the_fits(blocks: int) -> None:
    """By Student's t with a degree of freedom less than blocks."""
    free = np.array([1.0, 2.0, 3.0])
    for apart in (0.0, 0.5, -20.0, 20.0):
        analysis, errors = held(free, free, blocks)
        theta = free + apart * np.append(errors, errors[1] / 2)
        analysis = replace(analysis, theta=theta)
        reach = stats.t.ppf(0.975, blocks - 1) if blocks else stats.norm.ppf(0.975)
        found = analysis.interval(ROWS[:2])
        for row, error, (low, high) in zip(ROWS[:2], errors, found, strict=True):
            told, fitted = row @ free, row @ theta
            assert low == pytest.approx(min(told, fitted) - reach * error)
            assert high == pytest.approx(max(told, fitted) + reach * error)


def test_a_pull_is_in_standard_errors() -> None:
    free = np.array([1.0, 2.0, 3.0])
    analysis, errors = held(free, free)
    analysis = replace(analysis, theta=free + np.array([2.5 * errors[0], 0.0, -4 * errors[1]]))
    assert analysis.pull(ROWS[:2]) == pytest.approx([2.5, 4.0])
    assert analysis.pull(-3 * ROWS[:2]) == pytest.approx([2.5, 4.0])
    variance = 4 * errors[0] ** 2 + errors[1] ** 2 - 4 * covariance_of(analysis.uncertainty)
    assert analysis.pull(ROWS[2:3])[0] == pytest.approx((5 * errors[0] + 4 * errors[1]) / np.sqrt(variance))


def covariance_of(found: Uncertainty) -> float:
    """Of the first coefficient and the sum of the others, by what variances add up to."""
    plus, minus = np.square(found.of(np.array([[1.0, 1, 1], [1, -1, -1]])))
    return float(plus - minus) / 4


def test_what_the_data_do_not_determine_has_no_interval_and_no_pull() -> None:
    analysis, _ = held(np.array([1.0, 2.0, 3.0]), np.array([1.0, 5.0, 0.0]))
    low, high = analysis.interval(ROWS[3:])[0]
    assert (low, high) == (-np.inf, np.inf)
    assert analysis.pull(ROWS[3:]) == pytest.approx([0.0])


def test_the_sample_log_says_how_far_to_trust_it() -> None:
    """Intervals of base parameters hold the truth as often as they say, give or take; nothing is wrong with the log."""
    found = fitted()
    analysis = found.uncertainty_analysis
    assert analysis.identifiability
    B = analysis.identifiability.base.B
    assert np.isfinite(analysis.interval(B)).all()
    truth = B @ true_theta(found.experiment)
    low, high = analysis.interval(B).T
    assert ((low <= truth) & (truth <= high)).mean() > 0.85
    for values in (B @ found.estimate.theta, B @ analysis.cluster_robust.theta):
        assert ((low <= values) & (values <= high)).all()
    assert analysis.cluster_robust.bootstrap
    assert not any("log for longer" in said or "resampled" in said for said in texts(analysis.notices))
    assert analysis.repeatability is None
    np.testing.assert_array_equal(analysis.theta, found.estimate.theta)


def test_every_parameter_rests_on_something_and_its_range_holds_it() -> None:
    """Where the prior is weak: a firm one keeps bodies off the limits of their sets."""
    e = experiment(TRAIN)
    e = replace(e, config=e.config.model_copy(update={"regularization": WEAK_PRIOR}))
    found = fit(e, silent, analyze_uncertainty=True)
    asked = found.uncertainty_analysis.identifiability
    assert asked
    bases = asked.sources
    assert len(bases) == 10 * len(found.experiment.model.bodies)
    assert {basis.information_source for basis in bases} == {"data", "combination", "constraints", "prior"}
    for theta, basis in zip(found.estimate.theta, bases, strict=False):
        low, high = basis.range
        assert low is None or low <= theta + 1e-6
        assert high is None or theta <= high + 1e-6


def test_more_of_a_log_is_trusted_more() -> None:
    part = fit(experiment(TRAIN, holdout=0.7), silent).uncertainty_analysis
    whole = fitted().uncertainty_analysis
    assert part.identifiability is None
    ratio = part.uncertainty.of(base()) / whole.uncertainty.of(base())
    assert np.median(ratio) == pytest.approx(np.sqrt(1 / 0.3), rel=0.35)


def analysis_with(share: float, blocks: int | None = None) -> UncertaintyAnalysis:
    """The sample fit's trust from its first so many blocks, its residual worth a share of their independent samples."""
    found = fitted().experiment
    solution = estimate_from_logs(found, "ls", silent)
    data = tuple(replace(log, parts=log.parts[:blocks]) for log in solution.data)
    reduction = merge_reductions([log.total for log in data])
    count = float(np.mean([factor.independent for factor in reduction]))
    independent = dict.fromkeys(found.equation.joints, share * count)
    return uncertainty_analysis(found, replace(solution, data=data, reduction=reduction), independent, silent, False)


def base() -> Array:
    """The base parameters as combinations."""
    asked = fitted().uncertainty_analysis.identifiability
    assert asked
    return asked.base.B


def test_a_short_log_is_told_by_its_spectrum() -> None:
    """Fewer than 16 blocks: standard errors go with the root of the number of independent samples, and it is said."""
    one, fourth, more = (analysis_with(share, 10) for share in (1.0, 0.25, 4.0))
    for analysis in (one, fourth, more):
        assert analysis.cluster_robust.bootstrap is None
        (said,) = (said for said in texts(analysis.notices) if "blocks" in said)
        assert "too short for the 16 blocks" in said
        assert "log for longer" in said
    B = base()[one.uncertainty.directions.determines(base())]
    assert len(B) > 20
    np.testing.assert_allclose(fourth.uncertainty.of(B) / one.uncertainty.of(B), 2, rtol=1e-6)
    np.testing.assert_allclose(
        more.uncertainty.of(B), one.uncertainty.of(B), rtol=1e-6
    )  # none is worth more than itself


def test_with_enough_blocks_the_scatter_is_believed() -> None:
    one, fourth = (analysis_with(share) for share in (1.0, 0.25))
    np.testing.assert_array_equal(fourth.uncertainty.of(base()), one.uncertainty.of(base()))
    np.testing.assert_array_equal(one.uncertainty.of(base()), one.cluster_robust.uncertainty.of(base()))


def test_where_blocks_are_too_short_the_spectrum_has_a_say(monkeypatch: pytest.MonkeyPatch) -> None:
    """It makes standard errors larger, never smaller, and it is said."""

    times = 1.0

    def correlated(*rest: Any) -> ClusterRobustEstimate:
        found = cluster_robust_estimate(*rest)
        wider = replace(found.uncertainty, covariance_y=times * found.uncertainty.covariance_y)
        return replace(found, uncertainty=wider, correlated_beyond_clusters=True)

    plain = analysis_with(1.0).uncertainty
    monkeypatch.setattr("idtool.estimation.uncertainty.analysis.cluster_robust_estimate", correlated)
    many, few = analysis_with(4.0), analysis_with(1 / 400)
    np.testing.assert_allclose(many.uncertainty.of(base()), plain.of(base()), rtol=0.4)
    assert (many.uncertainty.of(base()) >= plain.of(base()) * (1 - 1e-9)).all()
    worth = few.uncertainty.directions.independent_per_row
    assert np.trace(few.uncertainty.covariance_y) * worth / len(few.uncertainty.covariance_y) == pytest.approx(400)
    times = 9.0
    np.testing.assert_allclose(analysis_with(1.0).uncertainty.of(base()), 3 * plain.of(base()), rtol=1e-6)
    for analysis in (many, few):
        assert any("correlated over more than" in said for said in texts(analysis.notices))


@pytest.mark.parametrize("memory", [256 << 20, 1 << 20])
@pytest.mark.parametrize("logs", [1, 2])
def test_factors_with_instruments_take_the_memory_that_is_expected(
    monkeypatch: pytest.MonkeyPatch, memory: int, logs: int
) -> None:
    """Where their number is bounded by the memory, they are fewer than those of the least squares."""
    monkeypatch.setattr(blocks, "_MEMORY", memory)
    monkeypatch.setattr(blocks, "_FEWEST_BLOCKS", 4)
    used = experiment(*(TRAIN, OTHER)[:logs])
    made = instruments(used, used.equation.prior, silent)
    data = instrumented_blocks(used, made, silent)
    taken = 0
    for log in data:
        for part in log.parts:
            taken += sum(factor.R.nbytes for factor in part)
    assert bias.factor_bytes(used) == pytest.approx(taken, rel=0.05)
    assert taken < 1.2 * memory
    plain = used.reduce_in_blocks(silent)
    is_bounded = memory == 1 << 20
    assert (sum(map(len, data)) < sum(map(len, plain))) == is_bounded


def test_bias_is_not_looked_for_where_it_would_take_much_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    used = fitted().experiment
    identification = estimate_from_logs(used, "ls", silent)
    expected = bias.factor_bytes(used)
    monkeypatch.setattr(bias, "_MOST_BYTES", expected - 1)
    assert bias.paired_estimates(used, identification, silent) is None
    monkeypatch.setattr(bias, "_MOST_BYTES", expected)
    assert bias.paired_estimates(used, identification, silent) is not None


@pytest.fixture
def spoilt(tmp_path: Path) -> Callable[[str, Callable[[JointLog], Array]], Path]:
    """Writes the sample log with another torque."""

    def write(name: str, torque: Callable[[JointLog], Array]) -> Path:
        log, path = read_log(TRAIN), tmp_path / f"{name}.csv"
        signals = {**log.signals, "tau": torque(log)}
        write_log(path, make_log(path, log.t, log.joints, signals))
        return path

    return write


def test_a_log_of_a_stiffer_knee_is_named(spoilt: Callable[[str, Callable[[JointLog], Array]], Path]) -> None:
    """Three logs, one of which has far more friction at the knee: named by its file, and by what differs."""

    def stiff(log: JointLog) -> Array:
        tau, knee = log.signals["tau"].copy(), log.joints.index("knee")
        v = log.signals["v"][:, knee]
        tau[:, knee] += 0.5 * v
        return np.asarray(tau)

    path = spoilt("stiff", stiff)
    found = fit(experiment(TRAIN, OTHER, path), silent, analyze_uncertainty=True).uncertainty_analysis
    compared, asked = found.repeatability, found.identifiability
    assert compared
    assert asked
    assert compared.outlier == 2
    assert any("the log that differs from the others is stiff.csv" in said for said in texts(found.notices))
    coefficients = fitted().experiment.equation.coefficients
    differ = [coefficients[k] for k in asked.base.own[~compared.agrees]]
    assert ("knee", "viscous") in [(c.owner, c.name) for c in differ]
    assert len(differ) < 6


def test_two_logs_of_one_leg_agree() -> None:
    found = fit(experiment(TRAIN, OTHER), silent, analyze_uncertainty=True).uncertainty_analysis
    assert found.repeatability
    assert found.repeatability.agrees.mean() > 0.9
    assert found.repeatability.outlier is None
