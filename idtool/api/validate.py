"""`validate`: a model's prediction errors on logs."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from idtool.api.data import Logs, call_text, changed_options, load_experiment
from idtool.api.distribution import open_distribution
from idtool.api.model import Model, Source, as_model
from idtool.api.notebook import Displayable, shows_progress
from idtool.api.results import Progress, Recordable, SavableResult, ignore_progress, notice_lines, table_lines
from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.common.names import suggestion
from idtool.common.number_text import number
from idtool.common.outputs import as_json
from idtool.common.threads import with_single_threaded_blas
from idtool.common.units import units_text
from idtool.estimation.dataset.experiment import Experiment, coefficients_of, sources_of
from idtool.estimation.evaluation.reduced_errors import TorqueEvaluator
from idtool.estimation.evaluation.rollouts import RolloutEvaluation, evaluate_rollouts, simulation_notices
from idtool.estimation.evaluation.torque_errors import Evaluation
from idtool.estimation.offset_notices import held_out_offset_notices
from idtool.estimation.reduced_experiment import ReducedExperiment
from idtool.reporting.fit_report import validation_report
from idtool.reporting.results.validation import ValidationReport
from idtool.reporting.simulation_report import simulation_report, why_not_simulated
from idtool.robot.model import RobotModel

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from idtool.api.results import RecordingData
    from idtool.reporting.terminal.output import Output


class ValidationResult(ValidationReport, SavableResult, Recordable, Displayable):
    """Validation of a model on logs. The fields are those of validation.json."""

    _model: RobotModel
    _models: Mapping[str, Array]
    _evaluation: Evaluation
    _rollouts: RolloutEvaluation | None
    _made_by: str

    def _files(self, folder: Path, made_by: str) -> dict[str, str | bytes]:
        from idtool.reporting.pages.validation import validation_page

        bodies = (self._model, self._models)
        page = validation_page(self._evaluation, self, made_by, self._rollouts, bodies)
        return {"validation.json": as_json(self.to_json()), "validation.html": page}

    def _recording_data(self) -> RecordingData:
        from idtool.api.recording import traces_by_log

        motions = self._rollouts.traces if self._rollouts else ()
        return self._model, traces_by_log(self._evaluation, motions), "model"

    def plot(self, log: int = 0) -> Figure:
        """Measured and predicted torque and the residual of every joint.

        Parameters
        ----------
        log
            Which of the logs.

        Raises
        ------
        IndexError
            If there are fewer logs.
        """
        from idtool.reporting.plots.torques import torque_figures

        return torque_figures(self._evaluation, "model", self.units).groups[log].to_plotly()

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.validation import show_validation

        show_validation(output, self)

    def __repr__(self) -> str:
        units = units_text(self.units)
        prior = self.rms.prior
        head = ["joint", "model"]
        if prior:
            head.append("prior")
        head.append("error / torque")
        if self.bound:
            head.append("bound")
        rows = []
        for name in (*self.joints, "overall"):
            row = [name, number(self.rms.model[name])]
            if prior:
                row.append(number(prior[name]))
            share = self.nrms.get(name)
            row.append("" if share is None else f"{100 * share:.1f} %")
            if self.bound:
                row.append(self._bound_text(name))
            rows.append(row)
        lines = [f"ValidationResult: RMS torque error [{units}] below {self.band_hz:g} Hz"]
        lines += table_lines(head, rows)
        lines += notice_lines(self.notices)
        return "\n".join(lines)

    def _bound_text(self, name: str) -> str:
        """The bound of a joint, marked where it was missed; empty without one."""
        if name not in self.bound:
            return ""
        bound = number(self.bound[name])
        return bound if self.ok[name] else f"{bound} (not met)"


@shows_progress
@with_single_threaded_blas
def validate(
    model: Model | Source,
    logs: Logs,
    *,
    prior: Model | Source | None = None,
    max_rms: float | Mapping[str, float] | None = None,
    simulation: bool = True,
    cluster: str | None = None,
    reductions: str | os.PathLike[str] | None = None,
    skip_bad: bool = False,
    progress: Progress | None = None,
) -> ValidationResult:
    """Compute the torque and motion errors of a model on logs, like `idtool validate`.

    Parameters
    ----------
    model
        The model, or its URDF.
    logs
        Paths of logs, which are read with the settings of the configuration, or `Log` objects. Files of
        `idtool.reduce` may stand in their place; then there is no simulation.
    prior
        A model of the same robot for comparison. If it has no configuration of its own, it uses that of the model, but
        without the friction values and the effects.
    max_rms
        Largest accepted torque error [N·m or N], for all joints together, or by joint and ``overall``; see ``ok``.
    simulation
        True to simulate the models too.
    cluster
        Dask cluster that reads the logs: the address or JSON file of its scheduler, or ``local:N`` for N processes on
        this machine. Then there is no simulation.
    reductions
        Folder for the reductions that the cluster makes of the logs, which a later call takes up; None: they are not
        kept.
    skip_bad
        True to leave out logs that cannot be used; a notice names each.
    progress
        Function that is called with the name of a stage and the fraction of it that is done; None: no reports.

    Raises
    ------
    IdtoolError
        If a log, a configuration or a model cannot be used. Messages contain the option names of the command line.

    Examples
    --------
    >>> result = idtool.validate("sample_logs/leg.urdf", "sample_logs/leg_validate.mcap", max_rms=0.5, simulation=False)
    >>> result.rms.model["overall"] > 0.5
    True
    >>> result.ok["overall"]
    False
    """
    report_progress = progress or ignore_progress
    model = as_model(model)
    with open_distribution(cluster, Path(reductions) if reductions else None, report_progress) as distribution:
        experiment = load_experiment(
            model,
            (),
            logs,
            progress=report_progress,
            takes_reductions=True,
            distribution=distribution,
            skip_bad=skip_bad,
        )
    bounds = _check_bounds(max_rms, experiment)
    options = changed_options(validate, max_rms=max_rms, simulation=simulation, cluster=cluster, skip_bad=skip_bad)
    if prior is not None:
        if not isinstance(prior, Model):
            prior = prior_model(Path(prior))
        options = {"prior": prior.name, **options}
    made_by = call_text("validate", model, logs, **options)
    return validate_experiment(experiment, prior, bounds, made_by, report_progress, simulation)


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
    if urdf.with_suffix(".yaml").is_file():
        return Model(urdf)
    return Model.bare(urdf)


def validate_experiment(
    experiment: Experiment,
    prior: Model | None,
    bounds: Mapping[str, float],
    made_by: str,
    progress: Progress,
    simulate: bool = True,
) -> ValidationResult:
    """Validate the model of an experiment, which holds model and logs.

    Parameters
    ----------
    experiment
        Model and data, all of it held out.
    prior
        A model to compare with.
    bounds
        Largest torque error that is accepted, by joint or ``overall``.
    made_by
        Command that the HTML report shows.
    progress
        Called with the stage and the share of it that is done.
    simulate
        True to simulate the models too.

    Raises
    ------
    ModelError
        If ``prior`` is no model of the same robot.
    """
    models = {"model": experiment.equation.prior}
    sources = experiment.sources
    if prior is not None:
        settings = prior.settings if prior.configured else experiment.config.without_friction_values()
        models["prior"] = coefficients_of(prior.robot, settings, experiment)
        sources += tuple(replace(s, kind=f"prior's {s.kind}") for s in sources_of(prior.robot, prior.settings))
    reduced = experiment.logs if isinstance(experiment, ReducedExperiment) else None
    evaluation = TorqueEvaluator(experiment, progress, reduced).evaluate(models, held_out=True)
    rollouts = None
    if simulate and reduced is None:
        rollouts = evaluate_rollouts(experiment, models, held_out=True, progress=progress)
    simulation = simulation_report(rollouts, "model", experiment)
    notices = [*experiment.notices, *held_out_offset_notices(evaluation), *simulation_notices(rollouts, "model")]
    model = experiment.model
    report = validation_report(
        evaluation,
        model.units,
        experiment.band_hz,
        bounds,
        simulation,
        sources,
        notices,
        model.row_kinds,
        why_not_simulated(rollouts, "model", experiment),
    )
    result = ValidationResult.from_result(report)
    result._model = model
    result._models = models
    result._evaluation = evaluation
    result._rollouts = rollouts
    result._made_by = made_by
    return result


def _check_bounds(max_rms: float | Mapping[str, float] | None, experiment: Experiment) -> dict[str, float]:
    """Bounds by joint or ``overall``; ConfigError if one cannot be used."""
    if max_rms is None:
        return {}
    bounds = dict(max_rms) if isinstance(max_rms, Mapping) else {"overall": max_rms}
    names = (*experiment.equation.joints, "overall")
    for name, bound in bounds.items():
        if name not in names:
            raise ConfigError("--max-rms", f"{name} is not a joint; {suggestion(name, names)}")
        if not 0 < bound < math.inf:
            raise ConfigError("--max-rms", f"{bound} is not a bound; give a number above 0")
    return bounds
