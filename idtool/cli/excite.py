"""`idtool excite`."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from idtool.cli.app import app
from idtool.cli.options import (
    LOG_TO_WRITE,
    ConfigOption,
    JsonOption,
    QuietOption,
    UrdfArgument,
    command_line,
    finish,
    output_file,
    output_folder,
)
from idtool.common.exceptions import ConfigError

_ALL_JOINTS = ""  # an option's value for all joints
NEEDS_TWO = (  # of --decide
    "needs two explanations, EFFECT:JOINT each or a configuration with effects; "
    "for example --decide backlash:hip payload:shank"
)
_CONFIGURATION_ENDINGS = (".yaml", ".yml")


def _check_two(explanations: tuple[str, str] | None) -> tuple[str, str] | None:
    """The explanations as given, unless one is the option or file that stands behind the only one.

    Raises
    ------
    ConfigError
        If there is only one.
    """
    for text in explanations or ():
        is_other_file = os.path.isfile(text) and not text.endswith(_CONFIGURATION_ENDINGS)
        if text.startswith("-") or is_other_file:
            raise ConfigError("--decide", NEEDS_TWO)
    return explanations


@app.command(
    "excite",
    epilog="Example: idtool excite leg.urdf --duration 30 --noise 0.1 --favour shank_link",
)
def excite_command(
    urdf: UrdfArgument,
    config: ConfigOption = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help=f"{LOG_TO_WRITE}; default: <urdf stem>_idtool/excitation.mcap."),
    ] = None,
    log: Annotated[
        list[Path] | None, typer.Option(help="An existing log that the trajectory complements; repeatable.")
    ] = None,
    pattern: Annotated[
        str,
        typer.Option(
            autocompletion=lambda: ["fourier", "bspline", "shell"],
            help="fourier, bspline, or shell (limb tips move on an ellipsoidal shell; Wensing et al. 2018).",
        ),
    ] = "fourier",
    criterion: Annotated[
        str,
        typer.Option(
            autocompletion=lambda: ["d", "a", "e", "condition"],
            help="d: all parameters; a: RMS error; e: worst combination; condition: condition number.",
        ),
    ] = "d",
    favour: Annotated[
        list[str] | None,
        typer.Option(help="Optimize for a body, a joint's friction or a parameter (hip.coulomb); repeatable."),
    ] = None,
    duration: Annotated[float, typer.Option(help="Duration of the trajectory, s.")] = 20.0,
    slow: Annotated[
        float, typer.Option(help="Fraction of the duration for slow sweeps and standstill (friction).")
    ] = 0.2,
    rate: Annotated[float, typer.Option(help="Sampling rate, Hz.")] = 1000.0,
    max_frequency: Annotated[
        float | None, typer.Option("--max-frequency", help="Highest frequency, Hz; default: computed from the limits.")
    ] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            help="RMS torque noise in the filter's band, N·m: 0.1 or hip=0.1; default: from --log, or 1 % of the "
            "effort limit."
        ),
    ] = None,
    margin: Annotated[float, typer.Option(help="Unused fraction of each limit; twice that for the effort.")] = 0.1,
    clearance: Annotated[float, typer.Option(help="Minimum distance between links, m.")] = 0.01,
    start: Annotated[
        list[str] | None, typer.Option(help="Joint position at start and end: hip=0.5, or *_knee=-1; repeatable.")
    ] = None,
    tip: Annotated[
        str | None,
        typer.Option(help="With --pattern shell: link that moves on the shell; default: the last link of every limb."),
    ] = None,
    iterations: Annotated[
        int | None, typer.Option(min=1, help="Iterations of the search; default: 200, with --stand 60.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Random seed; default: that of the configuration.")] = None,
    stand: Annotated[
        bool, typer.Option("--stand", help="Keep the feet on the ground; default: the base is held, the feet hang.")
    ] = False,
    feet: Annotated[
        list[str] | None,
        typer.Option(help="Contact that stays on the ground with --stand; repeatable; default: those at limbs' ends."),
    ] = None,
    friction_coefficient: Annotated[
        float | None,
        typer.Option("--ground-friction", help="Friction coefficient of the ground, with --stand; default: 0.5."),
    ] = None,
    sole_size: Annotated[
        tuple[float, float] | None,
        typer.Option(
            "--sole-size",
            metavar="LENGTH WIDTH",
            help="Length and width of flat feet, m; default: from their geometry.",
        ),
    ] = None,
    decide: Annotated[
        tuple[str, str] | None,
        typer.Option(
            metavar="A B",
            help="Optimize the trajectory to distinguish two explanations A and B, each given as EFFECT:JOINT or as a "
            "configuration with effects.",
            callback=_check_two,
        ),
    ] = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Design an exciting trajectory within the limits, and print the expected standard errors."""
    from idtool.api.excite import LOG_NAME, excite
    from idtool.api.model import Model
    from idtool.data.logs import check_log_file
    from idtool.reporting.terminal import Terminal
    from idtool.reporting.terminal.excite import show_excitation

    terminal = Terminal(quiet, as_json)
    file = output_file(out, LOG_NAME) if out else output_folder(urdf, None) / LOG_NAME
    check_log_file(file, [urdf, *(log or []), *([config] if config else [])])
    with terminal.progress() as progress:
        progress("reading", 0.0)
        result = excite(
            Model(urdf, config),
            logs=log or (),
            pattern=pattern,
            criterion=criterion,
            favour=favour or (),
            duration=duration,
            slow=slow,
            rate=rate,
            max_frequency=max_frequency,
            noise=_parse_numbers("--noise", noise or [], for_all=True),
            margin=margin,
            clearance=clearance,
            start=_parse_numbers("--start", start or [], for_all=False),
            tip=tip,
            iterations=iterations,
            seed=seed,
            stand=stand,
            feet=feet or (),
            friction_coefficient=friction_coefficient,
            sole_size=sole_size,
            decide=decide,
            progress=progress,
        )
        progress("writing", 0.0)
        result.save(file, command_line())
    report = result.model_copy(update={"file": str(file)})
    show_excitation(terminal, report)
    finish(terminal, report, {})


def _parse_numbers(option: str, texts: Sequence[str], for_all: bool) -> dict[str, float]:
    """Numbers of JOINT=NUMBER, by joint; a number without a joint is for all joints."""
    numbers = {}
    for text in texts:
        name, separator, number = text.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        lacks_joint = not separator and not for_all
        is_too_small = for_all and value <= 0
        if not math.isfinite(value) or lacks_joint or is_too_small:
            form = "NUMBER or JOINT=NUMBER, above 0" if for_all else "JOINT=NUMBER"
            raise ConfigError(option, f"{text or 'an empty value'} is not {form}")
        numbers[name if separator else _ALL_JOINTS] = value
    return numbers
