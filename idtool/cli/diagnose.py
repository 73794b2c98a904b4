"""`idtool diagnose`."""

from __future__ import annotations

from idtool.cli.app import IDENTIFY_AND_CHECK, app
from idtool.cli.options import (
    AgainstOption,
    AssumeOption,
    BudgetOption,
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
    UrdfArgument,
    ValidateOption,
    command_line,
    finish,
    output_folder,
)


@app.command(
    "diagnose",
    rich_help_panel=IDENTIFY_AND_CHECK,
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
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Find where model and data disagree, identify the missing effects, and add them to the model."""
    from idtool.api.diagnose import diagnose
    from idtool.api.model import Model
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.diagnosis import show_diagnosis

    terminal = Terminal(quiet, as_json)
    folder = output_folder(urdf, out)
    effect_ids = None if effects is None else effects.split(",")
    with terminal.progress() as progress:
        model, logs = Model.with_logs(urdf, logs, config)
        result = diagnose(
            model,
            logs,
            validate=validate or (),
            holdout=holdout,
            inertia=inertia,
            effects=effect_ids,
            most=max_effects,
            budget=budget,
            assume=assume or (),
            against=against or (),
            simulation=not no_simulation,
            progress=progress,
        )
        progress("writing", 0.0)
        if not report_only:
            result = result.saved_in(folder)
        files = result.save(folder, command_line(), report_only)
        if rerun:
            result.rerun(rerun)
    show_diagnosis(terminal, result, folder, tuple(file.name for file in files), explain)
    finish(terminal, result, {})
