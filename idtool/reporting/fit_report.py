"""The records of a fit and of a validation, and the configuration of an identified model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from idtool.common.arrays import Array
from idtool.common.notice import Notice
from idtool.common.provenance import InputFile
from idtool.dynamics.effects import NamedEffect, config_parameters, effect_from_entry, foot_compliance, friction_types
from idtool.estimation.dataset.equality_constraints import Constraint
from idtool.estimation.dataset.sensor_offsets import has_offset, offset_rows
from idtool.estimation.evaluation.torque_errors import Evaluation
from idtool.estimation.fit import Fit
from idtool.estimation.fleet import Fleet
from idtool.estimation.problem.realizability import RealizabilityCheck, check_realizability
from idtool.estimation.problem.regularization_path import PathPoint
from idtool.reporting.results.base import SampleCounts, notice_fields, plain_data, provenance_fields
from idtool.reporting.results.fit import (
    AutomaticWeight,
    BodyReport,
    EffectReport,
    ErrorsByKind,
    FitReport,
    FleetReport,
    FleetRobotReport,
    FootComplianceReport,
    FrictionErrors,
    FrictionIntervals,
    FrictionReport,
    KnownValue,
    OffsetInLog,
    PathPointReport,
    PointMasses,
    RegularizationReport,
    SolverReport,
    TorqueErrors,
    UnionPart,
    WholeRobotReport,
    WrenchSensorReport,
)
from idtool.reporting.results.rollouts import Simulation
from idtool.reporting.simulation_report import simulation_report, why_not_simulated
from idtool.reporting.uncertainty_report import (
    base_report,
    bias_report,
    controller_gains_report,
    controller_report,
    intervals,
    parameter_sources,
    reflected_inertia_report,
    repeatability_report,
    uncertainty_report,
)
from idtool.reporting.verdict import (
    bodies_reason,
    data_reason,
    motion_reason,
    next_steps,
    problem_reasons,
    torque_reason,
    worst_level,
)
from idtool.robot.body import Body
from idtool.robot.config import Config, EffectEntry
from idtool.robot.inertia import (
    PI_SIZE,
    mass_com_inertia,
    parameter_transform,
    pseudo_inertia,
    round_to_digits,
    rounded_inertial,
    smallest_eigenvalue,
    symmetric_entries,
)
from idtool.robot.kinematics import body_placements
from idtool.robot.meshes import relocated_mesh
from idtool.robot.urdf.writing import JointDynamics
from idtool.robot.witness import deviation_ellipsoid

if TYPE_CHECKING:
    from idtool.reporting.results.validation import ValidationReport


def fit_report(
    fit: Fit, fleet: Fleet | None = None, noise_floor: Mapping[str, float | None] | None = None
) -> FitReport:
    """The content of report.json.

    Parameters
    ----------
    fit
        The result.
    fleet
        The robots of the fleet that the logs are of; None: they are of one robot.
    noise_floor
        Error that noise alone makes, by joint and ``overall`` [N·m or N]; None: not known.
    """
    experiment = fit.experiment
    joints = experiment.equation.joints
    analysis = fit.uncertainty_analysis
    rms = _rms(fit, joints, raw=False)
    errors = rms.validation or rms.train
    error_shares = nrms(fit.evaluation, "identified", joints)
    simulation = simulation_report(fit.simulation, "identified", experiment)
    bodies = {body.name: body_report(fit, i, body) for i, body in enumerate(experiment.model.bodies)}
    base_parameters = base_report(fit, analysis.identifiability) if analysis.identifiability else None
    solver = SolverReport(**{name: getattr(fit.estimate.certificate, name) for name in SolverReport.model_fields})
    reasons = (
        *problem_reasons(fit.notices),
        torque_reason(
            errors,
            error_shares,
            experiment.model.units,
            rms.prior_validation,
            noise_floor,
            where="On held-out data" if fit.has_held_out else "On the data that the model was fitted to",
            was_fitted=not fit.has_held_out,
        ),
        motion_reason(simulation, why_not_simulated(fit.simulation, "identified", experiment)),
        bodies_reason(bodies, fit.notices),
        data_reason(base_parameters, solver),
    )
    return FitReport(
        **provenance_fields(experiment.sources),
        verdict=worst_level(reasons),
        verdict_reasons=reasons,
        next=next_steps(reasons),
        joints=joints,
        units=experiment.model.units,
        samples=SampleCounts(train=experiment.samples(held_out=False), validation=experiment.samples(held_out=True)),
        band_hz=experiment.band_hz,
        method=fit.method,
        rms=rms,
        rms_by_kind=_errors_by_kind(rms, experiment.model.row_kinds),
        rms_raw=_rms(fit, joints, raw=True),
        nrms=error_shares,
        simulation=simulation,
        noise_floor=noise_floor,
        noise=dict(zip(joints, fit.estimate.noise.tolist(), strict=True)),
        bodies=bodies,
        whole_robot=whole_robot_report(fit),
        foot_compliance=foot_compliance_report(fit),
        wrench_sensors=wrench_sensor_reports(fit),
        wrench_sensor_offsets=plain_data(fit.validation.sensor_offsets),
        friction={joint: friction_report(fit, joint) for joint in experiment.model.joint_names},
        friction_intervals={joint: friction_intervals(fit, joint) for joint in experiment.model.joint_names},
        fleet=fleet_report(fleet) if fleet else None,
        effects=[effect_report(fit, entry) for entry in experiment.config.effects],
        rotors=reflected_inertia_report(fit),
        controller=controller_report(fit),
        controller_gains=controller_gains_report(fit),
        controller_gains_text=fit.gains.text if fit.gains else None,
        uncertainty=uncertainty_report(fit),
        base_parameters=base_parameters,
        bias=bias_report(fit, analysis.identifiability, analysis.bias),
        repeatability=repeatability_report(fit, analysis.identifiability, analysis.repeatability),
        regularization=regularization_report(fit),
        known=[_known_value(constraint, fit) for constraint in experiment.equalities.constraints],
        solver=solver,
        seconds=fit.seconds,
        **notice_fields(fit.notices),
        logs=[str(path) for path in experiment.log_paths],
        urdf=str(experiment.model.robot.path),
    )


def regularization_report(fit: Fit) -> RegularizationReport:
    """The prior's kind and weight, and where the weight was chosen from the data, how."""
    prior, path = fit.regularization, fit.path
    automatic = None
    if path is not None:
        automatic = AutomaticWeight(
            limit=path.limit,
            reason=path.reason,
            best=_finite_or_none(path.best),
            standard_error=_finite_or_none(path.standard_error),
            chosen=_point(path.chosen),
            weaker=_point(path.weaker),
            stronger=_point(path.stronger),
            path=[_point(point) for point in path.points],
        )
    return RegularizationReport(
        kind=prior.kind,
        weight=prior.numeric_weight,
        mass_precision=prior.mass_precision_factor,
        units=prior.units,
        automatic=automatic,
    )


def _point(point: PathPoint) -> PathPointReport:
    return PathPointReport(**{name: _finite_or_none(value) for name, value in asdict(point).items()})


def _finite_or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _known_value(constraint: Constraint, fit: Fit) -> KnownValue:
    return KnownValue(
        what=constraint.label,
        value=constraint.value,
        standard_error=constraint.standard_error,
        identified=float(constraint.row @ fit.estimate.theta),
    )


def _rms(fit: Fit, joints: tuple[str, ...], raw: bool) -> TorqueErrors:
    held_out = fit.validation.errors
    return TorqueErrors(
        train=plain_data(fit.train.errors["identified"].rms(joints, raw)),
        validation=plain_data(held_out["identified"].rms(joints, raw)) if fit.has_held_out else None,
        prior_validation=plain_data(held_out["prior"].rms(joints, raw)) if fit.has_held_out else None,
    )


def _errors_by_kind(rms: TorqueErrors, kinds: Mapping[str, Sequence[str]]) -> ErrorsByKind | None:
    """Errors by kind of row; None if there is one kind."""
    if len(kinds) < 2:
        return None
    return ErrorsByKind(
        train=rms_by_kind(rms.train, kinds),
        validation=rms_by_kind(rms.validation, kinds) if rms.validation else None,
        prior_validation=rms_by_kind(rms.prior_validation, kinds) if rms.prior_validation else None,
    )


def rms_by_kind(rms: Mapping[str, float | None], kinds: Mapping[str, Sequence[str]]) -> dict[str, float | None]:
    """RMS error of the joints, and of the length of each force and moment.

    Joints without an error do not count; it is None if all are without. A force or moment needs an error of all three
    components, or it is None.

    Parameters
    ----------
    rms
        RMS error by row [N·m or N].
    kinds
        Rows of each kind, as `RobotModel.row_kinds`.
    """
    by_kind: dict[str, float | None] = {}
    for kind, rows in kinds.items():
        known = [error for row in rows if (error := rms[row]) is not None]
        sum_of_squares = sum(error**2 for error in known)
        by_kind[kind] = None
        if kind == "joints":
            if known:
                by_kind[kind] = math.sqrt(sum_of_squares / len(known))
        elif len(known) == len(rows):
            by_kind[kind] = math.sqrt(sum_of_squares)
    return by_kind


def met_bounds(rms: Mapping[str, float | None], bounds: Mapping[str, float]) -> dict[str, bool]:
    """By joint or ``overall``, whether an rms meets its bound; one that is not known does not."""
    is_met = {}
    for name, bound in bounds.items():
        error = rms[name]
        is_met[name] = error is not None and error <= bound
    return is_met


def nrms(evaluation: Evaluation, model: str, joints: tuple[str, ...]) -> dict[str, float | None]:
    """Root mean square in the band over the measured torque's standard deviation, by joint."""
    rms = evaluation.errors[model].rms(joints)
    shares = {name: rms[name] / spread if spread else None for name, spread in evaluation.torque_std.items()}
    return dict(plain_data(shares))


def whole_robot_report(fit: Fit) -> WholeRobotReport | None:
    """Mass and centre of mass of a robot with a floating base; None if the base is fixed."""
    model = fit.experiment.model
    if not model.has_floating_base:
        return None
    p = len(fit.experiment.equation.coefficients)
    to_root = np.zeros((4, p))  # mass and first moments about the root link's origin
    placements = body_placements(model, np.zeros((len(model.joints), 1)))
    for i in range(len(model.bodies)):
        R, position = placements[i]
        to_root[:, PI_SIZE * i : PI_SIZE * (i + 1)] = parameter_transform(R[0], position[0])[:4]
    mass, *moment = to_root @ fit.estimate.theta
    prior_mass, *prior_moment = to_root @ fit.experiment.equation.prior
    com = np.array(moment) / mass
    com_change = (to_root[1:] - np.outer(com, to_root[0])) / mass  # by each coefficient, to first order
    errors = [_finite_or_none(error) for error in fit.uncertainty.of(np.vstack([to_root[:1], com_change])).tolist()]
    return WholeRobotReport(
        mass=mass,
        mass_standard_error=errors[0],
        prior_mass=prior_mass,
        com=com,
        com_standard_error=tuple(errors[1:]),
        prior_com=np.array(prior_moment) / prior_mass,
    )


def wrench_sensor_reports(fit: Fit) -> dict[str, WrenchSensorReport]:
    """Readings without load of the wrench sensors whose offset was identified."""
    experiment = fit.experiment
    model, equation = experiment.model, experiment.equation
    runs = [run for run in experiment.runs if run.train]
    reports = {}
    for i, sensor in enumerate(experiment.config.wrench_sensors):
        if not has_offset(model, equation, i):
            continue
        offsets = []
        by_log = {}
        for run in runs:
            times = [0.0, *run.fitted_times]
            at_start, first, last = offset_rows(model, equation, i, run.signals.recording, times)
            offset, standard_error = _reading(fit, at_start)
            drift, drift_error = _reading(fit, last - first) if sensor.has_drift else (None, None)
            by_log[run.signals.recording] = OffsetInLog(
                offset=offset, standard_error=standard_error, drift=drift, drift_standard_error=drift_error
            )
            offsets.append(at_start)
        offset, standard_error = _reading(fit, np.mean(offsets, axis=0))
        reports[sensor.joint] = WrenchSensorReport(offset=offset, standard_error=standard_error, by_log=by_log)
    return reports


def _reading(fit: Fit, rows: Array) -> tuple[list[float], list[float | None]]:
    """A reading and its standard errors, from the reading per coefficient, shape (6, p)."""
    errors = fit.uncertainty.of(rows).tolist()
    return (rows @ fit.estimate.theta).tolist(), [_finite_or_none(error) for error in errors]


def foot_compliance_report(fit: Fit) -> FootComplianceReport | None:
    """Compliance of the balls of the feet; None if there are none."""
    found = _coefficient(fit, foot_compliance.EFFECT, foot_compliance.OWNER)
    if found is None:
        return None
    value, standard_error = found
    return FootComplianceReport(value=value, standard_error=standard_error)


def body_report(fit: Fit, index: int, body: Body) -> BodyReport:
    """One entry of ``bodies``."""
    part = slice(PI_SIZE * index, PI_SIZE * (index + 1))
    pi = fit.parameters(index)
    mass, com, inertia = mass_com_inertia(pi)
    errors = fit.uncertainty.standard_error[part]
    pieces = fit.estimate.pieces[index]
    copy = fit.experiment.equalities.copies.get(index)
    verdict = check_realizability(body, pi, pieces if len(pieces) else None)
    least = float(smallest_eigenvalue(pi))
    return BodyReport(
        kind=body.kind,
        mass=mass,
        com=com.tolist(),
        inertia_com=symmetric_entries(inertia).tolist(),
        pi=pi.tolist(),
        standard_error=[error if np.isfinite(error) else None for error in errors.tolist()],
        interval=intervals(fit)[part],
        rests_on=parameter_sources(fit, index),
        min_eig_pseudo_inertia=least,
        ellipsoid_margin=ellipsoid_margin(body, pi, verdict.pieces),
        realizable=least > 0 and not verdict.violations,
        identifiable=fit.uncertainty.identifiable[part].tolist(),
        constraints=fit.sets[index].name,
        copy_of=fit.experiment.model.bodies[copy[0]].name if copy else None,
        lumped=list(body.lumped_links),
        prior=body.pi.tolist(),
        ellipsoids=[ellipsoid.to_dict() for ellipsoid in body.ellipsoids],
        shapes=[shape.to_dict() for shape in body.shapes],
        deviation_ellipsoid=deviation_ellipsoid(pi).to_dict() if mass > 0 else None,
        split=None if verdict.pieces is None else [UnionPart(mass=p[0], pi=p) for p in verdict.pieces.tolist()],
        witness=_witness(verdict) if len(verdict.masses) else None,
        violations=verdict.violations,
    )


def _witness(verdict: RealizabilityCheck) -> PointMasses:
    return PointMasses(masses=verdict.masses.tolist(), points=verdict.points.tolist())


def ellipsoid_margin(body: Body, pi: Array, pieces: Array | None) -> float | None:
    """Tr(J(pi) Q) [kg], of a union the least over its pieces (Thm 4, Cor. 2); None without an ellipsoid.

    Parameters
    ----------
    body
        The body.
    pi
        Its parameters, shape (10,).
    pieces
        What they are the sum of where its bounds are a union, shape (pieces, 10). Where nothing in the union has these
        parameters, the margin is that of the ellipsoid they fit best.
    """
    if not body.ellipsoids:
        return None
    if pieces is None:
        return max(float(np.trace(pseudo_inertia(pi) @ e.Q)) for e in body.ellipsoids)
    return min(float(np.trace(pseudo_inertia(p) @ e.Q)) for p, e in zip(pieces, body.ellipsoids, strict=False))


def _coefficient(fit: Fit, effect: str, owner: str) -> tuple[float, float | None] | None:
    """Value and standard error of a joint's coefficient, if the model has it."""
    i = _coefficient_index(fit, effect, owner)
    if i is None:
        return None
    coefficient = fit.experiment.equation.coefficients[i]
    error = float(fit.uncertainty.standard_error[i])
    if error > coefficient.upper - coefficient.lower:
        error = math.inf  # the data say nothing within the range that it may have
    return float(fit.estimate.theta[i]), _finite_or_none(error)


def _coefficient_index(fit: Fit, effect: str, owner: str) -> int | None:
    """Index of a joint's coefficient, if the model has it."""
    names = [(c.effect, c.owner) for c in fit.experiment.equation.coefficients]
    return names.index((effect, owner)) if (effect, owner) in names else None


def friction_report(fit: Fit, joint: str) -> FrictionReport:
    """One entry of ``friction``."""
    terms = {key: _coefficient(fit, kind.id, joint) for key, kind in friction_types().items()}
    if fit.experiment.is_torque_unknown(joint):
        terms = dict.fromkeys(terms)
    values = {name: term[0] if term else None for name, term in terms.items()}
    errors = {name: term[1] if term else None for name, term in terms.items()}
    return FrictionReport(**values, standard_error=FrictionErrors(**errors))


def fleet_report(fleet: Fleet) -> FleetReport:
    """The entry ``fleet``."""
    joints = fleet.fit.experiment.model.joint_names
    robots = {}
    for robot in fleet.robots:
        fit = robot.fit
        robots[robot.name] = FleetRobotReport(
            logs=[str(path) for path in fit.experiment.log_paths],
            samples=fit.experiment.samples(held_out=False),
            rms=robot.rms_error,
            rms_alone=robot.rms_error_alone,
            friction={joint: friction_report(fit, joint) for joint in joints},
            outliers=[outlier.text for outlier in robot.outliers],
        )
    return FleetReport(shared=fleet.pool.shared, own=fleet.pool.own, robots=robots)


def friction_intervals(fit: Fit, joint: str) -> FrictionIntervals:
    """One entry of ``friction_intervals``: of each term the 95 % interval, None where the data do not determine it."""
    all_intervals = intervals(fit)
    by_term: dict[str, list[float] | None] = {}
    for key, kind in friction_types().items():
        i = _coefficient_index(fit, kind.id, joint)
        by_term[key] = None if i is None else all_intervals[i]
    return FrictionIntervals(**by_term)


def joint_dynamics(fit: Fit) -> dict[str, JointDynamics]:
    """Friction for the URDF."""
    return {joint: _urdf_dynamics(fit, joint) for joint in fit.experiment.model.joint_names}


def _urdf_dynamics(fit: Fit, joint: str) -> JointDynamics:
    """A joint's friction as URDF attributes."""
    report = friction_report(fit, joint)
    kinds = {key: kind for key, kind in friction_types().items() if kind.urdf_attribute}
    return JointDynamics(**{kind.urdf_attribute: getattr(report, key) for key, kind in kinds.items()})


def model_config(fit: Fit, folder: Path | None = None) -> dict[str, Any]:
    """The content of model.yaml: a complete configuration that with identified.urdf is the identified model.

    Parameters
    ----------
    fit
        The result.
    folder
        The folder of the file, from which the meshes of bounding shapes are named; None: the URDF's own.
    """
    experiment = fit.experiment
    config: Config = experiment.config
    data: dict[str, Any] = config.model_dump(mode="json", exclude_unset=True)
    data["joints"] = list(experiment.model.joint_names)
    data.pop("pool", None)  # of a fit alone
    data["filter"] = {**config.filter.model_dump(mode="json"), "cutoff_hz": experiment.band_hz}
    data["friction"] = {joint: _friction_terms(fit, joint) for joint in experiment.model.joint_names}
    contacts = experiment.equation.contacts
    if contacts is not None:
        noise = dict(zip(experiment.equation.joints, round_to_digits(contacts.noise, 4).tolist(), strict=True))
        data["base"] = {**data.get("base", {}), "noise": noise}
    compliance = foot_compliance_report(fit)
    if compliance is not None:
        balls = [contact.name for contact in config.contacts if contact.is_compliant]
        for contact in data["contacts"]:
            if contact["name"] in balls:
                contact["compliance"] = float(round_to_digits(np.array(compliance.value), 6))
    sensors = wrench_sensor_reports(fit)
    for sensor in data.get("wrench_sensors", ()):
        if sensor["joint"] in sensors:
            sensor["offset"] = round_to_digits(np.array(sensors[sensor["joint"]].offset), 6).tolist()
    for entry, given in zip(data.get("effects", ()), config.effects, strict=True):
        entry["parameters"].update(_effect_parameters(fit, given))
    robot_links = experiment.model.robot.links
    for i, body in enumerate(experiment.model.bodies):
        if body.kind == "rotor":
            rotor = data["rotors"][body.name]
            rotor.pop("inertial", None)
            if rotor.pop("inertia", None) is not None:
                filled_in = config.rotors[body.name].with_disc(body.axis, config.has_bound(body.name))
                rotor["bounding_ellipsoid"] = filled_in.model_dump(mode="json")["bounding_ellipsoid"]
            if body.name not in robot_links:  # else it is in the URDF
                mass, com, inertia = rounded_inertial(fit.parameters(i))
                inertial = {"mass": mass, "com": com.tolist(), "inertia": symmetric_entries(inertia).tolist()}
                rotor["inertial"] = inertial
    if folder is not None:
        for shapes in data.get("bounding_shapes", {}).values():
            for shape in shapes:
                if shape.get("file") is not None:
                    shape["file"] = relocated_mesh(experiment.model.robot.path, shape["file"], folder)
    return data


def _effect_parameters(fit: Fit, entry: EffectEntry) -> dict[str, dict[str, Any]]:
    """An effect's identified parameters, as the configuration has them."""
    pairs = config_parameters(fit.effect_parameters(entry))
    return {name: _config_value(**pair) for name, pair in pairs.items()}


def effect_report(fit: Fit, entry: EffectEntry) -> EffectReport:
    """One entry of ``effects``: its parameters as identified, or as given."""
    parameters = dict(entry.values)
    errors: dict[str, Any] = dict.fromkeys(parameters)
    for name, (value, error) in fit.effect_parameters(entry).items():
        parameters[name] = value
        errors[name] = error
    return EffectReport(
        effect=entry.effect,
        joint=entry.joint,
        link=entry.link,
        parameters=plain_data(parameters),
        standard_error=plain_data(errors),
        units=parameter_units(effect_from_entry(entry, fit.experiment.model), parameters),
    )


def parameter_units(effect: NamedEffect, names: Iterable[str]) -> dict[str, str | None]:
    """Units of an effect's parameters by name; None for one without."""
    units = effect.parameter_units()
    return {name: None if units.get(name) == "1" else units.get(name) for name in names}


def _friction_terms(fit: Fit, joint: str) -> dict[str, Any]:
    return {key: _friction_term(fit, kind.id, joint) for key, kind in friction_types().items()}


def _friction_term(fit: Fit, effect: str, joint: str) -> dict[str, Any] | bool:
    """A joint's coefficient as the configuration has it; False where the model lacks it."""
    pair = _coefficient(fit, effect, joint)
    if pair is None:
        return False
    return _config_value(*pair)


def _config_value(value: Any, standard_error: Any = None) -> dict[str, Any]:
    """A number or a list of them with its standard error, rounded as in a configuration."""
    entry = {"value": round_to_digits(value).tolist()}
    if standard_error is not None:
        entry["standard_error"] = round_to_digits(standard_error, 4).tolist()
    return entry


def validation_report(
    evaluation: Evaluation,
    units: Mapping[str, str],
    band_hz: float,
    bounds: Mapping[str, float],
    simulation: Simulation | None = None,
    sources: Sequence[InputFile] = (),
    notices: Sequence[Notice] = (),
    row_kinds: Mapping[str, Sequence[str]] | None = None,
    why_not: str = "it was not simulated",
) -> ValidationReport:
    """The content of validation.json.

    Parameters
    ----------
    evaluation
        Errors of ``model`` and, where one was given, ``prior``.
    units
        Unit of the torque or force, by joint.
    band_hz
        The low-pass's cut-off.
    bounds
        Largest rms in the band that is accepted, by joint or ``overall``.
    simulation
        From `simulation_report`.
    sources
        The files that were read.
    notices
        The notices.
    row_kinds
        As `RobotModel.row_kinds`; None: there are only joints.
    why_not
        Why there is no simulation, from `why_not_simulated`.
    """
    from idtool.reporting.results.validation import ModelErrors, ModelErrorsByKind, ValidationReport

    joints = tuple(units)
    rms = ModelErrors(**{model: plain_data(errors.rms(joints)) for model, errors in evaluation.errors.items()})
    rms_raw = {model: plain_data(errors.rms(joints, raw=True)) for model, errors in evaluation.errors.items()}
    by_kind = None
    if row_kinds is not None and len(row_kinds) > 1:
        by_kind = ModelErrorsByKind(
            model=rms_by_kind(rms.model, row_kinds), prior=rms_by_kind(rms.prior, row_kinds) if rms.prior else None
        )
    error_shares = nrms(evaluation, "model", joints)
    reasons = [
        *problem_reasons(notices),
        torque_reason(rms.model, error_shares, units, rms.prior, None, where="On these logs"),
        motion_reason(simulation, why_not),
    ]
    return ValidationReport(
        **provenance_fields(sources),
        verdict=worst_level(reasons),
        verdict_reasons=reasons,
        next=next_steps(reasons),
        joints=joints,
        units=units,
        samples=evaluation.errors["model"].samples,
        band_hz=band_hz,
        rms=rms,
        rms_by_kind=by_kind,
        rms_raw=ModelErrors(**rms_raw),
        nrms=error_shares,
        wrench_sensor_offsets=plain_data(evaluation.sensor_offsets),
        simulation=simulation,
        bound=bounds,
        ok=met_bounds(rms.model, bounds),
        **notice_fields(notices),
    )
