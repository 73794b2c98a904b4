"""The parameters of two results, side by side, and whether they differ by more than chance.

What is compared are the estimates from the data alone, without prior and constraints, each with its own standard error:
Welch's test for independent estimates. Of effects and of the whole robot, a report has only the value in the model,
which a prior may have moved. A report has the value in the model and an interval that covers this value and
the estimate by the same margin (`UncertaintyAnalysis.interval`); estimate and margin follow from these.

The answer is about the base parameters, since a single parameter of a body is seldom determined. Their p-values set the
limit, by the rate of false discoveries, that all other parameters are held against, too.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from typing import Literal

import numpy as np
from scipy.special import ndtri, stdtridf, stdtrit

from idtool.common.dataclass import dataclass
from idtool.common.units import INERTIA_UNITS, friction_units
from idtool.dynamics.effects import effect_name, target_name
from idtool.estimation.uncertainty.standard_errors import CONFIDENCE
from idtool.estimation.uncertainty.welch import FALSE_DISCOVERIES, significant_differences, welch_p_values
from idtool.reporting.results.comparison import ComparedParameter, ComparedValue, ParameterKind
from idtool.reporting.results.fit import BaseParameter, EffectReport, FitReport, FrictionErrors
from idtool.robot.inertia import PARAMETER_NAMES, PARAMETER_UNITS

OTHER_COMBINATION = "another combination"
_QUANTILE = 0.5 + CONFIDENCE / 2
_NORMAL_HALF_WIDTH = 1.96  # of an interval, in standard errors that are known exactly
_FACTOR_TOLERANCE = 1e-3  # relative, within which the factors of the same base parameter agree
_CLEARLY_NOT_ZERO = 3.0  # standard errors
_MAX_NUMBER = 1e60  # beyond which squares of estimates, or of their ratios to errors, overflow
_MAX_ITEMS = 100  # of a parameter that is a list

InformationSource = Literal["data", "combination", "constraints", "prior"]
Key = tuple[ParameterKind, str, str]


@dataclass(frozen=True)
class Parameter:
    """A parameter of one result.

    Attributes
    ----------
    name
        Its owner, or a base parameter as text.
    unit
        Its unit.
    value
        As it is reported.
    freedom
        Degrees of freedom of its standard error.
    terms
        Of a base parameter, the factor of each coefficient; None: it is none.
    """

    name: str
    unit: str
    value: ComparedValue
    freedom: float
    terms: Mapping[tuple[str, str], float] | None = None


def compare_parameters(a: FitReport, b: FitReport) -> list[ComparedParameter]:
    """All parameters of two results, those of the same kind in the order of the first.

    Parameters
    ----------
    a, b
        The results.
    """
    in_a, in_b = _parameters(a), _parameters(b)
    names = {key: parameter for parameters in (in_b, in_a) for key, parameter in parameters.items()}
    order = list(dict.fromkeys([*in_a, *in_b]))
    compared = [_paired(key, names[key], in_a.get(key), in_b.get(key)) for key in order]
    limit = p_limit(compared)
    results = []
    for parameter in compared:
        differs = None if parameter.p_value is None else limit is not None and parameter.p_value <= limit
        results.append(parameter.model_copy(update={"differs": differs}))
    return results


def deciding(parameters: Sequence[ComparedParameter]) -> list[ComparedParameter]:
    """Parameters that the answer is about: the base parameters and the controller's, or all if none is compared.

    Parameters
    ----------
    parameters
        All parameters.
    """
    has_base = any(p.kind == "base" and p.p_value is not None for p in parameters)
    return [p for p in parameters if not has_base or p.kind in ("base", "controller")]


def p_limit(parameters: Sequence[ComparedParameter]) -> float | None:
    """Largest p-value of those that differ by more than chance; None if none does.

    Parameters
    ----------
    parameters
        All parameters.
    """
    tested = np.array([p.p_value for p in deciding(parameters) if p.p_value is not None])
    significant = tested[significant_differences(tested)]
    return float(significant.max()) if len(significant) else None


def _paired(key: Key, named: Parameter, a: Parameter | None, b: Parameter | None) -> ComparedParameter:
    """A parameter of both results with the difference and its p-value; one of them gives name and unit."""
    kind, owner, what = key
    reason = _reason(a, b)
    difference = error = p_value = None
    if not reason and a is not None and b is not None:
        estimates = np.array([[a.value.estimate, b.value.estimate]], dtype=float)
        errors = np.array([[a.value.standard_error, b.value.standard_error]], dtype=float)
        difference = float(estimates[0, 1] - estimates[0, 0])
        error = float(np.hypot(*errors[0]))
        p_value = float(welch_p_values(estimates, errors, np.array([[a.freedom, b.freedom]]))[0])
    return ComparedParameter(
        kind=kind,
        of=named.name if kind == "base" else owner,
        what=what,
        owners=(owner,) if named.terms is None else tuple(dict.fromkeys(term[0] for term in named.terms)),
        unit=named.unit,
        a=a.value if a else None,
        b=b.value if b else None,
        difference=difference,
        standard_error=error,
        p_value=p_value,
        differs=None,
        reason=reason,
    )


def _reason(a: Parameter | None, b: Parameter | None) -> str:
    """Why a difference cannot be told from chance; empty if it can."""
    if a is None or b is None:
        return f"not in {'A' if a is None else 'B'}"
    if not _is_same_combination(a, b):
        return f"{OTHER_COMBINATION} in B"
    sources = {name: _main_source(parameter.value) for name, parameter in (("A", a), ("B", b))}
    others = {name: source for name, source in sources.items() if source != "data"}
    if not others:
        return ""
    if sources["A"] == sources["B"]:
        return f"{sources['A']} in A and B"
    return ", ".join(f"{source} in {name}" for name, source in others.items())


def _main_source(value: ComparedValue) -> str:
    """Sources that a value rests on, in words; ``data`` if it can be compared."""
    if value.rests_on in ("prior", "constraints"):
        return f"rests on the {value.rests_on}"
    if value.rests_on == "combination":
        return "known only in a combination"
    if value.estimate is None:
        return "given, or not determined by the data"
    return "data"


def _is_same_combination(a: Parameter, b: Parameter) -> bool:
    """True if two base parameters have the same terms; of other parameters always."""
    if a.terms is None or b.terms is None:
        return True
    if a.terms.keys() != b.terms.keys():
        return False
    return all(math.isclose(share, b.terms[term], rel_tol=_FACTOR_TOLERANCE) for term, share in a.terms.items())


def _parameters(report: FitReport) -> dict[Key, Parameter]:
    """All parameters of a result; those with the same key, as of two end stops of a joint, are numbered."""
    factors = _ErrorFactors(report)
    parameters: dict[Key, Parameter] = {}
    for collect in (_base_parameters, _body_parameters, _friction, _rotors, _effects, _whole_robot, _controller):
        for key, parameter in collect(report, factors):
            parameters[_numbered(key, parameters)] = parameter
    return parameters


def _numbered(key: Key, taken: Container[Key]) -> Key:
    """The key itself, or the first with a number behind the parameter's name that is not taken."""
    kind, owner, what = key
    number = 2
    while key in taken:
        key = (kind, owner, f"{what} ({number})")
        number += 1
    return key


class _ErrorFactors:
    """Factors by which the logs of a result scatter more than their standard errors predict, at least 1.

    Parameters
    ----------
    report
        The result; without a comparison of its logs, all factors are 1.

    Attributes
    ----------
    overall
        Factor of all base parameters together, rms.
    of_base
        Factor of each base parameter.
    """

    def __init__(self, report: FitReport) -> None:
        ratios = [p.ratio for p in report.repeatability.parameters] if report.repeatability else []
        known = [min(ratio, _MAX_NUMBER) for ratio in ratios if ratio is not None]
        self.overall = _error_factor(math.sqrt(np.square(known).mean())) if known else 1.0
        base = report.base_parameters.parameters if report.base_parameters else ()
        self.of_base = [self.overall] * len(base)
        if len(ratios) == len(base):  # else they are of other combinations
            self.of_base = [self.overall if ratio is None else _error_factor(ratio) for ratio in ratios]
        self._by_coefficient: dict[tuple[str, str], float] = {}
        for parameter, factor in zip(base, self.of_base, strict=True):
            if len(parameter.terms) == 1:
                (term,) = parameter.terms
                self._by_coefficient[term.of, term.what] = factor

    def of(self, owner: str, what: str) -> float:
        """The factor of a coefficient: that of the base parameter that it is, or else of all together."""
        return self._by_coefficient.get((owner, what), self.overall)


def _error_factor(scatter_ratio: float) -> float:
    """Factor of standard errors by a scatter ratio: never below 1, and never so large that squares overflow."""
    return min(max(scatter_ratio, 1.0), _MAX_NUMBER)


def _with_interval(
    name: str,
    unit: str,
    value: float,
    error: float | None,
    interval: tuple[float, float] | None,
    factor: float,
    rests_on: InformationSource | None = None,
    terms: Mapping[tuple[str, str], float] | None = None,
) -> Parameter:
    """A parameter with its estimate from the data alone; without one if error or interval cannot be reckoned with."""
    estimate = None
    freedom = math.inf
    is_usable = all(abs(end) < _MAX_NUMBER for end in (value, *(interval or ())))
    if error is not None and interval is not None and _is_error(error) and is_usable:
        estimate, margin = _estimate_and_margin(value, interval)
        freedom = _degrees_of_freedom(margin / error)
        error *= factor
    else:
        error = interval = None
    compared = ComparedValue(value=value, estimate=estimate, standard_error=error, interval=interval, rests_on=rests_on)
    return Parameter(name=name, unit=unit, value=compared, freedom=freedom, terms=terms)


def _estimate_and_margin(value: float, interval: tuple[float, float]) -> tuple[float, float]:
    """Estimate from the data alone, and half the width of its own 95 % interval.

    The reported interval reaches from the lower of value and estimate to the higher, and by the margin beyond both:
    low + high = value + estimate, and high − low = |estimate − value| + 2 margin.
    """
    low, high = interval
    estimate = low + high - value
    margin = (high - low - abs(estimate - value)) / 2
    return estimate, margin


def _with_error(name: str, unit: str, value: float, error: float | None, freedom: float, factor: float) -> Parameter:
    """A parameter of which no interval is reported: its value in the model stands for the estimate from the data."""
    interval = None
    if error is not None and math.isfinite(error):
        half_width = float(stdtrit(freedom, _QUANTILE)) * error
        interval = value - half_width, value + half_width
    return _with_interval(name, unit, value, error, interval, factor)


def _is_error(error: float) -> bool:
    """True for a standard error that can be reckoned with; that of an exactly known value is 0."""
    return 1 / _MAX_NUMBER < error < _MAX_NUMBER


def _degrees_of_freedom(margin_in_errors: float) -> float:
    """Degrees of freedom of a standard error, from half the width of the 95 % interval in standard errors."""
    if margin_in_errors <= _NORMAL_HALF_WIDTH:
        return math.inf
    freedom = float(stdtridf(_QUANTILE, margin_in_errors))
    return max(freedom, 1.0) if math.isfinite(freedom) else math.inf


def _base_parameters(report: FitReport, factors: _ErrorFactors) -> Iterator[tuple[Key, Parameter]]:
    base: Iterable[BaseParameter] = report.base_parameters.parameters if report.base_parameters else ()
    for p, factor in zip(base, factors.of_base, strict=True):
        if p.terms:
            own = p.terms[0]
            terms = {(term.of, term.what): term.share for term in p.terms}
            parameter = _with_interval(p.name, p.unit, p.value, p.standard_error, p.interval, factor, terms=terms)
            yield ("base", own.of, own.what), parameter


def _body_parameters(report: FitReport, factors: _ErrorFactors) -> Iterator[tuple[Key, Parameter]]:
    for name, body in report.bodies.items():
        for i, (what, unit) in enumerate(zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)):
            yield (
                ("body", name, what),
                _with_interval(
                    name,
                    unit,
                    float(body.pi[i]),
                    float(body.standard_error[i]),
                    body.interval[i],
                    factors.of(name, what),
                    body.rests_on[i].on if body.rests_on else None,
                ),
            )


def _friction(report: FitReport, factors: _ErrorFactors) -> Iterator[tuple[Key, Parameter]]:
    for joint, friction in report.friction.items():
        intervals = report.friction_intervals.get(joint)
        viscous_unit, dry_unit = friction_units(report.units[joint])
        for term in FrictionErrors.model_fields:
            value = getattr(friction, term)
            if value is not None:
                error = getattr(friction.standard_error, term)
                interval = getattr(intervals, term) if intervals else None
                unit = viscous_unit if term == "viscous" else dry_unit
                parameter = _with_interval(joint, unit, value, error, interval, factors.of(joint, term))
                yield ("friction", joint, term), parameter


def _rotors(report: FitReport, factors: _ErrorFactors) -> Iterator[tuple[Key, Parameter]]:
    for rotor, joints in report.rotors.items():
        for joint, inertia in joints.items():
            unit = INERTIA_UNITS[report.units.get(joint, "N·m")]
            value, error, interval = inertia.reflected_inertia, inertia.standard_error, inertia.interval
            parameter = _with_interval(rotor, unit, value, error, interval, factors.overall)
            yield ("rotor", rotor, f"reflected inertia at {joint}"), parameter


def _effects(report: FitReport, factors: _ErrorFactors) -> Iterator[tuple[Key, Parameter]]:
    freedom = _report_freedom(report)
    for effect in sorted(report.effects, key=_given_then_identified):
        owner = f"{effect_name(effect.effect)} on {target_name(effect.effect, effect.joint, effect.link)}"
        for name, given in effect.parameters.items():
            errors = effect.standard_error.get(name)
            unit = effect.units.get(name) or ""
            for label, value, error in _numbers_of(name.replace("_", " "), given, errors):
                parameter = _with_error(owner, unit, value, error, freedom, factors.overall)
                yield ("effect", owner, label), parameter


def _given_then_identified(effect: EffectReport) -> tuple[list[float], list[float]]:
    """The numbers of an effect's given parameters, and of the identified ones.

    In their order, two end stops of a joint are the same two in each result, wherever their file has them.
    """
    given: list[float] = []
    identified: list[float] = []
    for name, values in effect.parameters.items():
        numbers = [value for _, value, _ in _numbers_of(name, values, None)]
        (given if effect.standard_error.get(name) is None else identified).extend(numbers)
    return given, identified


def _numbers_of(name: str, given: object, errors: object) -> Iterator[tuple[str, float, float | None]]:
    """The numbers of an effect's parameter, each with its name and standard error."""
    if isinstance(given, list | tuple):
        each = errors if isinstance(errors, list | tuple) and len(errors) == len(given) else [None] * len(given)
        for i, (value, error) in enumerate(zip(given[:_MAX_ITEMS], each[:_MAX_ITEMS], strict=True)):
            if isinstance(value, float | int):
                yield f"{name} [{i + 1}]", float(value), float(error) if isinstance(error, float | int) else None
    elif isinstance(given, float | int) and not isinstance(given, bool):
        yield name, float(given), float(errors) if isinstance(errors, float | int) else None


def _whole_robot(report: FitReport, factors: _ErrorFactors) -> Iterator[tuple[Key, Parameter]]:
    freedom = _report_freedom(report)
    robot = report.whole_robot
    if robot is not None:
        values = {"mass": (robot.mass, robot.mass_standard_error, "kg")}
        for axis, value, error in zip("xyz", robot.com.tolist(), robot.com_standard_error, strict=True):
            values[f"centre of mass, {axis}"] = value, error, "m"
        for what, (value, error, unit) in values.items():
            parameter = _with_error("whole robot", unit, value, error, freedom, factors.overall)
            yield ("whole_robot", "whole robot", what), parameter
    feet = report.foot_compliance
    if feet is not None:
        parameter = _with_error("feet", "m/N", feet.value, feet.standard_error, freedom, factors.overall)
        yield ("whole_robot", "feet", "compliance"), parameter


def _controller(report: FitReport, factors: _ErrorFactors) -> Iterator[tuple[Key, Parameter]]:
    controller = report.controller
    if controller is not None and controller.fitted is not None:
        freedom = _report_freedom(report)
        error = controller.standard_error
        parameter = _with_error("controller", "s", controller.fitted, error, freedom, factors.overall)
        yield ("controller", "controller", "delay"), parameter


def _report_freedom(report: FitReport) -> float:
    """Degrees of freedom of a standard error that is reported without an interval: one less than the blocks of time."""
    blocks = report.uncertainty.blocks
    return max(blocks - 1.0, 1.0) if blocks else math.inf


def relative_sensitivity(parameters: Sequence[ComparedParameter]) -> float | None:
    """Difference of one parameter that has an even chance to be found, relative to its estimate; None: not known.

    It is the median of the parameters that are clearly not zero. If all others agree, a p-value must be below the rate
    of false discoveries divided by the number of parameters.

    Parameters
    ----------
    parameters
        Those that are compared.
    """
    shares = []
    needed_p_value = FALSE_DISCOVERIES / max(len(parameters), 1)
    needed_errors = -float(ndtri(needed_p_value / 2))
    for p in parameters:
        sizes = [_size(value) for value in (p.a, p.b) if value is not None]
        size = max(sizes, default=0.0)
        if p.standard_error is not None and size:
            shares.append(needed_errors * p.standard_error / size)
    return float(np.median(shares)) if shares else None


def _size(value: ComparedValue) -> float:
    """Absolute value of an estimate; 0 if it is not clearly different from zero."""
    if value.estimate is None or value.standard_error is None:
        return 0.0
    size = abs(value.estimate)
    return size if size > _CLEARLY_NOT_ZERO * value.standard_error else 0.0
