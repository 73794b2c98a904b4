"""`idtool export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from idtool.cli.app import USE, app
from idtool.cli.options import JsonOption, QuietOption, finish


@app.command("export", rich_help_panel=USE, epilog="Example: idtool export leg_idtool --to mujoco")
def export_command(
    folder: Annotated[
        Path, typer.Argument(help="The folder that idtool fit wrote to.", metavar="OUT", show_default=False)
    ],
    to: Annotated[Literal["mujoco", "drake"], typer.Option("--to", help="The simulator.", show_default=False)],
    out: Annotated[
        Path | None, typer.Option(help="File to write to; default: OUT/mujoco.xml or OUT/drake.urdf.")
    ] = None,
    rotor_bodies: Annotated[
        bool,
        typer.Option(
            "--rotor-bodies",
            help="For MuJoCo: a rotor that joint inertias cannot carry in full becomes a body that a constraint holds.",
        ),
    ] = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Write the identified model for a simulator, and tell what the simulator cannot carry."""
    from idtool.api.export import export
    from idtool.common.outputs import check_file
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.export import show_export

    terminal = Terminal(quiet, as_json)
    if out is not None:
        check_file(out, [])
    with terminal.progress() as progress:
        progress("reading", 0.0)
        result = export(folder, to, rotor_bodies=rotor_bodies)
        file = result.save(out)
    report = result.model_copy(update={"file": str(file)})
    show_export(terminal, report)
    finish(terminal, report, {})
