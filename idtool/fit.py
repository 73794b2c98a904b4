"""The main job: an experiment → identified parameters, how far to trust them, and how well they predict."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from idtool.blocks import together
from idtool.body import Body
from idtool.experiment import Experiment, Progress
from idtool.identify import Estimate, identify, stuck_note
from idtool.inertia import SIZE, pseudo_inertia
from idtool.local import LOCAL
from idtool.prior import moved_priors
from idtool.replay import Replay, replay
from idtool.sets import ConstraintSet, choose_set
from idtool.simulation_report import simulation_notes
from idtool.trust import Trust, trust
from idtool.uncertainty import Uncertainty
from idtool.validate import Evaluation, evaluate


@dataclass(frozen=True)
class Fit:
    """An identified model.

    Attributes
    ----------
    experiment
        What it was fitted to.
    sets
        The constraint set of each body.
    estimate
        The coefficients with their certificate.
    trust
        Standard errors, and what they rest on.
    train, validation
        Errors of the ``identified`` and the ``prior`` model; ``validation`` has no samples where nothing was held out.
    simulation
        The same models run forwards, on what was held out, else on the training data; None: not asked for.
    warnings
        What a user should know, a plain sentence each.
    seconds
        Wall time of each stage.
    """

    experiment: Experiment
    sets: tuple[ConstraintSet, ...]
    estimate: Estimate
    trust: Trust
    train: Evaluation
    validation: Evaluation
    simulation: Replay | None
    warnings: tuple[str, ...]
    seconds: dict[str, float]

    @property
    def uncertainty(self) -> Uncertainty:
        """Standard errors."""
        return self.trust.uncertainty

    def parameters(self, index: int) -> NDArray[np.float64]:
        """The identified parameters of the model's body of that index, shape (10,)."""
        return self.estimate.theta[SIZE * index : SIZE * (index + 1)]


def fit(experiment: Experiment, progress: Progress, simulated: bool = False, questioned: bool = False) -> Fit:
    """Identify.

    Parameters
    ----------
    experiment
        Model and data.
    progress
        Told the stage and how far it has come.
    simulated
        Whether to run the identified model and the prior forwards too.
    questioned
        Whether to ask what each number rests on, and several logs whether they agree.

    Raises
    ------
    LogError
        If there are fewer samples than it takes, or a joint does not move.
    SolverError
        If the problem could not be solved.
    """
    clock = _Clock()
    equation, model, known = experiment.equation, experiment.model, experiment.known
    data = experiment.blocks(progress)
    reduction = together([log.total for log in data])
    clock.done("reduce")
    warnings = list(experiment.warnings)
    config = experiment.config
    wanted = config.constraints or ("full" if config.solver.name in LOCAL else None)  # all that a local solver knows
    sets, remarks = choose_sets(model.bodies, wanted)
    warnings += remarks
    progress("solving", 0.0)
    solved = partial(
        identify,
        equation,
        model.bodies,
        sets=sets,
        regularization=config.regularization,
        known=known,
        solver=config.solver.name,
    )
    estimate = solved(reduction)
    warnings += _doubts(experiment, estimate)
    clock.done("identify")
    models = {"identified": estimate.theta, "prior": equation.prior}
    train = evaluate(experiment, models, held_out=False, progress=progress)
    validation = evaluate(experiment, models, held_out=True, progress=progress)
    held_out = validation.errors["identified"].samples > 0
    if not held_out:
        warnings.append("nothing was held out: the training error says little of how the model predicts")
    clock.done("evaluate")
    believed = trust(experiment, data, reduction, estimate, train.independent, solved, progress, questioned)
    warnings += believed.warnings
    clock.done("uncertainty")
    simulation = replay(experiment, models, held_out, progress) if simulated else None
    warnings += simulation_notes(simulation, "identified")
    clock.done("simulate")
    return Fit(experiment, sets, estimate, believed, train, validation, simulation, tuple(warnings), clock.seconds)


class _Clock:
    """Wall time of stages, one after the other."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def done(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage], self._last = now - self._last, now


def _doubts(experiment: Experiment, estimate: Estimate) -> list[str]:
    """What speaks against an estimate."""
    bodies, doubts = experiment.model.bodies, []
    if stuck := stuck_note(estimate.certificate):
        doubts.append(stuck)
    unreal = [body.name for i, body in enumerate(bodies) if not _can_be(estimate.theta[SIZE * i : SIZE * (i + 1)])]
    if unreal:
        doubts.append(f"no body can have the parameters of {', '.join(unreal)}: a URDF may not hold them")
    if moved := moved_priors(experiment.equation, bodies, experiment.config.regularization):
        doubts.append(f"no body can have the prior of {', '.join(moved)}; what is next to it stands in for it")
    return doubts


def _can_be(pi: NDArray[np.float64]) -> bool:
    return bool(np.linalg.eigvalsh(pseudo_inertia(pi))[0] > 0)


def choose_sets(bodies: tuple[Body, ...], name: str | None) -> tuple[tuple[ConstraintSet, ...], list[str]]:
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
