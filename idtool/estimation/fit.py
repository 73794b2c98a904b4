"""The main job: an experiment → identified parameters, how far to trust them, and how well they predict."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

from idtool.common.arrays import Array
from idtool.estimation.command_delay import CommandDelay, command_delay, with_delay
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.estimation.doubts import doubts
from idtool.estimation.evaluation.replay import Replay, replay, simulation_notes
from idtool.estimation.evaluation.validation import Evaluation, evaluate
from idtool.estimation.identified import Method, identified
from idtool.estimation.problem.identify import Estimate
from idtool.estimation.problem.regularization_path import RegularizationPath
from idtool.estimation.uncertainty import Trust, trust
from idtool.estimation.uncertainty.uncertainty import Uncertainty
from idtool.robot.config import Regularization
from idtool.robot.inertia import SIZE
from idtool.robot.sets import ConstraintSet

_AGAIN = 2  # fits more, where columns depend on what the coefficients are


@dataclass(frozen=True)
class Fit:
    """An identified model.

    Attributes
    ----------
    experiment
        What it was fitted to.
    method
        By least squares, or instrumental variables.
    sets
        The constraint set of each body.
    estimate
        The coefficients with their certificate.
    regularization
        The prior with its weight as a number.
    path
        How that was chosen; None where it was given.
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
    delay
        From command to torque, as the data have it; None: no torque comes from a command, or it was not asked for.
    """

    experiment: Experiment
    method: Method
    sets: tuple[ConstraintSet, ...]
    estimate: Estimate
    regularization: Regularization
    path: RegularizationPath | None
    trust: Trust
    train: Evaluation
    validation: Evaluation
    simulation: Replay | None
    warnings: tuple[str, ...]
    seconds: dict[str, float]
    delay: CommandDelay | None

    @property
    def uncertainty(self) -> Uncertainty:
        """Standard errors."""
        return self.trust.uncertainty

    def parameters(self, index: int) -> Array:
        """The identified parameters of the model's body of that index, shape (10,)."""
        return self.estimate.theta[SIZE * index : SIZE * (index + 1)]


def fit(
    experiment: Experiment,
    progress: Progress,
    simulated: bool = False,
    questioned: bool = False,
    method: Method = "ls",
) -> Fit:
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
        Whether to ask what each number rests on, several logs whether they agree, and whether noise has biased it.
    method
        Least squares, or instrumental variables.

    Raises
    ------
    LogError
        If there are fewer samples than it takes, or a joint does not move.
    ModelError
        If there are no instruments, as the model cannot be simulated.
    SolverError
        If the problem could not be solved.
    """
    clock = _Clock()
    experiment, delay, data = with_delay(experiment, progress)
    if delay is None and questioned:
        delay = command_delay(experiment, progress)
    clock.done("delay")
    found = identified(experiment, method, progress, data)
    for _ in range(_AGAIN if experiment.equation.depends_on_parameters else 0):
        experiment = replace(experiment, equation=experiment.equation.linearized_at(found.estimate.theta))
        settled = experiment.config.model_copy(update={"regularization": found.regularization})
        found = replace(identified(replace(experiment, config=settled), method, progress), path=found.path)
    estimate = found.estimate
    warnings = [*experiment.warnings, *(delay.warnings if delay else ()), *found.warnings]
    clock.done("identify")
    models = {"identified": estimate.theta, "prior": experiment.equation.prior}
    train = evaluate(experiment, models, held_out=False, progress=progress, angles=True)
    validation = evaluate(experiment, models, held_out=True, progress=progress, angles=True)
    held_out = validation.errors["identified"].samples > 0
    if not held_out:
        warnings.append("nothing was held out: the training error says little of how the model predicts")
    warnings += doubts(experiment, found, validation if held_out else train, held_out)
    clock.done("evaluate")
    change = delay.slope * delay.error if delay and delay.error else None
    believed = trust(experiment, found, train.independent, progress, questioned, change)
    warnings += believed.warnings
    clock.done("uncertainty")
    simulation = replay(experiment, models, held_out, progress) if simulated else None
    warnings += simulation_notes(simulation, "identified")
    clock.done("simulate")
    return Fit(
        experiment,
        method,
        found.sets,
        estimate,
        found.regularization,
        found.path,
        believed,
        train,
        validation,
        simulation,
        tuple(warnings),
        clock.seconds,
        delay,
    )


class _Clock:
    """Wall time of stages, one after the other."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def done(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage], self._last = now - self._last, now
