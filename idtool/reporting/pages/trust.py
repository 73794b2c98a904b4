"""How far to trust a fit, of report.html: what each number rests on, base parameters, the logs side by side, bias."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from idtool.reporting.figures import between, interval_text, number
from idtool.reporting.pages.base import Sections
from idtool.reporting.results.diagnosis import DiagnosisReport
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
    MOST_COMPARED,
    MOST_ROWS,
    BaseParametersSection,
    BiasSection,
    RepeatabilitySection,
    compared_parameters,
    shown_logs,
)
from idtool.robot.inertia import PARAMETER_NAMES

RESTS = ("Source of each parameter", "trust.html")
BASE = BaseParametersSection()
LOGS = RepeatabilitySection()
BIAS = BiasSection()

_PARAMETERS = ("mass", *(name.replace("mc_", "m·c_") for name in PARAMETER_NAMES[1:]))
_MOST_BODIES = 80  # in words
_WIDEST = 10.0  # standard errors that a dot is drawn away from the middle
_REACH = 2.0  # standard errors that a bar reaches to either side of its dot
_NOTHING = 1e-4  # of a value
_ALONE = "prior only"

View = dict[str, Any]


def with_trust(sections: Sections, report: FitReport) -> Sections:
    """The sections, without those of which the report holds nothing."""
    needs = {RESTS: "base_parameters", BASE: "base_parameters", LOGS: "repeatability", BIAS: "bias"}
    return [section for section in sections if section not in needs or getattr(report, needs[section])]


def trust_view(report: FitReport | DiagnosisReport) -> View:
    """What the templates read of it, of bounded size; None where the report holds nothing.

    Parameters
    ----------
    report
        The content of report.json.
    """
    base = logs = bias = None
    if isinstance(report, FitReport):
        base, logs, bias = report.base_parameters, report.repeatability, report.bias
    return {
        "rests": _rests(report.bodies) if base else None,
        "compared": _compared(logs) if logs else None,
        "bias": _bias(bias) if bias else None,
        "rotors": _rotors(report.rotors),
        "undetermined": [
            f"{joint} {'Coulomb' if term == 'coulomb' else term}"
            for joint, friction in report.friction.items()
            for term in FrictionErrors.model_fields
            if getattr(friction, term) is not None and getattr(friction.standard_error, term) is None
        ],
    }


def _rests(bodies: Mapping[str, BodyReport]) -> View:
    """What the parameters of each body rest on, and how many on what."""
    asked = {name: body for name, body in bodies.items() if body.rests_on}
    shown = list(asked.items())[:_MOST_BODIES]
    return {
        "parameters": _PARAMETERS,
        "bodies": [_body(name, body) for name, body in shown],
        "hidden": len(asked) - len(shown),
        "on": Counter(source.on for body in asked.values() for source in body.rests_on or ()),
        "of": len(_PARAMETERS) * len(asked),
    }


def _body(name: str, body: BodyReport) -> View:
    """One body: a cell a parameter, and rows of those on which there is more to say than that the prior chose them."""
    rows, alone = [], []
    sources = body.rests_on or ()
    for k, (parameter, source) in enumerate(zip(_PARAMETERS, sources, strict=True)):
        words = _words(source.text, name, parameter)
        value, ends = number(body.pi[k]), between(*(_settled(end, body.pi[k]) for end in source.range))
        if words == _ALONE and k and body.interval[k] is None:
            alone.append(f"{parameter} {value} ({ends})")
        else:
            rows.append((parameter, value, interval_text(body.interval[k]), ends, words))
    cells = [
        (round(100 * source.data), round(100 * source.constraints), sees)
        for source, sees in zip(sources, body.identifiable, strict=True)
    ]
    return {"name": name, "cells": cells, "rows": rows, "alone": alone}


def _settled(end: float | None, value: float) -> float | None:
    """An end of a range; zero where it is next to nothing beside the value, as a solver leaves it."""
    return 0.0 if end is not None and abs(end) < _NOTHING * abs(value) else end


def _words(text: str, body: str, parameter: str) -> str:
    """What a parameter rests on, without its own name."""
    return text.removeprefix(f"{body} {parameter}: ")


def _rotors(rotors: Mapping[str, Mapping[str, ReflectedInertia]]) -> View:
    """The number of reflected inertias, and how many of them the data determine."""
    determined = [found.interval is not None for joints in rotors.values() for found in joints.values()]
    return {"of": len(determined), "determined": sum(determined)}


def _compared(logs: RepeatabilityReport) -> View:
    """Logs side by side: those parameters first that do not agree, then by how far they scatter."""
    shown = shown_logs(logs)
    told = compared_parameters(logs)
    dots = [_dots(p, shown) for p in told[:MOST_COMPARED]]
    far = max((abs(x) + half for row in dots for x, half in filter(None, row)), default=0.0)
    widest = min(max(math.ceil(far), math.ceil(_REACH) + 1), _WIDEST)
    rows = [{"name": p.name, "dots": [_place(dot, widest) for dot in row]} for p, row in zip(told, dots, strict=False)]
    return {
        "logs": [logs.logs[k] for k in shown],
        "hidden_logs": len(logs.logs) - len(shown),
        "rows": rows,
        "hidden": len(told) - len(rows),
        "single": len(logs.parameters) - len(told),
        "differ": sum(not p.agrees for p in logs.parameters),
        "of": len(logs.parameters),
        "widest": widest,
        "middle": round(100 * _REACH / widest, 1),
    }


def _dots(p: RepeatedParameter, shown: Iterable[int]) -> list[tuple[float, float] | None]:
    """Where each log's value lies from their weighted mean, and how far its interval reaches, in standard errors.

    The standard error is the root mean square of the logs'. None where a log does not determine the parameter.
    """
    value = np.array([np.nan if x is None else x for x in p.value])
    error = np.array([np.nan if x is None else x for x in p.standard_error])
    known = np.isfinite(error)
    unit = float(np.sqrt(np.mean(np.square(error[known]))))
    weights = 1 / np.square(np.maximum(error[known], 1e-9 * unit)) if unit else np.ones(known.sum())
    mean = float(np.average(value[known], weights=weights))
    unit = unit or 1.0
    return [(float((value[k] - mean) / unit), float(_REACH * error[k] / unit)) if known[k] else None for k in shown]


def _place(dot: tuple[float, float] | None, widest: float) -> tuple[float, float] | None:
    """Middle and half of the width of a bar, in percent of the axis; beyond its end at its end."""
    if dot is None:
        return None
    x, half = dot
    return round(50 + 50 * min(max(x / widest, -1), 1), 1), round(50 * half / widest, 1)


def _bias(bias: BiasReport) -> View:
    """How many of the estimates differ, and how many are not shown."""
    of = len(bias.parameters)
    return {"hidden": max(of - MOST_ROWS, 0), "differ": sum(p.differs for p in bias.parameters), "of": of}
