"""The sets' inequalities against each other on one problem with 30 bodies.

Run ``python benchmarks/lmi.py``. A chain of 30 links with an ellipsoid each and random places, axes and inertias;
random states, and the torque of the URDF's bodies with as much noise as torque, so that every body ends at its limit.
All sets get the same R-factors, prior and solver; the time is that of `estimate.solve` with its certificate.

The 6×6 inequality (semi-consistency) admits more bodies than the 4×4 (full consistency), which is the smaller and the
tighter at once. Likewise the density's one number Tr(J Q) ≥ 0 against the centre's 4×4 in the same ellipsoid.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import leg
import numpy as np
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


def chain(rng: np.random.Generator) -> str:
    """URDF of links in a row, each a solid ellipsoid around its own frame."""
    parts = ['<robot name="chain"><link name="link0"/>']
    for i in range(1, BODIES + 1):
        xyz, rpy, axis = (" ".join(map(repr, x.tolist())) for x in rng.uniform(-1, 1, (3, 3)) * [[0.1], [1], [1]])
        x, y, z = rng.uniform(0.03, 0.1, 3) ** 2 / 5
        inertia = f'<inertia ixx="{y + z}" iyy="{x + z}" izz="{x + y}" ixy="0" ixz="0" iyz="0"/>'
        parts.append(f'<link name="link{i}"><inertial><mass value="1"/>{inertia}</inertial></link>')
        parts.append(f'<joint name="joint{i}" type="continuous"><parent link="link{i - 1}"/><child link="link{i}"/>')
        parts.append(f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/></joint>')
    return "".join([*parts, "</robot>"])


def stated(rng: np.random.Generator) -> dict[str, Problem]:
    """The problem with each of the sets."""
    bounds = {f"link{i}": [{"semi_axes": rng.uniform(0.1, 0.15, 3).tolist()}] for i in range(1, BODIES + 1)}
    config = parse_config({"bounding_ellipsoids": bounds}, "chain")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "chain.urdf")
        path.write_text(chain(rng))
        model = build_model(read_robot(path), config, [f"joint{i}" for i in range(1, BODIES + 1)])
    equation = LinearModel(model.names, build_effects(model, config))
    q, v, a = rng.normal(size=(3, BODIES, SAMPLES)) * np.array([1.0, 2.0, 10.0])[:, None, None]
    motion = Motion(np.arange(float(SAMPLES)), q, v, a, q, q, np.full(BODIES, 1e-3), 1.0)
    tau = equation.torque(motion, equation.prior)
    tau += tau.std(axis=1, keepdims=True) * rng.normal(size=tau.shape)
    columns = (np.vstack([block[:-1], row]) for block, row in zip(equation.columns(motion), tau, strict=True))
    factors = tuple(Factor.from_columns(rows) for rows in columns)
    noise = free_noise(equation, factors)
    return {
        name: build_problem(
            equation, model.bodies, factors, [choose_set(b, name) for b in model.bodies], WEAK_PRIOR, noise
        )
        for name in SETS
    }


def main() -> None:
    """Solve by turns and print times, iterations and ratios."""
    problems = stated(np.random.default_rng(0))
    iterations = {name: solve(problem)[1].iterations for name, problem in problems.items()}
    actions = [lambda problem=problem: solve(problem) for problem in problems.values()]
    seconds = dict(zip(SETS, leg.medians(REPETITIONS, *actions), strict=True))
    for name in SETS:
        print(f"{name:13s} {1e3 * seconds[name]:6.1f} ms, {iterations[name]} iterations")
    for larger, smaller, words in (
        ("semi", "full", "6×6 against 4×4"),
        ("com_ellipsoid", "ellipsoid", "4×4 and 4×4 against 4×4 and one number"),
    ):
        whole = seconds[larger] / seconds[smaller]
        print(f"{words}: ratio {whole:.2f}, {whole * iterations[smaller] / iterations[larger]:.2f} an iteration")


if __name__ == "__main__":
    main()
