"""`validate`: how well a model predicts logs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from idtool.api.data import Logs, call, changed, experiment_of
from idtool.api.model import Model, Source, as_model
from idtool.api.records import Progress, Recordable, Saved, notice_lines, silent, table
from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.common.names import suggestion
from idtool.common.outputs import as_json
from idtool.estimation.dataset.experiment import Experiment, coefficients_of, sources_of
from idtool.estimation.evaluation.rollouts import RolloutEvaluation, evaluate_rollouts, simulation_notices
from idtool.estimation.evaluation.validation import Evaluation, evaluate
from idtool.reporting.figures import figure
from idtool.reporting.fit_report import validation_report
from idtool.reporting.results.validation import ValidationReport
from idtool.reporting.simulation_report import simulation_report
from idtool.robot.model import Model as RobotModel

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from idtool.api.records import RecordingData


class ValidationResult(ValidationReport, Saved, Recordable):
    """Validation of a model on logs. The fields are those of validation.json."""

    _model: RobotModel
    _models: Mapping[str, Array]
    _evaluation: Evaluation
    _rollouts: RolloutEvaluation | None
    _made_by: str

    def _files(self, folder: Path, made_by: str) -> dict[str, str | bytes]:
        from idtool.reporting.pages import validation_page

        bodies = (self._model, self._models)
        page = validation_page(self._evaluation, self, made_by, self._rollouts, bodies)
        return {"validation.json": as_json(self.to_json()), "validation.html": page}

    def _recording_data(self) -> RecordingData:
        from idtool.api.recording import beside

        motions = self._rollouts.traces if self._rollouts else ()
        return self._model, beside(self._evaluation, motions), "model"

    def plot(self, log: int = 0) -> Figure:
        """Measured and predicted torque and the residual of every joint.

        Parameters
        ----------
        log
            Which of the logs.

        Raises
        ------
        IndexError
            If there are not so many.
        """
        from idtool.reporting.plots.torques import torque_figures

        return torque_figures(self._evaluation, "model", self.units).groups[log].to_plotly()

    def __repr__(self) -> str:
        units = " or ".join(dict.fromkeys(self.units.values()))
        prior, bounds = self.rms.prior, self.bound
        head = ["joint", "model", *(["prior"] if prior else []), "of torque", *(["bound"] if bounds else [])]
        rows = []
        for name in (*self.joints, "overall"):
            share = self.nrms.get(name)
            row = [name, figure(self.rms.model[name]), *([figure(prior[name])] if prior else [])]
            row.append("" if share is None else f"{100 * share:.1f}%")
            missed = "" if self.ok.get(name, True) else " missed"
            rows.append([*row, *([f"{figure(bounds[name])}{missed}" if name in bounds else ""] if bounds else [])])
        title = f"ValidationResult: RMS torque error [{units}] below {self.band_hz:g} Hz"
        return "\n".join([title, *table(head, rows), *notice_lines(self.notices)])


def validate(
    model: Model | Source,
    logs: Logs,
    *,
    prior: Model | Source | None = None,
    max_rms: float | Mapping[str, float] | None = None,
    simulation: bool = True,
    progress: Progress | None = None,
) -> ValidationResult:
    """Tell how well a model predicts the torque and the motion of logs; `idtool validate` as a function.

    Parameters
    ----------
    model
        The model, or its URDF.
    logs
        The logs: paths, read as the configuration says, or `Log`.
    prior
        A model of the same robot to compare with. Without a configuration of its own it takes the model's, but neither
        the values of its friction nor its effects.
    max_rms
        Largest torque error that is accepted [N·m or N], over all joints or by joint and ``overall``; see ``ok``.
    simulation
        Whether to run the models forwards too.
    progress
        Told the stage and the share of it that is done; None: silence.

    Raises
    ------
    IdtoolError
        If a log, a configuration or a model cannot be used. Messages name options as the command line does.

    Examples
    --------
    >>> found = idtool.validate("sample_logs/leg.urdf", "sample_logs/leg_validate.mcap", max_rms=0.5, simulation=False)
    >>> found.rms.model["overall"] > 0.5
    True
    >>> found.ok["overall"]
    False
    """
    told = progress or silent
    model = as_model(model)
    experiment = experiment_of(model, (), logs, progress=told)
    bounds = _bounds(max_rms, experiment)
    other = prior if prior is None or isinstance(prior, Model) else prior_model(Path(prior))
    options = changed(validate, max_rms=max_rms, simulation=simulation)
    made_by = call("validate", model, logs, **({"prior": other.name} if other else {}), **options)
    return validate_experiment(experiment, other, bounds, made_by, told, simulation)


def prior_model(urdf: Path) -> Model:
    """A URDF to compare with; only a configuration under its own name is its own.

    Parameters
    ----------
    urdf
        The URDF.

    Raises
    ------
    IdtoolError
        If it or its configuration cannot be read.
    """
    return Model(urdf) if urdf.with_suffix(".yaml").is_file() else Model.bare(urdf)


def validate_experiment(
    experiment: Experiment,
    prior: Model | None,
    bounds: Mapping[str, float],
    made_by: str,
    progress: Progress,
    simulate: bool = True,
) -> ValidationResult:
    """The same from model and logs put together.

    Parameters
    ----------
    experiment
        Model and data, all of it held out.
    prior
        A model to compare with.
    bounds
        Largest torque error that is accepted, by joint or ``overall``.
    made_by
        What the page says it was made by.
    progress
        Told the stage and how far it has come.
    simulate
        Whether to run the models forwards too.

    Raises
    ------
    ModelError
        If ``prior`` is no model of the same robot.
    """
    models, sources = {"model": experiment.equation.prior}, experiment.sources
    if prior is not None:
        own = prior.settings if prior.configured else experiment.config.without_friction_values()
        models["prior"] = coefficients_of(prior.robot, own, experiment)
        sources += tuple(replace(s, kind=f"prior's {s.kind}") for s in sources_of(prior.robot, prior.settings))
    evaluation = evaluate(experiment, models, held_out=True, progress=progress, angles=True)
    rollouts = evaluate_rollouts(experiment, models, held_out=True, progress=progress) if simulate else None
    simulation = simulation_report(rollouts, "model", experiment)
    notices = [*experiment.notices, *simulation_notices(rollouts, "model")]
    report = validation_report(
        evaluation, experiment.model.units, experiment.band_hz, bounds, simulation, sources, notices
    )
    result = ValidationResult.from_result(report)
    result._model = experiment.model
    result._models = models
    result._evaluation = evaluation
    result._rollouts = rollouts
    result._made_by = made_by
    return result


def _bounds(given: float | Mapping[str, float] | None, experiment: Experiment) -> dict[str, float]:
    """Bounds by joint or ``overall``."""
    bounds = dict(given) if isinstance(given, Mapping) else {} if given is None else {"overall": given}
    known = (*experiment.equation.joints, "overall")
    for name, bound in bounds.items():
        if name not in known:
            raise ConfigError("--max-rms", f"{name} is not a joint; {suggestion(name, known)}")
        if not 0 < bound < math.inf:
            raise ConfigError("--max-rms", f"{bound} is not a bound; give a number above 0")
    return bounds
