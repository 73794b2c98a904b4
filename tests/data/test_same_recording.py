"""Logs that hold the same recording, under one name or two, and in different formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from commands import LEG, VALIDATE, VALIDATE_CSV

from idtool.api.data import load_experiment
from idtool.api.log import Log
from idtool.common.notice import Notice
from idtool.data.same_recording import is_same_recording, same_recordings

CODES = ("duplicate_log", "validated_on_training_log")
RATE = 1000.0


def recording(name: str = "run", *, seed: int = 0, torque: float = 0.0, tau: bool = True) -> Log:
    """Two seconds of two joints; ``torque`` is the noise of the torque, ``seed`` that of all noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(2000) / RATE
    q = np.column_stack([np.sin(3 * t), 0.1 * np.cos(5 * t)]) + 1e-3 * rng.standard_normal((2000, 2))
    load = np.column_stack([4 * np.cos(3 * t), np.sin(5 * t)]) + torque * rng.standard_normal((2000, 2))
    return Log.from_arrays(name, t, ["hip", "knee"], q=q, tau=load if tau else None)


def notices(*logs: object, validate: object = ()) -> list[Notice]:
    experiment = load_experiment(LEG, list(logs), validate)  # type: ignore[arg-type]
    return [notice for notice in experiment.notices if notice.code in CODES]


def rounded(log: Log, digits: int) -> Log:
    assert log.tau is not None
    return Log.from_arrays("rounded", log.t, log.joints, q=log.q.round(digits), tau=log.tau.round(digits))


def test_the_same_samples_are_the_same_recording_whatever_was_rounded_or_left_out() -> None:
    log = recording()
    assert is_same_recording(log.record, recording("copy").record)
    assert is_same_recording(log.record, rounded(log, 5).record)
    assert is_same_recording(log.record, recording("positions", tau=False).record)


def test_joints_are_compared_by_name_in_any_order_and_in_any_number_of_logs() -> None:
    log, other = recording(), recording("other", seed=1)
    assert log.tau is not None
    turned = Log.from_arrays("turned", log.t, ["knee", "hip"], q=log.q[:, ::-1], tau=log.tau[:, ::-1])
    swapped = Log.from_arrays("swapped", log.t, ["knee", "hip"], q=log.q, tau=log.tau)
    assert is_same_recording(log.record, turned.record)
    assert not is_same_recording(log.record, swapped.record)
    logs = [each.record for each in (other, log, swapped, turned, recording("copy"))]
    (group,) = same_recordings(logs)
    assert [each.path.name for each in group] == [logs[1].path.name, "turned", "copy"]


def test_another_run_of_the_same_motion_is_another_recording() -> None:
    log = recording()
    assert not is_same_recording(log.record, recording(seed=1).record)
    assert not is_same_recording(log.record, recording(torque=0.01).record)  # a torque of its own
    assert not is_same_recording(log.record, Log.from_arrays("a", log.t[:-1], log.joints, q=log.q[:-1]).record)
    assert not is_same_recording(log.record, Log.from_arrays("b", log.t, ["a", "b"], q=log.q).record)


def test_a_recording_in_two_formats_is_said_to_be_given_twice(tmp_path: Path) -> None:
    (notice,) = notices(VALIDATE, VALIDATE_CSV)
    assert notice.severity == "warning"
    assert notice.message == "the same recording is in leg_validate.mcap, leg_validate.csv"
    assert "agree confirms nothing" in notice.advice
    copy = Log(VALIDATE).save(tmp_path / VALIDATE.name)
    (notice,) = notices(VALIDATE, copy)
    assert notice.message == f"the same recording is in sample_logs/{VALIDATE.name}, {tmp_path.name}/{VALIDATE.name}"


def test_a_recording_that_is_used_for_fit_and_validation_is_said_whatever_its_format() -> None:
    (notice,) = notices(VALIDATE, validate=VALIDATE_CSV)
    assert (notice.code, notice.subject) == ("validated_on_training_log", "leg_validate.csv")
    assert notice.message.startswith("the log is used for validation and, as leg_validate.mcap, for the fit, so")
    (notice,) = notices(VALIDATE, validate=VALIDATE)
    assert notice.message.startswith("the log is used for validation and for the fit, so")
