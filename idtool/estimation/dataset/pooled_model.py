"""`PooledModel`: the torque equation of robots of one type, whose bodies are one, and some terms each robot's own.

Each robot has rows of its own, so that each has its own noise. All else is the model of one robot: theta_r = M_r theta
selects the coefficients of robot r from those of all.

Letters: theta (P,) coefficients of all robots, theta_r (p,) of one; R robots; nv joints of each. Joints, and the
factors of a reduction, are those of the first robot, then those of the second, and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Indices, Mask
from idtool.common.dataclass import dataclass
from idtool.dynamics.effects import Coefficient, friction_types
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.blocks import Blocks
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.dataset.reduction import Factor, Reduction
from idtool.robot.config.pool import FRICTION


@dataclass(frozen=True, kw_only=True)
class PooledModel(LinearModel):
    """The torque equation of several robots.

    Attributes
    ----------
    single_robot
        The equation of one of them.
    robots
        Their names.
    is_own
        True for the coefficients of which each robot has its own, shape (p,).
    """

    single_robot: LinearModel
    robots: tuple[str, ...]
    is_own: Mask

    @property
    @override
    def coefficients(self) -> tuple[Coefficient, ...]:
        shared: list[Coefficient] = []
        own: list[Coefficient] = []
        for coefficient, is_own in zip(self.single_robot.coefficients, self.is_own, strict=True):
            (own if is_own else shared).append(coefficient)
        pooled = shared
        for robot in self.robots:
            pooled += [replace(c, owner=f"{robot}: {c.owner}") for c in own]
        return tuple(pooled)

    @override
    def active(self) -> tuple[Indices, ...]:
        return self._pooled_active

    @cached_property
    def _pooled_active(self) -> tuple[Indices, ...]:
        return tuple(indices[active] for indices in self.indices for active in self.single_robot.active())

    @cached_property
    def indices(self) -> tuple[Indices, ...]:
        """Index of each robot's coefficients among all, shape (p,) each."""
        shared_count = int(np.count_nonzero(~self.is_own))
        own_count = int(np.count_nonzero(self.is_own))
        by_robot = []
        for robot in range(len(self.robots)):
            indices = np.empty(len(self.is_own), dtype=int)
            indices[~self.is_own] = np.arange(shared_count)
            indices[self.is_own] = shared_count + robot * own_count + np.arange(own_count)
            by_robot.append(indices)
        return tuple(by_robot)

    def selection(self, robot: int) -> Array:
        """M_r, which takes the coefficients of all robots to those of one, shape (p, P)."""
        return np.asarray(np.eye(len(self.coefficients))[self.indices[robot]])

    @property
    def averaging(self) -> Array:
        """Matrix that takes the coefficients of all robots to those of the mean robot, shape (p, P)."""
        return np.asarray(np.mean([self.selection(robot) for robot in range(len(self.robots))], axis=0))

    def equalities(self, of_single_robot: EqualityConstraints) -> EqualityConstraints:
        """Equality constraints of one robot, for all of them: theta = K theta[free], and an equation for each robot.

        Equations on shared coefficients alone are the same for all robots, and stand once.
        """
        P = len(self.coefficients)
        is_free = np.zeros(P, dtype=bool)
        K = np.zeros((P, P))
        for indices in self.indices:  # shared coefficients depend on shared ones, so each robot sets the same rows
            is_free[indices[of_single_robot.free]] = True
            K[np.ix_(indices, indices[of_single_robot.free])] = of_single_robot.K
        free = np.flatnonzero(is_free)
        constraints = []
        for constraint in of_single_robot.constraints:
            is_shared = not constraint.row[self.is_own].any()
            for indices in self.indices[:1] if is_shared else self.indices:
                row = np.zeros(P)
                row[indices] = constraint.row
                constraints.append(replace(constraint, row=row))
        return EqualityConstraints(K[:, free], free, tuple(constraints), of_single_robot.copies)

    def blocks(self, log: Blocks, robot: int) -> Blocks:
        """A log of a robot with R·nv factors, robot after robot, of which those of the other robots have no rows."""
        active = self.single_robot.active()
        without_rows = tuple(Factor(np.zeros((0, len(own) + 1)), rows=0, independent=0.0) for own in active)

        def with_other_robots(reduction: Reduction) -> Reduction:
            factors: list[Factor] = []
            for other in range(len(self.robots)):
                factors += reduction if other == robot else without_rows
            return tuple(factors)

        return log.map(with_other_robots)


def pooled_model(single_robot: LinearModel, robots: Sequence[str], own: Sequence[str]) -> PooledModel:
    """The equation of several robots.

    Parameters
    ----------
    single_robot
        The equation of one of them.
    robots
        Their names.
    own
        What each has of its own: ``friction``, or ids of effects.
    """
    own_effects = set(own)
    if FRICTION in own_effects:
        own_effects |= {kind.id for kind in friction_types().values()}
    return PooledModel(
        joints=tuple(f"{robot}: {joint}" for robot in robots for joint in single_robot.joints),
        effects=(),
        single_robot=single_robot,
        robots=tuple(robots),
        is_own=np.array([c.effect in own_effects for c in single_robot.coefficients]),
    )
