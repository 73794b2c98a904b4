"""`adapt`: identification online, row by row."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from idtool.api.data import Logs, call_text, changed_options, load_experiment
from idtool.api.model import Model, Source
from idtool.api.notebook import Displayable, shows_progress
from idtool.api.results import Progress, SavableResult, ignore_progress, notice_lines, table_lines
from idtool.common.number_text import number, short_number
from idtool.common.outputs import as_json
from idtool.common.threads import with_single_threaded_blas
from idtool.reporting.adaptation_report import adaptation_report
from idtool.reporting.results.adaptation import AdaptationReport

if TYPE_CHECKING:
    from idtool.reporting.terminal.output import Output


class AdaptationResult(AdaptationReport, SavableResult, Displayable):
    """Parameters identified online, over time; its fields are those of adapt.json."""

    _made_by: str

    def _files(self, folder: Path, made_by: str) -> dict[str, str | bytes]:
        from idtool.reporting.pages.adapt import adapt_page

        return {"adapt.json": as_json(self.to_json()), "adapt.html": adapt_page(self, made_by)}

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.adapt import show_adaptation

        show_adaptation(output, self)

    def __repr__(self) -> str:
        title = f"AdaptationResult: {self.samples} updates at {short_number(self.update_hz, 4)} Hz"
        rows = []
        for name, body in self.final.bodies.items():
            rows.append([name, number(body.mass), "yes" if body.realizable else "no"])
        lines = [title]
        lines += table_lines(["body", "mass [kg]", "realizable"], rows)
        lines += notice_lines(self.notices)
        return "\n".join(lines)


@shows_progress
@with_single_threaded_blas
def adapt(
    model: Model | Source, logs: Logs, *, forgetting: float = 20.0, progress: Progress | None = None
) -> AdaptationResult:
    """Identify online within the constraints, with one update per downsampled sample, like `idtool adapt`.

    Parameters
    ----------
    model
        The model, or its URDF.
    logs
        Paths of logs, which are read with the settings of the configuration, or `Log` objects.
    forgetting
        Time constant of exponential forgetting [s]; infinity: no forgetting.
    progress
        Function that is called with the name of a stage and the fraction of it that is done; None: no reports.

    Raises
    ------
    IdtoolError
        If a log, the configuration or the model cannot be used. Messages contain the option names of the command line.
    """
    from idtool.estimation.command_delay import with_delay
    from idtool.estimation.controller_gains import with_gains
    from idtool.estimation.dataset.experiment import NOT_SIMULATED
    from idtool.estimation.identification import bounds_notices, choose_sets
    from idtool.estimation.online.adapt import adapt as identify_online

    report_progress = progress or ignore_progress
    loaded = load_experiment(model, logs, holdout=0.0, progress=report_progress)
    with_known_gains, gains = with_gains(loaded, report_progress)
    experiment, delay, _ = with_delay(with_known_gains, report_progress)
    constraints = experiment.config.constraints
    sets = choose_sets(experiment.model.bodies, constraints)
    adaptation = identify_online(experiment, sets, forgetting, progress=report_progress)
    notices = [notice for notice in experiment.notices if notice.code not in NOT_SIMULATED]
    for fitted in (gains, delay):
        if fitted is not None:
            notices += fitted.notices
    notices += bounds_notices(experiment.model, sets, constraints)
    result = AdaptationResult.from_result(adaptation_report(adaptation, experiment, notices))
    result._made_by = call_text("adapt", model, logs, **changed_options(adapt, forgetting=forgetting))
    return result
