"""`idtool ellipsoids`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from idtool.cli.app import app
from idtool.cli.options import ConfigOption, JsonOption, QuietOption, UrdfArgument, finish, output_file
from idtool.common.exceptions import ConfigError

if TYPE_CHECKING:
    from idtool.reporting.terminal import Terminal


@app.command(
    "ellipsoids",
    epilog="Example: idtool ellipsoids leg.urdf --check --repair leg_repaired.urdf",
)
def ellipsoids_command(
    urdf: UrdfArgument,
    config: ConfigOption = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder, or YAML file to write; default: standard output.")
    ] = None,
    margin: Annotated[float, typer.Option(min=0.0, help="Fraction by which the semi-axes are enlarged.")] = 0.05,
    check: Annotated[
        bool,
        typer.Option(
            "--check",
            help="List the links whose inertia is not realizable, within the configuration's bounds if there are any; "
            "exit code 1 if there are such links.",
        ),
    ] = False,
    repair: Annotated[
        Path | None,
        typer.Option(help="With --check: write a copy of the URDF with the nearest realizable inertias to this file."),
    ] = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Compute bounding ellipsoids from the links' meshes and primitives, or check the links' inertias."""
    from idtool.common.outputs import check_file
    from idtool.reporting.terminal import Terminal

    if repair is not None and not check:
        raise ConfigError("--repair", "requires --check")
    if check and out is not None:
        raise ConfigError("--out", "cannot be combined with --check; --repair names the file to write")
    terminal = Terminal(quiet, as_json)
    if out is not None:
        out = output_file(out, "ellipsoids.yaml")
        check_file(out, [urdf, urdf.with_suffix(".yaml"), *([config] if config else [])])
    if repair is not None:  # the URDF itself may be repaired
        check_file(repair, [])
    if check:
        _check_links(terminal, urdf, config, repair)
    else:
        _write_ellipsoids(terminal, urdf, margin, out)


def _write_ellipsoids(terminal: Terminal, urdf: Path, margin: float, out: Path | None) -> None:
    """Write or print the bounding ellipsoids as YAML."""
    from idtool.api.ellipsoids import ellipsoids

    result = ellipsoids(urdf, margin=margin)
    if out is not None:
        result.save(out)
        terminal.say(f"written: {out}")
    elif not terminal.as_json:
        terminal.say(result.yaml.rstrip())
    terminal.notices(result.notices)
    finish(terminal, result, {})


def _check_links(terminal: Terminal, urdf: Path, config: Path | None, repair: Path | None) -> None:
    """Print the links whose inertia no body can have, and write the repaired URDF if asked for."""
    from idtool.api.ellipsoids import check
    from idtool.api.model import Model
    from idtool.reporting.terminal.check import show_check

    result = check(Model(urdf, config), repair=repair is not None)
    if repair is not None:
        result.save(repair)
    show_check(terminal, result, repair)
    is_realizable = {} if repair else {name: not link.violations for name, link in result.links.items()}
    finish(terminal, result, is_realizable, "inertia not realizable")
