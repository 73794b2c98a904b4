"""`PooledModel`: the torque equation of robots of one type, whose bodies are one, and some terms each robot's own.

Each robot has rows of its own, so that each has its own noise. All else is the model of one robot: theta_r = M_r theta
selects the coefficients of robot r from those of all.

Letters: p coefficients of one robot, P of all; R robots; nv joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Indices, Mask
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
    of_one
        The equation of one of them.
    robots
        Their names.
    is_own
        True for the coefficients of which each robot has its own, shape (p,).
    """

    of_one: LinearModel
    robots: tuple[str, ...]
    is_own: Mask

    @property
    @override
    def coefficients(self) -> tuple[Coefficient, ...]:
        of_one = self.of_one.coefficients
        all_of_them = [c for c, is_own in zip(of_one, self.is_own, strict=True) if not is_own]
        for robot in self.robots:
            own = [c for c, is_own in zip(of_one, self.is_own, strict=True) if is_own]
            all_of_them += [replace(c, owner=f"{robot}: {c.owner}") for c in own]
        return tuple(all_of_them)

    @override
    def active(self) -> tuple[Indices, ...]:
        return self._pooled_active

    @cached_property
    def _pooled_active(self) -> tuple[Indices, ...]:
        return tuple(indices[active] for indices in self.indices for active in self.of_one.active())

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
        """M_r: a robot's coefficients from those of all, shape (p, P)."""
        return np.asarray(np.eye(len(self.coefficients))[self.indices[robot]])

    @property
    def mean(self) -> Array:
        """The mean robot's coefficients from those of all, shape (p, P)."""
        return np.asarray(np.mean([self.selection(robot) for robot in range(len(self.robots))], axis=0))

    def equalities(self, of_one: EqualityConstraints) -> EqualityConstraints:
        """The equality constraints of one robot, for all of them; equations are on what they share."""
        P = len(self.coefficients)
        is_free = np.zeros(P, dtype=bool)
        K = np.zeros((P, P))
        for indices in self.indices:
            is_free[indices[of_one.free]] = True
            K[np.ix_(indices, indices[of_one.free])] = of_one.K
        free = np.flatnonzero(is_free)
        constraints = []
        for constraint in of_one.constraints:
            row = np.zeros(P)
            row[self.indices[0]] = constraint.row
            constraints.append(replace(constraint, row=row))
        return EqualityConstraints(K[:, free], free, tuple(constraints), of_one.copies)

    def blocks(self, log: Blocks, robot: int) -> Blocks:
        """A log of a robot, with its rows among those of all."""
        nothing = tuple(Factor(np.zeros((0, len(active) + 1)), 0, 0.0) for active in self.of_one.active())

        def among_all(reduction: Reduction) -> Reduction:
            factors: list[Factor] = []
            for other in range(len(self.robots)):
                factors += reduction if other == robot else nothing
            return tuple(factors)

        return log.map(among_all)


def pooled_model(of_one: LinearModel, robots: Sequence[str], own: Sequence[str]) -> PooledModel:
    """The equation of several robots.

    Parameters
    ----------
    of_one
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
        joints=tuple(f"{robot}: {joint}" for robot in robots for joint in of_one.joints),
        effects=(),
        of_one=of_one,
        robots=tuple(robots),
        is_own=np.array([c.effect in own_effects for c in of_one.coefficients]),
    )
