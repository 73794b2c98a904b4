"""Comparison with FIGAROH: regressor, convex identification, and both, for a quadruped's samples.

Run ``python benchmarks/peer_figaroh.py``; it needs ``pip install figaroh``. Its `solve_direct_effort_fit` minimizes the
torque error with positive definite pseudo-inertias and a prior, in PICOS and CVXOPT. It gets idtool's prior, units and
weights of the joints, so that both costs are the same function of the parameters.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
from comparison import Comparison, can_import, compare, version_text
from motion_samples import MotionSamples, optimum_difference, quadruped_samples
from numpy.typing import NDArray

from idtool.estimation.problem.estimate import solve
from idtool.estimation.problem.prior import prior_rows
from idtool.estimation.problem.problem import _LEAST_WEIGHT, Problem
from idtool.robot.config import WEAK_PRIOR

Array = NDArray[np.float64]

SAMPLES, REPETITIONS = 4000, 3


def is_installed() -> bool:
    """True if FIGAROH is installed."""
    return can_import("figaroh.identification.physical_fit", "solve_direct_effort_fit")


@dataclass(frozen=True)
class FigarohTask:
    """The samples as FIGAROH takes them.

    Attributes
    ----------
    samples
        The samples.
    robot
        Pinocchio's model and data.
    noise
        Noise of each joint, shape (nv,) [N·m].
    coulomb
        Columns of Coulomb friction, in idtool's form, shape (nv · N, nv).
    scale
        Deviation from the prior of each coefficient that costs as much as its weight, in FIGAROH's order, shape (p,).
    """

    samples: MotionSamples
    robot: SimpleNamespace
    noise: Array
    coulomb: Array
    scale: Array

    @classmethod
    def of(cls, samples: MotionSamples, problem: Problem, noise: Array) -> FigarohTask:
        """The task with the prior of an idtool problem."""
        tree = pin.buildModelFromXML(samples.urdf)
        equation, bodies = samples.experiment.equation, samples.experiment.model.bodies
        assert [*tree.names][1:] == [*samples.experiment.model.names]
        rows = prior_rows(equation, bodies, WEAK_PRIOR, problem.scale)[:, :-1]
        weights = np.square(rows).sum(axis=0) + _LEAST_WEIGHT / problem.scale**2  # the rows are diagonal
        scale = np.sqrt(WEAK_PRIOR.numeric_weight / weights)
        coulomb = samples.columns()[:, :, samples.indices_of("coulomb")].reshape(-1, tree.nv)
        robot = SimpleNamespace(model=tree, data=tree.createData())
        return cls(samples, robot, noise, coulomb, scale[_order(samples)])

    def regressor(self) -> Array:
        """Columns of all joints, one joint after the other, shape (nv · N, p)."""
        from figaroh.tools.regressor import RegressorBuilder, RegressorConfig

        motion = self.samples.motion
        builder = RegressorBuilder(self.robot, RegressorConfig(has_friction=True))
        active = {"act_idxv": range(self.robot.model.nv)}
        return np.asarray(builder.build_basic_regressor(motion.q.T, motion.v.T, motion.a.T, active))

    def column_difference(self, Y: Array) -> float:
        """Largest difference of the columns from idtool's but for Coulomb friction, relative to the largest entry."""
        order = _order(self.samples)
        compared = ~np.isin(order, self.samples.indices_of("coulomb"))
        by_joint = Y.reshape(self.robot.model.nv, len(self.samples), -1)
        difference = by_joint[:, :, compared] - self.samples.columns()[:, :, order[compared]]
        return float(np.abs(difference).max() / np.abs(Y).max())

    def problem(self, Y: Array) -> Any:
        """FIGAROH's problem, whose R-factor and base parameters are computed from all rows; Y is changed."""
        from figaroh.identification.parameter import get_standard_parameters
        from figaroh.identification.physical_fit import PhysicalPolicy, build_problem

        joints = [*self.robot.model.names][1:]
        inertial = get_standard_parameters(self.robot.model)
        names = [*inertial, *(f"{kind}_{joint}" for kind in ("fv", "fs") for joint in joints)]
        prior = self.samples.experiment.equation.prior[_order(self.samples)]
        assert np.allclose(prior[: len(inertial)], [*inertial.values()])
        weights = np.repeat(1 / self.noise, len(self.samples)) / np.sqrt(len(self.samples))
        policy = PhysicalPolicy(prior_weight=WEAK_PRIOR.numeric_weight)
        tau = self.samples.motion.tau.ravel()
        Y[:, -len(joints) :] = self.coulomb
        built = build_problem(Y, tau, names, joints, prior=prior, row_weight=weights, policy=policy)
        return replace(built, coord_scale=self.scale)

    def solve(self, problem: Any) -> Array:
        """FIGAROH's optimum in the order of idtool's coefficients, shape (p,)."""
        from figaroh.identification.physical_fit import solve_direct_effort_fit

        record = solve_direct_effort_fit(problem)
        assert record.accepted, record.exception or record.solver_status
        theta = np.empty_like(record.theta)
        theta[_order(self.samples)] = record.theta
        return theta

    def identify(self) -> Array:
        """FIGAROH's way from the samples to the parameters, in the order of idtool's coefficients, shape (p,)."""
        return self.solve(self.problem(self.regressor()))


def _order(samples: MotionSamples) -> NDArray[np.intp]:
    """Index among idtool's coefficients of each of FIGAROH's: bodies, then viscous and Coulomb friction by joint."""
    coefficients = samples.experiment.equation.coefficients
    count = len(coefficients)
    kinds = {"viscous": 1, "coulomb": 2}
    return np.array(sorted(range(count), key=lambda k: (kinds.get(coefficients[k].name, 0), k)))


def comparisons() -> list[Comparison]:
    """Check that columns and optima are equal, then time each step by turns."""
    samples = quadruped_samples(SAMPLES)
    noise = samples.noise()
    problem, x = samples.identify(noise)
    task = FigarohTask.of(samples, problem, noise)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of libraries that FIGAROH imports
        Y = task.regressor()
        columns = {"relative columns": task.column_difference(Y)}
        theirs = task.problem(Y)
        theta = task.solve(theirs)
    assert columns["relative columns"] < 1e-10
    optima = optimum_difference(problem, theta / problem.scale, problem.S @ x)
    assert abs(optima["relative cost"]) < 1e-5
    equation = samples.experiment.equation
    joints = len(equation.joints)
    peer = version_text("figaroh", "cvxopt")
    return [
        compare(
            f"regressor of {SAMPLES} samples, {joints} joints",
            version_text("figaroh", "pin"),
            lambda: equation.columns(samples.motion),
            task.regressor,
            REPETITIONS,
            columns,
            "The column of Coulomb friction is sign(v) in FIGAROH, and its mean over a sample in idtool.",
        ),
        compare(
            f"identification with realizable bodies from R-factors, {joints} joints",
            peer,
            lambda: solve(problem),
            lambda: task.solve(theirs),
            REPETITIONS,
            optima,
            "The time of idtool includes its certificate, that of FIGAROH its record of residuals.",
        ),
        compare(
            f"from {SAMPLES} samples to realizable bodies, {joints} joints",
            peer,
            samples.identify,
            task.identify,
            REPETITIONS,
            optima,
            "The time of FIGAROH includes the base parameters. It gets the weights of the joints from idtool.",
        ),
    ]


def main() -> None:
    """Print the ratios."""
    if not is_installed():
        print("error: figaroh: is not installed; pip install figaroh", file=sys.stderr)
        raise SystemExit(2)
    for comparison in comparisons():
        print(comparison)


if __name__ == "__main__":
    main()
