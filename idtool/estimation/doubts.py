"""What speaks against an identified model, in words."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from idtool.common.arrays import Array
from idtool.common.names import some
from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.evaluation.validation import Evaluation
from idtool.estimation.identified import Identified
from idtool.estimation.problem.identify import stuck_note, unfinished_note
from idtool.estimation.problem.prior import moved_priors
from idtool.robot.body import Body
from idtool.robot.inertia import SIZE, is_realizable, pseudo_inertia

_HEAVY = 3.0  # times its mass in the prior, of a body that is too heavy or too light
_TOTAL = 0.3  # of the prior's total mass, that the total may differ from it
_THIN = 0.1  # of the prior's, of a body's radius of gyration along an axis, below which it is a plate or a needle
_RIM = 1e-3  # of its mass, of the margin within a bounding ellipsoid
_ABSURD = 30.0  # times the measured torque's spread, of the prior's error
_SHAPES = ("plate", "needle", "point")  # by how many axes a body has no extent along


def doubts(experiment: Experiment, found: Identified, shown: Evaluation, held_out: bool) -> list[str]:
    """What a user should know before he believes an estimate, a plain sentence each.

    Parameters
    ----------
    experiment
        Model and data.
    found
        The identification.
    shown
        Errors of the ``identified`` and the ``prior`` model.
    held_out
        Whether on what was held out.
    """
    return [
        *_unsolved(experiment, found),
        *_unreal(experiment, found),
        *_masses(experiment, found),
        *_shapes(experiment, found),
        *_wrong(experiment, found, shown, held_out),
    ]


def _unsolved(experiment: Experiment, found: Identified) -> Iterator[str]:
    """Solvers that failed or fell short."""
    certificate = found.estimate.certificate
    if experiment.config.solver.name == "clarabel" != certificate.name:
        yield f"Clarabel could not solve the problem as it was stated directly; {certificate.name} solved it"
    if stuck := stuck_note(certificate):
        yield stuck
    if unfinished := unfinished_note(certificate):
        yield unfinished


def _unreal(experiment: Experiment, found: Identified) -> Iterator[str]:
    """Bodies that cannot be."""
    unreal = [body.name for body, pi in _bodies(found) if not is_realizable(pi)]
    if unreal:
        yield f"no body can have the parameters of {', '.join(unreal)}: a URDF may not hold them"
    as_given = found.prior is experiment.model.bodies
    moved = moved_priors(experiment.equation, found.prior, found.regularization) if as_given else ()
    if moved:
        yield f"no body can have the prior of {', '.join(moved)}; what is next to it stands in for it"


def _masses(experiment: Experiment, found: Identified) -> Iterator[str]:
    """Masses that leave the prior's by more than a mechanic would believe."""
    measured = experiment.config.known.total_mass
    cure = "" if measured else "; weigh the robot and give known.total_mass"
    prior = sum(float(body.pi[0]) for body in found.prior)
    total = sum(float(pi[0]) for _, pi in _bodies(found))
    if measured is None and prior > 0 and not 1 - _TOTAL < total / prior < 1 + _TOTAL:
        yield f"the total mass is {total:.3g} kg, in the prior {prior:.3g} kg: the logs seldom tell it{cure}"
    far = {
        body.name: f"{pi[0]:.3g} kg for {body.pi[0]:.3g}"
        for body, pi in _bodies(found)
        if body.pi[0] > 0 and not 1 / _HEAVY < pi[0] / body.pi[0] < _HEAVY
    }
    if far:
        masses = " and ".join(list(far.values())[:2])
        yield (
            f"{some(list(far))}: over three times heavier or lighter than in the prior ({masses}): the mass stands in "
            f"for what the model lacks, such as rotors, springs or larger bounding ellipsoids{cure}"
        )


def _shapes(experiment: Experiment, found: Identified) -> Iterator[str]:
    """Bodies that are next to having no extent, or that press against what bounds them."""
    is_firm = experiment.config.regularization.is_automatic and found.regularization.kind == "entropic"
    cure = "" if is_firm else "; leave regularization at its default, entropic and auto"
    thin: dict[str, list[str]] = {}
    for body, pi in _bodies(found):
        flat = int(np.count_nonzero(_gyration(pi) < _THIN * _gyration(body.pi)))
        if flat:
            thin.setdefault(_SHAPES[flat - 1], []).append(body.name)
    for shape, names in thin.items():
        yield (
            f"{some(names)}: nearly a {shape}, as no real link is: the motion does not show the inertia about every "
            f"axis; log one that turns the link about more axes (idtool excite){cure}"
        )
    rim = [body.name for body, pi in _bodies(found) if _at_rim(body, pi) and not _at_rim(body, body.pi)]
    if rim:
        yield (
            f"{some(rim)}: all mass lies at the rim of the bounding ellipsoid: it may be too small, or the mass stands "
            "in for what the model lacks, such as rotors"
        )


def _bodies(found: Identified) -> Iterator[tuple[Body, Array]]:
    """The prior's bodies, and the parameters identified, shape (10,)."""
    for i, body in enumerate(found.prior):
        yield body, found.estimate.theta[SIZE * i : SIZE * (i + 1)]


def _gyration(pi: Array) -> Array:
    """Radii of gyration along the principal axes, the least first, shape (3,) [m]; zero where nothing can have them."""
    if not pi[0] > 0:
        return np.zeros(3)
    J = pseudo_inertia(pi)
    com = J[:3, 3] / J[3, 3]
    covariance = J[:3, :3] / J[3, 3] - np.outer(com, com)
    return np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0))


def _at_rim(body: Body, pi: Array) -> bool:
    """Whether a body's mass can lie nowhere but at the surface of its one bounding ellipsoid (Thm 4)."""
    if len(body.ellipsoids) != 1 or body.shapes:
        return False
    return bool(np.trace(pseudo_inertia(pi) @ body.ellipsoids[0].Q) < _RIM * pi[0])


def _wrong(experiment: Experiment, found: Identified, shown: Evaluation, held_out: bool) -> Iterator[str]:
    """Errors that no noise explains."""
    joints = experiment.equation.joints
    own, prior = (shown.errors[name].rms(joints)["overall"] for name in ("identified", "prior"))
    spread = float(np.sqrt(np.mean(np.square(list(shown.spread.values())))))
    if prior > _ABSURD * spread > 0 and found.prior is experiment.model.bodies:
        yield (
            f"the prior's torque error, {prior:.3g}, is {prior / spread:.0f} times the measured torque: a unit in the "
            "URDF or the configuration may be wrong"
        )
    if held_out and own > prior:
        yield (
            f"the identified model predicts what was held out worse than the URDF does ({own:.3g} against {prior:.3g})"
        )
