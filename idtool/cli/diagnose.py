"""`idtool diagnose`."""

from __future__ import annotations

from idtool.cli.app import app
from idtool.cli.options import (
    REDUCTIONS,
    AgainstOption,
    AssumeOption,
    BudgetOption,
    ClusterOption,
    ConfigOption,
    EffectsOption,
    ExplainOption,
    HoldoutOption,
    InertiaOption,
    JobsOption,
    JsonOption,
    LogsArgument,
    MaxEffectsOption,
    NoSimulationOption,
    OutOption,
    QuietOption,
    ReportOnlyOption,
    RerunOption,
    SkipBadOption,
    UrdfArgument,
    ValidateOption,
    command_line,
    distribution_of,
    finish,
    output_folder,
)


@app.command(
    "diagnose",
    epilog="Example: idtool diagnose leg.urdf run1.mcap run2.mcap --validate run3.mcap",
)
def diagnose_command(
    urdf: UrdfArgument,
    logs: LogsArgument,
    config: ConfigOption = None,
    out: OutOption = None,
    holdout: HoldoutOption = 0.3,
    validate: ValidateOption = None,
    inertia: InertiaOption = None,
    effects: EffectsOption = None,
    max_effects: MaxEffectsOption = 12,
    budget: BudgetOption = None,
    assume: AssumeOption = None,
    against: AgainstOption = None,
    report_only: ReportOnlyOption = False,
    explain: ExplainOption = False,
    no_simulation: NoSimulationOption = False,
    rerun: RerunOption = None,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
    skip_bad: SkipBadOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Find where model and data disagree, identify the missing effects, and add them to the model."""
    from idtool.api.data import load_for_diagnosis
    from idtool.api.diagnose import check_simulator_logs, diagnose_experiment, paired_logs, search_options
    from idtool.api.model import Model
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.diagnosis import show_diagnosis

    terminal = Terminal(quiet, as_json)
    folder = output_folder(urdf, out)
    effect_ids = None if effects is None else effects.split(",")
    simulator_logs = against or []
    with terminal.progress() as progress:
        model, logs = Model.with_logs(urdf, logs, config)
        search = search_options(
            inertia, effect_ids, max_effects, budget, assume or [], simulator_logs, simulation=not no_simulation
        )
        check_simulator_logs(model, logs, simulator_logs, cluster, skip_bad)
        simulated = paired_logs(logs, simulator_logs)
        with distribution_of(cluster, folder / REDUCTIONS, terminal, progress) as distribution:
            experiment = load_for_diagnosis(model, logs, validate or (), holdout, progress, distribution, skip_bad)
        made_by = command_line()
        result = diagnose_experiment(model, experiment, search, simulated, holdout, made_by, progress)
        progress("writing", 0.0)
        if not report_only:
            result = result.saved_in(folder)
        files = result.save(folder, made_by, report_only)
        if rerun:
            result.rerun(rerun)
    show_diagnosis(terminal, result, folder, tuple(file.name for file in files), explain)
    finish(terminal, result, {})
