"""`idtool fit`."""

from __future__ import annotations

from idtool.cli.app import app
from idtool.cli.options import (
    REDUCTIONS,
    ClusterOption,
    ConfigOption,
    HoldoutOption,
    JobsOption,
    JsonOption,
    LogsArgument,
    MaxRmsOption,
    MethodOption,
    NoSimulationOption,
    OutOption,
    QuickOption,
    QuietOption,
    RerunOption,
    SkipBadOption,
    StrictOption,
    UrdfArgument,
    ValidateOption,
    command_line,
    distribution_of,
    finish_model,
    output_folder,
    parse_bounds,
)


@app.command(
    "fit",
    epilog="Example: idtool fit leg.urdf run1.mcap run2.mcap --validate run3.mcap",
)
def fit_command(
    urdf: UrdfArgument,
    logs: LogsArgument,
    config: ConfigOption = None,
    out: OutOption = None,
    holdout: HoldoutOption = 0.3,
    validate: ValidateOption = None,
    max_rms: MaxRmsOption = None,
    strict: StrictOption = False,
    no_simulation: NoSimulationOption = False,
    method: MethodOption = "ls",
    quick: QuickOption = False,
    rerun: RerunOption = None,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
    skip_bad: SkipBadOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Identify inertias, friction and rotors; write identified.urdf, model.yaml, report.json and report.html."""
    from idtool.reporting.pages.plotly_js import prepare_plotly

    prepare_plotly()
    from idtool.api.fit import check_method, fit_experiment, load_for_fit
    from idtool.api.model import Model
    from idtool.reporting.fit_report import met_bounds
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.fit import show_fit

    terminal = Terminal(quiet, as_json)
    folder = output_folder(urdf, out)
    with terminal.progress() as progress:
        model, logs = Model.with_logs(urdf, logs, config)
        check_method(method, model, cluster)
        with distribution_of(cluster, folder / REDUCTIONS, terminal, progress) as distribution:
            experiment = load_for_fit(model, logs, validate or (), holdout, distribution, skip_bad, progress)
        bounds = parse_bounds(max_rms or [], experiment)
        simulate = not (no_simulation or quick)
        result = fit_experiment(experiment, command_line(), progress, simulate, not quick, method)
        progress("writing", 0.0)
        result.save(folder)
        if rerun:
            result.rerun(rerun)
    show_fit(terminal, result, folder)
    rms = result.rms.validation or result.rms.train
    finish_model(terminal, result, met_bounds(rms, bounds), strict)
