"""Solver times with the inequalities of several constraint sets, on one problem with 30 bodies.

Run ``python benchmarks/lmi.py``. The robot is a chain of 30 links with random positions, axes and inertias and an
ellipsoid each. Its states are random, and its torque is that of the URDF's bodies with as much noise as torque, so that
every body ends on the boundary of its set. All sets get the same R-factors, prior and solver; the time is that of
`estimate.solve` with its certificate.

The 4×4 inequality (full consistency) is smaller than the 6×6 one (semi-consistency), and yet admits fewer bodies. The
same holds for the scalar Tr(J Q) ≥ 0 (density in an ellipsoid) and the 4×4 one of a centre of mass in that ellipsoid.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import sample_leg
from numpy.typing import NDArray

from idtool.data.signals import Motion
from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.reduction import Factor
from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.problem.estimate import solve
from idtool.estimation.problem.problem import Problem, build_problem
from idtool.robot.config import WEAK_PRIOR, parse_config
from idtool.robot.model import build_model
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

BODIES, SAMPLES, REPETITIONS = 30, 3000, 9
SETS = ("semi", "full", "com_ellipsoid", "ellipsoid")


def chain_urdf(rng: np.random.Generator) -> str:
    """URDF of a chain of links, each a solid ellipsoid around its own frame."""
    lines = ['<robot name="chain"><link name="link0"/>']
    for i in range(1, BODIES + 1):
        xyz, rpy, axis = (_text(x) for x in rng.uniform(-1, 1, (3, 3)) * [[0.1], [1], [1]])
        x, y, z = rng.uniform(0.03, 0.1, 3) ** 2 / 5
        inertia = f'<inertia ixx="{y + z}" iyy="{x + z}" izz="{x + y}" ixy="0" ixz="0" iyz="0"/>'
        lines.append(f'<link name="link{i}"><inertial><mass value="1"/>{inertia}</inertial></link>')
        lines.append(f'<joint name="joint{i}" type="continuous"><parent link="link{i - 1}"/><child link="link{i}"/>')
        lines.append(f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/></joint>')
    return "".join([*lines, "</robot>"])


def _text(values: Array) -> str:
    return " ".join(map(repr, values.tolist()))


def problems_by_set(rng: np.random.Generator) -> dict[str, Problem]:
    """The problem with each of the constraint sets."""
    bounds = {f"link{i}": [{"semi_axes": rng.uniform(0.1, 0.15, 3).tolist()}] for i in range(1, BODIES + 1)}
    config = parse_config({"bounding_ellipsoids": bounds}, "chain")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "chain.urdf")
        path.write_text(chain_urdf(rng))
        model = build_model(read_robot(path), config, [f"joint{i}" for i in range(1, BODIES + 1)])
    equation = LinearModel(model.names, build_effects(model, config))
    q, v, a = rng.normal(size=(3, BODIES, SAMPLES)) * np.array([1.0, 2.0, 10.0])[:, None, None]
    motion = Motion(np.arange(float(SAMPLES)), q, v, a, q, q, np.full(BODIES, 1e-3), 1.0)
    tau = equation.torque(motion, equation.prior)
    tau += tau.std(axis=1, keepdims=True) * rng.normal(size=tau.shape)
    factors = []
    for block, row in zip(equation.columns(motion), tau, strict=True):
        factors.append(Factor.from_columns(np.vstack([block[:-1], row])))
    reduction = tuple(factors)
    noise = free_noise(equation, reduction)
    problems = {}
    for name in SETS:
        sets = [choose_set(body, name) for body in model.bodies]
        problems[name] = build_problem(equation, model.bodies, reduction, sets, WEAK_PRIOR, noise)
    return problems


def main() -> None:
    """Solve in turn and print times, iterations and ratios."""
    problems = problems_by_set(np.random.default_rng(0))
    iterations = {name: solve(problem)[1].iterations for name, problem in problems.items()}
    actions = [lambda problem=problem: solve(problem) for problem in problems.values()]
    seconds = dict(zip(SETS, sample_leg.median_times(REPETITIONS, *actions), strict=True))
    for name in SETS:
        print(f"{name:13s} {1e3 * seconds[name]:6.1f} ms, {iterations[name]} iterations")
    for larger, smaller, words in (
        ("semi", "full", "6×6 against 4×4"),
        ("com_ellipsoid", "ellipsoid", "4×4 and 4×4 against 4×4 and one number"),
    ):
        ratio = seconds[larger] / seconds[smaller]
        print(f"{words}: ratio {ratio:.2f}, {ratio * iterations[smaller] / iterations[larger]:.2f} an iteration")


if __name__ == "__main__":
    main()
