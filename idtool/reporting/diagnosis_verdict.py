"""Verdict of a diagnosis: on the model with the effects that were found.

Torque, motion and bodies are judged like those of a fit, see `idtool.reporting.verdict`, and besides:

==========  ==================================================================================================
data        Do not use: a fault of the data makes all results meaningless.
effects     Good: model and data agree, or the effects found explain all of the disagreement. Torque only: part of it
            is not explained, the search was not complete, or an effect is doubtful.
motion      Torque only: rollouts are worse than those of the original model.
==========  ==================================================================================================
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

from idtool.common.notice import Notice
from idtool.common.number_text import number
from idtool.common.units import common_unit, position_units
from idtool.reporting.diagnosis_text import found_sentence, remaining_sentences, worse_motion_sentences
from idtool.reporting.number_text import percent
from idtool.reporting.results.diagnosis import DiagnosisReport
from idtool.reporting.results.verdict import VerdictLevel, VerdictReason
from idtool.reporting.verdict import problem_reasons


def diagnosis_reasons(
    report: DiagnosisReport, of_model: Sequence[VerdictReason], faults: Collection[Notice]
) -> tuple[VerdictReason, ...]:
    """Reasons of the verdict.

    Parameters
    ----------
    report
        The content of diagnosis.json, of the robot's logs by themselves.
    of_model
        Reasons of the fit of the model with the effects.
    faults
        Faults of the data.
    """
    reasons = [*problem_reasons(faults), *_effect_reasons(report)]
    for reason in of_model:
        if reason.about == "torque":
            reasons.append(_torque_reason(report, reason))
        elif reason.about == "motion":
            reasons += _motion_reasons(report, reason)
        elif reason.about != "data" or reason.level != "good":  # that all is determined was not asked
            reasons.append(reason)
    return tuple(reasons)


def _effect_reasons(report: DiagnosisReport) -> Iterator[VerdictReason]:
    """Reasons by the effects found, and by what they do not explain."""
    is_explained = report.verdict in ("explained", "no_disagreement")
    level: VerdictLevel = "good" if is_explained else "torque_only"
    share = report.gap_closed["overall"]
    yield VerdictReason(about="effects", level=level, figure=share, text=found_sentence(report))
    for sentence in remaining_sentences(report):
        yield VerdictReason(about="effects", level="torque_only", figure=None, text=sentence)


def _torque_reason(report: DiagnosisReport, of_model: VerdictReason) -> VerdictReason:
    """Reason by the torque error of the fit, without the figures of the effects' reason if it is in order."""
    if of_model.level == "do_not_use" or of_model.figure is None:
        return of_model
    where = "On held-out data" if report.after.validation else "On the data that the model was fitted to"
    text = f"{where}, the torque error is {percent(of_model.figure)} of the torque's standard deviation."
    return of_model.model_copy(update={"text": text})


def _motion_reasons(report: DiagnosisReport, of_model: VerdictReason) -> Iterator[VerdictReason]:
    """Reasons by the simulation: that of the fit, unless the original model is better, and steps that make it worse."""
    level = of_model.level
    before, after = report.before.simulation, report.after.simulation
    if "overall" in report.rollout_worse and before and after:
        level = "torque_only"
        unit = common_unit(position_units(report.units))
        yield VerdictReason(about="motion", level=level, figure=None, text=_worse_model_text(before, after, unit))
    else:
        yield of_model
    for sentence in worse_motion_sentences(report):
        yield VerdictReason(about="motion", level=level, figure=None, text=sentence)


def _worse_model_text(before: Mapping[str, float | None], after: Mapping[str, float | None], unit: str) -> str:
    """Sentence on a model that simulates worse than the original one, by their position errors [rad or m]."""
    original_error = f"{number(before['overall'])} {unit}"
    if after["overall"] is None:  # not finite
        return f"Do not simulate the model: it diverges, and the error of the original model is {original_error} RMS."
    return (
        f"Do not simulate the model: it is {number(after['overall'])} {unit} RMS from the measured position, and "
        f"the original model {original_error}."
    )
