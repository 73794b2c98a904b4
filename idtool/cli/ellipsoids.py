"""`idtool ellipsoids`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from idtool.cli.app import FIRST, app
from idtool.cli.options import ConfigOption, JsonOption, QuietOption, UrdfArgument, finish
from idtool.common.exceptions import ConfigError

if TYPE_CHECKING:
    from idtool.reporting.terminal import Terminal
    from idtool.robot.config import Config
    from idtool.robot.urdf.reading import Robot


@app.command(
    "ellipsoids", rich_help_panel=FIRST, epilog="Example: idtool ellipsoids leg.urdf --check --repair leg_repaired.urdf"
)
def ellipsoids_command(
    urdf: UrdfArgument,
    config: ConfigOption = None,
    out: Annotated[Path | None, typer.Option(help="YAML file to write to; default: standard output.")] = None,
    margin: Annotated[float, typer.Option(min=0.0, help="Share by which the semi-axes grow.")] = 0.05,
    check: Annotated[
        bool,
        typer.Option(
            "--check",
            help="List the links whose inertia no body can have, within the configuration's bounds where it has any; "
            "exit code 1 if there are some.",
        ),
    ] = False,
    repair: Annotated[
        Path | None, typer.Option(help="With --check: write the nearest URDF whose bodies can exist to this file.")
    ] = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Write bounding ellipsoids of the links' meshes and primitives, or check the links' inertias."""
    from idtool.api.model import Model
    from idtool.common.outputs import check_file
    from idtool.reporting.terminal import Terminal

    if repair is not None and not check:
        raise ConfigError("--repair", "goes with --check; give both")
    if check and out is not None:
        raise ConfigError("--out", "is for the ellipsoids; with --check, --repair names the file to write")
    terminal = Terminal(quiet, as_json)
    if out is not None:
        check_file(out, [urdf, urdf.with_suffix(".yaml"), *([config] if config else [])])
    if repair is not None:  # the URDF itself may be repaired
        check_file(repair, [])
    if check:
        model = Model(urdf, config)
        _check(terminal, model.robot, model.settings, repair)
    else:
        _bound(terminal, Model.bare(urdf).robot, margin, out)


def _bound(terminal: Terminal, robot: Robot, margin: float, out: Path | None) -> None:
    """Bounding ellipsoids as YAML."""
    from idtool.common.outputs import as_yaml, write_all
    from idtool.reporting.report import HEADER
    from idtool.robot.bounding import as_config, bounding_ellipsoids

    found, reasons = bounding_ellipsoids(robot, margin)
    notes = [f"link {link}: no ellipsoid; {why}" for link, why in reasons.items()]
    data = {"bounding_ellipsoids": as_config(found)}
    header = f"Smallest ellipsoids around the links of {robot.path.name}, semi-axes {margin:.0%} longer; m, rad."
    text = as_yaml(data, header)
    if out is not None:
        write_all(out.parent, {out.name: text})
        terminal.say(f"written: {out}")
    elif not terminal.as_json:
        terminal.say(text.rstrip())
    terminal.warn(notes)
    finish(terminal, {**HEADER, **data, "warnings": notes}, {})


def _check(terminal: Terminal, robot: Robot, config: Config, repair: Path | None) -> None:
    """Links whose inertia no body can have."""
    from idtool.common.outputs import write_all
    from idtool.estimation.problem.link_check import check_links, check_report, nearest_bodies, repaired
    from idtool.reporting.report import HEADER
    from idtool.reporting.terminal.check import show_check

    checks = check_links(robot, config)
    nearest = nearest_bodies(checks) if repair else {}
    report = {**HEADER, **check_report(checks, nearest), "urdf": str(robot.path)}
    if repair is not None:
        write_all(repair.parent, {repair.name: repaired(robot, nearest)})
    show_check(terminal, report, repair)
    met = {} if repair else {c.body.name: not c.violations for c in checks}
    finish(terminal, report, met, "no body can have the inertia of")
