"""The record of an online identification: adapt.json."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.notice import Notice
from idtool.dynamics.effects import friction_types
from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.online.adapt import Adaptation
from idtool.reporting.results.adaptation import (
    AdaptationReport,
    AdaptedBody,
    AdaptedFriction,
    CoefficientReport,
    FinalEstimate,
)
from idtool.reporting.results.base import notice_fields, plain_data, provenance_fields
from idtool.robot.inertia import PI_SIZE, is_realizable, mass_com_inertia, symmetric_entries


def adaptation_report(
    adaptation: Adaptation, experiment: Experiment, notices: Sequence[Notice] = ()
) -> AdaptationReport:
    """The content of adapt.json.

    Parameters
    ----------
    adaptation
        The parameters over time.
    experiment
        Model and data.
    notices
        What a user should know.
    """
    equation, bodies = experiment.equation, experiment.model.bodies
    theta = adaptation.estimate
    return AdaptationReport(
        **provenance_fields(experiment.sources),
        joints=equation.joints,
        units=experiment.model.units,
        bodies=[body.name for body in bodies],
        coefficients=[
            CoefficientReport(effect=c.effect, owner=c.owner, name=c.name, unit=c.unit) for c in equation.coefficients
        ],
        constraints={body.name: kind.name for body, kind in zip(bodies, adaptation.sets, strict=True)},
        forgetting=adaptation.forgetting if np.isfinite(adaptation.forgetting) else None,
        band_hz=experiment.band_hz,
        t=adaptation.t.tolist(),
        theta=adaptation.theta.tolist(),
        prediction_rms=plain_data(adaptation.prediction_rms(equation.joints)),
        final=FinalEstimate(
            bodies={body.name: _body(theta[PI_SIZE * i : PI_SIZE * (i + 1)]) for i, body in enumerate(bodies)},
            friction={joint: _friction(theta, experiment, joint) for joint in experiment.model.joint_names},
        ),
        samples=adaptation.samples,
        update_hz=adaptation.update_hz,
        seconds=adaptation.seconds,
        **notice_fields(notices),
        logs=[str(run.signals.log.path) for run in experiment.runs],
        urdf=str(experiment.model.robot.path),
    )


def _body(pi: Array) -> AdaptedBody:
    mass, com, inertia = mass_com_inertia(pi)
    return AdaptedBody(
        mass=mass,
        com=com.tolist(),
        inertia_com=symmetric_entries(inertia).tolist(),
        pi=pi.tolist(),
        realizable=is_realizable(pi),
    )


def _friction(theta: Array, experiment: Experiment, joint: str) -> AdaptedFriction:
    inertial = PI_SIZE * len(experiment.model.bodies)
    pairs = zip(experiment.equation.coefficients[inertial:], theta[inertial:], strict=True)
    own = {c.effect: float(value) for c, value in pairs if c.owner == joint}
    return AdaptedFriction(**{key: own.get(kind.id) for key, kind in friction_types().items()})
