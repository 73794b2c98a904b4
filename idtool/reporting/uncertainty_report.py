"""The records of the uncertainty analysis: sources of parameters, base parameters, repeatability, bias."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.number_text import short_number
from idtool.dynamics.effects.effect import Coefficient
from idtool.estimation.fit import Fit
from idtool.estimation.uncertainty.base_parameters import BaseParameters
from idtool.estimation.uncertainty.bias import BiasCheck
from idtool.estimation.uncertainty.identifiability import Identifiability, InformationShares, combination
from idtool.estimation.uncertainty.repeatability import Repeatability
from idtool.reporting.results.base import CombinationTerm
from idtool.reporting.results.fit import (
    BaseParameter,
    BaseParametersResult,
    BiasParameter,
    BiasReport,
    ControllerDelay,
    ControllerGainsReport,
    CorrelatedParameter,
    ParameterSource,
    ReflectedInertia,
    RepeatabilityReport,
    RepeatedParameter,
    UncertaintyReport,
)
from idtool.robot.inertia import PARAMETER_WORDS, PI_SIZE

_MAX_NAME_TERMS = 4  # terms of a combination that its name holds
MAX_PULL = 3.0  # standard errors from what the data say, at which prior or constraints are said to hold a number


def coefficient_name(coefficient: Coefficient) -> str:
    """Name of a coefficient: its owner and the quantity."""
    return f"{coefficient.owner} {PARAMETER_WORDS.get(coefficient.name, coefficient.name)}"


def combination_name(base: BaseParameters, i: int, coefficients: Sequence[Coefficient]) -> str:
    """A base parameter in words: ``thigh I_xx − thigh I_zz + 0.117 shank mass``."""
    terms = combination(base, i, coefficients)
    name = ""
    for k, share in terms[:_MAX_NAME_TERMS]:
        factor = "" if np.isclose(abs(share), 1) else f"{short_number(abs(share))} "
        minus, plus = (" − ", " + ") if name else ("−", "")
        sign = minus if share < 0 else plus
        name += f"{sign}{factor}{coefficient_name(coefficients[k])}"
    if len(terms) > _MAX_NAME_TERMS:
        name += " + …"
    return name


def terms_report(base: BaseParameters, i: int, coefficients: Sequence[Coefficient]) -> list[CombinationTerm]:
    """The terms of a base parameter."""
    terms = combination(base, i, coefficients)
    return [CombinationTerm(of=coefficients[k].owner, what=coefficients[k].name, share=share) for k, share in terms]


def uncertainty_report(fit: Fit) -> UncertaintyReport:
    """The entry ``uncertainty`` of report.json."""
    analysis = fit.uncertainty_analysis
    joints = fit.experiment.equation.joints
    robust = analysis.cluster_robust
    prediction = analysis.prediction
    return UncertaintyReport(
        confidence=0.95,
        blocks=robust.cluster_count if robust.bootstrap else 0,
        block_seconds=robust.cluster_seconds,
        correlated_beyond_blocks=robust.correlated_beyond_clusters,
        bootstrap_ratio=robust.bootstrap_ratio,
        independent_samples={name: analysis.independent[name] for name in joints},
        torque_standard_error=_by_joint(joints, prediction.rms),
        torque_standard_error_largest=_by_joint(joints, prediction.largest),
        torque_undetermined=_by_joint(joints, prediction.unknown),
    )


def controller_report(fit: Fit) -> ControllerDelay | None:
    """The entry ``controller`` of report.json; None where no torque comes from a command."""
    experiment = fit.experiment
    controller = experiment.config.controller
    if controller is None or not experiment.has_commands:
        return None
    delay = controller.known_delay
    fitted = fit.delay
    given = delay if fitted is None else fitted.given
    is_determined = fitted is not None and fitted.standard_error is not None
    return ControllerDelay(
        delay=delay.value if delay else 0.0,
        given=given.value if given else None,
        fitted=fitted.value if fitted and is_determined else None,
        standard_error=fitted.standard_error if fitted else None,
        known_friction_standard_error=fitted.known_friction_error if fitted else None,
        correlation=fitted.correlation if fitted and is_determined else None,
        contradicted=fitted.contradicted if fitted else None,
        text=fitted.text if fitted else None,
    )


def controller_gains_report(fit: Fit) -> dict[str, ControllerGainsReport]:
    """The entry ``controller_gains`` of report.json."""
    gains = fit.gains
    if gains is None:
        return {}
    reports = {}
    for joint, source in gains.scale_sources.items():
        kp, kd = gains.kp.get(joint), gains.kd.get(joint)
        reports[joint] = ControllerGainsReport(
            kp=kp.value if kp else None,
            kp_standard_error=kp.standard_error if kp else None,
            kd=kd.value if kd else None,
            kd_standard_error=kd.standard_error if kd else None,
            scale=source,
        )
    return reports


def _by_joint(joints: Sequence[str], values: Array) -> dict[str, float]:
    return dict(zip(joints, values.tolist(), strict=True))


def intervals(fit: Fit) -> list[list[float] | None]:
    """The 95 % interval of every coefficient; None where the data do not determine it."""
    pairs = zip(fit.uncertainty_analysis.intervals.tolist(), fit.uncertainty.identifiable, strict=True)
    return [pair if is_determined and np.isfinite(pair).all() else None for pair, is_determined in pairs]


def base_report(fit: Fit, identifiability: Identifiability) -> BaseParametersResult:
    """The entry ``base_parameters``."""
    coefficients = fit.experiment.equation.coefficients
    limits, pulls = (
        fit.uncertainty_analysis.interval(identifiability.base.B),
        fit.uncertainty_analysis.pull(identifiability.base.B),
    )
    entries = []
    for i in range(len(identifiability.base)):
        is_determined = bool(identifiability.determined[i])
        entries.append(
            BaseParameter(
                name=combination_name(identifiability.base, i, coefficients),
                terms=terms_report(identifiability.base, i, coefficients),
                unit=coefficients[identifiability.base.own[i]].unit,
                value=float(identifiability.value[i]),
                standard_error=float(identifiability.standard_error[i]) if is_determined else None,
                interval=limits[i].tolist() if is_determined else None,
                pull=float(pulls[i]) if is_determined else None,
            )
        )
    return BaseParametersResult(
        of=len(coefficients),
        structural=len(identifiability.base),
        determined=int(np.count_nonzero(identifiability.determined)),
        held_away=int(np.count_nonzero(pulls > MAX_PULL)),
        parameters=entries,
    )


def parameter_sources(fit: Fit, index: int) -> list[ParameterSource] | None:
    """Sources of the ten parameters of a body; None without the analysis."""
    identifiability = fit.uncertainty_analysis.identifiability
    if identifiability is None:
        return None
    return [_source_report(fit, identifiability, PI_SIZE * index + k) for k in range(PI_SIZE)]


def _source_report(fit: Fit, identifiability: Identifiability, k: int) -> ParameterSource:
    coefficients, source = fit.experiment.equation.coefficients, identifiability.sources[k]
    return ParameterSource(
        on=source.information_source,
        data=source.data,
        constraints=source.constraints,
        prior=source.prior,
        range=list(source.range),
        moves_with=[
            CorrelatedParameter(of=coefficients[i].owner, what=coefficients[i].name, correlation=correlation)
            for i, correlation in source.moves_with
        ],
        combinations=list(source.combinations),
        text=source_text(fit, identifiability, k),
    )


def source_text(fit: Fit, identifiability: Identifiability, k: int) -> str:
    """The source of a parameter in words."""
    coefficients, source = fit.experiment.equation.coefficients, identifiability.sources[k]
    names = [coefficient_name(coefficients[i]) for i, _ in source.moves_with[:2]]
    moves = f"; correlated with {' and '.join(names)}" if names and source.information_source != "data" else ""
    return f"{coefficient_name(coefficients[k])}: {_main_source_text(source, identifiability, coefficients)}{moves}"


def _main_source_text(
    source: InformationShares, identifiability: Identifiability, coefficients: Sequence[Coefficient]
) -> str:
    if source.information_source == "data":
        return "determined by the data"
    if source.information_source == "constraints":
        low, high = source.range
        ends = f", {short_number(low)} to {short_number(high)}" if low is not None and high is not None else ""
        return f"limited by the constraints{ends} ({100 * source.constraints:.0f} %)"
    if source.information_source == "combination":
        name = (
            combination_name(identifiability.base, source.combinations[0], coefficients) if source.combinations else ""
        )
        return f"determined by the data only in a combination: {name}"
    return "prior only" if source.prior > 0.9 else f"mostly prior ({100 * source.prior:.0f} %)"


def repeatability_report(
    fit: Fit, identifiability: Identifiability | None, compared: Repeatability | None
) -> RepeatabilityReport | None:
    """The entry ``repeatability``."""
    if identifiability is None or compared is None:
        return None
    coefficients = fit.experiment.equation.coefficients
    finite = np.isfinite(compared.standard_error)
    return RepeatabilityReport(
        logs=list(compared.logs),
        agree=bool(compared.agrees.all()),
        odd_one_out=None if compared.outlier is None else compared.logs[compared.outlier],
        cross_rms=compared.cross_error.tolist(),
        parameters=[
            RepeatedParameter(
                name=combination_name(identifiability.base, i, coefficients),
                unit=coefficients[identifiability.base.own[i]].unit,
                value=[v if sees else None for v, sees in zip(compared.value[i].tolist(), finite[i], strict=True)],
                standard_error=[
                    v if sees else None for v, sees in zip(compared.standard_error[i].tolist(), finite[i], strict=True)
                ],
                ratio=float(compared.ratio[i]) if np.isfinite(compared.ratio[i]) else None,
                agrees=bool(compared.agrees[i]),
            )
            for i in range(len(identifiability.base))
        ],
    )


def bias_report(fit: Fit, identifiability: Identifiability | None, biased: BiasCheck | None) -> BiasReport | None:
    """The entry ``bias``."""
    if identifiability is None or biased is None:
        return None
    coefficients = fit.experiment.equation.coefficients
    entries = []
    for i in range(len(identifiability.base)):
        if np.isfinite(biased.ls[i]):
            entries.append(
                BiasParameter(
                    name=combination_name(identifiability.base, i, coefficients),
                    unit=coefficients[identifiability.base.own[i]].unit,
                    ls=float(biased.ls[i]),
                    iv=float(biased.iv[i]),
                    standard_error=float(biased.standard_error[i]),
                    differs=bool(biased.differs[i]),
                )
            )
    return BiasReport(
        method=fit.method,
        instruments=biased.kind,
        iterations=biased.iterations,
        weak=list(biased.weak),
        parameters=entries,
    )


def reflected_inertia_report(fit: Fit) -> dict[str, dict[str, ReflectedInertia]]:
    """The entry ``rotors``: each rotor's inertia about its axis, reflected to the joints that it turns with [kg·m²]."""
    model, p = fit.experiment.model, len(fit.estimate.theta)
    rotors = {}
    for i, body in enumerate(model.bodies):
        if body.kind != "rotor":
            continue
        x, y, z = body.axis
        about = np.array([x * x, 2 * x * y, y * y, 2 * x * z, 2 * y * z, z * z])
        joints = {}
        for joint, ratio in zip(model.names, body.ratios, strict=True):
            if ratio:
                row = np.zeros((1, p))
                row[0, PI_SIZE * i + 4 : PI_SIZE * (i + 1)] = ratio**2 * about
                error = float(fit.uncertainty.of(row)[0])
                is_determined = np.isfinite(error)
                joints[joint] = ReflectedInertia(
                    reflected_inertia=float(row[0] @ fit.estimate.theta),
                    standard_error=error if is_determined else None,
                    interval=fit.uncertainty_analysis.interval(row)[0].tolist() if is_determined else None,
                )
        rotors[body.name] = joints
    return rotors
