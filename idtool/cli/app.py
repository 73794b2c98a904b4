"""The application that the commands belong to."""

from __future__ import annotations

from typing import Annotated

import typer

app = typer.Typer(
    name="idtool",
    help="Identify the dynamics of robot legs and arms from logged joint data.\n\n"
    "Reads a URDF and logs of q, v and tau, writes a URDF with inertias that some body can have, friction and rotors, "
    "and says how far to trust it.",
    epilog="Start with: idtool inspect LOG, then idtool fit URDF LOG. Exit codes: 0 done, 1 a bound was not met, "
    "2 the input is unusable.",
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from idtool import __version__

        typer.echo(f"idtool {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    pass
