"""Pairs that a log leaves open, simulated again along the designed motion: the fits differ, and the truth wins.

The plant is that of benchmarks/hidden_effects: MuJoCo's mass matrix and bias, with its own effects, drive and sensors.
A minute and more, so not part of CI.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hidden_effects.case_files import CaseFiles, write_case
from hidden_effects.case_list import Case
from hidden_effects.effects import HiddenEffect
from hidden_effects.logs import Sensors, record, write_log
from hidden_effects.motion import Motion
from hidden_effects.robots import ROBOTS, draw_truth

import idtool
from idtool.data.logs import read_log
from idtool.diagnosis.linearized_fit import linearize_fit
from idtool.diagnosis.selection_round import fit_assumed_effect
from idtool.estimation.dataset.experiment import prepare
from idtool.robot.config import read_config
from idtool.robot.urdf.reading import read_robot

SECONDS = 7.0  # of a first log without slow stretches

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Open:
    """A hidden effect, and another that explains the first log as well."""

    true: str
    other: str
    joint: str
    parameters: Mapping[str, float]
    seed: int = 0

    @property
    def explanations(self) -> tuple[str, str]:
        return f"{self.true}:{self.joint}", f"{self.other}:{self.joint}"


DRAG = Open("quadratic_drag", "stribeck_friction", "elbow", {"drag": 0.067})
WIDE_STRIBECK = Open("stribeck_friction", "quadratic_drag", "elbow", {"stribeck": 0.03, "velocity": 1.2})
SPRING = Open("parallel_spring", "torque_ripple", "elbow", {"stiffness": 0.1, "rest_position": 0.0})


def first_log(case: Open, folder: Path) -> CaseFiles:
    hidden = HiddenEffect(case.true, case.joint, parameters=case.parameters)
    return write_case(Case("first", "planar2", (hidden,), seed=case.seed, seconds=SECONDS), folder)


def simulate(case: Open, motion: Path, out: Path) -> None:
    """The same robot along a designed motion, with other noise."""
    robot = ROBOTS["planar2"]
    log = read_log(motion)
    q, v = log.signals["qcmd"].T, log.signals["vcmd"].T
    command = Motion(log.t, q, v, np.gradient(v, log.dt, axis=1))
    hidden = (HiddenEffect(case.true, case.joint, parameters=case.parameters),)
    write_log(out, robot, record(robot, draw_truth(robot, case.seed), hidden, command, Sensors(), case.seed + 100))


def advantage(case: Open, files: CaseFiles, log: Path) -> float:
    """How much better the true effect predicts blocks left out than the other one, in standard errors."""
    experiment = prepare(read_robot(files.urdf), read_config(files.config), [log], holdout=0.0)
    base = linearize_fit(experiment, quiet)
    gains = []
    for effect in (case.true, case.other):
        winner = fit_assumed_effect(base, quiet, effect, case.joint).winner
        gains.append(np.zeros(base.block_count) if winner is None else winner.gains)
    difference = gains[0] - gains[1]
    return float(difference.sum() / (difference.std() * np.sqrt(len(difference))))


def quiet(stage: str, share: float) -> None:
    pass


@pytest.mark.parametrize("case", [DRAG, WIDE_STRIBECK, SPRING], ids=lambda case: f"{case.true}-{case.other}")
def test_the_designed_motion_decides(tmp_path: Path, case: Open) -> None:
    files = first_log(case, tmp_path / "first")
    model = idtool.Model(files.urdf, files.config)
    result = idtool.excite(model, logs=files.log, decide=case.explanations, duration=20.0)
    decision = result.decide
    assert decision is not None
    assert decision.logged is not None
    result.save(tmp_path / "motion.csv")
    simulate(case, tmp_path / "motion.csv", tmp_path / "second.csv")
    first, second = (advantage(case, files, log) for log in (files.log, tmp_path / "second.csv"))
    assert abs(first) < 3
    assert second > 4
    assert second > abs(first) + 2
    assert decision.significance > decision.ordinary.significance
    assert decision.significance > 2 * decision.logged.significance


def test_diagnose_calls_a_pair_and_then_decides(tmp_path: Path) -> None:
    files = first_log(DRAG, tmp_path / "first")
    model = idtool.Model(files.urdf, files.config)
    (step,) = idtool.diagnose(model, files.log, simulation=False).steps
    assert step.evidence.pair
    assert {step.effect, step.alternatives[0].effect} == {DRAG.true, DRAG.other}
    a, b = DRAG.explanations
    command = f"idtool excite {files.urdf} --config {files.config} --log {files.log} --decide {a} {b}"
    assert step.evidence.separate.endswith(f"`{command}`")

    result = idtool.excite(model, logs=files.log, decide=DRAG.explanations, duration=20.0)
    result.save(tmp_path / "motion.csv")
    simulate(DRAG, tmp_path / "motion.csv", tmp_path / "second.csv")
    (step,) = idtool.diagnose(model, [files.log, tmp_path / "second.csv"], simulation=False).steps
    assert step.effect == DRAG.true
    assert not step.evidence.pair
