"""The application that the commands belong to."""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, Annotated

import typer
from typer.core import TyperGroup
from typing_extensions import override

if TYPE_CHECKING:
    from typer._click import HelpFormatter

_SECTIONS = {  # of the help, in the order in which a user needs the commands
    "First steps": ("sample", "inspect", "init", "ellipsoids", "excite"),
    "Identify and check": ("fit", "validate", "diagnose", "reduce"),
    "Further analysis": ("study", "compare", "adapt"),
    "Use the model": ("simulate", "export"),
}
_WIDTH = 100  # characters of a line of help, in a terminal that has them


class _Commands(TyperGroup):
    """The commands, in the sections of the help."""

    @override
    def list_commands(self, ctx: typer.Context) -> list[str]:  # type: ignore[override]
        in_order = chain.from_iterable(_SECTIONS.values())
        return [name for name in in_order if name in self.commands]

    @override
    def format_commands(self, ctx: typer.Context, formatter: HelpFormatter) -> None:  # type: ignore[override]
        width = max(map(len, self.commands))  # the sections are aligned
        for title, names in _SECTIONS.items():
            rows = []
            for name in names:
                summary, _, _ = (self.commands[name].help or "").partition("\n\n")
                rows.append((name.ljust(width), summary))
            with formatter.section(title):
                formatter.write_dl(rows)


app = typer.Typer(
    name="idtool",
    cls=_Commands,
    help="Identify the dynamics of robot legs and arms from logged joint data.\n\n"
    "Reads a URDF and logs of q, v and tau. Writes a URDF with physically realizable inertias, a configuration with "
    "friction and rotors, and a report of how well the model predicts held-out data.",
    epilog="From logs to a model:\n\n"
    "\b\n"  # keeps the lines of the next paragraph
    "  idtool inspect run1.mcap\n"
    "  idtool init robot.urdf run1.mcap\n"
    "  idtool fit robot.urdf run1.mcap run2.mcap --validate run3.mcap\n"
    "  idtool diagnose robot.urdf run1.mcap run2.mcap --validate run3.mcap\n\n"
    "COMMAND --help shows the options of a command and an example. "
    "Exit codes: 0 done, 1 a bound was not met, 2 the input cannot be used.",
    add_completion=True,
    context_settings={"help_option_names": ["--help", "-h"], "max_content_width": _WIDTH},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # whose import would take longer than the help
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
