"""Doubts about effects that the data do not confirm."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from idtool.common.notice import Notice
from idtool.diagnosis.confirmation import contradiction
from idtool.diagnosis.error_summary import increases_error
from idtool.diagnosis.records import DiagnosisStep
from idtool.dynamics.effects import effect_name

_MIN_SIGNIFICANCE = 3.0  # ratio of a gain to its standard error by the scatter over blocks of time
_MIN_SHARE = 0.75  # of its joint's squared residual above the noise, explained by an effect of less significance


def doubt_about(
    step: DiagnosisStep,
    units: Mapping[str, str],
    floor: Mapping[str, float],
    remaining: Mapping[str, float],
    faults: Iterable[Notice],
) -> str:
    """Reason to doubt the effect of a step, a plain sentence; empty if there is none.

    Parameters
    ----------
    step
        The step, with the size of its effect on parts of the data.
    units
        Unit of each parameter of its effect.
    floor, remaining
        Noise floor, and error with all effects, by joint and ``overall`` [N·m or N].
    faults
        Faults of the data.
    """
    for fault in faults:
        if fault.severity == "problem":
            what = fault.code.replace("_", " ")
            where = f" on {fault.subject}" if fault.subject else ""
            return f"{step.chosen.words} may imitate a fault of the data: {what}{where}"

    clause = contradiction(step.parts, units)
    if clause:
        return f"{step.chosen.words} is not the same everywhere in the data: {clause}; something else may be behind it"

    if increases_error(step.before, step.after):
        where = "on the held-out data " if step.before.validation is not None else ""
        return (
            f"{step.chosen.words} increases the error {where}in this step; it lowers the "
            "error only together with other effects, or away from reversals of the velocity, where the direction of "
            "friction is certain"
        )

    joint = step.chosen.joint or "overall"
    explained = max(step.before.torque[joint] ** 2 - step.after.torque[joint] ** 2, 0.0)
    above_floor = max(step.before.torque[joint] ** 2 - floor[joint] ** 2, explained)
    explained_share = explained / above_floor if above_floor else 0.0
    share = max(step.chosen.score, explained_share)  # the score is of the first order
    if step.significance < _MIN_SIGNIFICANCE and share < _MIN_SHARE:
        return (
            f"{step.chosen.words} explains {100 * share:.0f} % of the mean square residual above the noise "
            "floor, and most of that in a few parts of the data, so something else may be behind it"
        )

    unexplained = remaining[joint] ** 2 - floor[joint] ** 2
    if explained >= unexplained:
        return ""
    share = explained / (explained + unexplained)
    where = step.chosen.joint or "all joints"
    return (
        f"{effect_name(step.chosen.effect)} explains {100 * share:.0f} % of the mean square residual of {where} above "
        "the noise floor; the rest remains unexplained, so something else may be behind both"
    )
