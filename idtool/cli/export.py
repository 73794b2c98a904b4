"""`idtool export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from idtool.cli.app import app
from idtool.cli.options import JsonOption, QuietOption, finish, output_file


@app.command("export", epilog="Example: idtool export leg_idtool --to mujoco")
def export_command(
    folder: Annotated[
        Path,
        typer.Argument(help="Folder with the results of idtool fit or diagnose.", metavar="OUT", show_default=False),
    ],
    to: Annotated[
        Literal["mujoco", "drake"] | None, typer.Option("--to", help="Simulator.", show_default=False)
    ] = None,
    patch: Annotated[
        Path | None,
        typer.Option(
            "--patch",
            metavar="FILE",
            help="Instead of --to: write a copy of this MJCF or URDF with the changes that idtool diagnose --against "
            "found, or else with all values of the model.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="Folder, or file to write; default: OUT/mujoco.xml, OUT/drake.urdf, or FILE with _patched in its "
            "name.",
        ),
    ] = None,
    rotor_bodies: Annotated[
        bool,
        typer.Option(
            "--rotor-bodies",
            help="For MuJoCo: create bodies, held by constraints, for rotors that armature cannot fully represent.",
        ),
    ] = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Write the identified model for a simulator, and list what the simulator cannot represent."""
    from idtool.api.export import export
    from idtool.common.outputs import check_file
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.export import show_export

    terminal = Terminal(quiet, as_json)
    if out is not None:
        check_file(output_file(out, "model"), [])
    with terminal.progress() as progress:
        progress("reading", 0.0)
        result = export(folder, to, rotor_bodies=rotor_bodies, patch=patch)
        file = output_file(out, result.default_file.name) if out else result.default_file
        is_left = result.leaves(file)
        result.save(file)
    report = result.model_copy(update={"file": None if is_left else str(file)})
    show_export(terminal, report, file if is_left else None)
    finish(terminal, report, {})
