"""Uncertainty in report.html: source of each parameter, base parameters, repeatability, bias."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from idtool.common.number_text import number, range_text
from idtool.reporting.number_text import interval_text
from idtool.reporting.pages.base import Sections
from idtool.reporting.results.fit import (
    BiasReport,
    BodyReport,
    FitReport,
    FrictionErrors,
    ReflectedInertia,
    RepeatabilityReport,
    RepeatedParameter,
)
from idtool.reporting.sections.uncertainty import (
    MAX_COMPARED,
    MAX_ROWS,
    BaseParametersSection,
    BiasSection,
    RepeatabilitySection,
    bias_distance,
    compared_parameters,
    shown_logs,
)
from idtool.robot.inertia import PARAMETER_NAMES

if TYPE_CHECKING:
    from idtool.reporting.results.diagnosis import DiagnosisReport

SOURCES = ("Source of each parameter", "trust.html")
BASE_PARAMETERS = BaseParametersSection()
REPEATABILITY = RepeatabilitySection()
BIAS = BiasSection()

_PARAMETERS = ("mass", *(name.replace("mc_", "m·c_") for name in PARAMETER_NAMES[1:]))
_MAX_BODIES = 80  # in words
_MAX_DEVIATION = 10.0  # standard errors that a dot is drawn away from the middle
_BAR_HALF_WIDTH = 2.0  # standard errors that a bar reaches to either side of its dot
_NEGLIGIBLE = 1e-4  # of a value
_PRIOR_ONLY = "prior only"

View = dict[str, Any]


def with_uncertainty(sections: Sections, report: FitReport) -> Sections:
    """The sections, without those of which the report holds nothing."""
    needs = {
        SOURCES: "base_parameters",
        BASE_PARAMETERS: "base_parameters",
        REPEATABILITY: "repeatability",
        BIAS: "bias",
    }
    return [section for section in sections if section not in needs or getattr(report, needs[section])]


def uncertainty_view(report: FitReport | DiagnosisReport) -> View:
    """Template variables of the uncertainty analysis, of bounded size; None where the report holds nothing.

    Parameters
    ----------
    report
        The content of report.json.
    """
    base = logs = bias = None
    if isinstance(report, FitReport):
        base, logs, bias = report.base_parameters, report.repeatability, report.bias
    undetermined = []
    for joint, friction in report.friction.items():
        for term in FrictionErrors.model_fields:
            if getattr(friction, term) is not None and getattr(friction.standard_error, term) is None:
                undetermined.append(f"{joint} {'Coulomb' if term == 'coulomb' else term}")
    return {
        "rests": _sources_view(report.bodies) if base else None,
        "compared": _repeatability_view(logs) if logs else None,
        "bias": _bias_view(bias) if bias else None,
        "rotors": _rotors_view(report.rotors),
        "undetermined": undetermined,
    }


def _sources_view(bodies: Mapping[str, BodyReport]) -> View:
    """Sources of each body's parameters, and the number of parameters by source."""
    analyzed = {name: body for name, body in bodies.items() if body.rests_on}
    shown = list(analyzed.items())[:_MAX_BODIES]
    counts: Counter[str] = Counter()
    for body in analyzed.values():
        counts.update(source.on for source in body.rests_on or ())
    return {
        "parameters": _PARAMETERS,
        "bodies": [_body_view(name, body) for name, body in shown],
        "hidden": len(analyzed) - len(shown),
        "on": counts,
        "of": len(_PARAMETERS) * len(analyzed),
    }


def _body_view(name: str, body: BodyReport) -> View:
    """One body: a cell for each parameter, and rows of those that not only the prior determines."""
    rows = []
    prior_only = []
    cells = []
    for k, (parameter, source) in enumerate(zip(_PARAMETERS, body.rests_on or (), strict=True)):
        text = _without_name(source.text, name, parameter)
        value = number(body.pi[k])
        low, high = source.range
        ends = range_text(_zero_if_negligible(low, body.pi[k]), _zero_if_negligible(high, body.pi[k]))
        if text == _PRIOR_ONLY and k and body.interval[k] is None:
            prior_only.append(f"{parameter} {value} ({ends})")
        else:
            rows.append((parameter, value, interval_text(body.interval[k]), ends, text))
        cells.append((round(100 * source.data), round(100 * source.constraints), body.identifiable[k]))
    return {"name": name, "cells": cells, "rows": rows, "alone": prior_only}


def _zero_if_negligible(end: float | None, value: float) -> float | None:
    """An end of a range; zero where it is next to nothing beside the value, as a solver leaves it."""
    if end is not None and abs(end) < _NEGLIGIBLE * abs(value):
        return 0.0
    return end


def _without_name(text: str, body: str, parameter: str) -> str:
    """The source of a parameter in words, without the parameter's name."""
    return text.removeprefix(f"{body} {parameter}: ")


def _rotors_view(rotors: Mapping[str, Mapping[str, ReflectedInertia]]) -> View:
    """The number of reflected inertias, and the number of those that the data determine."""
    inertias = [inertia for joints in rotors.values() for inertia in joints.values()]
    determined = [inertia for inertia in inertias if inertia.interval is not None]
    return {"of": len(inertias), "determined": len(determined)}


def _repeatability_view(logs: RepeatabilityReport) -> View:
    """Logs side by side: those parameters first that do not agree, then by how far they scatter."""
    shown = shown_logs(logs)
    compared = compared_parameters(logs)
    deviations = [_deviations(p, shown) for p in compared[:MAX_COMPARED]]
    farthest = 0.0
    for row in deviations:
        for dot in row:
            if dot is not None:
                deviation, half_width = dot
                farthest = max(farthest, abs(deviation) + half_width)
    widest = min(max(math.ceil(farthest), math.ceil(_BAR_HALF_WIDTH) + 1), _MAX_DEVIATION)
    rows = []
    for p, row in zip(compared, deviations, strict=False):
        rows.append({"name": p.name, "dots": [_axis_position(dot, widest) for dot in row]})
    return {
        "logs": [logs.logs[k] for k in shown],
        "hidden_logs": len(logs.logs) - len(shown),
        "rows": rows,
        "hidden": len(compared) - len(rows),
        "single": len(logs.parameters) - len(compared),
        "differ": sum(not p.agrees for p in logs.parameters),
        "of": len(logs.parameters),
        "largest": max((p.ratio for p in logs.parameters if p.ratio is not None), default=None),
        "widest": widest,
        "middle": round(100 * _BAR_HALF_WIDTH / widest, 1),
    }


def _deviations(p: RepeatedParameter, shown: Iterable[int]) -> list[tuple[float, float] | None]:
    """Deviation of each log's value from their weighted mean, and half its interval, in standard errors.

    The standard error is the root mean square of the logs'. None where a log does not determine the parameter.
    """
    value = np.array(p.value, dtype=float)
    error = np.array(p.standard_error, dtype=float)
    known = np.isfinite(error)
    unit = float(np.sqrt(np.mean(np.square(error[known]))))
    weights = np.ones(known.sum())
    if unit:
        weights = 1 / np.square(np.maximum(error[known], 1e-9 * unit))
    mean = float(np.average(value[known], weights=weights))
    unit = unit or 1.0
    deviations: list[tuple[float, float] | None] = []
    for k in shown:
        if known[k]:
            deviations.append((float((value[k] - mean) / unit), float(_BAR_HALF_WIDTH * error[k] / unit)))
        else:
            deviations.append(None)
    return deviations


def _axis_position(dot: tuple[float, float] | None, widest: float) -> tuple[float, float] | None:
    """Middle and half of the width of a bar, in percent of the axis; beyond its end at its end."""
    if dot is None:
        return None
    x, half = dot
    return round(50 + 50 * min(max(x / widest, -1), 1), 1), round(50 * half / widest, 1)


def _bias_view(bias: BiasReport) -> View:
    """The number of parameters, of those that differ, and of those that are not shown; the largest difference."""
    count = len(bias.parameters)
    return {
        "hidden": max(count - MAX_ROWS, 0),
        "differ": sum(p.differs for p in bias.parameters),
        "of": count,
        "largest": max(map(bias_distance, bias.parameters), default=None),
    }
