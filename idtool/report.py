"""Results → plain data for JSON, configuration and pages. Keys are the contract's (sections 3 and 5)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idtool import __version__
from idtool.body import Body
from idtool.config import Config
from idtool.effects import known_effects
from idtool.fit import Fit
from idtool.inertia import SIZE, mass_com_inertia, pseudo_inertia, six
from idtool.urdf import JointDynamics
from idtool.validate import Evaluation

Array = NDArray[np.float64]

HEADER = {"idtool": __version__, "schema": 1}
_FRICTION = {"viscous": "viscous_friction", "coulomb": "coulomb_friction", "offset": "torque_offset"}


def fit_report(fit: Fit) -> dict[str, Any]:
    """The content of report.json."""
    experiment, estimate = fit.experiment, fit.estimate
    joints = experiment.equation.joints
    certificate = estimate.certificate
    validated = fit.validation.errors["identified"].samples > 0
    return {
        **HEADER,
        "joints": list(joints),
        "units": experiment.model.units,
        "samples": {"train": experiment.samples(False), "validation": experiment.samples(True)},
        "band_hz": experiment.band_hz,
        "rms": _rms(fit, joints, raw=False),
        "rms_raw": _rms(fit, joints, raw=True),
        "nrms": nrms(fit.validation if validated else fit.train, "identified", joints),
        "noise": dict(zip(joints, estimate.noise.tolist(), strict=True)),
        "bodies": {body.name: body_report(fit, i, body) for i, body in enumerate(experiment.model.bodies)},
        "friction": {joint: friction_report(fit, joint) for joint in joints},
        "solver": {
            "name": certificate.name,
            "status": certificate.status,
            "objective": certificate.objective,
            "duality_gap": certificate.duality_gap,
            "iterations": certificate.iterations,
            "seconds": certificate.seconds,
            "violation": certificate.violation,
        },
        "seconds": fit.seconds,
        "warnings": list(fit.warnings),
        "logs": [str(run.signals.log.path) for run in experiment.runs],
        "urdf": str(experiment.model.robot.path),
    }


def _rms(fit: Fit, joints: tuple[str, ...], raw: bool) -> dict[str, Any]:
    held_out = fit.validation.errors
    validated = held_out["identified"].samples > 0
    return {
        "train": fit.train.errors["identified"].rms(joints, raw),
        "validation": held_out["identified"].rms(joints, raw) if validated else None,
        "prior_validation": held_out["prior"].rms(joints, raw) if validated else None,
    }


def nrms(evaluation: Evaluation, model: str, joints: tuple[str, ...]) -> dict[str, float | None]:
    """Root mean square in the band over the measured torque's standard deviation, by joint."""
    rms = evaluation.errors[model].rms(joints)
    return {name: rms[name] / spread if spread else None for name, spread in evaluation.spread.items()}


def body_report(fit: Fit, index: int, body: Body) -> dict[str, Any]:
    """One entry of ``bodies``."""
    part = slice(SIZE * index, SIZE * (index + 1))
    pi = fit.parameters(index)
    mass, com, inertia = mass_com_inertia(pi)
    errors = fit.uncertainty.standard_error[part]
    margin = ellipsoid_margin(body, fit.estimate.parts[index])
    least = float(np.linalg.eigvalsh(pseudo_inertia(pi))[0])
    return {
        "kind": body.kind,
        "mass": mass,
        "com": com.tolist(),
        "inertia_com": six(inertia).tolist(),
        "pi": pi.tolist(),
        "standard_error": [error if np.isfinite(error) else None for error in errors.tolist()],
        "min_eig_pseudo_inertia": least,
        "ellipsoid_margin": margin,
        "realizable": least > 0 and (margin is None or margin >= 0),
        "identifiable": fit.uncertainty.identifiable[part].tolist(),
        "constraints": fit.sets[index].name,
        "lumped": list(body.lumped),
        "prior": body.pi.tolist(),
        "ellipsoids": [
            {"center": list(e.center), "semi_axes": list(e.semi_axes), "rpy": list(e.rpy)} for e in body.ellipsoids
        ],
    }


def ellipsoid_margin(body: Body, parts: Array) -> float | None:
    """Tr(J(pi) Q) [kg], of a union the least over its parts (Thm 4, Cor. 2); None without an ellipsoid.

    Parameters
    ----------
    body
        The body.
    parts
        The parameter vectors it is the sum of, shape (parts, 10).
    """
    if not body.ellipsoids:
        return None
    if len(parts) != len(body.ellipsoids):  # identified without regard to the ellipsoids
        parts = np.repeat(parts.sum(axis=0, keepdims=True), len(body.ellipsoids), axis=0)
        margins = [float(np.trace(pseudo_inertia(pi) @ e.Q)) for pi, e in zip(parts, body.ellipsoids, strict=True)]
        return max(margins)
    return min(float(np.trace(pseudo_inertia(pi) @ e.Q)) for pi, e in zip(parts, body.ellipsoids, strict=True))


def _coefficient(fit: Fit, effect: str, owner: str) -> tuple[float, float | None] | None:
    """Value and standard error of a joint's coefficient, if the model has it."""
    for i, c in enumerate(fit.experiment.equation.coefficients):
        if c.effect == effect and c.owner == owner:
            error = float(fit.uncertainty.standard_error[i])
            return float(fit.estimate.theta[i]), error if np.isfinite(error) else None
    return None


def friction_report(fit: Fit, joint: str) -> dict[str, Any]:
    """One entry of ``friction``."""
    found = {name: _coefficient(fit, effect, joint) for name, effect in _FRICTION.items()}
    return {
        **{name: pair[0] if pair else None for name, pair in found.items()},
        "standard_error": {name: pair[1] if pair else None for name, pair in found.items()},
    }


def joint_dynamics(fit: Fit) -> dict[str, JointDynamics]:
    """Friction for the URDF."""
    reports = {joint: friction_report(fit, joint) for joint in fit.experiment.equation.joints}
    return {joint: JointDynamics(report["viscous"], report["coulomb"]) for joint, report in reports.items()}


def model_config(fit: Fit) -> dict[str, Any]:
    """The content of model.yaml: a complete configuration that with identified.urdf is the identified model."""
    experiment = fit.experiment
    config: Config = experiment.config
    data: dict[str, Any] = config.model_dump(mode="json", exclude_unset=True)
    data["joints"] = list(experiment.equation.joints)
    data["filter"] = {**config.filter.model_dump(mode="json"), "cutoff_hz": experiment.band_hz}
    data["friction"] = {joint: _friction_terms(fit, joint) for joint in experiment.equation.joints}
    for entry in data.get("effects", ()):
        name = known_effects()[entry["effect"]].name
        entry["parameters"][name] = _term(fit, entry["effect"], entry["joint"])
    robot_links = experiment.model.robot.links
    for i, body in enumerate(experiment.model.bodies):
        if body.kind == "rotor":
            data["rotors"][body.name].pop("inertial", None)
            if body.name not in robot_links:  # else it is in the URDF
                mass, com, inertia = mass_com_inertia(fit.parameters(i))
                inertial = {"mass": mass, "com": com.tolist(), "inertia": six(inertia).tolist()}
                data["rotors"][body.name]["inertial"] = inertial
    return data


def _friction_terms(fit: Fit, joint: str) -> dict[str, Any]:
    return {name: _term(fit, effect, joint) for name, effect in _FRICTION.items()}


def _term(fit: Fit, effect: str, joint: str) -> dict[str, float] | bool:
    """A joint's coefficient as the configuration has it; False where the model lacks it."""
    pair = _coefficient(fit, effect, joint)
    if pair is None:
        return False
    value, error = pair
    return {"value": value} if error is None else {"value": value, "standard_error": error}


def validation_report(
    evaluation: Evaluation, units: Mapping[str, str], band_hz: float, bounds: Mapping[str, float]
) -> dict[str, Any]:
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
    """
    joints = tuple(units)
    rms = {model: errors.rms(joints) for model, errors in evaluation.errors.items()}
    return {
        **HEADER,
        "joints": list(joints),
        "units": dict(units),
        "samples": evaluation.errors["model"].samples,
        "band_hz": band_hz,
        "rms": rms,
        "rms_raw": {model: errors.rms(joints, raw=True) for model, errors in evaluation.errors.items()},
        "nrms": nrms(evaluation, "model", joints),
        "bound": dict(bounds),
        "ok": {name: rms["model"][name] <= bound for name, bound in bounds.items()},
    }
