"""The record of a comparison of two results, and its answer in a sentence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from idtool.common.names import count_text, join_names
from idtool.common.notice import Notice
from idtool.common.number_text import with_error
from idtool.estimation.uncertainty.welch import FALSE_DISCOVERIES
from idtool.reporting.compared_parameters import (
    OTHER_COMBINATION,
    compare_parameters,
    deciding,
    p_limit,
    relative_sensitivity,
)
from idtool.reporting.compared_settings import changed_settings, shared_logs
from idtool.reporting.number_text import percent
from idtool.reporting.results.base import notice_fields, provenance_fields
from idtool.reporting.results.comparison import (
    Answer,
    BodyValues,
    ComparedBody,
    ComparedParameter,
    ComparedResult,
    ComparedValue,
    ComparisonReport,
)
from idtool.reporting.results.fit import FitReport
from idtool.reporting.stored_fit import StoredFit
from idtool.reporting.verdict import LEVEL_TEXTS

# Codes of notices about a fit by which its estimates are off by more than their standard errors say.
_DOUBTS = ("logs_disagree", "biased_parameters", "correlated_residual", "few_blocks", "duplicate_data")
_DUPLICATE = 0.01  # standard errors, by which estimates from the same data may differ


def compare_report(a: StoredFit, b: StoredFit) -> ComparisonReport:
    """The content of comparison.json.

    Parameters
    ----------
    a, b
        The results.
    """
    parameters = compare_parameters(a.report, b.report)
    about = deciding(parameters)
    compared = [p for p in about if p.differs is not None]
    in_both_models = [p for p in about if p.a is not None and p.b is not None]
    differing = [p for p in compared if p.differs]
    in_both = [name for name in a.report.joints if name in b.report.joints]
    only_in_a = [name for name in a.report.joints if name not in b.report.joints]
    only_in_b = [name for name in b.report.joints if name not in a.report.joints]
    logs_in_both = shared_logs(a.report, b.report)
    sensitivity = relative_sensitivity(compared)
    answer: Answer = "unknown"
    if compared:
        answer = "differ" if differing else "agree"
    summary = _joints_text(only_in_a, only_in_b)
    summary += _answer_text(compared, differing, sensitivity, bool(logs_in_both), is_same_robot=not summary)
    return ComparisonReport(
        **provenance_fields([*a.sources, *b.sources]),
        answer=answer,
        summary=summary,
        compared=len(compared),
        differing=len(differing),
        not_compared=len(in_both_models) - len(compared),
        false_discoveries=FALSE_DISCOVERIES,
        p_limit=p_limit(parameters),
        detectable=sensitivity,
        same_logs=bool(logs_in_both),
        joints=in_both,
        joints_only_in_a=only_in_a,
        joints_only_in_b=only_in_b,
        a=_compared_result(a),
        b=_compared_result(b),
        parameters=parameters,
        bodies=_compared_bodies(a.report, b.report),
        settings=changed_settings(a, b),
        logs_in_both=logs_in_both,
        **notice_fields(_notices(a, b, about, logs_in_both)),
    )


def _compared_result(result: StoredFit) -> ComparedResult:
    """One of the two results."""
    report = result.report
    base = report.base_parameters
    return ComparedResult(
        report=result.path,
        idtool=report.idtool,
        versions=report.versions,
        verdict=report.verdict,
        verdict_reasons=report.verdict_reasons,
        urdf=report.urdf,
        logs=report.logs,
        joints=report.joints,
        units=report.units,
        samples=report.samples,
        band_hz=report.band_hz,
        held_out=report.rms.validation is not None,
        rms=report.rms.validation or report.rms.train,
        nrms=report.nrms,
        noise_floor=report.noise_floor,
        simulation=report.simulation,
        friction=report.friction,
        determined=base.determined if base else None,
    )


def _compared_bodies(a: FitReport, b: FitReport) -> dict[str, ComparedBody]:
    """Masses, centres and inertias of the bodies of both results."""
    names = dict.fromkeys([*a.bodies, *b.bodies])
    return {name: ComparedBody(a=_body_values(a, name), b=_body_values(b, name)) for name in names}


def _body_values(report: FitReport, name: str) -> BodyValues | None:
    body = report.bodies.get(name)
    if body is None:
        return None
    return BodyValues(mass=body.mass, com=body.com.tolist(), inertia_com=body.inertia_com.tolist())


def _joints_text(only_in_a: Sequence[str], only_in_b: Sequence[str]) -> str:
    """Sentence about joints that only one of the robots has; empty if both have the same."""
    parts = [f"only {name} has {join_names(joints)}" for name, joints in (("A", only_in_a), ("B", only_in_b)) if joints]
    if not parts:
        return ""
    return f"Not the same joints: {', '.join(parts)}. "


def _answer_text(
    compared: Sequence[ComparedParameter],
    differing: Sequence[ComparedParameter],
    sensitivity: float | None,
    has_same_logs: bool,
    is_same_robot: bool,
) -> str:
    """The answer as a sentence, with its figures."""
    if not compared:
        return "It cannot be told whether these are the same: no parameter is determined by the data of both."
    if differing:
        return _difference_text(compared, differing, has_same_logs, is_same_robot)
    if max(map(_distance, compared)) < _DUPLICATE:
        source = ", from the same logs" if has_same_logs else ""
        return f"The same estimates{source}: all {_compared_text(compared)} are equal."
    return _agreement_text(compared, sensitivity, is_same_robot)


def _difference_text(
    compared: Sequence[ComparedParameter],
    differing: Sequence[ComparedParameter],
    has_same_logs: bool,
    is_same_robot: bool,
) -> str:
    """Sentence on what differs: how many parameters, what they have in common, and the clearest of them."""
    verdict = "Not the same"
    if has_same_logs:
        verdict = "Not the same model, though a log is part of both"
    elif not is_same_robot:
        verdict = "What they have in common is not the same"
    verb = "differs" if len(differing) == 1 else "differ"
    owners = _common_owners(differing, compared)
    common = f", all of which involve {join_names(owners)}" if owners else ""
    clearest = max(differing, key=_distance)
    return (
        f"{verdict}: {len(differing)} of {_compared_text(compared)} {verb} by more than chance{common}; "
        f"most clearly {parameter_name(clearest)}: {_values_text(clearest)}."
    )


def _agreement_text(compared: Sequence[ComparedParameter], sensitivity: float | None, is_same_robot: bool) -> str:
    """Sentence on results that agree, and how large a difference could have been seen."""
    verdict = "The same, as far as the data tell"
    if not is_same_robot:
        verdict = "What they have in common is the same, as far as the data tell"
    visible = ""
    if sensitivity is not None:
        visible = f"; a difference of {percent(sensitivity)} in one of them would have an even chance to be seen"
    return f"{verdict}: none of {_compared_text(compared)} differs by more than chance{visible}."


def _compared_text(compared: Sequence[ComparedParameter]) -> str:
    """Number of the parameters that the answer is about, in words."""
    return f"{len(compared)} parameters that the data of both determine"


def _distance(p: ComparedParameter) -> float:
    """Size of the difference in standard errors."""
    return abs(p.difference_in_errors or 0.0)


def _common_owners(differing: Sequence[ComparedParameter], compared: Sequence[ComparedParameter]) -> list[str]:
    """Bodies and joints in all of several parameters that differ, but in fewer than half of those compared."""
    if len(differing) < 2:
        return []
    common = []
    for owner in differing[0].owners:
        involved = [p for p in compared if owner in p.owners]
        is_in_all = all(owner in p.owners for p in differing)
        if is_in_all and 2 * len(involved) < len(compared):
            common.append(owner)
    return common


def parameter_name(p: ComparedParameter) -> str:
    """Name of a parameter in words."""
    return p.of if p.kind == "base" else f"{p.of} {p.what}"


def _values_text(p: ComparedParameter) -> str:
    """Both estimates of a parameter, in words."""
    texts = [f"{_estimate_text(value)} {p.unit} in {name}" for name, value in (("A", p.a), ("B", p.b)) if value]
    return ", ".join(texts)


def _estimate_text(value: ComparedValue) -> str:
    return " ± ".join(with_error(value.estimate, value.standard_error))


def _notices(
    a: StoredFit, b: StoredFit, about: Sequence[ComparedParameter], logs_in_both: Sequence[str]
) -> Iterator[Notice]:
    """Notices about what limits the comparison."""
    if logs_in_both:
        message = f"logs in both: {join_names(logs_in_both)}; the results are not independent"
        advice = "a difference comes from the settings, the URDF or the other logs, hardly from the robot"
        yield Notice("not_independent", "warning", None, message, advice)
    for name, result in (("A", a), ("B", b)):
        report = result.report
        if report.verdict == "do_not_use":
            message = f"the verdict is: {LEVEL_TEXTS[report.verdict]}; its parameters say little about the robot"
            yield Notice("compared_unusable", "warning", name, message)
        if report.base_parameters is None:
            message = "it was fitted with --quick: what its data determine in combination is not compared"
            yield Notice("compared_quick", "warning", name, message, "fit again without --quick")
        for notice in report.notices:
            if notice.code in _DOUBTS:
                advice = "the comparison relies on the standard errors of A and B"
                yield Notice("compared_doubtful", "warning", name, notice.message, advice)
        if report.fleet is not None:
            message = "it is a fleet: its friction is the mean of the robots"
            yield Notice("compared_fleet", "note", name, message)
    if a.report.base_parameters and b.report.base_parameters and a.report.joints == b.report.joints:
        of_models = [p for p in about if p.kind != "controller"]  # a delay in one result alone says nothing of geometry
        others = [p for p in of_models if p.a is None or p.b is None or p.reason.startswith(OTHER_COMBINATION)]
        if others:
            count = count_text(len(others), "parameter")
            message = f"the models differ in geometry or in their terms: {count} without counterpart"
            advice = "the difference of another parameter may come from this, not from the robot"
            yield Notice("combinations_differ", "warning", None, message, advice)
    if any(p.differs for p in about):
        message = "the standard errors contain noise only: effects that a model lacks move its parameters, too"
        advice = (
            "idtool validate B/identified.urdf LOG --prior A/identified.urdf shows what the differences mean in torque"
        )
        yield Notice("difference_not_explained", "warning", None, message, advice)
    for name, result in (("A", a), ("B", b)):
        if result.config is None:
            message = "there is no model.yaml beside the report, so that configurations are not compared"
            yield Notice("no_configuration", "note", name, message)
