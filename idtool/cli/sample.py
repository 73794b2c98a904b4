"""`idtool sample`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from idtool.cli.app import app
from idtool.cli.options import JsonOption, QuietOption, finish
from idtool.common.samples import FOLDER, SampleName


@app.command("sample", epilog="Example: idtool sample leg")
def sample_command(
    name: Annotated[SampleName, typer.Argument(help="Which sample.", metavar="NAME", show_default=False)],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to write to.")] = Path(FOLDER),
    force: Annotated[bool, typer.Option("--force", help="Overwrite files that differ from the sample's.")] = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Write a simulated robot with its logs, to try the commands with.

    leg, belt_arm: a robot and logs to fit and validate.

    quadruped: a robot with an IMU that stands, walks and hangs.

    hidden: a leg with a spring or a payload that its model lacks.

    pair: an arm and its simulator.
    """
    from idtool.api.sample import sample
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.sample import show_sample

    terminal = Terminal(quiet, as_json)
    result = sample(name, out, force=force)
    show_sample(terminal, result)
    finish(terminal, result, {})
