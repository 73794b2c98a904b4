"""Torque's noise is no effect, though a soft joint's torque equation takes it against itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import SAMPLES
from disturbed import experiment_of, silent, torque_on_joint
from sentences import sentences

from idtool.common.arrays import Array
from idtool.data.signals import Batch
from idtool.diagnosis import selection_round
from idtool.diagnosis.diagnose import Options, diagnose
from idtool.diagnosis.linearized_fit import linearize_fit
from idtool.diagnosis.noise_gain import noise_gain_with_probe
from idtool.diagnosis.selection_round import find_best_effect
from idtool.diagnosis.summarize_data import summarize_data
from idtool.diagnosis.trial import with_effects, with_fixed_inertia
from idtool.dynamics.effects.joint_elasticity import JointElasticity
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.robot.config import EffectEntry, read_config
from idtool.robot.urdf.reading import read_robot


def training_batches(experiment: Experiment) -> Iterator[Batch]:
    (run,) = experiment.runs
    return experiment.batches(run, held_out=False)


@pytest.mark.parametrize("robot", ["leg", "belt_arm"])
def test_sample_logs_hide_nothing(robot: str) -> None:
    """Two robots of MuJoCo whose torque is logged with white noise, a tenth of it, and nothing else is amiss."""
    train, held_out = (Path(SAMPLES, f"{robot}_{part}.mcap") for part in ("train", "validate"))
    config = read_config(SAMPLES / f"{robot}.yaml")
    tried = prepare(read_robot(SAMPLES / f"{robot}.urdf"), config, [train], [held_out])
    found = diagnose(tried, Options(simulate=False), silent)
    assert (found.verdict, found.steps, sentences(found.notices)) == ("no_disagreement", (), ())
    assert found.floor["overall"] == pytest.approx(found.after.train["overall"], rel=0.05)


@pytest.mark.parametrize("begin", [0.0, 0.75])
def test_what_only_the_held_out_data_contain_is_said_to_be_there(tmp_path: Path, begin: float) -> None:
    """Torque that no effect has, throughout the log or only in the held-out part of it."""

    def strange(t: Array, q: Array, v: Array, tau: Array) -> Array:
        return np.where(t > begin * t[-1], np.sin(9 * t), 0.0)

    experiment = with_fixed_inertia(experiment_of(tmp_path, torque_on_joint(0, strange)))
    found = diagnose(experiment, Options(effects=("parallel_spring",), simulate=False), silent)
    assert found.verdict == "unexplained"
    messages = [notice.message for notice in found.notices if notice.code == "only_held_out_disagrees"]
    expected = "the held-out data disagree with the model on j1, but the training data do not show why"
    assert messages == ([expected] if begin else [])


def test_the_noise_that_a_soft_joint_cancels_does_not_depend_on_gaps(tmp_path: Path) -> None:
    """Its ratio decides whether the smaller residual of an elastic joint is more than noise against itself."""
    whole = Path(SAMPLES, "leg_validate.csv")
    lines = whole.read_text().splitlines(keepends=True)
    broken = tmp_path / "broken.csv"
    broken.write_text("".join([*lines[:2001], *lines[2021:]]))
    soft = EffectEntry(effect="joint_elasticity", joint="abad", parameters={"stiffness": 3600.0, "motor_friction": 1.0})
    ratios = []
    for log in (whole, broken):
        rigid = prepare(read_robot(SAMPLES / "leg.urdf"), read_config(SAMPLES / "leg.yaml"), [log])
        reference = linearize_fit(rigid, silent)
        elastic = linearize_fit(with_effects(rigid, [soft]), silent, reference)
        ratios.append(elastic.noise / reference.noise)
    assert ratios[0][0] < 0.85
    assert ratios[1] == pytest.approx(ratios[0], abs=0.03)


def test_what_an_elastic_joint_cancels_of_the_noise_is_known_before_it_is_fitted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """To first order, and that of the fitted model; a rigid leg, whose joints would be soft by their noise alone."""
    rigid = prepare(read_robot(SAMPLES / "leg.urdf"), read_config(SAMPLES / "leg.yaml"), [SAMPLES / "leg_train.mcap"])
    base = linearize_fit(rigid, silent)
    summary = summarize_data(base)
    joint = summary.model.names.index("abad")
    probe = JointElasticity.probe(summary, joint, {"motor_friction": 1.0})
    compliance = 1 / 3600.0
    first_order = noise_gain_with_probe(rigid, base.theta, base.noise, probe, np.array([compliance]))
    soft = EffectEntry(effect="joint_elasticity", joint="abad", parameters={"stiffness": 3600.0, "motor_friction": 1.0})
    elastic = linearize_fit(with_effects(rigid, [soft], base.theta), silent, base)
    fitted = elastic.noise_gain
    assert fitted[joint] < 0.9
    assert first_order == pytest.approx(fitted, abs=0.03)

    model = LinearizedModel(elastic.experiment.equation, elastic.theta, training_batches(rigid)[0].motion)
    white = np.random.default_rng(4).normal(size=model.measured_motion.tau.shape) * base.noise[:, None]
    noisy_motion = replace(model.measured_motion, tau=model.measured_motion.tau + white)
    exact = model.equation.residual(noisy_motion, model.theta) - model.residual
    error = model.residual_change_by_noise(white) - exact
    assert np.linalg.norm(error, axis=1) == pytest.approx(0, abs=0.01 * np.linalg.norm(exact[joint]))

    monkeypatch.setattr(selection_round, "quiet_joints", lambda *arguments: frozenset())
    step = find_best_effect(base, base, silent, ("joint_elasticity",))
    reasons = {one.target: one.reason for one in step.rejected}
    assert step.winner is None
    assert "explains only noise of the measured torque" in reasons.values()
