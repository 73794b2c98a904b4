"""A designed trajectory as plain data for JSON and its page."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.common.names import some
from idtool.estimation.uncertainty.base_parameters import BaseParameters
from idtool.excitation.design import Design
from idtool.excitation.limits import QUANTITIES
from idtool.excitation.task import Task
from idtool.reporting.trust_report import combination_name, quantity, terms_report
from idtool.robot.inertia import SIZE

_CURVE = 500  # instants of each curve
_TINY = 1e-3  # of a base parameter's size: a prior that small is none to compare with
_ROUNDING = 1e-9  # of its size
_LARGE = 1.0  # relative standard error from which a parameter is as good as unknown


def excite_report(design: Design) -> dict[str, Any]:
    """The content of the JSON but for its header, the command's inputs and outputs."""
    task, trajectory = design.task, design.trajectory
    names = [part.pattern.name for part in trajectory.parts]
    starts = trajectory.starts.tolist()
    return {
        "joints": list(task.model.names),
        "units": task.model.units,
        "duration": trajectory.seconds,
        "rate_hz": task.rate,
        "highest_hz": design.highest,
        "parts": [
            {"pattern": name, "start": start, "end": end}
            for name, start, end in zip(names, starts[:-1], starts[1:], strict=True)
        ],
        "home": _by_joint(task, trajectory.parts[0].pattern.home),
        "noise": _by_joint(task, task.noise),
        "criterion": task.aim.criterion,
        "criteria": {
            name: {kind: _finite(value) for kind, value in values.items()} for name, values in design.criteria.items()
        },
        "base_parameters": _base_parameters(design),
        **_coefficients(design),
        "limits": {joint: _limits(task, j) for j, joint in enumerate(task.model.names)},
        "use": {
            joint: dict(zip(QUANTITIES, design.use[:, j].tolist(), strict=True))
            for j, joint in enumerate(task.model.names)
        },
        "clearance": _clearance(design),
        "evaluations": design.evaluations,
        "interrupted": design.interrupted,
        "curves": _curves(design),
        "warnings": _warnings(design),
    }


def _finite(x: float) -> float | None:
    return float(x) if math.isfinite(x) else None


def _by_joint(task: Task, values: Array) -> dict[str, float]:
    return dict(zip(task.model.names, values.tolist(), strict=True))


def _base_parameters(design: Design) -> list[dict[str, Any]]:
    task, base = design.task, design.task.base
    coefficients = task.equation.coefficients
    prior = base.B @ task.theta
    chosen = len(task.aim.favoured) < len(base)
    found = []
    for i, own in enumerate(base.own):
        error = float(design.errors.base[i])
        before = float(design.logged_errors.base[i]) if design.logged_errors else math.inf
        comparable = abs(prior[i]) > _TINY * task.size[i]
        value = float(prior[i]) if abs(prior[i]) > _ROUNDING * task.size[i] else 0.0
        found.append(
            {
                "name": combination_name(base, i, coefficients),
                "terms": terms_report(base, i, coefficients),
                "unit": coefficients[own].unit,
                "prior": value,
                "standard_error": _finite(error),
                "relative": _finite(error / abs(prior[i])) if comparable else None,
                "logged_standard_error": _finite(before),
                "favoured": bool(chosen and i in task.aim.favoured),
            }
        )
    return found


def _coefficients(design: Design) -> dict[str, Any]:
    """Standard errors of bodies' parameters and of friction and other terms, None for what no motion tells alone."""
    task, errors = design.task, design.errors.coefficients
    bodies = {
        body.name: {"standard_error": [_finite(x) for x in errors[SIZE * i : SIZE * (i + 1)]]}
        for i, body in enumerate(task.model.bodies)
    }
    terms: dict[str, dict[str, Any]] = {}
    for c, error in list(zip(task.equation.coefficients, errors, strict=True))[SIZE * len(bodies) :]:
        terms.setdefault(c.owner, {})[c.name] = {"prior": c.prior, "standard_error": _finite(error), "unit": c.unit}
    return {"bodies": bodies, "terms": terms}


def _limits(task: Task, j: int) -> dict[str, Any]:
    full = task.full
    return {
        "position": [float(full.lower[j]), float(full.upper[j])],
        "velocity": float(full.velocity[j]),
        "acceleration": float(full.acceleration[j]),
        "effort": _finite(full.effort[j]),
    }


def _clearance(design: Design) -> dict[str, Any] | None:
    if design.nearest is None:
        return None
    links, distance, at = design.nearest
    return {"links": list(links), "distance": _finite(distance), "t": at, "wanted": design.task.clearance}


def _curves(design: Design) -> dict[str, Any]:
    """The motion and its predicted torque at a few instants."""
    task, trajectory = design.task, design.trajectory
    t = np.linspace(0, trajectory.seconds, _CURVE)
    samples = trajectory.at(t)
    curves = (*samples, task.torque(samples, t))
    return {
        "t": t.tolist(),
        "joints": {
            joint: {name: x[j].tolist() for name, x in zip(("q", "v", "a", "tau"), curves, strict=True)}
            for j, joint in enumerate(task.model.names)
        },
    }


def _warnings(design: Design) -> list[str]:
    """What a user should know, a plain sentence each."""
    task = design.task
    said = [*task.model.warnings, *task.full.notes]
    if task.noise_assumed:
        said.append(f"torque noise is not known; 1 % of the largest torque is taken: {some(task.noise_assumed)}")
    if task.collision is None or not task.collision.pairs:
        said.append("no geometry of links that could collide was found: self-collision was not checked")
    said += task.collision.warnings if task.collision else ()
    untold = untold_names(design, task.base)
    if untold:
        said.append(f"as good as untold by this trajectory: {some(untold)}; make it longer, or choose another pattern")
    if design.interrupted:
        said.append("the search was interrupted: this is the best trajectory so far")
    return said


def untold_names(design: Design, base: BaseParameters) -> list[str]:
    """The base parameters whose standard error is larger than their size, by their own coefficients' names."""
    coefficients = design.task.equation.coefficients
    large = design.errors.base > _LARGE * design.task.size
    return [quantity(coefficients[own]) for own, untold in zip(base.own, large, strict=True) if untold]
