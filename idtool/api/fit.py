"""`fit`: identify a model from logs."""

from __future__ import annotations

import os
from contextlib import ExitStack
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

from idtool.api.data import Logs, call_text, changed_options, load_experiment
from idtool.api.distribution import Distribution, open_distribution
from idtool.api.model import IDENTIFIED_URDF, MODEL_YAML, Model, Source, as_model, identified_urdf_text
from idtool.api.notebook import Displayable, shows_progress
from idtool.api.results import Progress, Recordable, SavableResult, ignore_progress, notice_lines, table_lines
from idtool.common.exceptions import ConfigError
from idtool.common.number_text import number, short_number
from idtool.common.outputs import as_json, as_yaml
from idtool.common.processes import Background, in_processes
from idtool.common.threads import with_single_threaded_blas
from idtool.common.units import units_text
from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.dataset.training_sample import training_sample
from idtool.estimation.evaluation.torque_errors import overall_rms
from idtool.estimation.fit import Fit
from idtool.estimation.fit import fit as run_fit
from idtool.estimation.fleet import Fleet, fit_fleet
from idtool.estimation.identification import Method
from idtool.estimation.reduced_experiment import ReducedExperiment
from idtool.reporting.fit_report import fit_report, model_config
from idtool.reporting.results.fit import FitReport

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from idtool.api.results import RecordingData
    from idtool.common.notice import Notice
    from idtool.diagnosis.records import ProfilesByJoint
    from idtool.reporting.terminal.output import Output

_UNCORRECTABLE_FAULTS = ("wrong_unit", "wrong_sign", "wrong_joint_order", "clipped", "wrapped_position")
ROBOTS = "robots"  # folder with a folder for the model of each robot of a fleet
_MAX_MASSES = 6  # in a result's repr
_NOISE_SAMPLE = 30.0  # s of the training data, from which the noise floor is estimated


class FitResult(FitReport, SavableResult, Recordable, Displayable):
    """An identified model and its errors and uncertainty. The fields are those of report.json."""

    _fit: Fit
    _fleet: Fleet | None
    _residual_maps: tuple[ProfilesByJoint, ProfilesByJoint] | None  # of the prior and the identified model
    _made_by: str

    @cached_property
    def model(self) -> Model:
        """The identified model, for `idtool.validate`, `idtool.simulate` and `idtool.diagnose`."""
        return Model.identified(self._fit)

    def _files(self, folder: Path, made_by: str) -> dict[str, str | bytes]:
        from idtool.reporting.pages.fit import fit_page

        files = _model_files(self._fit, folder)
        files["report.json"] = as_json(self.to_json())
        files["report.html"] = fit_page(self._fit, self, made_by, self._residual_maps)
        for robot in self._fleet.robots if self._fleet else ():
            own_folder = Path(ROBOTS, robot.name)
            for name, content in _model_files(robot.fit, folder / own_folder).items():
                files[str(own_folder / name)] = content
        return files

    def _recording_data(self) -> RecordingData:
        from idtool.api.recording import fit_traces

        return self._fit.experiment.model, fit_traces(self._fit), "identified"

    def plot(self, log: int = 0) -> Figure:
        """Measured and predicted torque and the residual of every joint, on the held-out data where there are any.

        Parameters
        ----------
        log
            Index of the log.

        Raises
        ------
        IndexError
            If there are fewer logs.
        """
        from idtool.reporting.plots.torques import torque_figures

        return torque_figures(self._fit.evaluation, "identified", self.units).groups[log].to_plotly()

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.fit import show_fit

        show_fit(output, self)

    def __repr__(self) -> str:
        units = units_text(self.units)
        data = "the fitted data" if self.rms.validation is None else "held-out data"
        rms = self.rms.validation or self.rms.train
        prior = self.rms.prior_validation
        head = ["joint", "identified"]
        if prior:
            head.append("prior")
        head += ["viscous", "coulomb"]
        rows = []
        for name in (*self.joints, "overall"):
            row = [name, number(rms[name])]
            if prior:
                row.append(number(prior[name]))
            friction = self.friction.get(name)
            row.append(number(friction.viscous if friction else None))
            row.append(number(friction.coulomb if friction else None))
            rows.append(row)
        masses = [f"{name} {short_number(body.mass)}" for name, body in self.bodies.items()]
        mass_text = ", ".join(masses[:_MAX_MASSES])
        if len(masses) > _MAX_MASSES:
            mass_text += f" and {len(masses) - _MAX_MASSES} more"
        urdf = Path(self.urdf).name
        lines = [f"FitResult {urdf}: RMS torque error [{units}] below {self.band_hz:g} Hz, on {data}"]
        lines += table_lines(head, rows)
        lines.append(f"  mass [kg]: {mass_text}")
        lines += notice_lines(self.notices)
        return "\n".join(lines)


def _model_files(fit: Fit, folder: Path) -> dict[str, str | bytes]:
    """The files of an identified model, for a folder, by name."""
    urdf = fit.experiment.model.robot.path.name
    header = f"Identified by idtool from {urdf}. Together with identified.urdf it is the identified model."
    return {
        IDENTIFIED_URDF: identified_urdf_text(fit, folder),
        MODEL_YAML: as_yaml(model_config(fit, folder), header),
    }


@shows_progress
@with_single_threaded_blas
def fit(
    model: Model | Source,
    logs: Logs,
    *,
    validate: Logs = (),
    holdout: float = 0.3,
    method: Method = "ls",
    simulation: bool = True,
    quick: bool = False,
    cluster: str | None = None,
    reductions: str | os.PathLike[str] | None = None,
    skip_bad: bool = False,
    progress: Progress | None = None,
) -> FitResult:
    """Identify inertias, friction and rotors, like `idtool fit`.

    Parameters
    ----------
    model
        The model, or its URDF.
    logs
        Logs for the fit: paths, which are read with the settings of the configuration, or `Log` objects. Files of
        `idtool.reduce` may stand in their place; then there is no simulation and no check of the bias from noise.
    validate
        Whole logs for validation. If they are given, no part of the other logs is held out.
    holdout
        Fraction at the end of every log that is kept for validation; at least 0 and less than 1.
    method
        ``ls``: least squares; ``iv``: instrumental variables, which are not biased by noise in q and v but are slower.
    simulation
        True to simulate the identified and the original model too.
    quick
        Only fit the model. Skip the simulation, the sources of the parameters, the comparison of logs, and the check
        of the bias from noise.
    cluster
        Dask cluster that reads the logs: the address or JSON file of its scheduler, or ``local:N`` for N processes on
        this machine. Then there is no simulation and no check of the bias from noise.
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
        If a log, the configuration or the model cannot be used: `LogError`, `ConfigError`, `ModelError`; or the
        problem was not solved: `SolverError`. Messages contain the option names of the command line.

    Examples
    --------
    >>> result = idtool.fit("sample_logs/leg.urdf", "sample_logs/leg_train.mcap", quick=True)
    >>> round(result.rms.validation["overall"], 2)
    0.11
    >>> result.bodies["shank_link"].realizable
    True
    """
    report_progress = progress or ignore_progress
    model = as_model(model)
    check_method(method, model, cluster)
    with open_distribution(cluster, Path(reductions) if reductions else None, report_progress) as distribution:
        experiment = load_for_fit(model, logs, validate, holdout, distribution, skip_bad, report_progress)
    options = changed_options(
        fit, holdout=holdout, method=method, simulation=simulation, quick=quick, cluster=cluster, skip_bad=skip_bad
    )
    made_by = call_text("fit", model, logs, validate=validate, **options)
    return fit_experiment(experiment, made_by, report_progress, simulation and not quick, not quick, method)


def check_method(method: Method, model: Model, cluster: str | None) -> None:
    """Refuse instrumental variables where logs are reduced; ConfigError."""
    if method == "iv" and (cluster or model.settings.pool):
        what = "--cluster" if cluster else "pool in the configuration"
        raise ConfigError("--method iv", f"needs the samples of the logs, which are not kept with {what}")


def load_for_fit(
    model: Model,
    logs: Logs,
    validate: Logs,
    holdout: float,
    distribution: Distribution | None,
    skip_bad: bool,
    progress: Progress,
) -> Experiment:
    """Put a model and its logs together for `fit_experiment`.

    Parameters
    ----------
    model
        The model. If its configuration has a pool, the logs are reduced.
    logs, validate, holdout, skip_bad
        As in `fit`.
    distribution
        A cluster that reduces the logs; None: they are read here.
    progress
        Called with the name of a stage and the share of it that is done.

    Raises
    ------
    IdtoolError
        If a log, the configuration or the model cannot be used.
    """
    return load_experiment(
        model,
        logs,
        validate,
        holdout,
        progress,
        takes_reductions=True,
        distribution=distribution,
        skip_bad=skip_bad,
        pool=model.settings.pool,
    )


def fit_experiment(
    experiment: Experiment,
    made_by: str,
    progress: Progress,
    simulate: bool = True,
    analyze_uncertainty: bool = True,
    method: Method = "ls",
) -> FitResult:
    """Fit an experiment, which holds model and logs.

    Parameters
    ----------
    experiment
        Model and data.
    made_by
        Command that the HTML report shows.
    progress, method
        As in `fit`.
    simulate
        True to simulate the identified and the original model too.
    analyze_uncertainty
        If true, find the information source of each parameter, compare logs, and look for bias by noise.

    Raises
    ------
    IdtoolError
        As in `fit`.
    """
    has_samples = not isinstance(experiment, ReducedExperiment)
    fleet = maps = noise_floor = None
    faults: tuple[Notice, ...] = ()
    with ExitStack() as stack:
        check = None
        can_check = has_samples and experiment.has_only_joints  # a base that moves and contacts are not checked
        is_background = has_samples and not experiment.lacks_gains  # without gains there is no torque before the fit
        if analyze_uncertainty and can_check and is_background:
            check = stack.enter_context(Background(partial(_find_data_faults, experiment)))
        solved = run_fit(experiment, progress, simulate and has_samples, analyze_uncertainty, method)
        if experiment.config.pool is not None:
            fleet = fit_fleet(solved, progress)
            solved = fleet.fit
        if analyze_uncertainty and has_samples:
            models = (experiment.equation.prior, solved.estimate.theta)
            from idtool.diagnosis.residual_maps import residual_maps

            prior_maps, identified_maps = in_processes(partial(residual_maps, solved.experiment), models, progress)
            maps = (prior_maps, identified_maps)
            noise_floor = _noise_floor(solved, progress)
        if check is not None:  # last, since the other process looks for them meanwhile
            faults = check.result(progress)
        elif analyze_uncertainty and can_check:
            faults = _find_data_faults(solved.experiment, progress)
    uncorrectable = [fault for fault in faults if fault.code in _UNCORRECTABLE_FAULTS]
    solved = replace(solved, notices=(*uncorrectable, *solved.notices))
    result = FitResult.from_result(fit_report(solved, fleet, noise_floor))
    result._fit = solved
    result._fleet = fleet
    result._residual_maps = maps
    result._made_by = made_by
    return result


def _noise_floor(solved: Fit, progress: Progress) -> dict[str, float | None]:
    """Torque error that noise alone makes, by joint and ``overall``, from a sample of the training data.

    None for joints that move too little, and ``overall`` if there are such.
    """
    from idtool.diagnosis.noise_floor import estimate_noise_floor

    sample = training_sample(solved.experiment, _NOISE_SAMPLE)
    floor = estimate_noise_floor(sample, solved.estimate.theta, progress, on_training_data=True)
    by_joint: dict[str, float | None] = {}
    for name, rms, is_known in zip(
        solved.experiment.equation.joints, floor.rms.tolist(), floor.is_joint_estimated.tolist(), strict=True
    ):
        by_joint[name] = rms if is_known else None
    known = [rms for rms in by_joint.values() if rms is not None]
    by_joint["overall"] = overall_rms(known) if len(known) == len(by_joint) else None
    return by_joint


def _find_data_faults(experiment: Experiment, progress: Progress) -> tuple[Notice, ...]:
    from idtool.diagnosis.data_faults import find_data_faults

    return find_data_faults(experiment, progress)
