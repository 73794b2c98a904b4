"""Sample of the training data: windows that are spread evenly over long logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from paths import SAMPLES
from prescribed_motions import silent

from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.dataset.training_sample import training_sample
from idtool.robot.config import Config
from idtool.robot.urdf.reading import read_robot


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    logs = [SAMPLES / "leg_train.mcap", SAMPLES / "leg_validate.csv"]
    return prepare(read_robot(SAMPLES / "leg.urdf"), Config(), logs)


def durations(experiment: Experiment) -> list[float]:
    """Duration of the training data of each log [s]."""
    return [run.signals.log.dt * sum(part.stop - part.start for part in run.train) for run in experiment.runs]


def test_short_logs_are_used_as_they_are(experiment: Experiment) -> None:
    assert training_sample(experiment, sum(durations(experiment))) is experiment


def test_windows_are_spread_evenly_over_all_logs(experiment: Experiment) -> None:
    whole = durations(experiment)
    share = 0.6
    sample = training_sample(experiment, share * sum(whole))
    assert sum(durations(sample)) == pytest.approx(share * sum(whole), abs=3.0)
    for run, sampled, duration in zip(experiment.runs, sample.runs, whole, strict=True):
        assert sum(durations(replace(sample, runs=(sampled,)))) == pytest.approx(share * duration, abs=1.6)
        (part,) = run.train
        edges = [part.start, *(edge for window in sampled.train for edge in (window.start, window.stop)), part.stop]
        assert (np.diff(edges) >= 0).all()
        left_out = np.diff(edges)[::2]
        np.testing.assert_allclose(left_out[1:-1], 2 * left_out[0], atol=2)
        assert left_out[-1] == pytest.approx(left_out[0], abs=2)
    assert sample.samples(held_out=True) == experiment.samples(held_out=True)


def test_windows_are_within_their_part_and_apart(experiment: Experiment) -> None:
    run = experiment.runs[0]
    window = round(3.0 / run.signals.log.dt)
    for samples in np.linspace(window, 4 * window, 13).astype(int).tolist():
        for share in (0.01, 0.3, 0.5, 0.7, 0.9, 0.99):
            part = slice(100, 100 + samples)
            one_part = replace(experiment, runs=(replace(run, train=(part,)),))
            windows = training_sample(one_part, share * samples * run.signals.log.dt).runs[0].train
            edges = [part.start, *(edge for each in windows for edge in (each.start, each.stop)), part.stop]
            assert (np.diff(edges) >= 0).all()


def test_of_many_short_parts_only_some_are_taken(experiment: Experiment) -> None:
    run = experiment.runs[0]
    start = run.train[0].start
    short = replace(run, train=tuple(slice(start + 500 * i, start + 500 * i + 400) for i in range(12)))
    sample = training_sample(replace(experiment, runs=(short, short)), 6 * 400 * run.signals.log.dt)
    assert [len(each.train) for each in sample.runs] == [3, 3]


def test_joints_without_samples_are_no_error(experiment: Experiment) -> None:
    runs = tuple(replace(run, train=(slice(0, 20),)) for run in experiment.runs)
    reduction = replace(experiment, runs=runs).reduce_unchecked(silent)
    assert [factor.rows for factor in reduction] == [0] * len(experiment.model.joints)


def test_parts_between_gaps_that_are_short_are_kept_whole(experiment: Experiment) -> None:
    run = experiment.runs[0]
    start = run.train[0].start
    short = replace(run, train=(slice(start, start + 500), slice(start + 600, start + 5600)))
    sample = training_sample(replace(experiment, runs=(short,)), 3.0)
    assert sample.runs[0].train[0] == short.train[0]
    (window,) = sample.runs[0].train[1:]
    assert window.stop - window.start == round(3.0 / run.signals.log.dt)
