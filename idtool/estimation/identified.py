"""The logs reduced, and the coefficients identified from them by least squares or instrumental variables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from idtool.common.arrays import Array
from idtool.common.exceptions import SolverError
from idtool.estimation.dataset.blocks import Blocks, together
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.problem.backends import check_backend
from idtool.estimation.problem.identify import Estimate, identify
from idtool.estimation.problem.local import LOCAL
from idtool.estimation.problem.prior_bodies import prior_bodies
from idtool.estimation.problem.regularization_path import RegularizationPath, assumed_weight, regularization_path
from idtool.estimation.two_stage import TwoStage, two_stage
from idtool.robot.body import Body
from idtool.robot.config import Regularization
from idtool.robot.sets import ConstraintSet, choose_set

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
    prior
        The bodies that the fit was pulled towards; see `prior_bodies`.
    regularization
        Its kind, and its weight as a number.
    path
        How that was chosen; None where it was given.
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
    prior: tuple[Body, ...]
    regularization: Regularization
    path: RegularizationPath | None
    again: Callable[[Reduction], Estimate]
    two_stage: TwoStage | None
    warnings: tuple[str, ...]

    def theta_of(self, data: Reduction) -> Array:
        """The coefficients by least squares from other data, shape (p,)."""
        return self.again(data).theta


def identified(
    experiment: Experiment, method: Method, progress: Progress, data: tuple[Blocks, ...] | None = None
) -> Identified:
    """Reduce and identify.

    Parameters
    ----------
    experiment
        Model and data.
    method
        Least squares, or instrumental variables, which noise in q and v does not bias.
    progress
        Told the stage and how far it has come.
    data
        The training data, where they have been reduced before.

    Raises
    ------
    LogError
        If there are fewer samples than it takes, or a joint does not move.
    ModelError
        If there are no instruments, as the model cannot be simulated.
    SolverError
        If the problem could not be solved.
    """
    if backend := experiment.config.solver.backend:
        check_backend(backend)  # before the logs are read through
    data = data or experiment.blocks(lambda run: experiment.rows(run, progress))
    reduction = together([log.total for log in data])
    config = experiment.config
    wanted = config.constraints or ("full" if config.solver.name in LOCAL else None)  # all that a local solver knows
    sets, remarks = choose_sets(experiment.model.bodies, wanted)
    experiment, path, said = _with_prior(experiment, data, reduction, sets, progress)
    remarks += said
    regularization, prior = experiment.config.regularization, experiment.model.bodies
    progress("solving", 0.0)
    again = partial(
        identify,
        experiment.equation,
        experiment.model.bodies,
        sets=sets,
        regularization=regularization,
        known=experiment.known,
        solver=config.solver.name,
        backend=config.solver.backend,
    )
    estimate = again(reduction)
    if method == "ls":
        return Identified(sets, data, reduction, estimate, prior, regularization, path, again, None, tuple(remarks))
    other = two_stage(experiment, sets, estimate.theta, progress)
    estimate = replace(again(other.projected, noise=other.noise), noise=other.noise)
    warnings = (*remarks, *other.warnings)
    return Identified(sets, data, other.projected, estimate, prior, regularization, path, again, other, warnings)


def _with_prior(
    experiment: Experiment,
    data: Sequence[Blocks],
    reduction: Reduction,
    sets: Sequence[ConstraintSet],
    progress: Progress,
) -> tuple[Experiment, RegularizationPath | None, list[str]]:
    """The experiment with the prior that its fit is pulled towards and its weight as a number; how that was chosen."""
    regularization = experiment.config.regularization
    if regularization.kind == "none":
        return experiment, None, []
    prior = prior_bodies(experiment.config, experiment.model, experiment.equation, reduction)
    said = list(prior.warnings)
    if prior.placeholders and regularization.mass_precision is None:
        regularization = regularization.model_copy(update={"mass_precision": 1.0})  # nobody has weighed these
    if prior.bodies is not experiment.model.bodies:
        model = replace(experiment.model, bodies=prior.bodies)
        experiment = replace(experiment, model=model, equation=prior.equation)
    path = None
    if regularization.is_automatic:
        progress("choosing the prior's weight", 0.0)
        equation, bodies, known = experiment.equation, experiment.model.bodies, experiment.known
        noise = free_noise(equation, reduction, known)
        try:
            path = regularization_path(equation, bodies, data, sets, regularization, known, noise)
            regularization = regularization.weighing(path.weight)
        except SolverError:  # what cannot be fulfilled, the fit itself says with its place in the configuration
            regularization = regularization.weighing(assumed_weight(reduction))
            said.append(f"the prior's weight could not be chosen from the data; {regularization.number:.1g} is assumed")
    config = experiment.config.model_copy(update={"regularization": regularization})
    return replace(experiment, config=config), path, said


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
