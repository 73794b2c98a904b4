"""Samples of a quadruped's motion, and idtool's way from them to its parameters, for comparisons with other programs.

The robot is that of `long_logs`: four legs of three joints on a fixed trunk, without rotors, which not every program
knows. The samples are those of a log after idtool's filter and differentiation; columns are not filtered again. The
column of Coulomb friction is the mean of sign(v) over a sample, which other programs get from here.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import long_logs
import numpy as np
from numpy.typing import NDArray

from idtool.data.signals import Motion
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.dataset.reduction import Factor, Reduction
from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.identification import choose_sets
from idtool.estimation.problem.estimate import solve
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.robot.config import WEAK_PRIOR, read_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

MINUTES = 0.15


@dataclass(frozen=True)
class MotionSamples:
    """Samples of a robot's motion.

    Attributes
    ----------
    experiment
        The robot with its log.
    motion
        The samples.
    urdf
        Text of the robot's URDF.
    """

    experiment: Experiment
    motion: Motion
    urdf: str

    def __len__(self) -> int:
        return len(self.motion.t)

    def first(self, count: int) -> MotionSamples:
        """The first samples."""
        names = ("t", "q", "v", "a", "tau", "logged_tau")
        signals = {name: np.ascontiguousarray(getattr(self.motion, name)[..., :count]) for name in names}
        return replace(self, motion=replace(self.motion, kept_columns=None, **signals))

    def columns(self) -> Array:
        """Columns of all joints over all coefficients, shape (nv, N, p)."""
        equation = self.experiment.equation
        columns = np.zeros((len(equation.joints), len(self), len(equation.coefficients)))
        by_joint = zip(equation.columns(self.motion), equation.active_in_columns(), strict=True)
        for joint, (block, active) in enumerate(by_joint):
            columns[joint][:, active] = block[:-1].T
        return columns

    def indices_of(self, *names: str) -> NDArray[np.intp]:
        """Indices of the coefficients of some names."""
        return np.flatnonzero([c.name in names for c in self.experiment.equation.coefficients])

    def reduction(self) -> Reduction:
        """R-factors of the samples."""
        return tuple(Factor.from_columns(block) for block in self.experiment.equation.columns(self.motion))

    def problem(self, noise: Array | None = None) -> Problem:
        """Identification with realizable bodies from the samples.

        Parameters
        ----------
        noise
            Noise of each joint, shape (nv,) [N·m]; None: that of a fit without constraints.
        """
        equation, bodies = self.experiment.equation, self.experiment.model.bodies
        reduction = self.reduction()
        if noise is None:
            noise = free_noise(equation, reduction)
        sets = choose_sets(bodies, "full")
        return build_problem(equation, bodies, reduction, sets, WEAK_PRIOR, noise)

    def identify(self, noise: Array | None = None) -> tuple[Problem, Array]:
        """The problem, and its optimum x."""
        problem = self.problem(noise)
        return problem, solve(problem)[0]

    def noise(self) -> Array:
        """Noise of each joint under a fit without constraints, shape (nv,) [N·m]."""
        return free_noise(self.experiment.equation, self.reduction())


def quadruped_samples(count: int) -> MotionSamples:
    """The first samples of the quadruped's log."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        robot = long_logs.BranchedRobot(branches=4, length=3)
        true_urdf = long_logs.write_robot(folder, robot)
        log = folder / "log.mcap"
        long_logs.write_log_of(robot, true_urdf, 0, MINUTES, log)
        urdf = folder / "robot.urdf"
        experiment = prepare(read_robot(urdf), read_config(folder / "robot.yaml"), [log], holdout=0.0)
        motion = next(iter(experiment.runs[0].signals.batches())).motion
        return MotionSamples(experiment, motion, urdf.read_text()).first(count)


def optimum_difference(problem: Problem, z: Array, optimum: Array) -> dict[str, float]:
    """Excess of another solver's cost, and distance of its coefficients, in the problem's units, shape (p',) each."""
    excess = problem.cost(z) / problem.cost(optimum) - 1
    distance = np.linalg.norm(z - optimum) / np.linalg.norm(optimum)
    return {"relative cost": float(excess), "relative parameters": float(distance)}
