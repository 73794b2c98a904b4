"""A diagnosis in words, from its records."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from idtool.common.names import capitalized
from idtool.common.number_text import number
from idtool.common.units import common_unit, position_units
from idtool.diagnosis.records import COMMAND_DELAY, RIGID_BODY
from idtool.dynamics.effects import NamedEffect, effect_types, target_name
from idtool.dynamics.effects import effect_name as named_effect_name
from idtool.reporting.results.base import ByJointOrNone
from idtool.reporting.results.fit import EffectReport

if TYPE_CHECKING:
    from idtool.reporting.results.diagnosis import (
        AgainstReport,
        CandidateReport,
        ChangeReport,
        DataFault,
        DiagnosisReport,
        ErrorLevel,
        StepReport,
    )

UNKNOWN = "unknown"
RESIDUAL_MAPS = "the residual maps in diagnosis.html"  # which the page links to

_ONLY_BY_RECORDING = ("dropped_samples", "time_jitter")  # faults that cannot be corrected in a log
_ONLY_BY_RECORDING_ALL = ("stale",)  # the same, if they are of all joints at once


def effect_name(effect: str) -> str:
    """An effect's id in plain words."""
    if effect == RIGID_BODY:
        return "inertia"
    return named_effect_name(effect)


def step_title(step: StepReport) -> str:
    """Effect of a step and what it acts on, as a title."""
    name = "unknown effect" if step.effect == UNKNOWN else effect_name(step.effect)
    return capitalized(f"{name} on {owner_name(step)}")


def owner_name(effect: EffectReport | CandidateReport | ChangeReport) -> str:
    """Joint or link of an effect, or what it acts on of the whole robot."""
    if effect.effect == COMMAND_DELAY:
        return "the controller"
    return target_name(effect.effect, effect.joint, effect.link)


def summary(report: DiagnosisReport) -> str:
    """The verdict in a few sentences.

    Parameters
    ----------
    report
        The content of diagnosis.json.
    """
    return " ".join([found_sentence(report), *remaining_sentences(report), *worse_motion_sentences(report)])


def found_sentence(report: DiagnosisReport) -> str:
    """The effects that were found, and how much of the disagreement they explain."""
    known_steps = _known_steps(report)
    unknown = _unknown_owners(report)
    unit = common_unit(report.units)
    which = "held-out" if report.before.validation else "training"
    first = number(_overall(report.before))
    last = number(_overall(report.after))
    floor = None if report.noise_floor["overall"] is None else number(report.noise_floor["overall"])
    floor_clause = "the noise floor is not known" if floor is None else f"the noise floor is {floor} {unit}"
    if report.verdict == "no_disagreement":
        return (
            f"Model and data agree: the {which} torque error, {first} {unit} RMS, cannot be distinguished from the "
            f"noise floor, {floor} {unit}, and nothing was added."
        )
    errors = f"the {which} torque error is {first} {unit} RMS, and {floor_clause}"
    if not known_steps:
        if report.stopped:
            return f"No effect was found: {errors}."
        if not unknown:  # and the noise floor is not known
            return f"It is not known whether model and data agree: {errors}."
        nothing = _no_effect_explains(report)
        if first == floor:
            return (
                f"The {which} torque error, {first} {unit} RMS, is at the noise floor, but {nothing} the structure of "
                f"the residual on {unknown}."
            )
        return f"Model and data disagree, and {nothing} the difference on {unknown}: {errors}."
    share = report.gap_closed["overall"]
    closed = f"; {floor_clause}"
    if share is not None:
        closed = f", which closes {100 * max(share, 0.0):.0f} % of the gap to the noise floor, {floor} {unit}"
    doubted = [step for step in known_steps if step.evidence.doubt]
    lacks = "may lack" if len(doubted) == len(known_steps) else "lacks"
    lacking = _join_words([_effect_or_rival(step) for step in known_steps])
    effects = "this effect" if len(known_steps) == 1 else "these effects"
    return (
        f"The original model {lacks} {lacking}: with {effects}, the {which} torque error goes from {first} to "
        f"{last} {unit} RMS{closed}."
    )


def remaining_sentences(report: DiagnosisReport) -> list[str]:
    """Sentences about what the effects found do not explain, and about doubtful ones."""
    sentences = []
    known_steps = _known_steps(report)
    unknown = _unknown_owners(report)
    if report.stopped:
        more = ", so more effects may be missing" if known_steps else ""
        sentences.append(f"The diagnosis is incomplete: {_outcome(report.stopped)}{more}.")
    elif known_steps and unknown:
        sentences.append(f"{capitalized(_no_effect_explains(report))} the remaining residual on {unknown}.")
    doubted = [_effect_on_owner(step) for step in known_steps if step.evidence.doubt]
    if doubted:
        sentences.append(f"Doubtful: {_join_words(doubted)}; the notices give the reasons.")
    return sentences


def worse_motion_sentences(report: DiagnosisReport) -> list[str]:
    """Steps after which the simulated motion is worse, in one sentence; empty if there are none."""
    worse = [_effect_on_owner(step) for step in _known_steps(report) if worse_motion(step)]
    if not worse:
        return []
    return [f"The simulated motion gets worse with {_join_words(worse)}{_final_motion(report)}."]


def _known_steps(report: DiagnosisReport) -> list[StepReport]:
    return [step for step in report.steps if step.effect != UNKNOWN]


def _unknown_owners(report: DiagnosisReport) -> str:
    """Joints with a residual that no effect explains."""
    return _join_words(owner_name(step) for step in report.steps if step.effect == UNKNOWN)


def _outcome(stopped: str) -> str:
    """Clause on the end of a search, without the details that the notices give."""
    return stopped.partition(":")[0]


def _no_effect_explains(report: DiagnosisReport) -> str:
    """Subject and verb of a clause on what the effects do not explain."""
    if report.searched is None:
        return "no known effect explains"
    if len(report.searched) == 1:
        return f"the only effect searched for, {effect_name(report.searched[0])}, does not explain"
    return "none of the effects searched for explains"


def worse_motion(step: StepReport) -> list[str]:
    """Joints whose simulated motion a step makes worse, although it predicts the torque better.

    The joint that the effect acts on, and ``overall``. Any other joint alone is left aside, since it moves with those.
    """
    return [name for name in step.evidence.rollout_worse if name in (step.joint, "overall")]


def worse_motion_sentence(step: StepReport, report: DiagnosisReport) -> str:
    """Errors of the simulated motion before and after a step that makes it worse, and those of the final model."""
    lengths = position_units(report.units)
    units = {**lengths, "overall": common_unit(lengths)}
    changes = []
    for name in worse_motion(step):
        before = _error(step.evidence.simulation_before, name)
        after = _error(step.evidence.simulation_after, name)
        final = _error(report.after.simulation, name)
        change = f"{_joint_words(name)} {number(before)} → {number(after)} {units[name]}"
        if final != after:
            change += f" (final model: {number(final)} {units[name]})"
        changes.append(change)
    return f"the simulated motion gets worse at this step: {', '.join(changes)}"


def _error(errors: ByJointOrNone | None, name: str) -> float | None:
    return errors[name] if errors else None


def _joint_words(name: str) -> str:
    return "all joints" if name == "overall" else name


def _final_motion(report: DiagnosisReport) -> str:
    """Clause that compares the simulated motion of the final model with the original one's; empty if not known."""
    if "overall" in report.rollout_worse:
        return ", and that of the final model is worse than that of the original one"
    first = _error(report.before.simulation, "overall")
    last = _error(report.after.simulation, "overall")
    if first is None or last is None or last >= first:
        return ""
    return ", but that of the final model is better than that of the original one"


def against_summary(report: AgainstReport, unit: str, floor: float | None, stopped: str) -> str:
    """The difference between robot and simulator in a sentence or two.

    Parameters
    ----------
    report
        The content of `against`.
    unit
        Unit of the torque of all joints.
    floor
        Noise floor of the robot's logs, over all joints; None: it is not known.
    stopped
        Reason why the search for effects ended before it was complete, a clause; empty if it was complete.
    """
    caution = ""
    if stopped:
        caution = f"The comparison is incomplete: {_outcome(stopped)}. "
    elif report.inconclusive:
        caution = f"The comparison is not conclusive: {report.inconclusive}. "
    before = report.torque_before["overall"]
    after = report.torque_after["overall"]
    if not report.changes:
        noise = "the noise floor is not known" if floor is None else f"the noise floor is {number(floor)} {unit}"
        return (
            f"{caution}No change to make in the simulator was found. The torque error of its model on the robot's "
            f"logs is {number(before)} {unit} RMS, and {noise}."
        )
    effects = [change for change in report.changes if change.effect != RIGID_BODY]
    bodies = [owner_name(change) for change in report.changes if change.effect == RIGID_BODY]
    differences = [_effect_on_owner(change) for change in effects]
    if bodies:
        links = "link" if len(bodies) == 1 else "links"
        differences.append(f"the inertia of the {links} ({', '.join(bodies)})")
    names = _join_words(differences)
    difference = f"{caution}Simulator and robot differ in {names}."
    if all(change.effect == COMMAND_DELAY for change in report.changes):  # which its torque error does not contain
        return f"{difference} The simulator's torque error on the robot's logs is {number(before)} {unit} RMS."
    changes = "this change" if len(report.changes) == 1 else "these changes"
    return (
        f"{difference} With {changes}, the simulator's torque error on the robot's logs goes from {number(before)} to "
        f"{number(after)} {unit} RMS."
    )


def is_correctable(fault: DataFault) -> bool:
    """True if a fault must be corrected, and can be, in the log or in the configuration, without a new recording."""
    if fault.undone or fault.fault in _ONLY_BY_RECORDING:
        return False
    return fault.joint is not None or fault.fault not in _ONLY_BY_RECORDING_ALL


def next_steps(report: DiagnosisReport, folder: Path | None = None) -> list[str]:
    """Suggested next steps, one sentence each.

    Parameters
    ----------
    report
        The content of diagnosis.json.
    folder
        Folder that the model is written to; None: it is not known.
    """
    steps = []
    out = Path("OUT") if folder is None else folder
    if any(is_correctable(fault) for fault in report.data_faults):
        steps.append(
            "First correct the data, or describe them correctly in the configuration, and then diagnose again."
        )
    for step in report.steps:
        if step.evidence.pair and step.alternatives:
            purpose = f"To distinguish {_effect_on_owner(step)} from {_effect_on_owner(step.alternatives[0])}"
            steps.append(f"{purpose}: {step.evidence.separate}")
    owners = [owner_name(step) for step in report.steps if step.effect == UNKNOWN]
    if owners and not report.stopped:
        steps.append(f"To find out what remains on {_join_words(owners)}, see {RESIDUAL_MAPS}.")
    if owners and report.inertia == "fixed" and report.against is None:
        steps.append("The inertia of the URDF was kept. If it may be wrong, diagnose with --inertia refit.")
    if report.against is not None and report.against.inconclusive:
        steps.append(report.against.advice)
    elif report.against is not None and report.against.changes and not report.stopped:
        command = shlex.join(["idtool", "export", str(out), "--patch", "FILE"])
        steps.append(
            f"Make the changes in the simulator: `{command}` writes a copy of its MJCF or URDF with those that the "
            "file can represent."
        )
    if report.stopped:
        steps.append("Diagnose again, and let the search finish.")
    is_usable = "overall" not in report.rollout_worse and report.verdict in ("explained", "no_disagreement")
    if is_usable and not steps:
        files = [str(out / "identified.urdf"), "LOG", "--config", str(out / "model.yaml")]
        command = shlex.join(["idtool", "validate", *files])
        steps.append(f"Check the final model on a log that was not used here: `{command}`.")
    return steps


def _overall(level: ErrorLevel) -> float | None:
    return level.torque["overall"]


def _effect_on_owner(effect: StepReport | CandidateReport | ChangeReport) -> str:
    name = effect_name(effect.effect)
    kind = effect_types().get(effect.effect, NamedEffect)
    article = ""
    if kind.is_countable:
        article = "an " if name[0] in "aeiou" else "a "
    return f"{article}{name} on {owner_name(effect)}"


def _effect_or_rival(step: StepReport) -> str:
    """The effect of a step, with the alternative that the data cannot distinguish from it."""
    text = _effect_on_owner(step)
    if step.evidence.assumed:
        text += " (assumed)"
    if step.evidence.pair and step.alternatives:
        text += f" (or {_effect_on_owner(step.alternatives[0])})"
    return text


def _join_words(words: Iterable[str]) -> str:
    """Words as a list in a sentence, each once; empty for none."""
    distinct = list(dict.fromkeys(words))
    if len(distinct) < 2:
        return "".join(distinct)
    return f"{', '.join(distinct[:-1])} and {distinct[-1]}"
