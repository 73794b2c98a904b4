"""The command line: one thin function a command. What is heavy is imported where it is used, so that help is quick."""

from __future__ import annotations

import math
import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from idtool.exceptions import ConfigError, IdtoolError

if TYPE_CHECKING:
    from typer.exceptions import TyperException

    from idtool.config import Config
    from idtool.experiment import Experiment

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

UrdfArgument = Annotated[Path, typer.Argument(help="The robot's URDF.", show_default=False)]
LogsArgument = Annotated[list[Path], typer.Argument(help="Logs: MCAP or CSV.", show_default=False)]
ConfigOption = Annotated[
    Path | None, typer.Option("--config", help="Configuration (YAML); default: <urdf stem>.yaml beside the URDF.")
]
OutOption = Annotated[Path | None, typer.Option("--out", help="Folder to write to; default: <urdf stem>_idtool/.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output.")]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]
MaxRmsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--max-rms",
        help="Largest RMS torque error in the band that is accepted, for all joints together (0.5) or one (hip=0.5); "
        "exit code 1 above it.",
    ),
]


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


@app.command("fit", epilog="Example: idtool fit leg.urdf run1.mcap run2.mcap --validate run3.mcap")
def fit_command(
    urdf: UrdfArgument,
    logs: LogsArgument,
    config: ConfigOption = None,
    out: OutOption = None,
    holdout: Annotated[float, typer.Option(help="Share at the end of every log that is kept for validation.")] = 0.3,
    validate: Annotated[
        list[Path] | None, typer.Option(help="A whole log kept for validation, in place of the holdout; repeatable.")
    ] = None,
    max_rms: MaxRmsOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Identify inertias, friction and rotors; write identified.urdf, model.yaml, report.json and report.html."""
    from idtool.experiment import prepare
    from idtool.fit import fit
    from idtool.outputs import as_json as dump
    from idtool.outputs import as_yaml, write_all
    from idtool.pages import fit_page
    from idtool.report import fit_report, joint_dynamics, model_config
    from idtool.robot import read_robot
    from idtool.terminal import Terminal, show_fit
    from idtool.urdf import identified_urdf

    terminal = Terminal(quiet, as_json)
    folder = out or Path(f"{urdf.stem}_idtool")
    with terminal.progress() as progress:
        progress("reading", 0.0)
        experiment = prepare(read_robot(urdf), _config(urdf, config), logs, validate or (), holdout)
        bounds = _bounds(max_rms or [], experiment)
        result = fit(experiment, progress)
        progress("writing", 0.0)
        report = fit_report(result)
        bodies = {body.name: (body, result.parameters(i)) for i, body in enumerate(experiment.model.bodies)}
        header = f"Identified by idtool from {urdf.name}; with identified.urdf it is the identified model."
        write_all(
            folder,
            {
                "identified.urdf": identified_urdf(experiment.model.robot, bodies, joint_dynamics(result)),
                "model.yaml": as_yaml(model_config(result), header),
                "report.json": dump(report),
                "report.html": fit_page(result, report, _command()),
            },
        )
    show_fit(terminal, result, report, folder)
    rms = report["rms"]["validation"] or report["rms"]["train"]
    _finish(terminal, report, {name: rms[name] <= bound for name, bound in bounds.items()})


@app.command("validate", epilog="Example: idtool validate leg_idtool/identified.urdf run3.mcap --prior leg.urdf")
def validate_command(
    urdf: Annotated[Path | None, typer.Argument(help="The model's URDF.", show_default=False)] = None,
    logs: Annotated[list[Path] | None, typer.Argument(help="Logs: MCAP or CSV.", show_default=False)] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", help="Configuration; default: <urdf stem>.yaml or model.yaml beside the URDF."),
    ] = None,
    prior: Annotated[Path | None, typer.Option(help="A URDF to compare with.")] = None,
    out: OutOption = None,
    max_rms: MaxRmsOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Tell how well a model predicts the torque of logs; without arguments, run the regression on sample_logs/."""
    from idtool.terminal import Terminal

    terminal = Terminal(quiet, as_json)
    if urdf is None:
        if config or prior or out or max_rms:
            raise ConfigError("urdf", "is missing; the regression, which runs without one, takes no such options")
        _regression(terminal)
        return
    from idtool.experiment import coefficients_of, prepare
    from idtool.outputs import as_json as dump
    from idtool.outputs import write_all
    from idtool.pages import validation_page
    from idtool.report import validation_report
    from idtool.robot import read_robot
    from idtool.terminal import show_validation
    from idtool.validate import evaluate

    settings = _config(urdf, config)
    with terminal.progress() as progress:
        progress("reading", 0.0)
        experiment = prepare(read_robot(urdf), settings, [], logs or [])
        bounds = _bounds(max_rms or [], experiment)
        models = {"model": experiment.equation.prior}
        if prior is not None:
            own = _config(prior, None) if prior.with_suffix(".yaml").is_file() else settings.without_friction_values()
            models["prior"] = coefficients_of(read_robot(prior), own, experiment)
        evaluation = evaluate(experiment, models, held_out=True, progress=progress)
        report = validation_report(evaluation, experiment.model.units, experiment.band_hz, bounds)
        report["warnings"] = list(experiment.warnings)
        write_all(
            out or Path(f"{urdf.stem}_idtool"),
            {"validation.json": dump(report), "validation.html": validation_page(evaluation, report, _command())},
        )
    show_validation(terminal, report, out or Path(f"{urdf.stem}_idtool"))
    _finish(terminal, report, report["ok"])


@app.command("inspect", epilog="Example: idtool inspect run1.mcap")
def inspect_command(
    log: Annotated[Path, typer.Argument(help="A log: MCAP or CSV.", show_default=False)],
    config: Annotated[Path | None, typer.Option("--config", help="Configuration; its log section is used.")] = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Tell what is in a log, what is wrong with it, and what that means for the fit."""
    from idtool.config import Config, read_config
    from idtool.inspection import inspect_log
    from idtool.logs import read_log
    from idtool.report import HEADER
    from idtool.terminal import Terminal, show_inspection

    terminal = Terminal(quiet, as_json)
    options = (read_config(config) if config else Config()).log
    with terminal.progress() as progress:
        progress("reading", 0.0)
        record = read_log(log, topic=options.topic, columns=options.columns, scale=dict(options.scale))
        progress("inspecting", 0.0)
        inspection = inspect_log(record)
    show_inspection(terminal, inspection)
    _finish(terminal, {**HEADER, **inspection.to_dict()}, {})


def _regression(terminal: Any) -> None:
    """`idtool validate` without arguments."""
    from idtool.regression import read_manifest, run_case
    from idtool.report import HEADER
    from idtool.terminal import show_regression

    here, home = Path("sample_logs"), Path(__file__).parents[1] / "sample_logs"
    folder = here if (here / "manifest.yaml").exists() else home
    outcomes = []
    with terminal.progress() as progress:
        for case in read_manifest(folder / "manifest.yaml"):
            outcomes += run_case(case, folder, progress)
    show_regression(terminal, outcomes)
    cases = [
        {"case": o.case, "joint": o.joint, "rms": o.rms, "bound": o.bound, "prior": o.prior, "ok": o.ok}
        for o in outcomes
    ]
    _finish(terminal, {**HEADER, "cases": cases}, {f"{o.case} {o.joint}": o.ok for o in outcomes})


def _config(urdf: Path, given: Path | None) -> Config:
    """The configuration: the one given, else the one beside the URDF, else the defaults."""
    from idtool.config import Config, read_config

    beside = [urdf.with_suffix(".yaml"), *([urdf.with_name("model.yaml")] if urdf.stem == "identified" else [])]
    path = given or next((path for path in beside if path.is_file()), None)
    return read_config(path) if path else Config()


def _bounds(given: list[str], experiment: Experiment) -> dict[str, float]:
    """Bounds by joint or ``overall`` from the options."""
    from idtool.names import nearest

    bounds = {}
    for text in given:
        name, _, number = text.rpartition("=")
        name = name or "overall"
        known = (*experiment.equation.joints, "overall")
        if name not in known:
            raise ConfigError("--max-rms", f"{name} is no joint; {nearest(name, known)}")
        try:
            bounds[name] = float(number)
        except ValueError:
            bounds[name] = math.nan
        if not 0 < bounds[name] < math.inf:
            raise ConfigError("--max-rms", f"{text or 'nothing'} is not NUMBER or JOINT=NUMBER, with a number above 0")
    return bounds


def _command() -> str:
    return shlex.join(["idtool", *sys.argv[1:]])


def _finish(terminal: Any, result: dict[str, Any], met: dict[str, bool]) -> None:
    """Print the result where asked for; exit with 1 where a bound was not met."""
    terminal.result(result)
    missed = [name for name, ok in met.items() if not ok]
    if missed:
        terminal.say(f"bound not met: {', '.join(missed)}")
        raise typer.Exit(1)


def main() -> None:
    """Run the command line; an error a user can act on is one line and exit code 2."""
    from typer.exceptions import Abort, TyperException

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small: threads would wait for each other

    try:
        code = app(sys.argv[1:] or ["--help"], standalone_mode=False)
    except IdtoolError as error:
        code = _fail(str(error))
    except TyperException as error:
        code = _fail(_usage(error))
    except (Abort, KeyboardInterrupt):
        code = 130
    sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str) -> int:
    sys.stderr.write(f"error: {message}\n")
    return 2


def _usage(error: TyperException) -> str:
    """A mistake in the command's words as one line."""
    text = " ".join(error.format_message().split()).rstrip(".")
    return f"command: {text[:1].lower()}{text[1:]}; try idtool --help"
