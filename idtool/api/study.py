"""`study`: comparison of constraint sets, priors and estimators on the same data."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from idtool.api.data import Logs, call_text, changed_options, load_experiment
from idtool.api.distribution import open_distribution
from idtool.api.model import Model, Source
from idtool.api.notebook import Displayable, shows_progress
from idtool.api.results import Progress, SavableResult, ignore_progress, notice_lines, table_lines
from idtool.common.exceptions import ConfigError
from idtool.common.number_text import number
from idtool.common.outputs import as_json
from idtool.common.threads import with_single_threaded_blas
from idtool.common.units import units_text
from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.evaluation.torque_errors import Evaluation
from idtool.reporting.results.study import StudyReport
from idtool.reporting.study_report import study_report

if TYPE_CHECKING:
    from idtool.reporting.terminal.output import Output

_MIN_DRAWS = 5


class StudyResult(StudyReport, SavableResult, Displayable):
    """Comparison of all constraint sets, priors and estimators. The fields are those of study.json."""

    _validation: Evaluation
    _made_by: str

    def _files(self, folder: Path, made_by: str) -> dict[str, str | bytes]:
        from idtool.reporting.pages.study import study_page

        return {"study.json": as_json(self.to_json()), "study.html": study_page(self._validation, self, made_by)}

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.study import show_study

        show_study(output, self)

    def __repr__(self) -> str:
        units = units_text(self.units)
        title = f"StudyResult: RMS torque error [{units}] below {self.band_hz:g} Hz"
        rows = []
        for name, entry in self.sets.items():
            train = number(entry.rms.train["overall"])
            validation = number(entry.rms.validation["overall"])
            rows.append([name, train, validation, str(entry.violations)])
        lines = [title]
        lines += table_lines(["constraints", "train", "held out", "not realizable"], rows)
        lines += notice_lines(self.notices)
        return "\n".join(lines)


@shows_progress
@with_single_threaded_blas
def study(
    model: Model | Source,
    logs: Logs,
    *,
    validate: Logs = (),
    holdout: float = 0.3,
    draws: int = 40,
    cluster: str | None = None,
    reductions: str | os.PathLike[str] | None = None,
    skip_bad: bool = False,
    progress: Progress | None = None,
) -> StudyResult:
    """Compare all constraint sets, priors and estimators, also for fewer samples, like `idtool study`.

    Parameters
    ----------
    model
        The model, or its URDF.
    logs
        Logs for the fit: paths, which are read with the settings of the configuration, or `Log` objects. Files of
        `idtool reduce` are taken too; the convergence of the online estimate is left out then.
    validate
        Whole logs for validation. If they are given, no part of the other logs is held out.
    holdout
        Fraction at the end of every log that is kept for validation; at least 0 and less than 1.
    draws
        Number of random draws for each number of samples, at least 5.
    cluster
        Dask cluster that reads the logs: the address or JSON file of its scheduler, or ``local:N`` for N processes on
        this machine.
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
        If a log, the configuration or the model cannot be used. Messages contain the option names of the command line.
    """
    check_draws(draws)
    report_progress = progress or ignore_progress
    with open_distribution(cluster, Path(reductions) if reductions else None, report_progress) as distribution:
        experiment = load_experiment(
            model,
            logs,
            validate,
            holdout,
            report_progress,
            takes_reductions=True,
            distribution=distribution,
            skip_bad=skip_bad,
        )
    options = changed_options(study, holdout=holdout, draws=draws, cluster=cluster, skip_bad=skip_bad)
    made_by = call_text("study", model, logs, validate=validate, **options)
    return study_experiment(experiment, made_by, report_progress, draws)


def check_draws(draws: int) -> None:
    """Refuse too few draws; ConfigError."""
    if draws < _MIN_DRAWS:
        raise ConfigError("--draws", f"{draws} is too few; give {_MIN_DRAWS} or more")


def study_experiment(experiment: Experiment, made_by: str, progress: Progress, draws: int) -> StudyResult:
    """Study an experiment, which holds model and logs.

    Parameters
    ----------
    experiment
        Model and data.
    made_by
        Command that the HTML report shows.
    progress, draws
        As in `study`.

    Raises
    ------
    IdtoolError
        As in `study`.
    """
    from idtool.estimation.study.study import study as compare

    comparison = compare(experiment, progress, draws)
    result = StudyResult.from_result(study_report(comparison))
    result._validation = comparison.validation
    result._made_by = made_by
    return result
