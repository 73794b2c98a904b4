"""Comparison with pydrake: regressor, semidefinite program, and both, for a quadruped's samples.

Run ``python benchmarks/peer_drake.py``; it needs ``pip install drake``. Drake computes no numeric regressor; as in its
examples, a MultibodyPlant whose inertias are variables of automatic differentiation has the columns as derivatives of
its inverse dynamics. The program is stated in MathematicalProgram and solved by Drake's own Clarabel, in two ways:

- as one would write it, with `Add2NormSquaredCost`, which forms AᵀA and so squares the condition number;
- with the residuals as variables, which does not, and tolerances of 1e-12, to be as accurate as idtool.

Both have idtool's variables and units.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
import reduced_solve
import sample_leg
from comparison import Comparison, can_import, compare, version_text
from motion_samples import MotionSamples, optimum_difference, quadruped_samples
from numpy.typing import NDArray

from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.problem.estimate import solve
from idtool.estimation.problem.problem import Problem
from idtool.robot.inertia import PI_SIZE

Array = NDArray[np.float64]

SAMPLES, REPETITIONS = 500, 5
TIGHT = {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-9}


def is_installed() -> bool:
    """True if pydrake is installed."""
    return can_import("pydrake.all", "ClarabelSolver")


def solve_squared(problem: Problem, A: Array, b: Array) -> Array:
    """The optimum x of the cost ‖A S x − b‖² by `Add2NormSquaredCost`, shape (m,)."""
    from pydrake.all import MathematicalProgram

    program = MathematicalProgram()
    x = program.NewContinuousVariables(problem.variables)
    program.Add2NormSquaredCost(A @ problem.S, b, x)
    return _optimum(program, problem, x, {})


def solve_residuals(problem: Problem, A: Array, b: Array) -> Array:
    """The optimum x of the cost ‖r‖², r = A S x − b, shape (m,)."""
    from pydrake.all import MathematicalProgram

    program = MathematicalProgram()
    x = program.NewContinuousVariables(problem.variables)
    r = program.NewContinuousVariables(len(b))
    equations = np.hstack([A @ problem.S, -np.eye(len(b))])
    program.AddLinearEqualityConstraint(equations, b, np.concatenate([x, r]))
    program.Add2NormSquaredCost(np.eye(len(b)), np.zeros(len(b)), r)
    return _optimum(program, problem, x, TIGHT)


def _optimum(program: Any, problem: Problem, x: Any, tolerances: dict[str, float]) -> Array:
    """The solution of a program with a cost, after adding the problem's inequalities on x."""
    from pydrake.all import ClarabelSolver, SolverOptions

    if len(problem.bounded):
        no_limit = np.full(len(problem.bounds), np.inf)
        program.AddBoundingBoxConstraint(problem.bounds, no_limit, x[problem.bounded])
    for inequality in problem.inequalities:
        n = inequality.G.shape[-1]
        variables = x[inequality.x_slice]
        if inequality.G.ndim == 2:
            least = np.full(n, inequality.interior)
            program.AddLinearConstraint(inequality.G.T, least, np.full(n, np.inf), variables)
        else:
            matrices = [-inequality.interior * np.eye(n), *inequality.G]
            program.AddLinearMatrixInequalityConstraint(matrices, variables)
    options = SolverOptions()
    for name, value in tolerances.items():
        options.SetOption(ClarabelSolver.id(), name, value)
    result = ClarabelSolver().Solve(program, None, options)
    assert result.is_success(), result.get_solution_result()
    return np.asarray(result.GetSolution(x))


@dataclass(frozen=True)
class DrakeTask:
    """The samples as Drake takes them.

    Attributes
    ----------
    samples
        The samples.
    plant, context
        The MultibodyPlant on automatic differentiation, and its context with the inertias as variables.
    order
        Index in Drake's velocities of each of idtool's joints, shape (nv,).
    friction
        Columns of friction in idtool's form, shape (nv, N, 2 nv).
    """

    samples: MotionSamples
    plant: Any
    context: Any
    order: list[int]
    friction: Array

    @classmethod
    def of(cls, samples: MotionSamples) -> DrakeTask:
        """The plant of the samples' URDF."""
        from pydrake.all import MultibodyPlant, Parser

        plant = MultibodyPlant(0.0)
        Parser(plant).AddModelsFromString(samples.urdf, "urdf")
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("trunk"))
        plant.Finalize()
        plant = plant.ToAutoDiffXd()
        context = plant.CreateDefaultContext()
        model = samples.experiment.model
        _set_inertias(plant, context, [body.name for body in model.bodies], [body.pi for body in model.bodies])
        order = [plant.GetJointByName(name).velocity_start() for name in model.names]
        friction = samples.columns()[:, :, samples.indices_of("viscous", "coulomb")]
        return cls(samples, plant, context, order, friction)

    def regressor(self) -> Array:
        """Columns of the bodies' parameters for each joint, shape (nv, N, 10 · bodies)."""
        from pydrake.all import AutoDiffXd, ExtractGradient, MultibodyForces_

        motion = self.samples.motion
        nv, bodies = len(self.order), len(self.samples.experiment.model.bodies)
        q, v, a = np.empty((3, nv, len(self.samples)))
        for signal, out in ((motion.q, q), (motion.v, v), (motion.a, a)):
            out[self.order] = signal
        forces = MultibodyForces_[AutoDiffXd](self.plant)
        Y = np.empty((nv, len(self.samples), PI_SIZE * bodies))
        for n in range(len(self.samples)):
            self.plant.SetPositions(self.context, q[:, n])
            self.plant.SetVelocities(self.context, v[:, n])
            self.plant.CalcForceElementsContribution(self.context, forces)
            acceleration = np.array([AutoDiffXd(x) for x in a[:, n]])
            tau = self.plant.CalcInverseDynamics(self.context, acceleration, forces)
            Y[:, n] = ExtractGradient(tau)[self.order]
        return Y

    def rows(self, problem: Problem, noise: Array) -> tuple[Array, Array]:
        """A and b of the cost ‖A z − b‖² of all samples and the prior, z in units of a problem."""
        nv, count = len(self.order), len(self.samples)
        columns = np.concatenate([self.regressor(), self.friction], axis=2)
        weights = np.repeat(1 / noise, count)[:, None] / np.sqrt(count)
        A = columns.reshape(nv * count, -1) * weights * problem.scale
        b = self.samples.motion.tau.reshape(-1, 1) * weights
        prior = reduced_solve.prior_of(self.samples.experiment, problem.scale)
        return np.concatenate([A, prior[:, :-1] * problem.scale]), np.concatenate([b[:, 0], prior[:, -1]])

    def identify(self, problem: Problem, noise: Array) -> Array:
        """Drake's way from the samples to the optimum x."""
        return solve_squared(problem, *self.rows(problem, noise))


def _set_inertias(plant: Any, context: Any, names: list[str], pi: list[Array]) -> None:
    """Make the parameters of all bodies, shape (10,) each, variables of automatic differentiation."""
    from pydrake.all import AutoDiffXd, InitializeAutoDiff, SpatialInertia_, UnitInertia_

    variables = InitializeAutoDiff(np.concatenate(pi))[:, 0].reshape(len(names), PI_SIZE)
    for name, (mass, hx, hy, hz, xx, xy, yy, xz, yz, zz) in zip(names, variables, strict=True):
        center = np.array([hx / mass, hy / mass, hz / mass])
        unit = UnitInertia_[AutoDiffXd](xx / mass, yy / mass, zz / mass, xy / mass, xz / mass, yz / mass)
        inertia = SpatialInertia_[AutoDiffXd](mass, center, unit)
        plant.GetBodyByName(name).SetSpatialInertiaInBodyFrame(context, inertia)


def leg_comparisons() -> list[Comparison]:
    """The semidefinite program of the leg from the same R-factors, in both ways."""
    problem, _, _ = reduced_solve.problem_and_rows(sample_leg.leg_experiment())
    optimum = problem.S @ solve(problem)[0]
    compared = []
    for way, words in (
        (solve_residuals, "residuals as variables, tolerances 1e-12"),
        (solve_squared, "Add2NormSquaredCost, default tolerances"),
    ):
        x = way(problem, problem.A, problem.b)
        agreement = optimum_difference(problem, problem.S @ x, optimum)
        assert abs(agreement["relative cost"]) < 1e-5
        compared.append(
            compare(
                "identification within ellipsoids from R-factors, leg of 6 bodies",
                f"{version_text('drake')}, {words}",
                lambda: solve(problem),
                lambda way=way: way(problem, problem.A, problem.b),  # type: ignore[misc]
                REPETITIONS,
                agreement,
                "The time of idtool includes its certificate.",
            )
        )
    return compared


def quadruped_comparisons() -> list[Comparison]:
    """The regressor of the quadruped, and all from samples to parameters."""
    samples = quadruped_samples(SAMPLES)
    equation = samples.experiment.equation
    task = DrakeTask.of(samples)
    Y = task.regressor()
    difference = np.abs(Y - samples.columns()[:, :, : Y.shape[2]]).max() / np.abs(Y).max()
    assert difference < 1e-10
    noise = free_noise(equation, samples.reduction())
    problem, x = samples.identify(noise)
    agreement = optimum_difference(problem, problem.S @ task.identify(problem, noise), problem.S @ x)
    assert abs(agreement["relative cost"]) < 1e-5
    joints = len(equation.joints)
    peer = version_text("drake")
    return [
        compare(
            f"regressor of {SAMPLES} samples, {joints} joints",
            peer,
            lambda: equation.columns(samples.motion),
            task.regressor,
            REPETITIONS,
            {"relative columns": float(difference)},
            "Drake differentiates the inverse dynamics automatically. The columns of idtool include friction.",
        ),
        compare(
            f"from {SAMPLES} samples to realizable bodies, {joints} joints",
            f"{peer}, Add2NormSquaredCost",
            samples.identify,
            lambda: task.identify(problem, noise),
            REPETITIONS,
            agreement,
            "Drake gets the weights of the joints and the columns of friction from idtool.",
        ),
    ]


def comparisons() -> list[Comparison]:
    """Check that columns and optima are equal, and time all by turns."""
    return [*quadruped_comparisons(), *leg_comparisons()]


def main() -> None:
    """Print the ratios."""
    if not is_installed():
        print("error: drake: is not installed; pip install drake", file=sys.stderr)
        raise SystemExit(2)
    for comparison in comparisons():
        print(comparison)


if __name__ == "__main__":
    main()
