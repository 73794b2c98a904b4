"""`diagnose`: find effects that a model lacks."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

from idtool.api.data import (
    Logs,
    LogSource,
    as_list,
    call_text,
    changed_options,
    load_for_diagnosis,
    path_of,
    reduction_path,
)
from idtool.api.distribution import open_distribution
from idtool.api.effect_arguments import EffectAssumption, check_assumptions, parse_assumption, parse_candidates
from idtool.api.log import Log
from idtool.api.model import IDENTIFIED_URDF, MODEL_YAML, Model, Source, as_model, identified_urdf_text
from idtool.api.notebook import Displayable, shows_progress
from idtool.api.results import Progress, Recordable, SavableResult, ignore_progress, notice_lines, table_lines
from idtool.common.exceptions import ConfigError, LogError
from idtool.common.names import printable, without_secrets
from idtool.common.number_text import number
from idtool.common.outputs import as_json, as_yaml
from idtool.common.threads import with_single_threaded_blas
from idtool.data.logs import read_log
from idtool.data.logs.message_options import message_options
from idtool.data.pairing import check_joints, paired_paths
from idtool.data.same_recording import is_same_recording
from idtool.diagnosis.records import Diagnosis
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.reporting.diagnosis_report import diagnosis_report
from idtool.reporting.diagnosis_text import next_steps, step_title
from idtool.reporting.fit_report import model_config
from idtool.reporting.results.diagnosis import DiagnosisReport

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from idtool.api.results import RecordingData
    from idtool.diagnosis.diagnose import Options
    from idtool.reporting.terminal.output import Output


class DiagnosisResult(DiagnosisReport, SavableResult, Recordable, Displayable):
    """Diagnosis of a model: the effects that it lacks. The fields are those of diagnosis.json."""

    _diagnosis: Diagnosis
    _made_by: str

    @cached_property
    def model(self) -> Model:
        """The model with the effects, for `idtool.validate`, `idtool.simulate` and `idtool.diagnose`."""
        return Model.identified(self._diagnosis.last)

    def save(
        self, folder: str | os.PathLike[str], made_by: str | None = None, report_only: bool = False
    ) -> tuple[Path, ...]:
        """Write the files as `FitResult.save` does; ``report_only`` leaves out the model."""
        if report_only:
            return self._write(folder, made_by, (MODEL_YAML, IDENTIFIED_URDF))
        return self.saved_in(Path(folder))._write(folder, made_by)

    def saved_in(self, folder: Path) -> Self:
        """The result with the model's folder in the commands of ``next``."""
        return self.model_copy(update={"next": tuple(next_steps(self, folder))})

    def _files(self, folder: Path, made_by: str) -> dict[str, str | bytes]:
        from idtool.reporting.pages.diagnosis import diagnosis_page

        last = self._diagnosis.last
        urdf = last.experiment.model.robot.path.name
        header = (
            f"Written by idtool diagnose for {urdf}. Together with identified.urdf it is the model with the effects "
            "that were found."
        )
        return {
            "diagnosis.json": as_json(self.to_json()),
            "diagnosis.html": diagnosis_page(self._diagnosis, self, made_by),
            MODEL_YAML: as_yaml(model_config(last, folder), header),
            IDENTIFIED_URDF: identified_urdf_text(last, folder),
        }

    def _recording_data(self) -> RecordingData:
        from idtool.api.recording import fit_traces

        last = self._diagnosis.last
        return last.experiment.model, fit_traces(last), "identified"

    def plot(self) -> Figure:
        """Plot the torque and simulation errors after each step, for all joints together and for each joint."""
        from idtool.reporting.plots.figure import stack_figures
        from idtool.reporting.plots.gap import gap_figures

        return stack_figures(gap_figures(self)).to_plotly()

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.diagnosis import show_diagnosis

        show_diagnosis(output, self)

    def __repr__(self) -> str:
        before = self.before.torque
        after = self.after.torque
        rows = []
        for name in before:
            share = self.gap_closed[name]
            gap_closed = "–" if share is None else f"{100 * share:.0f} %"
            errors = [number(before[name]), number(after[name]), number(self.noise_floor[name])]
            rows.append([name, *errors, gap_closed])
        lines = [f"DiagnosisResult: {self.summary}"]
        for i, step in enumerate(self.steps, 1):
            lines.append(f"  {i}. {step_title(step)}")
        if self.against is not None:
            lines.insert(1, f"  {self.against.summary}")
        lines += table_lines(["torque RMS", "before", "after", "noise floor", "gap closed"], rows)
        lines += notice_lines(self.notices)
        return "\n".join(lines)


@shows_progress
@with_single_threaded_blas
def diagnose(
    model: Model | Source,
    logs: Logs,
    *,
    validate: Logs = (),
    holdout: float = 0.3,
    inertia: Literal["refit", "fixed"] | None = None,
    effects: Sequence[str] | None = None,
    most: int = 12,
    budget: float | None = None,
    assume: Sequence[str | EffectAssumption] = (),
    against: Logs = (),
    simulation: bool = True,
    cluster: str | None = None,
    reductions: str | os.PathLike[str] | None = None,
    skip_bad: bool = False,
    progress: Progress | None = None,
) -> DiagnosisResult:
    """Find where model and data disagree, identify the missing effects and add them, like `idtool diagnose`.

    With ``against``, find what to change in a simulator of the model.

    Parameters
    ----------
    model
        The model, or its URDF.
    logs
        Paths of logs, which are read with the settings of the configuration, or `Log` objects. Of a file of
        `idtool.reduce`, the samples that it keeps are searched: some of each log.
    validate
        Whole logs for validation. If they are given, no part of the other logs is held out.
    holdout
        Fraction at the end of every log that is kept for validation; at least 0 and less than 1.
    inertia
        ``refit``: the inertia is identified again at every step; ``fixed``: the inertia of the URDF is kept, so
        that a payload, a torque gain or a tilted base can be found. None: ``fixed`` with ``against``, else ``refit``.
    effects
        Ids of the effects to search for; None: all.
    most
        Largest number of effects to add.
    budget
        Time for the search [s]; then what was found is reported. None: no limit.
    assume
        Effects to start with: ``"parallel_spring:hip"``, ``("parallel_spring", "hip")``, or ``"gravity_tilt"`` for one
        that has neither joint nor link.
    against
        Logs of a simulator of the model under the same commands: one for each of ``logs``, in the same order, or a
        folder with a log of the same name for each. They are in SI units, whatever ``log.scale`` says.
    simulation
        True to simulate the models too.
    cluster
        Dask cluster that reads the logs: the address or JSON file of its scheduler, or ``local:N`` for N processes on
        this machine. Some samples of each log are then searched, here.
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
        If a log, the configuration or the model cannot be used, or an effect is not known. Messages name options as
        the command line does.

    Examples
    --------
    >>> options = {"effects": ["parallel_spring"], "simulation": False}
    >>> diagnosis = idtool.diagnose("sample_logs/leg.urdf", "sample_logs/leg_train.mcap", **options)
    >>> diagnosis.verdict
    'no_disagreement'
    """
    report_progress = progress or ignore_progress
    model = as_model(model)
    search = search_options(inertia, effects, most, budget, assume, against, simulation)
    check_simulator_logs(model, logs, against, cluster, skip_bad)
    with open_distribution(cluster, Path(reductions) if reductions else None, report_progress) as distribution:
        experiment = load_for_diagnosis(model, logs, validate, holdout, report_progress, distribution, skip_bad)
    options = changed_options(
        diagnose,
        holdout=holdout,
        inertia=inertia,
        effects=effects,
        most=most,
        budget=budget,
        assume=assume,
        against=[without_secrets(str(path_of(log))) for log in as_list(against)] or (),
        simulation=simulation,
        cluster=cluster,
        skip_bad=skip_bad,
    )
    made_by = call_text("diagnose", model, logs, validate=validate, **options)
    simulated_logs = paired_logs(logs, against)
    return diagnose_experiment(model, experiment, search, simulated_logs, holdout, made_by, report_progress)


def search_options(
    inertia: Literal["refit", "fixed"] | None,
    effects: Sequence[str] | None,
    most: int,
    budget: float | None,
    assume: Sequence[str | EffectAssumption],
    against: Logs,
    simulation: bool,
) -> Options:
    """Options of a search, of the parameters of `diagnose`.

    Raises
    ------
    ConfigError
        If one of them makes no sense.
    """
    from idtool.diagnosis.diagnose import Options

    if most < 1:
        raise ConfigError("--max-effects", f"{most} is too few; give 1 or more")
    if budget is not None and not budget >= 0:
        raise ConfigError("--budget", f"{budget:g} s is no time; give 0 or more")
    candidates = None if effects is None else parse_candidates(effects)
    assumptions = tuple(parse_assumption(text) for text in assume)
    if inertia is None:
        inertia = "fixed" if as_list(against) else "refit"
    return Options(inertia, candidates, most, assumptions, simulation, budget)


def check_simulator_logs(model: Model, logs: Logs, against: Logs, cluster: str | None, skip_bad: bool) -> None:
    """Refuse logs of a simulator with a model, logs or options for which they cannot be compared.

    Parameters
    ----------
    model, logs, against, cluster, skip_bad
        As in `diagnose`.

    Raises
    ------
    ConfigError
        If there are such.
    """
    if not as_list(against):
        return
    model.settings.require_only_joints("idtool diagnose --against")
    if cluster is not None:
        raise ConfigError("--cluster", "cannot be combined with --against, which compares whole logs")
    if skip_bad:
        raise ConfigError(
            "--skip-bad", "cannot be combined with --against, which needs each log; leave the bad one out"
        )
    if any(reduction_path(log) is not None for log in (*as_list(logs), *as_list(against))):
        raise ConfigError("--against", "needs the logs themselves, not their reductions")


def diagnose_experiment(
    model: Model,
    experiment: Experiment,
    search: Options,
    simulated_logs: Sequence[LogSource],
    holdout: float,
    made_by: str,
    progress: Progress,
) -> DiagnosisResult:
    """Diagnose an experiment, which holds model and logs.

    Parameters
    ----------
    model
        The model.
    experiment
        Model and data.
    search
        Options of the search.
    simulated_logs
        Log of a simulator for each of the logs; empty: the model itself is searched for missing effects.
    holdout
        As in `diagnose`.
    made_by
        Call or command that the HTML report shows.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Raises
    ------
    IdtoolError
        As in `diagnose`.
    """
    from idtool.diagnosis.comparison import compare
    from idtool.diagnosis.diagnose import diagnose as run_search

    check_assumptions(search.assumed, experiment.model)
    comparison = None
    if simulated_logs:
        simulated = _simulator_experiment(model, simulated_logs, experiment, holdout)
        comparison = compare(experiment, simulated, search, progress)
        diagnosis = comparison.measured
    else:
        diagnosis = run_search(experiment, search, progress)
    result = DiagnosisResult.from_result(diagnosis_report(diagnosis, search.inertia, comparison))
    result._diagnosis = diagnosis
    result._made_by = made_by
    return result


def paired_logs(logs: Logs, against: Logs) -> list[LogSource]:
    """The simulator's log of each log; empty if there are none."""
    simulated = as_list(against)
    if not simulated:
        return []
    names = [path_of(log) for log in as_list(logs)]
    folder_or_logs = paired_paths(names, [path_of(log) for log in simulated])
    is_folder = len(simulated) == 1 and folder_or_logs[0] != path_of(simulated[0])
    return list(folder_or_logs) if is_folder else simulated


def _simulator_experiment(model: Model, logs: Sequence[LogSource], robot: Experiment, holdout: float) -> Experiment:
    """The simulator's logs with the model, for the joints of the robot's logs.

    Raises
    ------
    LogError
        If one of them cannot be used, or is the robot's own recording.
    """
    settings = model.settings
    joints = robot.model.names
    options = settings.log
    messages = message_options(options, model.robot.joints)
    records = []
    for log in logs:
        if isinstance(log, Log):
            record = log.record
        else:
            record = read_log(log, topic=options.topic, columns=options.columns, messages=messages)
        check_joints(record, joints)
        records.append(record)
    for record, run in zip(records, robot.runs, strict=False):  # the robot's logs for validation have no partner
        measured = run.signals.log
        if is_same_recording(record, measured):
            what = f"is the same recording as the robot's log {printable(measured.path.name)}"
            raise LogError(record.path, f"{what}; as --against, give the simulator's log under the same commands")
    return prepare(model.robot, settings.model_copy(update={"joints": list(joints)}), records, (), holdout)
