"""How far to trust a fit, as records and in words: what report.json has of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array
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
    CorrelatedParameter,
    ParameterSource,
    ReflectedInertia,
    RepeatabilityReport,
    RepeatedParameter,
    UncertaintyReport,
)
from idtool.robot.inertia import PARAMETER_NAMES, PI_SIZE

_WORDS = {"m": "mass", **{name: name.replace("mc_", "m·c_") for name in PARAMETER_NAMES[1:4]}}
_NAMED = 4  # terms of a combination that its name holds
PULLED = 3.0  # standard errors from what the data say, at which prior or constraints are said to hold a number


def quantity(coefficient: Coefficient) -> str:
    """What a coefficient is called: its owner and what it is of it."""
    return f"{coefficient.owner} {_WORDS.get(coefficient.name, coefficient.name)}"


def combination_name(base: BaseParameters, i: int, coefficients: Sequence[Coefficient]) -> str:
    """A base parameter in words: ``thigh I_xx − thigh I_zz + 0.117 shank mass``."""
    terms = combination(base, i, coefficients)
    name = ""
    for k, share in terms[:_NAMED]:
        factor = "" if np.isclose(abs(share), 1) else f"{abs(share):.3g} "
        sign = ("−" if share < 0 else "") if not name else (" − " if share < 0 else " + ")
        name += f"{sign}{factor}{quantity(coefficients[k])}"
    return name + (" + …" if len(terms) > _NAMED else "")


def terms_report(base: BaseParameters, i: int, coefficients: Sequence[Coefficient]) -> list[CombinationTerm]:
    """What a base parameter is the sum of."""
    terms = combination(base, i, coefficients)
    return [CombinationTerm(of=coefficients[k].owner, what=coefficients[k].name, share=share) for k, share in terms]


def uncertainty_report(fit: Fit) -> UncertaintyReport:
    """The entry ``uncertainty`` of report.json."""
    analysis, joints = fit.uncertainty_analysis, fit.experiment.equation.joints
    robust = analysis.cluster_robust
    ahead = analysis.prediction
    return UncertaintyReport(
        confidence=0.95,
        blocks=robust.cluster_count if robust.bootstrap else 0,
        block_seconds=robust.cluster_seconds,
        correlated_beyond_blocks=robust.correlated_beyond_clusters,
        bootstrap_ratio=robust.bootstrap_ratio,
        independent_samples={name: analysis.independent[name] for name in joints},
        torque_standard_error=_by_joint(joints, ahead.rms),
        torque_standard_error_largest=_by_joint(joints, ahead.largest),
        torque_undetermined=_by_joint(joints, ahead.unknown),
    )


def controller_report(fit: Fit) -> ControllerDelay | None:
    """The entry ``controller`` of report.json; None where no torque comes from a command."""
    experiment, found = fit.experiment, fit.delay
    controller = experiment.config.controller
    if controller is None or not any(run.signals.command.joints.any() for run in experiment.runs):
        return None
    given = controller.known_delay if found is None else found.given
    taken = controller.known_delay
    told = found is not None and found.standard_error is not None
    return ControllerDelay(
        delay=taken.value if taken else 0.0,
        given=given.value if given else None,
        fitted=found.value if told and found else None,
        standard_error=found.standard_error if found else None,
        known_friction_standard_error=found.known_friction_error if found else None,
        correlation=found.correlation if told and found else None,
        contradicted=found.contradicted if found else None,
        text=found.text if found else None,
    )


def _by_joint(joints: Sequence[str], values: Array) -> dict[str, float]:
    return dict(zip(joints, values.tolist(), strict=True))


def intervals(fit: Fit) -> list[list[float] | None]:
    """The 95 % interval of every coefficient; None where the data do not determine it."""
    pairs = zip(fit.uncertainty_analysis.intervals.tolist(), fit.uncertainty.identifiable, strict=True)
    return [pair if sees and np.isfinite(pair).all() else None for pair, sees in pairs]


def base_report(fit: Fit, asked: Identifiability) -> BaseParametersResult:
    """The entry ``base_parameters``."""
    coefficients = fit.experiment.equation.coefficients
    limits, pulls = fit.uncertainty_analysis.interval(asked.base.B), fit.uncertainty_analysis.pull(asked.base.B)
    entries = []
    for i in range(len(asked.base)):
        sees = bool(asked.determined[i])
        entries.append(
            BaseParameter(
                name=combination_name(asked.base, i, coefficients),
                terms=terms_report(asked.base, i, coefficients),
                unit=coefficients[asked.base.own[i]].unit,
                value=float(asked.value[i]),
                standard_error=float(asked.standard_error[i]) if sees else None,
                interval=limits[i].tolist() if sees else None,
                pull=float(pulls[i]) if sees else None,
            )
        )
    return BaseParametersResult(
        of=len(coefficients),
        structural=len(asked.base),
        determined=int(np.count_nonzero(asked.determined)),
        held_away=int(np.count_nonzero(pulls > PULLED)),
        parameters=entries,
    )


def rests_on(fit: Fit, index: int) -> list[ParameterSource] | None:
    """What the ten parameters of a body rest on; None where it was not asked for."""
    asked = fit.uncertainty_analysis.identifiability
    if asked is None:
        return None
    return [_source_report(fit, asked, PI_SIZE * index + k) for k in range(PI_SIZE)]


def _source_report(fit: Fit, asked: Identifiability, k: int) -> ParameterSource:
    coefficients, source = fit.experiment.equation.coefficients, asked.sources[k]
    return ParameterSource(
        on=source.information_source,
        data=source.data,
        constraints=source.constraints,
        prior=source.prior,
        range=list(source.range),
        moves_with=[
            CorrelatedParameter(of=coefficients[i].owner, what=coefficients[i].name, correlation=tied)
            for i, tied in source.moves_with
        ],
        combinations=list(source.combinations),
        text=basis_text(fit, asked, k),
    )


def basis_text(fit: Fit, asked: Identifiability, k: int) -> str:
    """What a parameter rests on, in words."""
    coefficients, source = fit.experiment.equation.coefficients, asked.sources[k]
    names = [quantity(coefficients[i]) for i, _ in source.moves_with[:2]]
    moves = f"; correlated with {' and '.join(names)}" if names and source.information_source != "data" else ""
    return f"{quantity(coefficients[k])}: {_source_text(source, asked, coefficients)}{moves}"


def _source_text(source: InformationShares, asked: Identifiability, coefficients: Sequence[Coefficient]) -> str:
    if source.information_source == "data":
        return "determined by the data"
    if source.information_source == "constraints":
        low, high = source.range
        ends = f", {low:.3g} to {high:.3g}" if low is not None and high is not None else ""
        return f"limited by the constraints{ends} ({source.constraints:.0%})"
    if source.information_source == "combination":
        name = combination_name(asked.base, source.combinations[0], coefficients) if source.combinations else ""
        return f"determined by the data only in a combination: {name}"
    return "prior only" if source.prior > 0.9 else f"mostly prior ({source.prior:.0%})"


def repeatability_report(
    fit: Fit, asked: Identifiability | None, compared: Repeatability | None
) -> RepeatabilityReport | None:
    """The entry ``repeatability``."""
    if asked is None or compared is None:
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
                name=combination_name(asked.base, i, coefficients),
                unit=coefficients[asked.base.own[i]].unit,
                value=[v if sees else None for v, sees in zip(compared.value[i].tolist(), finite[i], strict=True)],
                standard_error=[
                    v if sees else None for v, sees in zip(compared.standard_error[i].tolist(), finite[i], strict=True)
                ],
                ratio=float(compared.ratio[i]) if np.isfinite(compared.ratio[i]) else None,
                agrees=bool(compared.agrees[i]),
            )
            for i in range(len(asked.base))
        ],
    )


def bias_report(fit: Fit, asked: Identifiability | None, biased: BiasCheck | None) -> BiasReport | None:
    """The entry ``bias``."""
    if asked is None or biased is None:
        return None
    coefficients = fit.experiment.equation.coefficients
    entries = []
    for i in range(len(asked.base)):
        if np.isfinite(biased.ls[i]):
            entries.append(
                BiasParameter(
                    name=combination_name(asked.base, i, coefficients),
                    unit=coefficients[asked.base.own[i]].unit,
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


def reflected_inertia(fit: Fit) -> dict[str, dict[str, ReflectedInertia]]:
    """The entry ``rotors``: what each rotor's inertia about its axis is at the joints that it turns with [kg·m²]."""
    model, p = fit.experiment.model, len(fit.estimate.theta)
    found = {}
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
                sees = np.isfinite(error)
                joints[joint] = ReflectedInertia(
                    reflected_inertia=float(row[0] @ fit.estimate.theta),
                    standard_error=error if sees else None,
                    interval=fit.uncertainty_analysis.interval(row)[0].tolist() if sees else None,
                )
        found[body.name] = joints
    return found
