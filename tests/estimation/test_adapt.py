"""Online identification of logs: how soon, without a look ahead, and what is reported."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from paths import SAMPLES

from idtool.common.exceptions import ConfigError, LogError
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.dataset.weights import weighted_rows
from idtool.estimation.online import adapt as module
from idtool.estimation.online.adapt import Adaptation, adapt, convergence, time_to
from idtool.estimation.problem.estimate import estimate
from idtool.reporting.adaptation_report import adaptation_report
from idtool.robot.config import WEAK_PRIOR, read_config
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]


def quiet(stage: str, share: float) -> None:
    """No progress shown."""


@pytest.fixture(scope="module")
def leg() -> Experiment:
    """The sample leg."""
    robot, config = read_robot(SAMPLES / "leg.urdf"), read_config(SAMPLES / "leg.yaml")
    return prepare(robot, config, [SAMPLES / "leg_train.mcap"], holdout=0.0)


@pytest.fixture(scope="module")
def short(leg: Experiment) -> Experiment:
    """The first four seconds of its log."""
    (run_of_log,) = leg.runs
    return replace(leg, runs=(replace(run_of_log, train=(slice(run_of_log.train[0].start, 4000),)),))


def adapted(experiment: Experiment, name: str, forgetting: float = 20.0) -> Adaptation:
    sets = [choose_set(body, name) for body in experiment.model.bodies]
    return adapt(experiment, sets, forgetting, progress=quiet)


def test_tighter_sets_converge_sooner_on_the_leg(leg: Experiment) -> None:
    """Remark 5: from the URDF's figures to a tenth of their error against the fit of the whole log.

    With the plain distance: the other two keep to realizable bodies by themselves.
    """
    leg = replace(leg, config=leg.config.model_copy(update={"regularization": WEAK_PRIOR}))
    sets = [choose_set(body, "ellipsoid") for body in leg.model.bodies]
    reduction = leg.reduce(quiet)
    target = estimate(leg.equation, leg.model.bodies, reduction, sets, WEAK_PRIOR, leg.equalities)
    rows = weighted_rows(leg.equation, reduction, target.noise)[:, :-1]
    seconds: dict[str, float] = {}
    for name in ("none", "full", "ellipsoid"):
        found = adapted(leg, name)
        error = convergence(found, target.theta, rows)
        assert error[0] == 1
        assert error[-1] < 0.1
        seconds[name] = time_to(found.t, error) or np.inf
        assert found.prediction_rms(leg.equation.joints)["overall"] < 1.2 * target.noise.mean()
    assert seconds["ellipsoid"] <= seconds["full"] + 0.1
    assert seconds["full"] < 0.8 * seconds["none"]


def test_the_end_of_a_log_does_not_change_its_beginning(short: Experiment) -> None:
    cut = 2500
    (signals,) = (run.signals for run in short.runs)
    kept = {name: x.copy() for name, x in signals.log.signals.items()}
    before = adapted(short, "ellipsoid")
    try:
        for x in signals.log.signals.values():  # what was calibrated stays
            x[cut:] *= 1.1
        after = adapted(short, "ellipsoid")
    finally:
        for name, x in kept.items():
            signals.log.signals[name][:] = x
    np.testing.assert_array_equal(before.t, after.t)
    same = (before.theta == after.theta).all(axis=1)
    changed = before.t[np.argmin(same)]
    assert same[before.t < changed].all()
    assert not same[before.t >= changed].any()
    first = signals.log.t[signals.ranges[0].start] - signals.log.t[0]
    assert cut * signals.log.dt - 0.3 < changed + first < cut * signals.log.dt + 0.3


def test_two_logs_follow_each_other(short: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_REPORTED", 100)
    once, twice = adapted(short, "full"), adapted(replace(short, runs=short.runs * 2), "full")
    assert twice.samples == 2 * once.samples > 1000
    assert twice.t[-1] == pytest.approx(2 * once.t[-1])
    assert (np.diff(twice.t) > 0).all()
    for found in (once, twice):
        assert 50 < len(found.t) <= 102
        assert found.t[0] == 0
        np.testing.assert_array_equal(found.theta[-1], found.estimate)


def test_the_report_is_plain_data(short: Experiment) -> None:
    found = adapted(short, "full", np.inf)
    report = json.loads(json.dumps(adaptation_report(found, short).to_json(), allow_nan=False))
    assert report["forgetting"] is None
    assert report["update_hz"] == pytest.approx(1000 / 6)  # of 1 kHz, four rows a period of 40 Hz
    assert report["samples"] == pytest.approx(found.t[-1] * report["update_hz"], abs=1)
    assert report["joints"] == ["abad", "hip", "knee"]
    assert report["constraints"] == dict.fromkeys(report["bodies"], "full")
    assert len(report["t"]) == len(report["theta"]) == len(found.t)
    assert len(report["coefficients"]) == len(report["theta"][0]) == 66
    assert set(report["prediction_rms"]) == {"abad", "hip", "knee", "overall"}
    for i, name in enumerate(report["bodies"]):
        body = report["final"]["bodies"][name]
        assert body["pi"] == report["theta"][-1][10 * i : 10 * i + 10]
        assert body["mass"] == body["pi"][0]
        assert body["realizable"]
        assert len(body["inertia_com"]) == 6
    assert report["final"]["friction"]["knee"]["coulomb"] == report["theta"][-1][-1]
    assert report["final"]["friction"]["knee"]["offset"] is None


@pytest.mark.parametrize("forgetting", [0.0, -1.0, np.nan])
def test_a_time_constant_must_be_positive(leg: Experiment, forgetting: float) -> None:
    with pytest.raises(ConfigError, match="time constant"):
        adapted(leg, "full", forgetting)


def test_a_log_that_the_filters_use_up_is_refused(leg: Experiment) -> None:
    (run_of_log,) = leg.runs
    short = replace(leg, runs=(replace(run_of_log, train=(slice(500, 540),)),))
    with pytest.raises(LogError, match="too short"):
        adapted(short, "full")


def test_the_error_is_that_of_the_parameters_that_the_data_determine() -> None:
    class Short:
        theta = np.array([[0.0, 0.0, 5.0], [1.0, 0.0, 7.0], [1.0, 3.0, 9.0]])
        units = np.array([1.0, 3.0, 1.0])

    rows = np.array([[100.0, 0.0, 0.0], [0.0, 0.01, 0.0]])  # the torque hardly depends on the second
    error = convergence(Short(), np.array([1.0, 3.0, 0.0]), rows)  # type: ignore[arg-type]
    np.testing.assert_allclose(error, [1.0, np.sqrt(0.5), 0.0], atol=1e-12)


def test_the_time_to_an_error_is_that_after_which_it_stays() -> None:
    t, error = np.arange(6.0), np.array([1.0, 0.05, 0.3, 0.1, 0.09, 0.0])
    assert time_to(t, error) == 3.0
    assert time_to(t, error, 0.5) == 1.0
    assert time_to(t[:3], error[:3]) is None
    assert time_to(t, np.zeros(6)) == 0.0
