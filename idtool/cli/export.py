"""`idtool export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from idtool.cli.app import USE, app
from idtool.cli.options import JsonOption, QuietOption, finish
from idtool.common.exceptions import ConfigError

if TYPE_CHECKING:
    from idtool.reporting.export import Export, Part
    from idtool.reporting.terminal import Terminal


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
    from idtool.common.outputs import check_file, write_all
    from idtool.reporting.export import read_identified, to_drake, to_mujoco
    from idtool.reporting.export.identified import CONFIG, URDF
    from idtool.reporting.report import HEADER
    from idtool.reporting.terminal import Terminal

    if rotor_bodies and to != "mujoco":
        raise ConfigError("--rotor-bodies", f"is for mujoco; leave it out for {to}")
    terminal = Terminal(quiet, as_json)
    with terminal.progress() as progress:
        progress("reading", 0.0)
        folder = folder.parent if folder.is_file() else folder
        if out is not None:
            check_file(out, [folder / URDF, folder / CONFIG])
        identified = read_identified(folder)
        export = to_mujoco(identified, rotor_bodies) if to == "mujoco" else to_drake(identified)
        file = out or folder / export.name
        write_all(file.parent, {file.name: export.text})
    _show(terminal, export, file)
    warnings = list(identified.model.warnings)
    if to == "mujoco" and any(part.what == "rotor" for part in export.not_carried):
        warnings.append("--rotor-bodies carries the rotors in full, each as a body with a coordinate of its own")
    terminal.warn(warnings)
    finish(terminal, {**HEADER, "file": str(file), **export.to_dict(), "warnings": warnings}, {})


def _show(terminal: Terminal, export: Export, file: Path) -> None:
    """What is carried, a line a kind, and what is not, those alike on one line."""
    for what in dict.fromkeys(part.what for part in export.carried):
        names = dict.fromkeys(part.of for part in export.carried if part.what == what)
        terminal.say(f"carried: {what} of {', '.join(names)}")
    groups: dict[tuple[str, str], list[Part]] = {}
    for part in export.not_carried:
        groups.setdefault((part.what, part.detail), []).append(part)
    for (what, detail), parts in groups.items():
        sizes = [(abs(part.value), part.unit) for part in parts if part.value is not None]
        size = ", up to {:.3g} {}".format(*max(sizes)) if sizes else ""
        terminal.say(f"not carried: {what} of {', '.join(part.of for part in parts)}: {detail}{size}", "yellow")
    terminal.say(f"written: {file}")
