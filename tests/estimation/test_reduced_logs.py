"""Logs reduced in one pass: errors and curves of any model from them, compared with those from all samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paths import SAMPLES

from idtool.common.arrays import Array
from idtool.estimation.dataset.experiment import Experiment, Rows, Run, prepare
from idtool.estimation.dataset.extreme_rows import ExtremeRows
from idtool.estimation.dataset.reduced_logs import ReducedLog, reduce_logs, training_blocks
from idtool.estimation.evaluation.reduced_errors import evaluate_reduced
from idtool.estimation.evaluation.torque_errors import evaluate
from idtool.estimation.uncertainty.prediction import prediction, reduced_prediction
from idtool.estimation.uncertainty.standard_errors import least_squares_uncertainty
from idtool.robot.config import read_config
from idtool.robot.urdf.reading import read_robot

BINS = 5


def silent(stage: str, share: float) -> None:
    """Ignore the progress."""


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    """The sample leg with both of its logs, a third held out of each."""
    logs = [SAMPLES / "leg_train.mcap", SAMPLES / "leg_validate.mcap"]
    return prepare(read_robot(SAMPLES / "leg.urdf"), read_config(SAMPLES / "leg.yaml"), logs, holdout=1 / 3)


@pytest.fixture(scope="module")
def reduced(experiment: Experiment) -> tuple[ReducedLog, ...]:
    """The same, reduced."""
    return reduce_logs(experiment, silent)


@pytest.fixture(scope="module")
def models(experiment: Experiment) -> dict[str, Array]:
    """Two models."""
    prior = experiment.equation.prior
    return {"heavier": 1.2 * prior, "prior": prior}


@pytest.mark.parametrize("held_out", [False, True])
def test_errors_are_those_of_all_samples(
    experiment: Experiment, reduced: Sequence[ReducedLog], models: dict[str, Array], held_out: bool
) -> None:
    """Sums over the samples of the band stand for those over all samples."""
    exact = evaluate(experiment, models, held_out, silent)
    evaluation = evaluate_reduced(experiment.equation, reduced, models, held_out)
    joints = experiment.equation.joints
    for name, errors in exact.errors.items():
        assert evaluation.errors[name].samples == errors.samples
        assert evaluation.errors[name].rms(joints) == pytest.approx(errors.rms(joints), rel=1e-3)
        assert evaluation.errors[name].rms(joints, raw=True) == pytest.approx(errors.rms(joints, raw=True), rel=2e-3)
    assert evaluation.torque_std == pytest.approx(exact.torque_std, rel=1e-9)
    if not held_out:
        assert evaluation.independent_samples == pytest.approx(exact.independent_samples, rel=1e-2)


def test_held_out_parts_need_no_blocks(
    experiment: Experiment, reduced: Sequence[ReducedLog], models: dict[str, Array]
) -> None:
    divided = reduce_logs(experiment, silent, divides_held_out=True)
    assert [len(log.held_out[0].blocks) for log in reduced] == [1, 1]
    assert all(len(log.held_out[0].blocks) > 10 for log in divided)
    joints = experiment.equation.joints
    for held_out in (False, True):
        whole = evaluate_reduced(experiment.equation, reduced, models, held_out)
        of_blocks = evaluate_reduced(experiment.equation, divided, models, held_out)
        for name in models:
            assert whole.errors[name].rms(joints) == pytest.approx(of_blocks.errors[name].rms(joints), rel=1e-11)


def test_training_data_are_those_of_the_fit(experiment: Experiment, reduced: Sequence[ReducedLog]) -> None:
    """And those of all columns, of which a reduction evaluates only independent ones."""

    def all_rows(run: Run) -> Rows:
        return experiment.batches(run, False).map(experiment.equation.counted_rows)

    blocks = experiment.blocks(all_rows, silent, "reading")
    for log, own in zip(blocks, training_blocks(experiment, reduced), strict=True):
        assert (own.name, len(own), own.seconds) == (log.name, len(log), log.seconds)
        for part, own_part in zip(log.parts, own.parts, strict=True):
            for factor, own_factor in zip(part, own_part, strict=True):
                np.testing.assert_allclose(own_factor.R.T @ own_factor.R, factor.R.T @ factor.R, atol=1e-9)
                assert (own_factor.rows, own_factor.independent) == (factor.rows, factor.independent)


@pytest.mark.parametrize("held_out", [False, True])
def test_standard_errors_of_the_torque_are_those_of_all_rows(
    experiment: Experiment, reduced: Sequence[ReducedLog], held_out: bool
) -> None:
    """Of the largest, the rows that are kept hold most."""
    total = experiment.reduce(silent)
    noise = np.ones(len(total))
    uncertainty = least_squares_uncertainty(experiment.equation, total, noise, experiment.equalities)
    exact = prediction(experiment, uncertainty, held_out, silent)
    own = reduced_prediction(experiment.equation, reduced, uncertainty, held_out)
    np.testing.assert_allclose(own.rms, exact.rms, rtol=0.02)  # it includes the rows that don't count in a fit
    assert (own.largest > 0.7 * exact.largest).all()
    assert (own.largest < 1.3 * exact.largest).all()
    np.testing.assert_array_equal(own.unknown, exact.unknown)


def test_standard_errors_of_the_torque_do_not_depend_on_the_prior_of_the_reduction(experiment: Experiment) -> None:
    reduced = reduce_logs(experiment, silent)
    noise = np.ones(len(experiment.equation.joints))
    data = experiment.reduce(silent)
    uncertainty = least_squares_uncertainty(experiment.equation, data, noise, experiment.equalities)
    before = reduced_prediction(experiment.equation, reduced, uncertainty, False)
    for log in reduced:
        for rows in log.train[0].extremes.rows:
            rows[:, 2:, :-2] *= 10  # those that the prior's error chose
    after = reduced_prediction(experiment.equation, reduced, uncertainty, False)
    for name in ("rms", "largest", "unknown"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))


def test_curves_hold_the_extremes_of_torque_and_prior_error(
    experiment: Experiment, reduced: Sequence[ReducedLog], models: dict[str, Array]
) -> None:
    """Rows are chosen by both; only what lies between samples of the band is missed."""
    prior = {"prior": models["prior"]}
    exact = evaluate(experiment, prior, False, silent, angles=True)
    own = evaluate_reduced(experiment.equation, reduced, prior, False)
    for trace, own_trace in zip(exact.traces, own.traces, strict=True):
        assert own_trace.name == trace.name
        assert own_trace.curves.keys() == trace.curves.keys()
        for curve in ("q", "measured", "residual"):
            x, own_x = trace.curves[curve], own_trace.curves[curve]
            span = np.nanmax(x, axis=1) - np.nanmin(x, axis=1)
            assert (np.abs(np.nanmax(own_x, axis=1) - np.nanmax(x, axis=1)) < 0.05 * span).all()
            assert (np.abs(np.nanmin(own_x, axis=1) - np.nanmin(x, axis=1)) < 0.05 * span).all()


def test_it_does_not_matter_how_many_processes_read(
    experiment: Experiment, reduced: Sequence[ReducedLog], models: dict[str, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Blocks that lie across two processes' shares, too."""
    monkeypatch.setattr("idtool.estimation.dataset.passes._FEWEST_BATCHES", 1)
    evaluations = []
    for count in (1, 3):
        monkeypatch.setattr("idtool.estimation.dataset.passes.process_count", lambda count=count: count)
        logs = reduce_logs(experiment, silent)
        blocks = training_blocks(experiment, logs)
        grams = [factor.R.T @ factor.R for log in blocks for part in log.parts for factor in part]
        evaluations.append((grams, evaluate_reduced(experiment.equation, logs, models, True)))
    (grams, one), (own_grams, three) = evaluations
    for gram, own_gram in zip(grams, own_grams, strict=True):
        np.testing.assert_allclose(own_gram, gram, rtol=0, atol=1e-10 * np.abs(gram).max())
    joints = experiment.equation.joints
    for name, errors in one.errors.items():
        assert three.errors[name].rms(joints) == pytest.approx(errors.rms(joints), rel=1e-9)
        assert three.errors[name].rms(joints, raw=True) == pytest.approx(errors.rms(joints, raw=True), rel=1e-9)
    for trace, own_trace in zip(one.traces, three.traces, strict=True):
        for curve, x in trace.curves.items():
            np.testing.assert_allclose(own_trace.curves[curve], x, rtol=0, atol=1e-9, err_msg=curve)


@given(
    st.lists(st.tuples(st.integers(0, BINS - 1), st.integers(-9, 9), st.integers(-9, 9)), max_size=40),
    st.integers(0, 40),
)
def test_extreme_rows_are_those_of_all(samples: list[tuple[int, int, int]], cut: int) -> None:
    """In each bin, each quantity's least and greatest row, wherever the samples are cut into pieces."""
    samples.sort(key=lambda sample: sample[0])
    pieces = [samples[:cut], samples[cut:]]
    merged = ExtremeRows([3], BINS)
    for piece in pieces:
        rows = ExtremeRows([3], BINS)
        x = np.array(piece, dtype=float).reshape(-1, 3).T
        rows.add(x[0].astype(int), [[x]], (x[1:2], x[2:]))
        merged.merge(rows)
    for number in range(BINS):
        own = np.array([sample for sample in samples if sample[0] == number], dtype=float).reshape(-1, 3)
        kept = merged.rows[0][number]
        if not len(own):
            assert np.isnan(kept).all()
            continue
        for quantity in (1, 2):
            low, high = kept[2 * quantity - 2], kept[2 * quantity - 1]
            assert low[quantity] == own[:, quantity].min()
            assert high[quantity] == own[:, quantity].max()
            assert low.tolist() in own.tolist()
            assert high.tolist() in own.tolist()
