"""Errors before and after a step, and whether an increase is more than chance."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from disturbed import experiment_of, nothing, silent

from idtool.diagnosis.error_summary import evaluate_errors, increases_error
from idtool.diagnosis.records import ErrorSummary
from idtool.estimation.evaluation.torque_errors import evaluate


def summary_of(squares_by_second: Sequence[float]) -> ErrorSummary:
    overall = float(np.sqrt(np.sum(squares_by_second)))
    return ErrorSummary({"overall": overall}, None, None, np.array(squares_by_second))


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        ([1.0, 1.0, 1.0, 1.0], False),  # the same
        ([0.9, 0.9, 0.9, 0.9], False),  # smaller
        ([1.003, 1.003, 1.003, 1.003], True),  # slightly larger, in every second
        ([1.04, 0.97, 1.02, 0.98], False),  # slightly larger in sum, now larger, now smaller
        ([1.0, 1.1, 1.1, 1.0], True),  # larger by more than chance may explain
    ],
)
def test_a_small_increase_counts_if_it_is_much_beside_its_scatter(after: Sequence[float], expected: bool) -> None:
    assert increases_error(summary_of([1.0] * 4), summary_of(after)) == expected


def test_without_errors_by_second_every_increase_counts() -> None:
    before, after = (ErrorSummary({"overall": error}, None, None) for error in (1.0, 1.003))
    assert increases_error(before, after)
    assert not increases_error(before, before)


def test_seconds_without_samples_do_not_count() -> None:
    """Ten seconds were not held out; the increase in the other two is no chance."""
    before = summary_of([0.0] * 10 + [1.0, 1.0])
    assert increases_error(before, summary_of([0.0] * 10 + [1.004, 1.003]))
    assert not increases_error(before, summary_of([0.0] * 10 + [1.05, 0.96]))


def test_the_squared_errors_of_all_seconds_add_up(tmp_path: Path) -> None:
    experiment = experiment_of(tmp_path, nothing)
    theta = experiment.equation.prior
    errors = evaluate(experiment, {"prior": theta}, experiment.has_held_out, silent).errors["prior"]
    by_second = evaluate_errors(experiment, theta, False, silent).torque_squares_by_second
    assert by_second is not None
    (run,) = experiment.runs
    held_out = sum(part.stop - part.start for part in run.held_out) * run.signals.log.dt
    assert len(by_second) == int(held_out) + 1
    np.testing.assert_allclose(by_second.sum(), errors.sum_squares_in_band.sum(), rtol=1e-12)
