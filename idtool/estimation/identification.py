"""Estimation from logs: the logs reduced, the prior chosen, the coefficients estimated by one of two methods."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import SolverError
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.estimation.dataset.blocks import Blocks, merge_reductions
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.weights import free_noise, weighted_rows
from idtool.estimation.problem.backends import check_backend
from idtool.estimation.problem.estimate import Estimate, estimate
from idtool.estimation.problem.local import LOCAL
from idtool.estimation.problem.prior_bodies import prior_bodies
from idtool.estimation.problem.regularization_path import RegularizationPath, assumed_weight, regularization_path
from idtool.estimation.two_stage import TwoStage, two_stage_estimate
from idtool.robot.body import Body
from idtool.robot.config import Regularization
from idtool.robot.geometry import links_with_geometry
from idtool.robot.model import RobotModel
from idtool.robot.sets import ConstraintSet, choose_set

Method = Literal["ls", "iv"]


@dataclass(frozen=True)
class Identification:
    """An estimate with the data and the prior that it was made from.

    Attributes
    ----------
    sets
        The constraint set of each body.
    data
        The logs.
    reduction
        The data of the estimate: all logs, for instrumental variables projected onto the instruments.
    estimate
        The coefficients.
    prior
        The bodies that the fit was pulled towards; see `prior_bodies`.
    regularization
        Its kind, and its weight as a number.
    path
        The choice of that weight; None where it was given.
    reestimate
        Least squares from other data.
    two_stage
        The instruments and their estimate; None for least squares.
    notices
        Plain sentences for the user.
    """

    sets: tuple[ConstraintSet, ...]
    data: tuple[Blocks, ...]
    reduction: Reduction
    estimate: Estimate
    prior: tuple[Body, ...]
    regularization: Regularization
    path: RegularizationPath | None
    reestimate: Callable[[Reduction], Estimate]
    two_stage: TwoStage | None
    notices: tuple[Notice, ...]

    def theta_from(self, data: Reduction) -> Array:
        """The coefficients by least squares from other data, shape (p,)."""
        return self.reestimate(data).theta


def estimate_from_logs(
    experiment: Experiment, method: Method, progress: Progress, data: tuple[Blocks, ...] | None = None
) -> Identification:
    """Reduce the logs and estimate the coefficients.

    Parameters
    ----------
    experiment
        Model and data.
    method
        Least squares, or instrumental variables, which noise in q and v does not bias.
    progress
        Callback for the stage and its progress, from 0 to 1.
    data
        The training data, if they have been reduced before.

    Raises
    ------
    LogError
        If there are fewer samples than it takes, or a joint does not move.
    ModelError
        If there are no instruments, as the model cannot be simulated.
    SolverError
        If the problem could not be solved.
    """
    config = experiment.config
    if config.solver.backend:
        check_backend(config.solver.backend)  # before the logs are read through
    data = data or experiment.reduce_in_blocks(progress)
    reduction = merge_reductions([log.total for log in data])

    set_name = config.constraints
    if set_name is None and config.solver.name in LOCAL:
        set_name = "full"  # the only one that a local solver knows
    sets = choose_sets(experiment.model.bodies, set_name)
    notices = bounds_notices(experiment.model, sets, set_name)
    noise = free_noise(experiment.equation, reduction, experiment.equalities)
    rows = weighted_rows(experiment.equation, reduction, noise)
    experiment, path, prior_notices = _with_prior(experiment, data, reduction, sets, noise, rows, progress)
    notices += prior_notices
    prior = experiment.model.bodies
    regularization = experiment.config.regularization

    progress("solving", 0.0)
    reestimate = partial(
        estimate,
        experiment.equation,
        prior,
        sets=sets,
        regularization=regularization,
        equalities=experiment.equalities,
        solver=config.solver.name,
        backend=config.solver.backend,
    )
    solution = reestimate(reduction, noise=noise, rows=rows)
    two_stage = None
    if method == "iv":
        two_stage = two_stage_estimate(experiment, sets, solution.theta, progress)
        reduction = two_stage.projected
        solution = replace(reestimate(reduction, noise=two_stage.noise), noise=two_stage.noise)
        notices += two_stage.notices
    return Identification(
        sets=sets,
        data=data,
        reduction=reduction,
        estimate=solution,
        prior=prior,
        regularization=regularization,
        path=path,
        reestimate=reestimate,
        two_stage=two_stage,
        notices=tuple(notices),
    )


def _with_prior(
    experiment: Experiment,
    data: Sequence[Blocks],
    reduction: Reduction,
    sets: Sequence[ConstraintSet],
    noise: Array,
    rows: Array,
    progress: Progress,
) -> tuple[Experiment, RegularizationPath | None, list[Notice]]:
    """The experiment with its prior and the prior's weight as a number, the choice of that, and notices."""
    regularization = experiment.config.regularization
    if regularization.kind == "none":
        return experiment, None, []
    prior = prior_bodies(experiment.config, experiment.model, experiment.equation, reduction)
    notices = list(prior.notices)
    if prior.placeholders and regularization.mass_precision is None:
        regularization = regularization.model_copy(update={"mass_precision": 1.0})  # nobody has weighed these
    if prior.bodies is not experiment.model.bodies:
        model = replace(experiment.model, bodies=prior.bodies)
        experiment = replace(experiment, model=model, equation=prior.equation)
    path = None
    if regularization.is_automatic:
        progress("choosing the prior's weight", 0.0)
        equation, bodies, equalities = experiment.equation, experiment.model.bodies, experiment.equalities
        try:
            path = regularization_path(equation, bodies, data, sets, regularization, equalities, noise, rows)
            regularization = regularization.with_weight(path.weight)
        except SolverError:  # if it is infeasible, the fit itself says so, with the place in the configuration
            regularization = regularization.with_weight(assumed_weight(reduction))
            message = (
                "the weight could not be chosen from the data; "
                f"{short_number(regularization.numeric_weight, 1)} is assumed"
            )
            notices.append(Notice("prior_weight_assumed", "warning", "regularization.weight", message))
    config = experiment.config.model_copy(update={"regularization": regularization})
    return replace(experiment, config=config), path, notices


def choose_sets(bodies: Sequence[Body], name: str | None) -> tuple[ConstraintSet, ...]:
    """The constraint set of each body: the one asked for, by default the tightest that its bounds allow."""
    return tuple(choose_set(body, name) for body in bodies)


def bounds_notices(model: RobotModel, sets: Sequence[ConstraintSet], name: str | None) -> list[Notice]:
    """Notice about bodies that lack the bounds of their constraint set.

    Parameters
    ----------
    model
        The robot.
    sets
        The constraint set of each body.
    name
        The one that was asked for; None: the tightest that each body's bounds allow.
    """
    lacking = []
    for body, chosen in zip(model.bodies, sets, strict=True):
        if (chosen.name != name) if name else not body.bounds:
            lacking.append(body)
    if not lacking:
        return []
    bounds = {"known_com": "known centre of mass", "shape": "bounding shape"}.get(name or "", "bounding ellipsoid")
    names = join_names([body.name for body in lacking])
    message = f"these bodies have no {bounds}, so only full physical consistency is required of them: {names}"
    advice = "add the missing bounds to the configuration"
    links = [member.link for body in lacking if body.kind == "link" for member in body.members]
    if bounds == "bounding ellipsoid" and links_with_geometry(model.robot).intersection(links):
        advice += "; idtool ellipsoids computes bounding ellipsoids of links from their geometry"
    return [Notice("bodies_without_bounds", "warning", None, message, advice)]
