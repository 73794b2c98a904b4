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
    unknown = _listed(on(step) for step in report.steps if step.effect == UNKNOWN)
    unit, which = together(report.units), "held-out" if report.before.validation else "training"
    first, last = _overall(report.before), _overall(report.after)
    floor = f"{report.noise_floor['overall']:.3g} {unit}"
    if report.verdict == "no_disagreement":
        return (
            f"Model and data agree: the {which} torque error, {first:.3g} {unit} RMS, cannot be distinguished from the "
            f"noise floor, {floor}. Nothing was added."
        )
    if not named:
        cause = "but the difference is too small to be attributed to an effect"
        if unknown:
            cause = f"and no known effect explains the difference on {unknown}"
        return (
            f"Model and data disagree, {cause}. The {which} torque error is {first:.3g} {unit} RMS, and the noise "
            f"floor is {floor}."
        )
    share = report.gap_closed["overall"]
    closed = "" if share is None else f", so {100 * max(share, 0.0):.0f} % of the gap is closed"
    rest = f" No known effect explains the remaining residual on {unknown}." if unknown else ""
    doubted = [_named_alone(step) for step in named if step.evidence.doubt]
    rest += f" Doubtful: {_listed(doubted)}; the notices give the reasons." if doubted else ""
    effects = "this effect" if len(named) == 1 else "these effects"
    return (
        f"The model lacks {_listed([_named(step) for step in named])}. With {effects}, the {which} torque error goes "
        f"from {first:.3g} to {last:.3g} {unit} RMS. The noise floor is {floor}{closed}.{rest}"
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
        said.append("First correct the data, or describe them correctly in the configuration, and then diagnose again.")
    for step in report.steps:
        if step.evidence.pair and step.alternatives:
            told = f"To distinguish {_named_alone(step)} from {_named_alone(step.alternatives[0])}"
            said.append(f"{told}: {step.evidence.separate}")
    if left := [on(step) for step in report.steps if step.effect == UNKNOWN]:
        what = "is not caused by any known effect: see the residual maps in diagnosis.html"
        said.append(f"The remaining residual on {_listed(left)} {what}.")
    if "overall" in report.rollout_worse:
        said.append("Do not simulate with this model yet: its rollouts are worse than those of the original model.")
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
    """Words as a list in a sentence, each once; empty for none."""
    distinct = list(dict.fromkeys(words))
    if len(distinct) < 2:
        return "".join(distinct)
    return f"{', '.join(distinct[:-1])} and {distinct[-1]}"
