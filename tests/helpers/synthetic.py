"""Data made without idtool: Pinocchio's regressor rows of random trees, whose true bodies are point masses.

Letters: nv joints, n samples, p coefficients; Y (nv, n, p) rows, tau (nv, n) torque [N·m or N], theta (p,) the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from reference import Reference
from robots import actuated, rotation

from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints, equality_constraints
from idtool.estimation.dataset.reduction import Factor, Reduction
from idtool.robot.body import Body, Frame
from idtool.robot.config import Config, parse_config
from idtool.robot.ellipsoid import Ellipsoid
from idtool.robot.inertia import PI_SIZE
from idtool.robot.model import RobotModel, build_model
from idtool.robot.shapes import Shape
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]

FRICTION: dict[str, Callable[[Array], Array]] = {"viscous": lambda v: v, "coulomb": np.sign, "offset": np.ones_like}


@dataclass(frozen=True)
class Synthetic:
    """A robot, its true coefficients, and the rows of a motion in which no sample knows of the others."""

    config: Config
    model: RobotModel
    linear: LinearModel
    Y: Array
    theta: Array

    @property
    def tau(self) -> Array:
        """Torque without noise."""
        return np.asarray(self.Y @ self.theta)

    @property
    def equalities(self) -> EqualityConstraints:
        """The configuration's equality constraints."""
        return equality_constraints(self.config, self.model, self.linear)

    def noisy(self, share: float, seed: int = 0) -> Array:
        """The torque with white noise of a share of its own spread, joint by joint."""
        noise = np.random.default_rng(seed).normal(size=self.tau.shape)
        return np.asarray(self.tau + share * self.tau.std(axis=1, keepdims=True) * noise)

    def reduction(self, tau: Array) -> Reduction:
        """The rows and a torque as R-factors."""
        return tuple(
            Factor.from_columns(np.vstack([Y.T[columns], row]))
            for Y, row, columns in zip(self.Y, tau, self.linear.active(), strict=True)
        )


def synthetic(
    rng: np.random.Generator,
    robot: Robot,
    count: int,
    config: Mapping[str, Any] | None = None,
    states: Array | None = None,
) -> Synthetic:
    """Random states, or those given (3, n, nv), of a robot whose bodies are, in truth, points of mass in ellipsoids."""
    everything: dict[str, Any] = {"gravity": [0.0, 0.0, -9.81], **(config or {})}
    parsed = parse_config(everything, "")
    model = build_model(robot, parsed, actuated(robot))
    linear = LinearModel(model.names, build_effects(model, parsed))
    reference = Reference(robot.text.decode(), model.names, everything)
    q, v, a = random_states(rng, count, len(model.names)) if states is None else states
    names = [body.name for body in model.bodies]
    rigid = np.stack([reference.regressor(names, *state) for state in zip(q, v, a, strict=True)], axis=1)
    others = [c for c in linear.coefficients if c.effect != "rigid_body"]
    friction = np.zeros((*rigid.shape[:2], len(others)))
    for k, coefficient in enumerate(others):
        j = model.names.index(coefficient.owner)
        friction[j, :, k] = FRICTION[coefficient.name](v[:, j])
    truth = np.concatenate([*(true_body(rng, body) for body in model.bodies), rng.uniform(0.2, 2, len(others))])
    return Synthetic(parsed, model, linear, np.concatenate([rigid, friction], axis=2), truth)


def random_states(rng: np.random.Generator, count: int, nv: int) -> Array:
    """Independent random positions, velocities and accelerations, shape (3, count, nv)."""
    return np.asarray(rng.normal(size=(3, count, nv)) * np.array([1.0, 3.0, 20.0])[:, None, None])


def true_body(rng: np.random.Generator, body: Body) -> Array:
    """Parameters of six points of mass in each of a body's ellipsoids, or around its own frame."""
    parts = [points_in(rng, ellipsoid, 6) for ellipsoid in body.ellipsoids] or [0.1 * rng.normal(size=(6, 3))]
    return point_parameters(rng.uniform(0.05, 0.3, sum(map(len, parts))), np.concatenate(parts))


def point_parameters(masses: Array, places: Array) -> Array:
    """The ten parameters of points of mass (n,) at places (n, 3), written out from their definition."""
    x, y, z = places.T
    moments = [y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y]
    return np.array([np.sum(masses * f) for f in [np.ones_like(x), x, y, z, *moments]])


def points_in(rng: np.random.Generator, ellipsoid: Ellipsoid, count: int) -> Array:
    """Points spread evenly over an ellipsoid, shape (count, 3)."""
    directions = rng.normal(size=(count, 3))
    radii = rng.uniform(size=count) ** (1 / 3) / np.linalg.norm(directions, axis=1)
    return np.asarray(directions * radii[:, None] * ellipsoid.semi_axes @ ellipsoid.rotation.T + ellipsoid.center)


def random_ellipsoid(rng: np.random.Generator) -> Ellipsoid:
    """At any place and angle, of 0.2 to 2 m half length."""
    center, semi_axes = rng.normal(size=3), rng.uniform(0.2, 2, 3)
    return Ellipsoid.from_axes(center, semi_axes, rotation(rng))


def bounded_body(*bounds: Ellipsoid | Shape, com: Array | None = None) -> Body:
    """A link without mass or place within the union of its bounds, its centre known or not."""
    ellipsoids = tuple(bound for bound in bounds if isinstance(bound, Ellipsoid))
    shapes = tuple(bound for bound in bounds if isinstance(bound, Shape))
    mount = Frame(-1, np.eye(3), np.zeros(3))
    center = None if com is None else (float(com[0]), float(com[1]), float(com[2]))
    turn = np.array([0.0, 0.0, 1.0]), False, np.ones(1)
    return Body("body", "link", np.zeros(PI_SIZE), ellipsoids, mount, *turn, shapes=shapes, com=center)


def random_bound(rng: np.random.Generator) -> dict[str, Any]:
    """A bounding ellipsoid as the configuration gives it, at any angle."""
    return {
        "center": rng.uniform(-0.2, 0.2, 3).tolist(),
        "semi_axes": rng.uniform(0.05, 0.3, 3).tolist(),
        "rpy": rng.uniform(-3, 3, 3).tolist(),
    }


def bounds(rng: np.random.Generator, robot: Robot, each: int = 1) -> dict[str, Any]:
    """The configuration with as many ellipsoids for every link."""
    return {"bounding_ellipsoids": {link: [random_bound(rng) for _ in range(each)] for link in robot.links}}
