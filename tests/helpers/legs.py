"""Legs that are mirror images of each other, as URDF text and as data that Pinocchio made; and their fits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from robots import body, inertial, joint
from synthetic import Synthetic, point_parameters, points_in, random_bound, random_states, synthetic

from idtool.estimation.dataset.equality_constraints import EqualityConstraints, with_equal_bounds
from idtool.estimation.problem.estimate import Estimate, estimate
from idtool.estimation.uncertainty.standard_errors import Uncertainty, least_squares_uncertainty
from idtool.robot.config import Regularization
from idtool.robot.inertia import PI_SIZE
from idtool.robot.sets import choose_set
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]
Robots = Callable[[str], Robot]

PRIOR = Regularization(kind="euclidean", weight=1e-6)
LENGTH = 2  # links of a leg

# Signs of x, y and z in the image of the front left leg, and how the configuration says so.
LEGS = {"FL": (1, 1, 1), "FR": (1, -1, 1), "HL": (-1, 1, 1), "HR": (-1, -1, 1)}
COPIES = {"FR": ("FL", "xz"), "HR": ("HL", "xz"), "HL": ("FL", "yz")}  # the hind right one by way of the left one


def legs_urdf(rng: np.random.Generator, names: Sequence[str]) -> str:
    """Legs that are images of one another but for their inertials, which are anything."""
    placed = [(rng.uniform(-0.3, 0.3, 3), rng.uniform(-1, 1, 3), np.eye(3)[i]) for i in range(LENGTH)]
    parts = ['<link name="base"/>']
    for name in names:
        signs = np.array(LEGS[name])
        turned = np.prod(signs) * signs  # of what turns: rotation about a reflected axis turns the other way
        for i, (xyz, rpy, axis) in enumerate(placed, start=1):
            place, angles, about = (" ".join(map(repr, x.tolist())) for x in (signs * xyz, turned * rpy, turned * axis))
            inside = f'<origin xyz="{place}" rpy="{angles}"/><axis xyz="{about}"/>'
            parent = "base" if i == 1 else f"{name}_link{i - 1}"
            parts.append(f'<link name="{name}_link{i}">{inertial(rng)}</link>')
            parts.append(joint(f"{name}{i}", "revolute", parent, f"{name}_link{i}", inside))
    return f'<robot name="legs">{"".join(parts)}</robot>'


def copies(names: Sequence[str], joints: bool = True) -> list[dict[str, str]]:
    """The configuration's `mirror`."""
    found = []
    for copy, (of, plane) in COPIES.items():
        for i in range(1, LENGTH + 1) if copy in names else ():
            found.append({"body": f"{copy}_link{i}", "of": f"{of}_link{i}", "plane": plane})
            found += [{"joint": f"{copy}{i}", "of": f"{of}{i}"}] if joints else []
    return found


def image(pi: Array, signs: Sequence[int]) -> Array:
    """Parameters of a body's image: every moment changes sign with the coordinates in it."""
    x, y, z = signs
    return np.asarray(pi * [1, x, y, z, 1, x * y, 1, x * z, y * z, 1])


def legs(robot_of: Robots, names: Sequence[str], count: int = 200, alike: bool = False, **config: Any) -> Synthetic:
    """Legs whose bodies are in truth images of each other, and so is their friction but for offsets.

    Parameters
    ----------
    robot_of
        Reads a URDF.
    names
        Which legs.
    count
        Samples.
    alike
        Whether all legs move as the first one does.
    config
        What the configuration holds beside gravity and bounding ellipsoids of the front left leg.
    """
    rng = np.random.default_rng(7)
    robot = robot_of(legs_urdf(rng, names))
    bounds = {f"FL_link{i}": [random_bound(rng)] for i in range(1, LENGTH + 1)}
    states = random_states(rng, count, LENGTH * len(names))
    if alike:
        states = np.tile(states[:, :, :LENGTH], len(names))
    everything = {"gravity": [0.0, 0.0, -9.81], "friction": {"offset": True}, "bounding_ellipsoids": bounds, **config}
    s = synthetic(rng, robot, count, everything, states)
    shared = {name: rng.uniform(0.2, 2) for i in range(1, LENGTH + 1) for name in (f"viscous{i}", f"coulomb{i}")}
    theta = s.theta.copy()
    for i in range(1, LENGTH + 1):
        first = body(s.model, f"FL_link{i}")
        places, masses = points_in(rng, first.ellipsoids[0], 8), rng.uniform(0.05, 0.3, 8)
        for name in names:
            theta[of_body(s, f"{name}_link{i}")] = point_parameters(masses, places * LEGS[name])
    for k, c in enumerate(s.linear.coefficients):
        if c.name in ("viscous", "coulomb"):
            theta[k] = shared[c.name + c.owner[-1]]
    return replace(s, theta=theta)


def of_body(s: Synthetic, name: str) -> slice:
    """Indices of a body's coefficients."""
    first = PI_SIZE * [b.name for b in s.model.bodies].index(name)
    return slice(first, first + PI_SIZE)


def of_joint(s: Synthetic, name: str, term: str) -> int:
    """Index of a friction term's coefficient."""
    (found,) = [k for k, c in enumerate(s.linear.coefficients) if (c.owner, c.name) == (name, term)]
    return found


def fit(
    s: Synthetic,
    tau: Array,
    equalities: EqualityConstraints | None = None,
    kind: str = "ellipsoid",
    prior: Regularization = PRIOR,
) -> Estimate:
    """The identification with what is known, by default what the configuration says."""
    equalities = equalities or s.equalities
    bodies = with_equal_bounds(s.model, equalities).bodies
    return estimate(s.linear, bodies, s.reduction(tau), [choose_set(b, kind) for b in bodies], prior, equalities)


def no_constraints(s: Synthetic) -> EqualityConstraints:
    """No equality constraints."""
    return EqualityConstraints.none(len(s.theta))


def uncertainty_with(s: Synthetic, equalities: EqualityConstraints, sigma: float = 1.0) -> Uncertainty:
    """Uncertainty of the coefficients under equality constraints."""
    return least_squares_uncertainty(s.linear, s.reduction(s.tau), np.full(len(s.Y), sigma), equalities)
