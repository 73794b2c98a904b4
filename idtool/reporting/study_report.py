"""A study as plain data for study.json (contract, section 4)."""

from __future__ import annotations

from typing import Any

import numpy as np

from idtool.common.provenance import provenance
from idtool.estimation.problem.estimate import stuck_note
from idtool.estimation.study.learning import Curve
from idtool.estimation.study.study import Study, StudyEntry
from idtool.robot.inequality import Inequality
from idtool.robot.inertia import SIZE


def study_report(study: Study) -> dict[str, Any]:
    """The content of study.json but for its header."""
    experiment, online = study.experiment, study.online
    return {
        **provenance(experiment.sources),
        "joints": list(experiment.equation.joints),
        "units": experiment.model.units,
        "band_hz": experiment.band_hz,
        "samples": {"train": experiment.samples(False), "validation": experiment.samples(True)},
        "sets": {name: _set_report(study, f"set {name}", outcome) for name, outcome in study.sets.items()},
        "estimators": {name: _estimator_report(study, name, outcome) for name, outcome in study.estimators.items()},
        "learning": {
            "counts": study.counts,
            "draws": study.draws,
            "unit_overall": " or ".join(dict.fromkeys(experiment.model.units.values())),
            "curves": {name: _plain(c, "median", "lower", "upper") for name, c in study.curves.items()},
            "advantage": {name: _plain(c, "advantage", "advantage_error") for name, c in study.curves.items()},
            "violation": {name: _plain(c, "violation")["violation"] for name, c in study.curves.items()},
        },
        "adaptation": {
            "t": online.t.tolist(),
            "error": {name: error.tolist() for name, error in online.error.items()},
            "time_to_10_percent": online.settled,
            "forgetting": None,
        },
        "warnings": list(study.warnings),
        "logs": [str(run.signals.log.path) for run in experiment.runs],
        "urdf": str(experiment.model.robot.path),
        "seconds": study.seconds,
    }


def _plain(curve: Curve, *names: str) -> dict[str, list[float | None]]:
    """A curve's values by name; None where no draw was solved."""
    return {name: [x if np.isfinite(x) else None for x in getattr(curve, name).tolist()] for name in names}


def _rms(study: Study, name: str) -> dict[str, dict[str, float]]:
    joints = study.experiment.equation.joints
    parts = {"train": study.train, "validation": study.validation}
    return {part: evaluation.errors[name].rms(joints) for part, evaluation in parts.items()}


def _set_report(study: Study, name: str, outcome: StudyEntry) -> dict[str, Any]:
    certificate, bodies = outcome.certificate, study.experiment.model.bodies
    bounded = [(s, b) for s, b in zip(outcome.sets, bodies, strict=True) if f"set {s.name}" == name]
    forms = [_form(inequality) for inequality in bounded[0][0].pieces(bounded[0][1])[0].inequalities]
    return {
        "rms": _rms(study, name),
        "seconds": outcome.seconds,
        "objective": certificate.objective,
        "duality_gap": certificate.duality_gap,
        "iterations": certificate.iterations,
        "lmi": ", ".join(forms) or "none",
        "violations": int(np.count_nonzero(outcome.least < 0)),
        "worst_margin": float(outcome.least.min()),
        "masses": {body.name: float(outcome.theta[SIZE * i]) for i, body in enumerate(bodies)},
    }


def _form(inequality: Inequality) -> str:
    n = inequality.G.shape[-1]
    return f"{n}×{n}" if inequality.G.ndim == 3 else f"{n} linear"


def _estimator_report(study: Study, name: str, outcome: StudyEntry) -> dict[str, Any]:
    certificate = outcome.certificate
    return {
        "rms": _rms(study, name),
        "seconds": outcome.seconds,
        "duality_gap": certificate.duality_gap,
        "iterations": certificate.iterations,
        "status": certificate.status,
        "note": stuck_note(certificate),
    }
