"""`idtool reduce`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from idtool.cli.app import app
from idtool.cli.options import (
    REDUCTIONS,
    ClusterOption,
    ConfigOption,
    HoldoutOption,
    JobsOption,
    JsonOption,
    LogsArgument,
    QuietOption,
    SkipBadOption,
    UrdfArgument,
    distribution_of,
    finish,
    output_file,
)
from idtool.common.names import stem

ReductionOption = Annotated[
    Path,
    typer.Option(
        "--out",
        "-o",
        metavar="FILE.idr",
        help="File to write, whose name ends in .idr, or folder for a file that is named after the URDF.",
        show_default=False,
    ),
]


@app.command(
    "reduce",
    epilog="Example: idtool reduce leg.urdf run1.mcap run2.mcap --out runs.idr",
)
def reduce_command(
    urdf: UrdfArgument,
    logs: LogsArgument,
    out: ReductionOption,
    config: ConfigOption = None,
    holdout: HoldoutOption = 0.3,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
    skip_bad: SkipBadOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Reduce logs to a small file, which idtool fit takes in place of the logs."""
    from idtool.api.model import Model
    from idtool.api.reduce import check_reduction_file, reduce_logs
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.reduction import show_reduction

    terminal = Terminal(quiet, as_json)
    file = check_reduction_file(output_file(out, f"{stem(urdf)}.idr"))
    with terminal.progress() as progress:
        model, logs = Model.with_logs(urdf, logs, config)
        parts = file.with_name(f"{file.stem}_{REDUCTIONS}")
        with distribution_of(cluster, parts, terminal, progress) as distribution:
            result = reduce_logs(model, logs, file, holdout, distribution, skip_bad, progress)
    show_reduction(terminal, result)
    finish(terminal, result, {})
