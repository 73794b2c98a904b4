"""The delay from command to torque: against drives in MuJoCo that are late by a known time, and on the sample logs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from leg_motions import RATE, Motion, shell
from leg_truth import CONFIG, JOINTS, SAMPLES, TRUTH, URDF
from numpy.typing import NDArray
from position_leg import GAINS, KD, KP, noisy, position_controlled
from scipy.interpolate import make_interp_spline
from sentences import sentences

import idtool
from idtool.data.controller import MAX_DELAY
from idtool.data.filters import delay_signal
from idtool.data.logs import JointLog, make_log, read_log
from idtool.estimation.command_delay import CommandDelay, command_delay, with_delay
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.fit import Fit, fit
from idtool.reporting.fit_report import fit_report, model_config
from idtool.robot.config import parse_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

MS = 1e-3
DELAYS = (0.0, 3 * MS, 7.5 * MS, 12 * MS)


def silent(stage: str, share: float) -> None:
    """No progress."""


def experiment_of(*logs: JointLog, controller: dict[str, Any] | None = None, **options: Any) -> Experiment:
    """The sample leg with logs of drives of `GAINS`."""
    config = parse_config({**CONFIG, "controller": {**GAINS, **(controller or {})}, **options}, "leg.yaml")
    return prepare(read_robot(URDF), config, logs)


def found_in(log: JointLog, **options: Any) -> CommandDelay:
    """The delay that a log tells."""
    found = command_delay(experiment_of(log, **options), silent)
    assert found is not None
    return found


@cache
def motion() -> Motion:
    """Six seconds of the paper's."""
    return shell(6.0)


@cache
def run(delay: float, held: bool = False) -> JointLog:
    """The leg along it, without noise."""
    return position_controlled(motion(), delay, held=held)


@pytest.mark.parametrize("delay", DELAYS)
def test_the_delay_of_a_position_controlled_leg_is_found(delay: float) -> None:
    found = found_in(noisy(run(delay), seed=1))
    assert found.value == pytest.approx(delay, abs=0.05 * MS)
    assert found.standard_error is not None
    assert 0 < found.standard_error < 0.05 * MS
    assert found.value == pytest.approx(delay, abs=5 * found.standard_error)


def test_a_command_that_is_held_is_half_a_sample_later() -> None:
    found = found_in(noisy(run(3 * MS, held=True), seed=1))
    assert found.value == pytest.approx(3 * MS + 0.5 / RATE, abs=0.03 * MS)


def late_command(log: JointLog, delay: float) -> JointLog:
    """A log with the position command that its torque is the answer to, so much later, in the torque's place."""
    kp, t = KP[0], log.t
    answered = log.signals["q"] + log.signals["tau"] / kp
    qcmd = make_interp_spline(t, answered, k=5)(np.minimum(t + delay, t[-1]))
    return make_log(Path("late.mcap"), t, log.joints, {"q": log.signals["q"], "v": log.signals["v"], "qcmd": qcmd})


@pytest.mark.parametrize("delay", DELAYS)
def test_the_delay_of_the_sample_leg_is_found(delay: float) -> None:
    log = late_command(read_log(SAMPLES / "leg_train.mcap"), delay)
    assert found_in(log, controller={"kd": {}}).value == pytest.approx(delay, abs=0.2 * MS)


def test_the_standard_error_is_what_noise_makes_of_the_delay() -> None:
    found = [found_in(noisy(run(3 * MS), seed=seed, louder=10.0)) for seed in range(12)]
    scatter = np.std([one.value for one in found], ddof=1)
    expected = np.sqrt(np.mean([np.square(one.standard_error or 0.0) for one in found]))
    assert 0.5 < scatter / expected < 1.6  # 12 values tell it to 20 %


def test_the_delay_stands_for_viscous_friction() -> None:
    """A joint that follows its command moves with the command's velocity: kp times a delay is its friction."""
    log = noisy(run(3 * MS), seed=1)
    found = found_in(log)
    viscous = [i for i, c in enumerate(experiment_of(log).equation.coefficients) if c.effect == "viscous_friction"]
    assert found.correlation > 0.9
    assert found.slope[viscous] == pytest.approx(-KP, rel=0.2)
    assert found.known_friction_error is not None
    assert found.standard_error is not None
    assert found.known_friction_error < 0.5 * found.standard_error
    fixed = found_in(log, friction={"viscous": False, "coulomb": True})
    assert fixed.correlation == 0.0
    assert fixed.text is not None
    assert "friction" not in fixed.text


@cache
def fitted(**controller: Any) -> Fit:
    """A whole fit to a log that is 7.5 ms late."""
    return fit(experiment_of(noisy(run(7.5 * MS), seed=1), controller=controller), silent)


def test_the_fit_has_the_delay_that_it_finds() -> None:
    result = fitted()
    delay = result.experiment.runs[0].signals.controller.delay
    assert delay == pytest.approx(7.5 * MS, abs=0.05 * MS)
    for joint in JOINTS:
        report = fit_report(result).to_json()["friction"][joint]
        assert abs(report["viscous"] - TRUTH.friction[joint].viscous) < 4 * report["standard_error"]["viscous"]
    written = model_config(result)["controller"]["delay"]
    assert written == {"value": delay, "standard_error": fit_report(result).to_json()["controller"]["standard_error"]}
    again = parse_config(model_config(result), "model.yaml").controller
    assert again is not None
    assert again.known_delay is not None
    assert again.known_delay.value == delay
    right = fitted(delay=7.5 * MS)
    for model in ("identified", "prior"):
        own, other = (one.validation.errors[model].rms(JOINTS)["overall"] for one in (result, right))
        assert own == pytest.approx(other, rel=0.02)


def test_the_friction_may_be_off_by_what_the_delay_may_be() -> None:
    """Standard errors of a fit with the delay given do not know of the delay's own."""
    own, given = (fitted(**more).uncertainty for more in ({}, {"delay": 7.5 * MS}))
    found = fitted().delay
    assert found is not None
    change = found.slope * found.error
    more, seen = given.with_common_error(change), given.identifiable
    assert more.standard_error[seen] == pytest.approx(np.hypot(given.standard_error, change)[seen], rel=1e-6)
    viscous = [i for i, c in enumerate(fitted().experiment.equation.coefficients) if c.effect == "viscous_friction"]
    assert own.standard_error[viscous] == pytest.approx(more.standard_error[viscous], rel=0.2)
    assert (own.standard_error[viscous] > 1.5 * given.standard_error[viscous]).all()


def test_a_given_delay_that_the_data_contradict_is_a_warning() -> None:
    log = noisy(run(7.5 * MS), seed=1)
    wrong = fit(experiment_of(log, controller={"delay": 3 * MS}), silent, analyze_uncertainty=True)
    (said,) = (note for note in sentences(wrong.notices) if note.startswith("controller.delay"))
    assert said.startswith("controller.delay: 3 ms is given, but the value fitted to the data is 7.")
    assert "and changes mean viscous friction from 1." in said
    report = fit_report(wrong).to_json()["controller"]
    assert (report["delay"], report["given"], report["contradicted"]) == (3 * MS, 3 * MS, True)
    assert report["fitted"] == pytest.approx(7.5 * MS, abs=0.05 * MS)
    right = found_in(log, controller={"delay": 7.5 * MS})
    assert not right.contradicted
    assert right.notices == ()
    doubtful = found_in(log, controller={"delay": {"value": 3 * MS, "standard_error": 5 * MS}})
    assert not doubtful.contradicted


def test_a_delay_beyond_those_that_are_looked_for_is_said() -> None:
    log = run(0.0)
    late = int((MAX_DELAY + 15 * MS) * RATE)
    early = {name: log.signals[name][:-late] for name in ("q", "v")}
    early |= {name: log.signals[name][late:] for name in ("qcmd", "vcmd")}
    found = found_in(noisy(make_log(log.path, log.t[late:], log.joints, early), seed=1))
    assert found.value == MAX_DELAY
    assert "50 ms or more fits best" in sentences(found.notices)[0]


def test_commands_that_stand_still_tell_nothing() -> None:
    log = noisy(run(3 * MS), seed=1)
    steady = {name: np.broadcast_to(x[:1], x.shape).copy() for name, x in log.signals.items() if "cmd" in name}
    found = found_in(replace(log, signals={**log.signals, **steady}))
    assert (found.value, found.standard_error, found.text) == (0.0, None, None)
    assert sentences(found.notices) == ("controller.delay: the commands do not determine the delay; 0 is used",)


def test_measured_torque_has_no_delay_of_a_command() -> None:
    log = read_log(SAMPLES / "leg_train.mcap")
    commanded = {**log.signals, "qcmd": log.signals["q"]}
    experiment = experiment_of(replace(log, signals=commanded))
    same, found, data = with_delay(experiment, silent)
    assert (same, found, data) == (experiment, None, None)
    assert fit_report(fit(same, silent)).controller is None


def test_joints_with_and_without_torque_in_one_log() -> None:
    """Those that log a torque keep it; the others tell the delay."""
    log = noisy(run(7.5 * MS), seed=1)
    torque = KP * (delay_by(log.signals["qcmd"], 7.5 * MS) - log.signals["q"])
    torque += KD * (delay_by(log.signals["vcmd"], 7.5 * MS) - log.signals["v"])
    torque[:, 1:] = np.nan
    mixed = replace(log, signals={**log.signals, "tau": torque})
    assert found_in(mixed).value == pytest.approx(7.5 * MS, abs=0.1 * MS)


def delay_by(x: Array, delay: float) -> Array:
    """A command so much later, the first one before it."""
    t = np.arange(len(x)) / RATE
    return np.transpose([np.interp(t - delay, t, column) for column in x.T])


def test_without_a_fit_a_delay_of_auto_is_none_and_said(tmp_path: Path) -> None:
    (tmp_path / "leg.yaml").write_text(yaml.safe_dump({**CONFIG, "controller": GAINS}))
    log = noisy(run(3 * MS), seed=1)
    logged = idtool.Log.from_arrays("run", log.t, log.joints, **log.signals)
    model = idtool.Model(URDF, tmp_path / "leg.yaml")
    result = idtool.validate(model, logged, simulation=False)
    assert any(note.startswith("controller.delay: the delay is not known, so 0 is used") for note in result.warnings)
    identified = idtool.fit(model, logged, quick=True).model
    assert not any("auto" in note for note in idtool.validate(identified, logged, simulation=False).warnings)


def test_a_signal_between_its_samples() -> None:
    """Exact for polynomials of degree 7, and for waves to a fifth of the sampling rate within 1 %."""
    n = np.arange(40.0)
    inner = n[4:-3]
    for share in (0.0, 0.3, 0.5, 0.99):
        for power in range(8):
            x = (n / 40) ** power
            np.testing.assert_allclose(delay_signal(x, share), ((inner - share) / 40) ** power, rtol=0, atol=1e-12)
        wave = delay_signal(np.exp(0.4j * np.pi * n).real, share)
        np.testing.assert_allclose(wave, np.cos(0.4 * np.pi * (inner - share)), rtol=0, atol=0.01)
