"""`idtool diagnose`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from idtool.cli.app import app
from idtool.cli.options import (
    AssumeOption,
    ConfigOption,
    EffectsOption,
    ExplainOption,
    HoldoutOption,
    InertiaOption,
    JsonOption,
    LogsArgument,
    MaxEffectsOption,
    NoSimulationOption,
    OutOption,
    QuietOption,
    ReportOnlyOption,
    UrdfArgument,
    ValidateOption,
    command,
    config_of,
    finish,
)
from idtool.exceptions import ConfigError

if TYPE_CHECKING:
    from idtool.fit import Fit
    from idtool.model import Model

Assumed = tuple[str, str | None]


@app.command("diagnose", epilog="Example: idtool diagnose leg.urdf run1.mcap run2.mcap --validate run3.mcap")
def diagnose_command(
    urdf: UrdfArgument,
    logs: LogsArgument,
    config: ConfigOption = None,
    out: OutOption = None,
    holdout: HoldoutOption = 0.3,
    validate: ValidateOption = None,
    inertia: InertiaOption = "refit",
    effects: EffectsOption = None,
    max_effects: MaxEffectsOption = 12,
    assume: AssumeOption = None,
    report_only: ReportOnlyOption = False,
    explain: ExplainOption = False,
    no_simulation: NoSimulationOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Find where model and data disagree, name the missing effect, add it, and show the gap shrink."""
    from idtool.diagnosis.diagnose import Options, diagnose
    from idtool.diagnosis_report import diagnosis_report
    from idtool.experiment import prepare
    from idtool.outputs import as_json as dump
    from idtool.outputs import write_all
    from idtool.pages import diagnosis_page
    from idtool.robot import read_robot
    from idtool.terminal import Terminal
    from idtool.terminal.diagnosis import show_diagnosis

    terminal, folder = Terminal(quiet, as_json), out or Path(f"{urdf.stem}_idtool")
    candidates, assumed = _candidates(effects), [_split(text) for text in assume or []]
    with terminal.progress() as progress:
        progress("reading", 0.0)
        experiment = prepare(read_robot(urdf), config_of(urdf, config), logs, validate or (), holdout)
        _check(assumed, experiment.model)
        options = Options(inertia, candidates, max_effects, tuple(assumed), not no_simulation)
        result = diagnose(experiment, options, progress)
        progress("writing", 0.0)
        report = diagnosis_report(result, inertia)
        files = {
            "diagnosis.json": dump(report),
            "diagnosis.html": diagnosis_page(result, report, command()),
            **({} if report_only else _model(result.last, urdf.name)),
        }
        write_all(folder, files)
    show_diagnosis(terminal, report, folder, tuple(files), explain)
    finish(terminal, report, {})


def _candidates(given: str | None) -> tuple[str, ...] | None:
    """The effects that may be named; None: all."""
    if given is None:
        return None
    return tuple(dict.fromkeys(_known("--effects", name.strip()) for name in given.split(",")))


def _split(text: str) -> Assumed:
    """An effect and what it acts on, which may have a colon in its name."""
    effect, colon, on = text.partition(":")
    return _known("--assume", effect.strip()), on if colon else None


def _known(option: str, effect: str) -> str:
    from idtool.effects import known_effects
    from idtool.names import nearest, shown

    named = [id for id, kind in known_effects().items() if kind.named]
    if effect not in named:
        raise ConfigError(option, f"{shown(effect) or 'nothing'} is no effect; {nearest(effect, named)}")
    return effect


def _check(assumed: list[Assumed], model: Model) -> None:
    """Whether the robot has what the assumed effects act on."""
    from idtool.effects import known_effects
    from idtool.effects.joint_effect import JointEffect
    from idtool.effects.link_effect import LinkEffect
    from idtool.names import nearest, shown

    for effect, on in assumed:
        kind = known_effects()[effect]
        of_link = issubclass(kind, LinkEffect)
        names, what = (model.robot.links, "link") if of_link else (model.names, "joint")
        if on is None and issubclass(kind, LinkEffect | JointEffect):
            raise ConfigError("--assume", f"{effect} acts on a {what}; give {effect}:{what.upper()}")
        if on is not None and on not in names:
            raise ConfigError("--assume", f"{shown(on) or 'nothing'} is no {what} of the model; {nearest(on, names)}")


def _model(fit: Fit, urdf: str) -> dict[str, str | bytes]:
    """The files of the model with the effects."""
    from idtool.outputs import as_yaml
    from idtool.report import joint_dynamics, model_config
    from idtool.urdf import identified_urdf

    model = fit.experiment.model
    bodies = {body.name: (body, fit.parameters(i)) for i, body in enumerate(model.bodies)}
    header = f"Diagnosed by idtool from {urdf}; with identified.urdf it is the model with the effects found."
    return {
        "model.yaml": as_yaml(model_config(fit), header),
        "identified.urdf": identified_urdf(model.robot, bodies, joint_dynamics(fit)),
    }
