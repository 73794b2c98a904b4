"""Sentences about the steps of a diagnosis."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace

from idtool.common.names import capitalized
from idtool.common.number_text import number, parameter_text
from idtool.common.units import POSITION_UNITS
from idtool.diagnosis.records import Candidate, DiagnosisStep
from idtool.dynamics.effects import effect_from_entry, effect_name, effect_types
from idtool.estimation.dataset.experiment import Experiment
from idtool.robot.config import EffectEntry
from idtool.robot.model import RobotModel

_MAX_PARAMETERS = 4  # in a sentence


def step_sentence(step: DiagnosisStep, model: RobotModel) -> str:
    """Summary of a step, which does not repeat the names of the effect and of what it acts on.

    Parameters
    ----------
    step
        The step.
    model
        The robot.
    """
    region = step.location.region
    if step.entry is None:
        where = f" ({region})" if region else ""
        return f"The residual has structure{where} that the model does not explain."
    kind = effect_types()[step.chosen.effect]
    description = capitalized(kind.description)
    others = {p.name: p.arbitrary_beside for p in kind.nonlinear_parameters if p.arbitrary_beside is not None}
    units = effect_from_entry(step.entry, model).parameter_units()
    parameters = []
    for name, value in list(step.parameters.items())[:_MAX_PARAMETERS]:
        error = step.standard_error.get(name)
        text = _parameter(name, value, error if isinstance(error, float) else None, units)
        if name in others and error is None:
            text += f", without influence beside the {effect_name(others[name])}"
        parameters.append(text)
    where = "" if region in ("", "in the whole log") else f"The residual was concentrated {region}. "
    source = "Assumed, not found. " if step.is_assumed else ""
    return f"{description} ({', '.join(parameters)}). {source}{where}{_improvement(step, model.units)}"


def with_doubts(steps: Sequence[DiagnosisStep], model: RobotModel) -> list[DiagnosisStep]:
    """Steps with the doubts about their effects; effects of one kind are considered together."""
    entries: dict[str, list[EffectEntry]] = {}
    for step in steps:
        if step.entry is not None:
            entry = step.entry.model_copy(update={"parameters": dict(step.parameters)})
            entries.setdefault(entry.effect, []).append(entry)
    doubts = {effect: effect_types()[effect].doubt(own, model) for effect, own in entries.items()}
    return [replace(step, doubt=doubts.get(step.chosen.effect) or step.doubt) for step in steps]


def _parameter(name: str, value: object, error: float | None, units: Mapping[str, str]) -> str:
    """A parameter in a sentence, to the first digit of its standard error."""
    return parameter_text(name, value, error, units.get(name), digits=3, error_digits=1)


def _improvement(step: DiagnosisStep, units: Mapping[str, str]) -> str:
    """Errors before and after a step."""
    joint = step.chosen.joint or "overall"
    unit = units.get(joint, next(iter(units.values())))
    kind = "held-out torque" if step.before.validation is not None else "torque"
    where = f" of {step.chosen.joint}" if step.chosen.joint else ""
    before, after = step.before.torque[joint], step.after.torque[joint]
    text = f"The {kind} error{where} changes from {number(before)} to {number(after)} {unit} RMS"
    if step.before.simulation is not None and step.after.simulation is not None:
        position_unit = POSITION_UNITS[unit]
        before, after = step.before.simulation[joint], step.after.simulation[joint]
        text += f", and the simulated position error from {number(before)} to {number(after)} {position_unit}"
    return f"{text}."


def fitted_along_sentence(entry: EffectEntry, model: RobotModel) -> str:
    """Message about an effect that was fitted but is not reported."""
    description = effect_types()[entry.effect].description
    units = effect_from_entry(entry, model).parameter_units()
    parameters = ", ".join(_parameter(name, value, None, units) for name, value in entry.parameters.items())
    return f"{description} ({parameters}); it was included in the fit, but is not part of the model"


def removal_sentence(removed: Candidate, by: Candidate) -> str:
    """Message about an effect that another one made superfluous."""
    kind = effect_types()[by.effect]
    why = f"with {by.words}" if kind.reportable else f"because on {by.target} {kind.description}"
    return removal_with_reason(removed, f"{why}, it no longer explains enough")


def removal_with_reason(removed: Candidate, reason: str) -> str:
    """Message about an effect that was removed; ``reason`` is a clause."""
    return f"{capitalized(removed.words)} was removed again: {reason}"


def replacement_sentence(replaced: Candidate, by: Candidate) -> str:
    """Message about an effect that was replaced by another one."""
    return (
        f"{capitalized(replaced.words)} was replaced by {by.words}, which explains the data better beside the other "
        "effects"
    )


def unproven_sentence(removed: Candidate, reason: str) -> str:
    """Message about an effect removed for lack of evidence; ``reason`` is what speaks against it, a clause."""
    return removal_with_reason(
        removed, f"{reason}, and the residual of its joints remains above the noise floor with it"
    )


def distinguishing_experiment(first: Candidate, second: Candidate, experiment: Experiment) -> str:
    """Motion that would distinguish two effects, and the command that designs it for the robot and its logs."""
    kinds = effect_types()
    hints = [
        f"{kinds[candidate.effect].excitation_hint} ({effect_name(candidate.effect)})" for candidate in (first, second)
    ]
    motion = f"log {', and '.join(dict.fromkeys(hints))}"
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
