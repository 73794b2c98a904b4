"""A motion that leaves the limits is scaled until it is within all of them, by Pinocchio's word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
from exciting import Array, arm

from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.excitation.feasibility import scale_to_limits
from idtool.excitation.patterns import Fourier, PatternSpec, TrajectorySegment
from idtool.excitation.task import DesignTask, make_design_task
from idtool.robot.config import Config
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import read_robot

RATE = 200.0


def task_of(folder: Path, text: str) -> DesignTask:
    path = folder / "robot.urdf"
    path.write_text(text)
    model = build_model(read_robot(path), Config(), ["a", "b"])
    equation = LinearModel(model.names, build_effects(model, Config()))
    known = EqualityConstraints.none(len(equation.prior))
    asked = {"criterion": "d", "favour": (), "noise": {}, "rate": RATE, "margin": 0.0, "clearance": 0.01}
    return make_design_task(model, equation, known, Config(), **asked)  # type: ignore[arg-type]


def share_of_effort(text: str, part: TrajectorySegment, effort: Array) -> float:
    """The largest of both joints', without friction, which is known to be small here."""
    model = pin.buildModelFromXML(text)
    data = model.createData()
    t = np.linspace(0, part.pattern.duration, 3001)
    tau = np.array([pin.rnea(model, data, q, v, a) for q, v, a in zip(*(x.T for x in part.motion(t)), strict=True)])
    return float((np.abs(tau) / effort).max())


def test_a_motion_too_strong_is_made_smaller(tmp_path: Path) -> None:
    text, home = (
        arm(effort=5.0).replace('damping="0.2" friction="0.5"', 'damping="0" friction="0"'),
        np.array([0.25, 0.2]),
    )
    task = task_of(tmp_path, text)
    pattern = Fourier(PatternSpec(task.model, task.limits, home, 8.0, 1.5))
    drawn = next(
        part
        for seed in range(50)
        if share_of_effort(
            text, part := TrajectorySegment(pattern, pattern.draw(np.random.default_rng(seed))), task.limits.effort
        )
        > 1
    )
    found = scale_to_limits(task, drawn)
    assert 0.3 < share_of_effort(text, found, task.limits.effort) <= 1.001
    assert np.linalg.norm(found.x) < np.linalg.norm(drawn.x)
    # and by no more than it takes
    larger = TrajectorySegment(
        pattern, pattern.scaled(drawn.x, np.full(2, min(1.0, 1.3 * np.linalg.norm(found.x) / np.linalg.norm(drawn.x))))
    )
    assert share_of_effort(text, larger, task.limits.effort) > share_of_effort(text, found, task.limits.effort)


def test_a_motion_too_fast_and_too_wide_is_made_to_fit(tmp_path: Path) -> None:
    task = task_of(tmp_path, arm(effort=1e3))
    limits = task.limits
    pattern = Fourier(PatternSpec(task.model, limits, limits.middle, 8.0, 3.0))
    part = scale_to_limits(task, TrajectorySegment(pattern, 3 * pattern.draw(np.random.default_rng(0))))
    use = limits.utilization(*part.motion(np.linspace(0, 8, 50_001)))
    assert (use <= 1 + 1e-6).all()
    assert (use.max(axis=0) > 0.999).all()  # joint by joint
