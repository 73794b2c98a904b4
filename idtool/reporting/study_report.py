"""The record of a study: study.json."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from idtool.common.arrays import Array
from idtool.common.notice import Notice
from idtool.common.units import units_text
from idtool.estimation.problem.estimate import stuck_note
from idtool.estimation.study.study import Study, StudyEntry
from idtool.reporting.results.base import SampleCounts, notice_fields, plain_data, provenance_fields
from idtool.reporting.results.study import (
    Advantage,
    Convergence,
    EstimatorReport,
    LearningCurve,
    LearningCurves,
    SetReport,
    StudyErrors,
    StudyReport,
)
from idtool.robot.inequality import Inequality
from idtool.robot.inertia import PI_SIZE


def study_report(study: Study) -> StudyReport:
    """The content of study.json."""
    experiment, online = study.experiment, study.online
    return StudyReport(
        **provenance_fields(experiment.sources),
        joints=experiment.equation.joints,
        units=experiment.model.units,
        band_hz=experiment.band_hz,
        samples=SampleCounts(train=experiment.samples(held_out=False), validation=experiment.samples(held_out=True)),
        sets={name: _set_report(study, f"set {name}", outcome) for name, outcome in study.sets.items()},
        estimators={name: _estimator_report(study, name, outcome) for name, outcome in study.estimators.items()},
        learning=LearningCurves(
            counts=study.counts,
            draws=study.draws,
            unit_overall=units_text(experiment.model.units),
            curves={
                name: LearningCurve(
                    median=_finite_or_none(c.median), lower=_finite_or_none(c.lower), upper=_finite_or_none(c.upper)
                )
                for name, c in study.curves.items()
            },
            advantage={
                name: Advantage(
                    advantage=_finite_or_none(c.advantage), advantage_error=_finite_or_none(c.advantage_error)
                )
                for name, c in study.curves.items()
            },
            violation={name: _finite_or_none(c.violation) for name, c in study.curves.items()},
        ),
        adaptation=Convergence(
            t=online.t.tolist(),
            error={name: error.tolist() for name, error in online.error.items()},
            time_to_10_percent=online.settled,
            forgetting=None,
        ),
        **notice_fields([*_not_certified(study), *study.notices]),
        logs=[str(path) for path in experiment.log_paths],
        urdf=str(experiment.model.robot.path),
        seconds=study.seconds,
    )


def _not_certified(study: Study) -> Iterator[Notice]:
    """Notices about estimators whose cost is not certified to be the least."""
    for outcome in study.estimators.values():
        if message := stuck_note(outcome.certificate):
            yield Notice("not_certified", "warning", None, message)


def _finite_or_none(values: Array) -> list[float | None]:
    """A curve's values; None where no draw was solved."""
    return [x if np.isfinite(x) else None for x in values.tolist()]


def _rms(study: Study, name: str) -> StudyErrors:
    joints = study.experiment.equation.joints
    return StudyErrors(
        train=plain_data(study.train.errors[name].rms(joints)),
        validation=plain_data(study.validation.errors[name].rms(joints)),
    )


def _set_report(study: Study, name: str, outcome: StudyEntry) -> SetReport:
    certificate, bodies = outcome.certificate, study.experiment.model.bodies
    bounded = [(s, b) for s, b in zip(outcome.sets, bodies, strict=True) if f"set {s.name}" == name]
    forms = [_inequality_size(inequality) for inequality in bounded[0][0].pieces(bounded[0][1])[0].inequalities]
    return SetReport(
        rms=_rms(study, name),
        seconds=outcome.seconds,
        objective=certificate.objective,
        duality_gap=certificate.duality_gap,
        iterations=certificate.iterations,
        lmi=", ".join(forms) or "none",
        violations=int(np.count_nonzero(outcome.least < 0)),
        worst_margin=float(outcome.least.min()),
        masses={body.name: float(outcome.theta[PI_SIZE * i]) for i, body in enumerate(bodies)},
    )


def _inequality_size(inequality: Inequality) -> str:
    n = inequality.G.shape[-1]
    return f"{n}×{n}" if inequality.G.ndim == 3 else f"{n} linear"


def _estimator_report(study: Study, name: str, outcome: StudyEntry) -> EstimatorReport:
    certificate = outcome.certificate
    return EstimatorReport(
        rms=_rms(study, name),
        seconds=outcome.seconds,
        duality_gap=certificate.duality_gap,
        iterations=certificate.iterations,
        status=certificate.status,
        note=stuck_note(certificate),
    )
