"""The application that the commands belong to."""

from __future__ import annotations

from typing import Annotated

import typer
from typer.core import TyperGroup

FIRST_STEPS, IDENTIFY_AND_CHECK, FURTHER_ANALYSIS, USE_THE_MODEL = (
    "First steps",
    "Identify and check",
    "Further analysis",
    "Use the model",
)

_ORDER = (  # in which a user needs them
    *("sample", "inspect", "init", "ellipsoids", "excite"),
    *("fit", "validate", "diagnose", "reduce"),
    *("study", "compare", "adapt"),
    *("simulate", "export"),
)


class _Commands(TyperGroup):
    """The commands in the order of the help."""

    def list_commands(self, ctx: typer.Context) -> list[str]:  # type: ignore[override]
        return sorted(super().list_commands(ctx), key=_ORDER.index)


app = typer.Typer(
    name="idtool",
    cls=_Commands,
    help="Identify the dynamics of robot legs and arms from logged joint data.\n\n"
    "Reads a URDF and logs of q, v and tau. Writes a URDF with physically realizable inertias, a configuration with "
    "friction and rotors, and a report of how well the model predicts held-out data.",
    epilog="From logs to a model:\n\n"
    "idtool inspect run1.mcap\n\n"
    "idtool init robot.urdf run1.mcap\n\n"
    "idtool fit robot.urdf run1.mcap run2.mcap --validate run3.mcap\n\n"
    "idtool diagnose robot.urdf run1.mcap run2.mcap --validate run3.mcap\n\n"
    "COMMAND --help shows the options of a command and an example. "
    "Exit codes: 0 done, 1 a bound was not met, 2 the input cannot be used.",
    add_completion=True,
    context_settings={"help_option_names": ["--help", "-h"]},
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def _print_version(requested: bool) -> None:
    if requested:
        from idtool.common.version import VERSION

        typer.echo(f"idtool {VERSION}")
        raise typer.Exit


@app.callback()
def _main_options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    pass
