"""The record of a designed trajectory."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.provenance import InputFile
from idtool.dynamics.effects import effect_from_entry
from idtool.estimation.uncertainty.base_parameters import BaseParameters
from idtool.excitation.deciding import Decision, Separation
from idtool.excitation.design import Design
from idtool.excitation.explanations import Explanation
from idtool.excitation.limits import QUANTITIES
from idtool.excitation.standing.design import StandingDesign
from idtool.excitation.standing.kinematics import BASE_MOTION
from idtool.excitation.task import DesignTask
from idtool.reporting.fit_report import parameter_units
from idtool.reporting.results.base import notice_fields, provenance_fields
from idtool.reporting.results.excitation import (
    Clearance,
    Criteria,
    DecisionReport,
    ExcitationCurves,
    ExcitationReport,
    ExpectedBody,
    ExpectedParameter,
    ExpectedTerm,
    ExplanationEffect,
    ExplanationReport,
    FootLoadReport,
    JointCurves,
    JointLimitsReport,
    LimitUtilization,
    MotionPart,
    SeparationReport,
    StandingReport,
)
from idtool.reporting.uncertainty_report import coefficient_name, combination_name, terms_report
from idtool.robot.inertia import PI_SIZE
from idtool.robot.model import RobotModel

_CURVE_POINTS = 500  # instants of each curve
_MIN_RELATIVE_PRIOR = 1e-3  # of a base parameter's size: a prior that small is none to compare with
_ROUNDING = 1e-9  # of its size
_MAX_RELATIVE_ERROR = 1.0  # relative standard error from which a parameter is as good as unknown


def excitation_report(
    design: Design,
    decision: Decision | None,
    sources: Sequence[InputFile],
    urdf: str,
    logs: Sequence[str],
    seed: int,
    notices: Sequence[Notice],
) -> ExcitationReport:
    """The content that `idtool excite` prints as JSON.

    Parameters
    ----------
    design
        The trajectory.
    decision
        Separation of two explanations on it; None if it was not designed for that.
    sources
        The files that were read.
    urdf, logs
        The URDF, and the logs that there were already.
    seed
        Seed of the random draws.
    notices
        Notices about the logs.
    """
    task, trajectory = design.task, design.trajectory
    starts = trajectory.starts.tolist()
    parts = zip(trajectory.segments, starts[:-1], starts[1:], strict=True)
    return ExcitationReport(
        **provenance_fields(sources),
        file=None,
        urdf=urdf,
        logs=logs,
        seed=seed,
        samples=math.floor(trajectory.duration * task.rate + 1e-9) + 1,
        joints=task.model.joint_names,
        units=task.model.units,
        duration=trajectory.duration,
        rate_hz=task.rate,
        highest_hz=design.max_frequency,
        parts=[MotionPart(pattern=part.pattern.name, start=start, end=end) for part, start, end in parts],
        home=dict(zip(task.model.joint_names, trajectory.home.tolist(), strict=True)),
        noise=dict(zip(task.model.names, task.noise.tolist(), strict=True)),
        criterion=task.criterion.kind,
        criteria={
            name: Criteria(**{kind: _finite_or_none(value) for kind, value in values.items()})
            for name, values in design.criteria.items()
        },
        base_parameters=_base_parameters(design),
        bodies=_bodies(design),
        terms=_terms(design),
        limits={joint: _limits(task, j) for j, joint in enumerate(task.model.joint_names)},
        use={
            joint: LimitUtilization(**dict(zip(QUANTITIES, design.utilization[:, j].tolist(), strict=True)))
            for j, joint in enumerate(task.model.joint_names)
        },
        clearance=_clearance(design),
        standing=_standing(design) if isinstance(design, StandingDesign) else None,
        decide=None if decision is None else _decision(decision, task),
        evaluations=design.evaluations,
        interrupted=design.interrupted,
        curves=_curves(design),
        **notice_fields([*notices, *_notices(design)]),
    )


def _finite_or_none(x: float) -> float | None:
    return float(x) if math.isfinite(x) else None


def _base_parameters(design: Design) -> list[ExpectedParameter]:
    task, base = design.task, design.task.base
    coefficients = task.equation.coefficients
    prior = base.B @ task.theta
    has_favoured = len(task.criterion.favoured) < len(base)
    parameters = []
    for i, own in enumerate(base.own):
        size = abs(prior[i])
        value = float(prior[i]) if size > _ROUNDING * task.scales[i] else 0.0
        error = float(design.errors.base[i])
        relative_error = _finite_or_none(error / size) if size > _MIN_RELATIVE_PRIOR * task.scales[i] else None
        logged_error = float(design.logged_errors.base[i]) if design.logged_errors else math.inf
        parameters.append(
            ExpectedParameter(
                name=combination_name(base, i, coefficients),
                terms=terms_report(base, i, coefficients),
                unit=coefficients[own].unit,
                prior=value,
                standard_error=_finite_or_none(error),
                relative=relative_error,
                logged_standard_error=_finite_or_none(logged_error),
                favoured=bool(has_favoured and i in task.criterion.favoured),
            )
        )
    return parameters


def _bodies(design: Design) -> dict[str, ExpectedBody]:
    """Standard errors of bodies' parameters, None for what no motion determines by itself."""
    errors = design.errors.coefficients
    bodies = {}
    for i, body in enumerate(design.task.model.bodies):
        own = errors[PI_SIZE * i : PI_SIZE * (i + 1)]
        bodies[body.name] = ExpectedBody(standard_error=[_finite_or_none(error) for error in own])
    return bodies


def _terms(design: Design) -> dict[str, dict[str, ExpectedTerm]]:
    """Standard errors of friction and other terms, by joint and name."""
    inertial = PI_SIZE * len(design.task.model.bodies)
    coefficients = design.task.equation.coefficients[inertial:]
    terms: dict[str, dict[str, ExpectedTerm]] = {}
    for c, error in zip(coefficients, design.errors.coefficients[inertial:], strict=True):
        term = ExpectedTerm(prior=c.prior, standard_error=_finite_or_none(error), unit=c.unit)
        terms.setdefault(c.owner, {})[c.name] = term
    return terms


def _limits(task: DesignTask, j: int) -> JointLimitsReport:
    full = task.robot_limits
    return JointLimitsReport(
        position=[float(full.lower[j]), float(full.upper[j])],
        velocity=float(full.velocity[j]),
        acceleration=float(full.acceleration[j]),
        effort=_finite_or_none(full.effort[j]),
    )


def _clearance(design: Design) -> Clearance | None:
    if design.nearest is None:
        return None
    links, distance, t = design.nearest
    return Clearance(links=links, distance=_finite_or_none(distance), t=t, wanted=design.task.clearance)


def _standing(design: StandingDesign) -> StandingReport:
    ground = design.ground
    feet = {}
    for foot, friction, force, pressure in zip(
        ground.feet, ground.friction, ground.lowest_load, ground.pressure, strict=True
    ):
        feet[foot.name] = FootLoadReport(
            friction_coefficient=float(friction),
            min_force=float(force),
            pressure=None if foot.sole is None else float(pressure),
        )
    shares = ground.limit_shares
    tightest = max(shares, key=lambda name: shares[name])
    return StandingReport(
        friction_coefficient=ground.friction_coefficient,
        feet=feet,
        base=dict(zip(BASE_MOTION, ground.base.T.tolist(), strict=True)),
        tightest=tightest,
        tightest_use=shares[tightest],
    )


def _decision(decision: Decision, task: DesignTask) -> DecisionReport:
    best = _separation(decision.design, task)
    return DecisionReport(
        a=_explanation(decision.a, task.model),
        b=_explanation(decision.b, task.model),
        joint=best.joint,
        difference=best.difference,
        noise=best.noise,
        significance=best.significance,
        ordinary=_separation(decision.ordinary, task),
        logged=None if decision.logged is None else _separation(decision.logged, task),
    )


def _separation(separation: Separation, task: DesignTask) -> SeparationReport:
    """The separation, at the joint where it is largest in units of the noise."""
    j = int(np.argmax(separation.rms / task.noise))
    return SeparationReport(
        joint=task.model.names[j],
        difference=float(separation.rms[j]),
        noise=float(task.noise[j]),
        significance=separation.significance,
    )


def _explanation(explanation: Explanation, model: RobotModel) -> ExplanationReport:
    effects = []
    for entry in explanation.entries:
        effect = ExplanationEffect(
            effect=entry.effect,
            joint=entry.joint,
            link=entry.link,
            parameters=entry.values,
            units=parameter_units(effect_from_entry(entry, model), entry.values),
        )
        effects.append(effect)
    return ExplanationReport(name=explanation.name, source=explanation.source, effects=effects)


def _curves(design: Design) -> ExcitationCurves:
    """The motion and its predicted torque at a few instants."""
    task, trajectory = design.task, design.trajectory
    t = np.linspace(0, trajectory.duration, _CURVE_POINTS)
    (q, v, a), tau = design.curves(t)
    joints = {}
    for j, joint in enumerate(task.model.joint_names):
        joints[joint] = JointCurves(q=q[j].tolist(), v=v[j].tolist(), a=a[j].tolist(), tau=tau[j].tolist())
    return ExcitationCurves(t=t.tolist(), joints=joints)


def _notices(design: Design) -> list[Notice]:
    """Notices about a designed trajectory."""
    task = design.task
    notices = [*task.model.notices, *task.robot_limits.notices]
    if task.noise_assumed:
        message = (
            "the torque noise is unknown; 1 % of the effort limit, or of the largest torque if there is no limit, is "
            f"assumed: {join_names(task.noise_assumed)}"
        )
        notices.append(Notice("noise_assumed", "warning", None, message, "give --noise, or a log with --log"))
    if task.collision is None or not task.collision.pairs:
        message = "no links with geometry that could collide were found, so self-collision was not checked"
        notices.append(Notice("self_collision_unchecked", "warning", None, message, "run the trajectory slowly first"))
    if task.collision:
        notices += task.collision.notices
    undetermined = undetermined_names(design, task.base)
    if undetermined:
        message = f"this trajectory hardly determines these parameters: {join_names(undetermined)}"
        advice = "make the trajectory longer, or choose another pattern"
        if isinstance(design, StandingDesign):
            advice = "fit its log together with logs of other motions, such as hanging and walking; --log takes them"
        notices.append(Notice("parameters_not_excited", "warning", None, message, advice))
    if design.interrupted:
        message = "the search was interrupted: this is the best trajectory so far"
        notices.append(Notice("search_interrupted", "warning", None, message))
    return notices


def undetermined_names(design: Design, base: BaseParameters) -> list[str]:
    """The base parameters whose standard error is larger than their size, by their own coefficients' names."""
    coefficients = design.task.equation.coefficients
    is_undetermined = design.errors.base > _MAX_RELATIVE_ERROR * design.task.scales
    own = np.array(base.own)[is_undetermined]
    return [coefficient_name(coefficients[i]) for i in own]
