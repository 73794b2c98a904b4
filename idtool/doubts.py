"""What speaks against an identified model, in words."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from idtool.experiment import Experiment
from idtool.identify import Estimate, stuck_note
from idtool.inertia import SIZE, pseudo_inertia
from idtool.names import some
from idtool.prior import moved_priors
from idtool.validation import Evaluation

Array = NDArray[np.float64]

_HEAVY = 3.0  # times its mass in the URDF, of a body that outweighs the whole robot in the URDF
_ABSURD = 30.0  # times the measured torque's spread, of the prior's error


def doubts(experiment: Experiment, estimate: Estimate, shown: Evaluation, held_out: bool) -> list[str]:
    """What a user should know before he believes an estimate, a plain sentence each.

    Parameters
    ----------
    experiment
        Model and data.
    estimate
        The estimate.
    shown
        Errors of the ``identified`` and the ``prior`` model.
    held_out
        Whether on what was held out.
    """
    return [*_unreal(experiment, estimate), *_heavy(experiment, estimate), *_wrong(experiment, shown, held_out)]


def _unreal(experiment: Experiment, estimate: Estimate) -> Iterator[str]:
    """Bodies that cannot be."""
    bodies = experiment.model.bodies
    if stuck := stuck_note(estimate.certificate):
        yield stuck
    unreal = [body.name for i, body in enumerate(bodies) if not _can_be(estimate.theta[SIZE * i : SIZE * (i + 1)])]
    if unreal:
        yield f"no body can have the parameters of {', '.join(unreal)}: a URDF may not hold them"
    if moved := moved_priors(experiment.equation, bodies, experiment.config.regularization):
        yield f"no body can have the prior of {', '.join(moved)}; what is next to it stands in for it"


def _heavy(experiment: Experiment, estimate: Estimate) -> Iterator[str]:
    """Links that outweigh the robot."""
    bodies = experiment.model.bodies
    whole = sum(float(body.pi[0]) for body in bodies)
    masses = [float(estimate.theta[SIZE * i]) for i in range(len(bodies))]
    heavy = {
        body.name: mass
        for body, mass in zip(bodies, masses, strict=True)
        if body.kind == "link" and mass > max(whole, _HEAVY * body.pi[0]) > 0
    }
    if heavy:
        weights = " and ".join(f"{mass:.3g} kg" for mass in list(heavy.values())[:2])
        yield (
            f"{some(heavy)}: heavier than the whole robot in the URDF ({weights}, against {whole:.3g} kg): the logs do "
            "not tell the mass, or it stands in for what the model lacks, such as rotors or springs"
        )


def _wrong(experiment: Experiment, shown: Evaluation, held_out: bool) -> Iterator[str]:
    """Errors that no noise explains."""
    joints = experiment.equation.joints
    own, prior = (shown.errors[name].rms(joints)["overall"] for name in ("identified", "prior"))
    spread = float(np.sqrt(np.mean(np.square(list(shown.spread.values())))))
    if prior > _ABSURD * spread > 0:
        yield (
            f"the prior's torque error, {prior:.3g}, is {prior / spread:.0f} times the measured torque: a unit in the "
            "URDF or the configuration may be wrong"
        )
    if held_out and own > prior:
        yield (
            f"the identified model predicts what was held out worse than the URDF does ({own:.3g} against {prior:.3g})"
        )


def _can_be(pi: Array) -> bool:
    return bool(np.linalg.eigvalsh(pseudo_inertia(pi))[0] > 0)
