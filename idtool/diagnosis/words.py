"""Sentences about the steps of a diagnosis."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace

from idtool.diagnosis.records import Candidate, DiagnosisStep
from idtool.dynamics.effects import effect_types
from idtool.estimation.dataset.experiment import Experiment
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel

_MAX_PARAMETERS = 4  # in a sentence
_MAX_ROWS = 8  # of a table in a sentence


def step_sentence(step: DiagnosisStep, units: Mapping[str, str]) -> str:
    """Summary of a step.

    Parameters
    ----------
    step
        The step.
    units
        Unit of each joint's torque.
    """
    chosen = step.chosen
    region = step.location.region
    if step.entry is None:
        where = f" ({region})" if region else ""
        return f"{chosen.target}: the residual has structure{where} that the model does not explain"
    description = effect_types()[chosen.effect].description
    shown = list(step.parameters.items())[:_MAX_PARAMETERS]
    parameters = ", ".join(_parameter(name, value, step.standard_error.get(name)) for name, value in shown)
    where = "" if region in ("", "in the whole log") else f"The residual was concentrated {region}. "
    return f"{chosen.target}: {description} ({chosen.effect}: {parameters}). {where}{_improvement(step, units)}"


def with_doubts(steps: Sequence[DiagnosisStep], model: RobotModel) -> list[DiagnosisStep]:
    """Steps with the doubts about their effects; effects of one kind are considered together."""
    entries: dict[str, list[EffectEntry]] = {}
    for step in steps:
        if step.entry is not None:
            entry = step.entry.model_copy(update={"parameters": dict(step.parameters)})
            entries.setdefault(entry.effect, []).append(entry)
    doubts = {effect: effect_types()[effect].doubt(own, model) for effect, own in entries.items()}
    return [replace(step, doubt=doubts.get(step.chosen.effect) or step.doubt) for step in steps]


def _parameter(name: str, value: object, error: object) -> str:
    if isinstance(value, float):
        return f"{name} {value:.3g}" + (f" ± {error:.2g}" if isinstance(error, float) else "")
    return f"{name} {_value(value)}"


def _value(value: object) -> str:
    if isinstance(value, list | tuple):
        if len(value) > _MAX_ROWS:
            return f"[{_value(value[0])}, …, {_value(value[-1])}] ({len(value)} rows)"
        return f"[{', '.join(_value(x) for x in value)}]"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _improvement(step: DiagnosisStep, units: Mapping[str, str]) -> str:
    """Errors before and after a step."""
    joint = step.chosen.joint or "overall"
    unit = units.get(joint, next(iter(units.values())))
    kind = "Held-out torque" if step.before.validation is not None else "Torque"
    text = f"{kind} error {step.before.torque[joint]:.3g} → {step.after.torque[joint]:.3g} {unit} RMS"
    if step.before.simulation is not None and step.after.simulation is not None:
        position_unit = "m" if unit == "N" else "rad"
        before, after = step.before.simulation[joint], step.after.simulation[joint]
        text += f", position error of the simulation {before:.2g} → {after:.2g} {position_unit}"
    return text


def fitted_along_sentence(entry: EffectEntry) -> str:
    """Message about an effect that was fitted but is not reported."""
    description = effect_types()[entry.effect].description
    parameters = ", ".join(_parameter(name, value, None) for name, value in entry.parameters.items())
    return f"{description} ({parameters}); it was included in the fit, but is not part of the model"


def removal_sentence(removed: Candidate, by: Candidate) -> str:
    """Reason why an effect was removed again."""
    kind = effect_types()[by.effect]
    why = f"with {by.effect} on {by.target}" if kind.reportable else f"because on {by.target} {kind.description}"
    return f"{removed.effect} on {removed.target} was removed again: {why}, it no longer explains enough"


def replacement_sentence(replaced: Candidate, by: Candidate) -> str:
    """Reason why an effect was replaced by another one."""
    return (
        f"{replaced.effect} on {replaced.target} was replaced by {by.effect} on {by.target}, which explains the data "
        "better beside the other effects"
    )


def unproven_sentence(removed: Candidate, reason: str) -> str:
    """Reason why an effect was removed for lack of evidence; ``reason`` is what speaks against it, a clause."""
    return (
        f"{removed.effect} on {removed.target} was removed again: {reason}, and the residual of its joints remains "
        "above the noise floor with it"
    )


def distinguishing_experiment(first: Candidate, second: Candidate, experiment: Experiment) -> str:
    """Motion that would distinguish two effects, and the command that designs it for the robot and its logs."""
    kinds = effect_types()
    hints = [f"{kinds[candidate.effect].excitation_hint} ({candidate.effect})" for candidate in (first, second)]
    motion = f"log {hints[0]}, and {hints[1]}"
    if any(kinds[candidate.effect].acts_in_bursts for candidate in (first, second)):
        return motion  # no motion can be designed for what acts whatever the motion
    names = [":".join(filter(None, (one.effect, one.joint or one.link))) for one in (first, second)]
    command = shlex.join([*_excite_words(experiment), "--decide", *names])
    return f"{motion}; or design the motion: `{command}`"


def _excite_words(experiment: Experiment) -> list[str]:
    """Words of the command that designs a motion to complement the training logs; LOG for one that is no file."""
    words = ["idtool", "excite", str(experiment.model.robot.path)]
    source = experiment.config.source
    if source is not None:
        words += ["--config", source.path]
    logs = [run.signals.log for run in experiment.runs if run.train]
    for path in dict.fromkeys(str(log.path) if log.sources else "LOG" for log in logs):
        words += ["--log", path]
    return words
