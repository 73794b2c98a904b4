"""Notices about a fit: solver failures, implausible bodies, large torque errors."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from idtool.common.arrays import Array
from idtool.common.names import join_names
from idtool.common.notice import Notice
from idtool.common.number_text import number, short_number
from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.evaluation.torque_errors import Evaluation, overall_rms
from idtool.estimation.problem.estimate import Estimate, stuck_note, unfinished_note
from idtool.estimation.problem.prior import moved_priors
from idtool.robot.body import Body
from idtool.robot.config import Regularization
from idtool.robot.inertia import PI_SIZE, is_realizable, pseudo_inertia

_MASS_RATIO = 3.0  # to its mass in the prior, of a body that is too heavy or too light
_TOTAL_MASS_CHANGE = 0.3  # relative to the prior's total mass
_THIN = 0.1  # radius of gyration relative to the prior's, below which a body is a plate or a needle
_RIM = 1e-3  # margin within a bounding ellipsoid, relative to the mass
_MAX_RATIO_TO_PRIOR = 1.001  # of the errors of a model and its prior, up to which one is no worse than the other
_ABSURD = 30.0  # the prior's torque error relative to the measured torque's spread
_THIN_SHAPES = ("plate", "needle", "point")  # by how many axes a body has no extent along


class EstimateWithPrior(Protocol):
    """An estimate with the prior that it was pulled towards, such as an `Identification` or a `Fit`."""

    @property
    def estimate(self) -> Estimate:
        """The coefficients."""

    @property
    def prior(self) -> tuple[Body, ...]:
        """The prior's bodies."""

    @property
    def regularization(self) -> Regularization:
        """The prior's kind and weight."""


def fit_notices(
    experiment: Experiment, identified: EstimateWithPrior, evaluation: Evaluation, held_out: bool
) -> list[Notice]:
    """Notices about an identified model.

    Parameters
    ----------
    experiment
        Model and data.
    identification
        The identified.
    evaluation
        Errors of the ``identified`` and the ``prior`` model.
    held_out
        True if these are on held-out data.
    """
    return [
        *_solver_notices(experiment, identified),
        *_realizability_notices(experiment, identified),
        *_mass_notices(experiment, identified),
        *_shape_notices(experiment, identified),
        *_error_notices(experiment, evaluation, identified, held_out),
    ]


def _solver_notices(experiment: Experiment, identified: EstimateWithPrior) -> Iterator[Notice]:
    """Solvers that failed or fell short."""
    certificate = identified.estimate.certificate
    if experiment.config.solver.name == "clarabel" != certificate.name:
        message = f"Clarabel could not solve the problem directly; {certificate.name} solved it"
        yield Notice("other_solver_used", "note", None, message)
    if stuck := stuck_note(certificate):
        yield Notice("not_certified", "warning", None, stuck)
    if unfinished := unfinished_note(certificate):
        advice = "increase regularization.weight"
        yield Notice("parameters_not_at_optimum", "warning", None, unfinished, advice)


def _realizability_notices(experiment: Experiment, identified: EstimateWithPrior) -> Iterator[Notice]:
    """Bodies that are not realizable."""
    unreal = [body.name for body, pi in _bodies(identified) if not is_realizable(pi)]
    if unreal:
        message = f"the parameters of {join_names(unreal)} are not realizable: a URDF must not contain them"
        yield Notice("not_realizable", "problem", None, message)
    as_given = identified.prior is experiment.model.bodies
    moved = moved_priors(experiment.equation, identified.prior, identified.regularization) if as_given else ()
    if moved:
        message = f"the prior of {join_names(moved)} is not realizable; the nearest realizable one is used"
        yield Notice("prior_not_realizable", "warning", None, message)


def _mass_notices(experiment: Experiment, identified: EstimateWithPrior) -> Iterator[Notice]:
    """Masses that differ from the prior's by more than is plausible."""
    measured = experiment.config.known.total_mass
    weighed = "the robot" if experiment.model.has_floating_base else "the moving parts"
    advice = "" if measured else f"weigh {weighed} and set known.total_mass"
    prior = sum(float(body.pi[0]) for body in identified.prior)
    total = sum(float(pi[0]) for _, pi in _bodies(identified))
    if measured is None and prior > 0 and not 1 - _TOTAL_MASS_CHANGE < total / prior < 1 + _TOTAL_MASS_CHANGE:
        message = f"the total mass of the bodies is {number(total)} kg, but {number(prior)} kg in the prior"
        if experiment.has_only_joints:
            message = f"{message}; logs seldom determine it"
        yield Notice("total_mass_changed", "warning", None, message, advice)
    changes = {}
    for body, pi in _bodies(identified):
        if body.pi[0] > 0 and not 1 / _MASS_RATIO < pi[0] / body.pi[0] < _MASS_RATIO:
            changes[body.name] = f"{short_number(pi[0])} kg instead of {short_number(body.pi[0])}"
    if changes:
        masses = " and ".join(list(changes.values())[:2])
        message = (
            f"{join_names(list(changes))}: mass differs from the prior by more than a factor of three ({masses}): the "
            "mass may compensate for something the model lacks, such as rotors, springs or larger bounding ellipsoids"
        )
        yield Notice("implausible_mass", "warning", None, message, advice)


def _shape_notices(experiment: Experiment, identified: EstimateWithPrior) -> Iterator[Notice]:
    """Bodies with next to no extent along an axis, or at the rim of their bounding ellipsoid."""
    has_default_prior = experiment.config.regularization.is_automatic and identified.regularization.kind == "entropic"
    advice = "log a motion that turns the link about more axes (idtool excite)"
    if not has_default_prior:
        advice += "; leave regularization at its default, entropic and auto"
    thin: dict[str, list[str]] = {}
    for body, pi in _bodies(identified):
        flat = int(np.count_nonzero(_gyration(pi) < _THIN * _gyration(body.pi)))
        if flat:
            thin.setdefault(_THIN_SHAPES[flat - 1], []).append(body.name)
    for shape, names in thin.items():
        unseen = "the motion does not excite the inertia about every axis"
        message = f"{join_names(names)}: the mass distribution is nearly a {shape}, which no real link is: {unseen}"
        yield Notice("implausible_shape", "warning", None, message, advice)
    at_rim = [body.name for body, pi in _bodies(identified) if _is_at_rim(body, pi) and not _is_at_rim(body, body.pi)]
    if at_rim:
        message = (
            f"{join_names(at_rim)}: all mass lies at the surface of the bounding ellipsoid: the ellipsoid may be "
            "too small, or the mass may compensate for something the model lacks, such as rotors"
        )
        yield Notice("mass_at_rim", "warning", None, message)


def _bodies(identified: EstimateWithPrior) -> Iterator[tuple[Body, Array]]:
    """Every body of the prior with its identified parameters, shape (10,)."""
    for i, body in enumerate(identified.prior):
        yield body, identified.estimate.theta[PI_SIZE * i : PI_SIZE * (i + 1)]


def _gyration(pi: Array) -> Array:
    """Radii of gyration along the principal axes, ascending, shape (3,) [m]; zero where no body can have them."""
    if not pi[0] > 0:
        return np.zeros(3)
    J = pseudo_inertia(pi)
    com = J[:3, 3] / J[3, 3]
    covariance = J[:3, :3] / J[3, 3] - np.outer(com, com)
    return np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0))


def _is_at_rim(body: Body, pi: Array) -> bool:
    """True if a body's mass can only lie at the surface of its one bounding ellipsoid (Thm 4)."""
    if len(body.ellipsoids) != 1 or body.shapes:
        return False
    return bool(np.trace(pseudo_inertia(pi) @ body.ellipsoids[0].Q) < _RIM * pi[0])


def _error_notices(
    experiment: Experiment, evaluation: Evaluation, identified: EstimateWithPrior, held_out: bool
) -> Iterator[Notice]:
    """Torque errors that no noise explains."""
    joints = experiment.equation.joints
    rms = evaluation.errors["identified"].rms(joints)
    own = rms["overall"]
    prior = evaluation.errors["prior"].rms(joints)["overall"]
    spread = overall_rms(std for name, std in evaluation.torque_std.items() if not np.isnan(rms[name]))
    if prior > _ABSURD * spread > 0 and identified.prior is experiment.model.bodies:
        message = f"the prior's torque error, {short_number(prior)}, is {prior / spread:.0f} times the measured torque"
        advice = "a unit in the URDF or the configuration may be wrong"
        yield Notice("prior_error_large", "warning", None, message, advice)
    if held_out and own > _MAX_RATIO_TO_PRIOR * prior:
        errors = f"error {short_number(own)} instead of {short_number(prior)}"
        message = f"the identified model predicts the held-out data worse than the URDF does ({errors})"
        yield Notice("worse_than_prior", "problem", None, message)
