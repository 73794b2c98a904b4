"""What was found, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from idtool.diagnosis.records import Candidate, Level, Step
from idtool.dynamics.effects import effect_types
from idtool.robot.config import EffectEntry
from idtool.robot.model import Model

_SHOWN = 4  # parameters in a sentence


def sentence(step: Step, units: Mapping[str, str]) -> str:
    """One step, for people.

    Parameters
    ----------
    step
        The step.
    units
        Of each joint's torque.
    """
    chosen = step.chosen
    if step.entry is None:
        region = f" ({step.where.region})" if step.where.region else ""
        return f"{chosen.on}: what is left has structure{region} that none of the effects explains"
    means = effect_types()[chosen.effect].description
    figures = ", ".join(
        _figure(name, x, step.standard_error.get(name)) for name, x in list(step.parameters.items())[:_SHOWN]
    )
    region = "" if step.where.region in ("", "all along") else f" {step.where.region}"
    return f"{chosen.on}:{region} {means} ({chosen.effect}: {figures}): {_shrinks(step, units)}"


def doubted(steps: Sequence[Step], model: Model) -> list[Step]:
    """The same steps, with what speaks against the effects of one kind together."""
    entries: dict[str, list[EffectEntry]] = {}
    for step in steps:
        if step.entry is not None:
            entry = step.entry.model_copy(update={"parameters": dict(step.parameters)})
            entries.setdefault(entry.effect, []).append(entry)
    doubts = {effect: effect_types()[effect].doubt(own, model) for effect, own in entries.items()}
    return [replace(step, doubt=doubts.get(step.chosen.effect) or step.doubt) for step in steps]


def _figure(name: str, value: object, error: object) -> str:
    if isinstance(value, float):
        return f"{name} {value:.3g}" + (f" ± {error:.2g}" if isinstance(error, float) else "")
    if isinstance(value, list | tuple):
        return f"{name} [{', '.join(_number(x) for x in value)}]"
    return f"{name} {value}"


def _number(x: object) -> str:
    if isinstance(x, list | tuple):
        return f"[{', '.join(_number(y) for y in x)}]"
    return f"{x:.3g}" if isinstance(x, float) else str(x)


def _shrinks(step: Step, units: Mapping[str, str]) -> str:
    joint = step.chosen.joint or "overall"
    unit = units.get(joint, next(iter(units.values())))
    before, after = (_torque(one)[joint] for one in (step.before, step.after))
    kind = "held-out torque" if step.before.validation is not None else "torque"
    said = f"{kind} RMS {before:.3g} → {after:.3g} {unit}"
    if step.before.simulation is not None and step.after.simulation is not None:
        moved = "m" if unit == "N" else "rad"
        said += f", rollout {step.before.simulation[joint]:.2g} → {step.after.simulation[joint]:.2g} {moved}"
    return said


def _torque(one: Level) -> Mapping[str, float]:
    return one.validation if one.validation is not None else one.train


def aside(entry: EffectEntry) -> str:
    """An effect that is no answer, for people."""
    means = effect_types()[entry.effect].description
    figures = ", ".join(_figure(name, value, None) for name, value in entry.parameters.items())
    return f"{means} ({figures}); that was fitted along, and is not in the model"


def superseded(out: Candidate, by: Candidate) -> str:
    """Why an effect was taken out again, for people."""
    kind = effect_types()[by.effect]
    why = f"with {by.effect} on {by.on}" if kind.reportable else f"where {kind.description}, as on {by.on},"
    return f"{out.effect} on {out.on} was taken out again: {why} it pays no more"


def separating(one: Candidate, other: Candidate) -> str:
    """Which experiment tells two effects apart."""
    kinds = effect_types()
    hints = [f"{kinds[found.effect].excitation_hint} ({found.effect})" for found in (one, other)]
    return f"log {hints[0]}, and {hints[1]}"
