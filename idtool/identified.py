"""The logs reduced, and the coefficients identified from them by least squares or instrumental variables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from idtool.blocks import Blocks, together
from idtool.body import Body
from idtool.experiment import Experiment, Progress
from idtool.identify import Estimate, identify
from idtool.local import LOCAL
from idtool.reduction import Reduction
from idtool.sets import ConstraintSet, choose_set
from idtool.two_stage import TwoStage, two_stage

Array = NDArray[np.float64]

Method = Literal["ls", "iv"]


@dataclass(frozen=True)
class Identified:
    """An identification.

    Attributes
    ----------
    sets
        The constraint set of each body.
    data
        The logs.
    reduction
        What the estimate was made from: all of them, for instrumental variables seen through the instruments.
    estimate
        The coefficients.
    again
        The identification by least squares from other data.
    two_stage
        How the instruments were found; None for least squares.
    warnings
        What a user should know, a plain sentence each.
    """

    sets: tuple[ConstraintSet, ...]
    data: tuple[Blocks, ...]
    reduction: Reduction
    estimate: Estimate
    again: Callable[[Reduction], Estimate]
    two_stage: TwoStage | None
    warnings: tuple[str, ...]

    def theta_of(self, data: Reduction) -> Array:
        """The coefficients by least squares from other data, shape (p,)."""
        return self.again(data).theta


def identified(experiment: Experiment, method: Method, progress: Progress) -> Identified:
    """Reduce and identify.

    Parameters
    ----------
    experiment
        Model and data.
    method
        Least squares, or instrumental variables, which noise in q and v does not bias.
    progress
        Told the stage and how far it has come.

    Raises
    ------
    LogError
        If there are fewer samples than it takes, or a joint does not move.
    ModelError
        If there are no instruments, as the model cannot be simulated.
    SolverError
        If the problem could not be solved.
    """
    data = experiment.blocks(lambda run: experiment.rows(run, progress))
    reduction = together([log.total for log in data])
    config, bodies = experiment.config, experiment.model.bodies
    wanted = config.constraints or ("full" if config.solver.name in LOCAL else None)  # all that a local solver knows
    sets, remarks = choose_sets(bodies, wanted)
    progress("solving", 0.0)
    again = partial(
        identify,
        experiment.equation,
        bodies,
        sets=sets,
        regularization=config.regularization,
        known=experiment.known,
        solver=config.solver.name,
    )
    estimate = again(reduction)
    if method == "ls":
        return Identified(sets, data, reduction, estimate, again, None, tuple(remarks))
    other = two_stage(experiment, sets, estimate.theta, progress)
    estimate = replace(again(other.projected, noise=other.noise), noise=other.noise)
    return Identified(sets, data, other.projected, estimate, again, other, (*remarks, *other.warnings))


def choose_sets(bodies: Sequence[Body], name: str | None) -> tuple[tuple[ConstraintSet, ...], list[str]]:
    """The constraint set of each body: the one asked for or the tightest, without an ellipsoid the tightest without.

    Returns
    -------
    One set a body, and a remark on bodies that lack their ellipsoid.
    """
    sets = tuple(choose_set(body, name) for body in bodies)
    lacking = [
        body.name
        for body, chosen in zip(bodies, sets, strict=True)
        if (chosen.name != name if name else not body.bounds)
    ]
    lack = {"known_com": "known centre of mass", "shape": "bounding shape"}.get(name or "", "bounding ellipsoid")
    return sets, [f"no {lack}, only full consistency is demanded: {', '.join(lacking)}"] if lacking else []
