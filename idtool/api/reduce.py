"""`reduce`: logs reduced to what a fit needs of them, on disk."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from idtool.api.data import DEFAULT_HOLDOUT, Logs, load_experiment
from idtool.api.distribution import Distribution, open_distribution
from idtool.api.model import Model, Source, as_model
from idtool.api.notebook import Displayable, shows_progress
from idtool.api.results import Progress, ignore_progress, notice_lines
from idtool.common.exceptions import ConfigError
from idtool.common.input_files import REDUCTION_SUFFIX
from idtool.common.outputs import check_file
from idtool.common.threads import with_single_threaded_blas
from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.distributed_reduction import remove_reductions
from idtool.estimation.reduced_experiment import ReducedExperiment, merged_reduction, save_reduction
from idtool.estimation.saved_reduction import SavedReduction, write_reduction
from idtool.reporting.results.base import notice_fields
from idtool.reporting.results.reduction import ReducedLogReport, ReductionReport

if TYPE_CHECKING:
    from idtool.reporting.terminal.output import Output


class ReductionResult(ReductionReport, Displayable):
    """Reduced logs and the file that holds them. The fields are those of `idtool reduce --json`."""

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.reduction import show_reduction

        show_reduction(output, self)

    def __repr__(self) -> str:
        train = sum(log.train for log in self.logs)
        validation = sum(log.validation for log in self.logs)
        logs = "1 log" if len(self.logs) == 1 else f"{len(self.logs)} logs"
        head = f"ReductionResult {self.file}: {logs}, {train} samples for fitting and {validation} for validation"
        return "\n".join([head, *notice_lines(self.notices)])


@shows_progress
@with_single_threaded_blas
def reduce(
    model: Model | Source,
    logs: Logs,
    out: str | os.PathLike[str],
    *,
    holdout: float = DEFAULT_HOLDOUT,
    cluster: str | None = None,
    skip_bad: bool = False,
    progress: Progress | None = None,
) -> ReductionResult:
    """Reduce logs to what a fit needs of them, like `idtool reduce`.

    `idtool.fit` takes the file in place of the logs.

    Parameters
    ----------
    model
        The model, or its URDF.
    logs
        The logs: paths, which are read with the settings of the configuration, or `Log` objects.
    out
        File to write; its name ends in ``.idr``.
    holdout
        Fraction at the end of every log that is kept for validation; at least 0 and less than 1.
    cluster
        Dask cluster that reads the logs: the address or JSON file of its scheduler, or ``local:N`` for N processes on
        this machine.
    skip_bad
        True to leave out logs that cannot be used; a notice names each.
    progress
        Function that is called with the name of a stage and the fraction of it that is done; None: no reports.

    Raises
    ------
    IdtoolError
        If a log, the configuration or the model cannot be used, or the file cannot be written.

    Examples
    --------
    >>> reduction = idtool.reduce("sample_logs/leg.urdf", "sample_logs/leg_train.mcap", "leg.idr")
    >>> round(idtool.fit("sample_logs/leg.urdf", reduction.file, quick=True).rms.validation["overall"], 2)
    0.11
    """
    file = check_reduction_file(Path(out))
    report_progress = progress or ignore_progress
    with open_distribution(cluster, None, report_progress) as distribution:
        return reduce_logs(model, logs, file, holdout, distribution, skip_bad, report_progress)


def reduce_logs(
    model: Model | Source,
    logs: Logs,
    file: Path,
    holdout: float,
    distribution: Distribution | None,
    skip_bad: bool,
    progress: Progress,
) -> ReductionResult:
    """Reduce logs here or by a cluster, whose reductions of single logs are removed when all are in one file.

    Parameters
    ----------
    model, logs, holdout, skip_bad
        As in `reduce`.
    file
        File to write.
    distribution
        A cluster that reduces the logs; None: they are read here.
    progress
        Called with the name of a stage and the share of it that is done.

    Raises
    ------
    IdtoolError
        As in `reduce`.
    """
    model = as_model(model)
    model.settings.require_only_joints("idtool reduce")  # the noise of other rows is that of all logs together
    experiment = load_experiment(
        model,
        logs,
        (),
        holdout,
        progress,
        takes_reductions=True,
        distribution=distribution,
        skip_bad=skip_bad,
        with_excerpts=True,
    )
    if isinstance(experiment, ReducedExperiment):
        reduction = merged_reduction(experiment, holdout)
    else:
        reduction = save_reduction(experiment, holdout, progress, keeps_excerpts=True)
    progress("writing", 0.0)
    write_reduction(file, reduction)
    if distribution is not None:
        remove_reductions(distribution.folder)
    return _result(experiment, reduction, file)


def check_reduction_file(file: Path) -> Path:
    """The file as given, checked before the work is done.

    Raises
    ------
    IdtoolError
        If its name does not end in ``.idr``, or it cannot be written.
    """
    if file.suffix.lower() != REDUCTION_SUFFIX:
        raise ConfigError("--out", f"{file} does not end in {REDUCTION_SUFFIX}; give a file that does")
    check_file(file, [])
    return file


def _result(experiment: Experiment, reduction: SavedReduction, file: Path) -> ReductionResult:
    """Result for a reduction that has been written to a file."""
    logs = []
    for log in reduction.logs:
        train = sum(part.samples for part in log.train)
        validation = sum(part.samples for part in log.held_out)
        logs.append(ReducedLogReport(path=str(log.path), train=train, validation=validation))
    return ReductionResult(
        file=str(file),
        bytes=file.stat().st_size,
        urdf=str(experiment.model.robot.path),
        joints=experiment.equation.joints,
        band_hz=reduction.band_hz,
        holdout=reduction.holdout,
        logs=tuple(logs),
        **notice_fields((*experiment.loading_notices, *experiment.model.notices, *reduction.notices)),
    )
