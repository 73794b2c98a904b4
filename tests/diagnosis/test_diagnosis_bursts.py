"""Contacts are found by when they come and go; what comes and goes otherwise is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import config_with, idtool
from disturbed import Array, Hidden, after_reversals, contact, experiment_of, motion, nothing, silent, torque_on_joint

from idtool.diagnosis.bursts import find_bursts
from idtool.diagnosis.linearized_fit import linearize_fit

WINDOWS = ((2.113, 4.207), (6.551, 7.009), (10.204, 14.498))


def test_contacts_are_found_although_the_model_is_fitted_to_them(tmp_path: Path) -> None:
    """To within 10 ms, in training and held-out parts, with a gap in the log, from a model that they have bent."""
    rows = np.abs(motion()[0] - 9.0) > 0.3
    friction = {"viscous": True, "coulomb": True}
    experiment = experiment_of(tmp_path, contact(*WINDOWS), rows=rows, friction=friction)
    (burst,) = find_bursts(experiment, linearize_fit(experiment, silent).theta, silent)
    np.testing.assert_allclose(burst.windows, WINDOWS, atol=0.01)


@pytest.mark.parametrize(
    ("begin", "end", "windows"), [(0.0, 2.5, ((0.0, 2.5),)), (14.0, 16.0, ((14.0, 16.0),)), (0.0, 16.0, ())]
)
def test_a_contact_may_be_there_from_the_start_or_to_the_end(
    tmp_path: Path, begin: float, end: float, windows: tuple[tuple[float, float], ...]
) -> None:
    experiment = experiment_of(tmp_path, contact((begin, end)))
    bursts = find_bursts(experiment, experiment.equation.prior, silent)
    found = bursts[0].windows if bursts else ()
    assert len(found) == len(windows)
    np.testing.assert_allclose(np.reshape(found, (-1, 2)), np.reshape(windows, (-1, 2)), atol=0.01)


def ramp(t: Array) -> Array:
    """From 5 to 8 s, come and gone within 0.3 s each."""
    return np.clip(np.minimum(t - 5.0, 8.0 - t) / 0.3, 0.0, 1.0)


NO_CONTACTS: dict[str, Hidden] = {
    "nothing": nothing,
    "friction that rises at low speed": torque_on_joint(
        0, lambda t, q, v, tau: 2 * np.exp(-np.square(v / 0.3)) * np.tanh(v / 0.01)
    ),
    "friction after reversals": torque_on_joint(0, lambda *state: 2 * after_reversals(*state)),
    "an end stop": torque_on_joint(0, lambda t, q, v, tau: 10 * np.maximum(q - 0.8, 0.0)),
    "ripple": torque_on_joint(0, lambda t, q, v, tau: 0.5 * np.sin(28 * q)),
    "saturation": torque_on_joint(0, lambda t, q, v, tau: -0.5 * np.sign(tau) * np.maximum(np.abs(tau) - 10, 0.0)),
    "what comes and goes slowly": torque_on_joint(0, lambda t, q, v, tau: 2 * ramp(t)),
    "what swings through zero": torque_on_joint(
        0, lambda t, q, v, tau: 2 * np.cos(2 * np.pi * (t - 6)) * (np.abs(t - 6.5) < 0.5)
    ),
    "a kick": torque_on_joint(1, lambda t, q, v, tau: 5.0 * (np.abs(t - 6) < 0.05)),
    "shaking": torque_on_joint(1, lambda t, q, v, tau: 2.0 * (np.abs(t - 6) < 1) * np.sin(60 * t)),
}


@pytest.mark.parametrize("hidden", NO_CONTACTS.values(), ids=NO_CONTACTS)
def test_what_is_no_contact(tmp_path: Path, hidden: Hidden) -> None:
    experiment = experiment_of(tmp_path, hidden)
    assert find_bursts(experiment, experiment.equation.prior, silent) == ()


def test_what_was_seen_neither_to_come_nor_to_go(tmp_path: Path) -> None:
    """Between two gaps of the log."""
    t = motion()[0]
    rows = np.minimum(np.abs(t - 5.8), np.abs(t - 8.2)) > 0.2
    experiment = experiment_of(tmp_path, contact((5.8, 8.2)), rows=rows)
    assert find_bursts(experiment, experiment.equation.prior, silent) == ()


def test_with_several_logs_a_contact_has_the_name_of_its_own(tmp_path: Path) -> None:
    """Its windows count from this log's first sample."""
    experiment = experiment_of(tmp_path, nothing, contact(WINDOWS[0]), contact(*WINDOWS[1:]))
    bursts = find_bursts(experiment, experiment.equation.prior, silent)
    second, third = (burst for burst in bursts if not burst.link)  # the others are pushes, for comparison
    assert (second.log, third.log) == ("log1.csv", "log2.csv")
    np.testing.assert_allclose(second.windows, WINDOWS[:1], atol=0.01)
    np.testing.assert_allclose(third.windows, WINDOWS[1:], atol=0.01)


@pytest.mark.slow
def test_diagnose_names_a_contact_in_each_of_several_logs(tmp_path: Path) -> None:
    friction = {"viscous": False, "coulomb": False}
    experiment_of(tmp_path, nothing, contact(WINDOWS[0]), contact(*WINDOWS[1:]))
    config = config_with(tmp_path / "arm.yaml", friction=friction)
    logs = [tmp_path / f"log{i}.csv" for i in range(3)]
    command = ["diagnose", tmp_path / "arm.urdf", *logs, "--config", config, "--out", tmp_path / "out", "--json"]
    done = idtool(*command)
    assert done.code == 0, done.err
    steps = [step for step in done.json["steps"] if step["effect"] != "unknown"]
    assert [(step["effect"], step["link"]) for step in steps] == [("external_contact", "lower")] * 2
    assert {step["parameters"]["log"] for step in steps} == {"log1.csv", "log2.csv"}
    assert done.json["gap_closed"]["overall"] > 0.95
