"""How far to trust a fit, of report.html: what each number rests on, base parameters, the logs side by side, bias."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from idtool.reporting.figures import number, with_error
from idtool.reporting.pages.base import Sections
from idtool.reporting.results.diagnosis import DiagnosisReport
from idtool.reporting.results.fit import (
    BaseParameter,
    BaseParameters,
    BiasParameter,
    BiasReport,
    BodyReport,
    FitReport,
    FrictionErrors,
    ReflectedInertia,
    RepeatabilityReport,
    RepeatedParameter,
)
from idtool.reporting.uncertainty_report import PULLED
from idtool.robot.inertia import PARAMETER_NAMES

RESTS = ("What each number rests on", "trust.html")
BASE = ("Base parameters", "base_parameters.html")
LOGS = ("Do the logs agree?", "repeatability.html")
BIAS = ("Least squares and instruments", "bias.html")

_PARAMETERS = ("mass", *(name.replace("mc_", "m·c_") for name in PARAMETER_NAMES[1:]))
_MOST_BODIES = 80  # in words
_MOST_ROWS = 60  # of a table of base parameters
_MOST_LOGS = 8  # side by side; as many colours there are
_MOST_COMPARED = 20  # parameters
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
        "base": _base(base) if base else None,
        "compared": _compared(logs) if logs else None,
        "bias": _bias(bias) if bias else None,
        "rotors": _rotors(report.rotors, report.units),
        "mass_interval": _mass_intervals(report.bodies),
        "undetermined": [
            f"{joint} {'Coulomb' if term == 'coulomb' else term}"
            for joint, friction in report.friction.items()
            for term in FrictionErrors.model_fields
            if getattr(friction, term) is not None and getattr(friction.standard_error, term) is None
        ],
    }


def between(low: float | None, high: float | None) -> str:
    """Two ends to two digits of the distance between them; None: no end."""
    if low is None or high is None:
        end = low if high is None else high
        return "any" if end is None else f"{number(end, 2)} or {'more' if high is None else 'less'}"
    width = high - low
    if abs(low + high) < 0.01 * width:
        return f"±{number(width / 2, 2)}"
    size = math.floor(math.log10(width)) if width > 0 else -9
    if not -5 < size < 6:
        return f"{number(low, 2)} to {number(high, 2)}"
    decimals = max(1 - size, 0)
    return " to ".join(f"{round(x, decimals) + 0.0:.{decimals}f}" for x in (low, high))


def _pair(ends: Sequence[float | None] | None) -> str:
    return "–" if ends is None else between(*ends)


def _mass_intervals(bodies: Mapping[str, BodyReport]) -> dict[str, str]:
    """The 95 % interval of each mass that the data determine."""
    found = {name: body.interval[0] for name, body in bodies.items()}
    return {name: _pair(ends) for name, ends in found.items() if ends is not None}


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
            rows.append((parameter, value, _pair(body.interval[k]), ends, words))
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


def _base(base: BaseParameters) -> View:
    """Base parameters: those held away from the data first, then those that these logs do not determine."""
    undetermined = [p for p in base.parameters if p.pull is None]
    pulled = [(p.pull, p) for p in base.parameters if p.pull is not None and p.pull > PULLED]
    groups = {
        f"Held more than {PULLED:g} standard errors away from what the data say": [
            p for _, p in sorted(pulled, key=lambda pair: -pair[0])
        ],
        "Not determined by these logs": undetermined,
        "As the data say": [p for p in base.parameters if p.pull is not None and p.pull <= PULLED],
    }
    left, tables = _MOST_ROWS, []
    for title, parameters in groups.items():
        if rows := [_base_row(p) for p in parameters[:left]]:
            tables.append((title, len(parameters), rows))
        left -= len(rows)
    return {"groups": tables, "hidden": len(base.parameters) - _MOST_ROWS + left}


def _base_row(p: BaseParameter) -> tuple[str, ...]:
    value, error = with_error(p.value, p.standard_error)
    return p.name, p.unit, value, error, _pair(p.interval), _tenths(p.pull)


def _tenths(x: float | None) -> str:
    return "–" if x is None else f"{x:.1f}"


def _rotors(rotors: Mapping[str, Mapping[str, ReflectedInertia]], units: Mapping[str, str]) -> View:
    """Reflected inertia: a row a rotor and joint, and how many the data determine."""
    rows = [
        (
            joint,
            rotor,
            *with_error(found.reflected_inertia, found.standard_error),
            _pair(found.interval),
            "kg" if units.get(joint) == "N" else "kg·m²",
        )
        for rotor, joints in rotors.items()
        for joint, found in joints.items()
    ]
    determined = [found.interval is not None for joints in rotors.values() for found in joints.values()]
    return {"rows": rows, "determined": sum(determined)}


def _compared(logs: RepeatabilityReport) -> View:
    """Logs side by side: those parameters first that do not agree, then by how far they scatter."""
    shown = _shown_logs(logs)
    order = sorted(logs.parameters, key=lambda p: (p.agrees, -(p.ratio or 0.0)))
    told = [p for p in order if sum(error is not None for error in p.standard_error) > 1]
    dots = [_dots(p, shown) for p in told[:_MOST_COMPARED]]
    far = max((abs(x) + half for row in dots for x, half in filter(None, row)), default=0.0)
    widest = min(max(math.ceil(far), math.ceil(_REACH) + 1), _WIDEST)
    rows = [
        {
            "name": p.name,
            "unit": p.unit,
            "agrees": p.agrees,
            "ratio": p.ratio,
            "dots": [_place(dot, widest) for dot in row],
            "values": [with_error(p.value[k], p.standard_error[k]) for k in shown],
        }
        for p, row in zip(told, dots, strict=False)
    ]
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
        "cross": [(logs.logs[i], [_cross(logs.cross_rms, i, k) for k in shown]) for i in shown],
    }


def _shown_logs(logs: RepeatabilityReport) -> list[int]:
    """The first logs, and the odd one among them."""
    shown = list(range(len(logs.logs)))[:_MOST_LOGS]
    odd = logs.odd_one_out
    place = logs.logs.index(odd) if odd is not None else 0
    return shown if place in shown else [*shown[:-1], place]


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


def _cross(errors: Sequence[Sequence[float]], fitted: int, on: int) -> tuple[str, bool]:
    """A model's error on a log, and whether it is half as much again as that of the log's own."""
    return number(errors[fitted][on]), errors[fitted][on] > 1.5 * errors[on][on]


def _bias(bias: BiasReport) -> View:
    """Both estimates: those that differ first, the most standard errors first."""

    def apart(p: BiasParameter) -> float:
        return abs(p.iv - p.ls) / p.standard_error if p.standard_error else 0.0

    order = sorted(bias.parameters, key=lambda p: (not p.differs, -apart(p)))
    rows = [{**p.model_dump(), "apart": with_error(p.iv - p.ls, p.standard_error)} for p in order[:_MOST_ROWS]]
    differ = sum(p.differs for p in order)
    return {"rows": rows, "hidden": len(order) - len(rows), "differ": differ, "of": len(order)}
