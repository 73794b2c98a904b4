"""What a diagnosis says in words; from its records."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from idtool.dynamics.effects import NamedEffect, effect_types
from idtool.reporting.results.diagnosis import CandidateReport, DiagnosisReport, ErrorLevel, StepReport
from idtool.reporting.results.fit import EffectReport
from idtool.reporting.simulation_report import POSITION_UNITS

UNKNOWN = "unknown"


def effect_name(effect: str) -> str:
    """An effect's id in plain words."""
    kind = effect_types().get(effect)
    return (kind.label if kind else "") or effect.replace("_", " ")


def on(effect: EffectReport | CandidateReport) -> str:
    """Joint or link of an effect, or what it acts on of the whole robot."""
    kind = effect_types().get(effect.effect, NamedEffect)
    return str(effect.joint or effect.link or kind.whole_robot_owner)


def together(units: Mapping[str, str]) -> str:
    """The unit of figures for joints with these units together."""
    kinds = list(dict.fromkeys(units.values()))
    return kinds[0] if len(kinds) == 1 else f"{' and '.join(kinds)} together"


def position_units(units: Mapping[str, str]) -> dict[str, str]:
    """The unit of each joint's position, by that of its torque."""
    return {joint: POSITION_UNITS[unit] for joint, unit in units.items()}


def summary(report: DiagnosisReport) -> str:
    """The verdict in a sentence or two.

    Parameters
    ----------
    report
        The content of diagnosis.json.
    """
    named = [step for step in report.steps if step.effect != UNKNOWN]
    left = [step for step in report.steps if step.effect == UNKNOWN]
    unit, which = together(report.units), "held-out" if report.before.validation else "training"
    first, last = _overall(report.before), _overall(report.after)
    floor = f"{report.noise_floor['overall']:.3g} {unit}"
    if report.verdict == "no_disagreement":
        return (
            f"Model and data do not disagree: the {which} torque error, {first:.3g} {unit} RMS, is as near to the "
            f"noise floor, {floor}, as the data can tell. Nothing was added."
        )
    unknown = f"{UNKNOWN}, on {_listed([on(step) for step in left])}" if left else "too little to be named"
    if not named:
        return (
            f"Model and data disagree, and no known effect explains it: {unknown}. The {which} torque error is "
            f"{first:.3g} {unit} RMS, the noise floor {floor}."
        )
    share = report.gap_closed["overall"]
    closed = "" if share is None else f": {100 * max(share, 0.0):.0f} % of the gap is closed"
    rest = f" What is left is {unknown}." if left else ""
    doubted = [_named_alone(step) for step in named if step.evidence.doubt]
    rest += f" In doubt: {_listed(doubted)}; the notes say why." if doubted else ""
    return (
        f"The model lacks {_listed([_named(step) for step in named])}. With that, the {which} torque error goes from "
        f"{first:.3g} to {last:.3g} {unit} RMS, the noise floor being {floor}{closed}.{rest}"
    )


def next_steps(report: DiagnosisReport) -> list[str]:
    """What to do next, a plain sentence each.

    Parameters
    ----------
    report
        The content of diagnosis.json.
    """
    said = []
    if any(not fault.undone for fault in report.data_faults):
        said.append("Correct the data first, or say what they mean in the configuration, and diagnose again.")
    for step in report.steps:
        if step.evidence.pair and step.alternatives:
            told = f"To tell {_named_alone(step)} from {_named_alone(step.alternatives[0])}"
            said.append(f"{told}: {step.evidence.separate}")
    if left := [on(step) for step in report.steps if step.effect == UNKNOWN]:
        what = "has a cause that is none of the effects known: see the residual maps"
        said.append(f"What is left on {_listed(left)} {what}.")
    if "overall" in report.rollout_worse:
        said.append("Do not simulate with this model yet: its rollouts are worse than those of the model given.")
    return said


def _overall(level: ErrorLevel) -> float | None:
    return level.torque["overall"]


def _named_alone(found: StepReport | CandidateReport) -> str:
    name = effect_name(found.effect)
    kind = effect_types().get(found.effect, NamedEffect)
    article = ""
    if kind.is_countable:
        article = "an " if name[0] in "aeiou" else "a "
    return f"{article}{name} on {on(found)}"


def _named(step: StepReport) -> str:
    """An effect that was found; with that which the data cannot tell it from."""
    pair = step.evidence.pair and step.alternatives
    return f"{_named_alone(step)} (or {_named_alone(step.alternatives[0])})" if pair else _named_alone(step)


def _listed(words: Iterable[str]) -> str:
    """Words as a list in a sentence, each once."""
    *some, last = dict.fromkeys(words)
    return f"{', '.join(some)} and {last}" if some else last
