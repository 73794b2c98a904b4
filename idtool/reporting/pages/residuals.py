"""What a diagnosis draws: the gap closing step by step, and what the models leave, by state and frequency."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idtool.common.arrays import Array
from idtool.diagnosis.records import ResidualProfile
from idtool.reporting.diagnosis_words import UNKNOWN, effect_name, on, position_units, together
from idtool.reporting.pages.charts import significant
from idtool.reporting.results.diagnosis import DiagnosisReport, ErrorLevel

_MOST_VALUES = 16_000  # that all residuals hold together: some 130 kB of text
_LEAST_POINTS = 12  # of a curve
_MOST_POINTS = 200
_CURVES = 38  # of a joint: 2 models, each with 5 views of 3 and 2 spectra of 2
_AXES = {
    "position": "position [{q}]",
    "velocity": "velocity [{q}/s]",
    "acceleration": "acceleration [{q}/s²]",
    "torque": "torque [{tau}]",
    "time": "time [s]",
}


def gap_views(report: DiagnosisReport) -> dict[str, Any]:
    """What is drawn of the gap: errors by step, for all joints together and for each.

    Parameters
    ----------
    report
        The content of diagnosis.json.

    Returns
    -------
    ``names`` of the models, the first the one without effects, and ``joints``: of each ``name``, and of its ``torque``
    and ``rollout`` (None where there was none) the ``unit`` and ``values``; of its torque the noise ``floor`` too.
    """
    steps = [(i, step) for i, step in enumerate(report.steps, 1) if step.effect != UNKNOWN]
    names = ["the model given", *(f"{i}: {effect_name(step.effect)} on {on(step)}" for i, step in steps)]
    first, last = report.before, report.after
    torques = [_held_out(first), *(step.validation_rms_after for _, step in steps)]
    rollouts = [first.simulation, *(step.evidence.simulation_after for _, step in steps)]
    if len(names) > 1 and torques[-1] != _held_out(last):  # what came to be superfluous was taken out again
        names, torques = [*names, "in the end"], [*torques, _held_out(last)]
        rollouts.append(last.simulation)
    units = {"overall": together(report.units), **report.units}
    lengths = {"overall": together(position_units(report.units)), **position_units(report.units)}
    views = []
    for joint, unit in units.items():
        floor = significant([report.noise_floor[joint]])[0]
        moved = significant([rms[joint] if rms else None for rms in rollouts])
        views.append(
            {
                "name": "all joints" if joint == "overall" else joint,
                "torque": {"unit": unit, "values": significant([rms[joint] for rms in torques]), "floor": floor},
                "rollout": {"unit": lengths[joint], "values": moved} if any(rollouts) else None,
            }
        )
    return {"names": names, "joints": views}


def _held_out(level: ErrorLevel) -> Mapping[str, float | None]:
    return level.validation or level.train


def residual_views(
    before: Mapping[str, ResidualProfile],
    after: Mapping[str, ResidualProfile],
    units: Mapping[str, str],
    names: tuple[str, str],
    of: str,
) -> dict[str, Any]:
    """What is drawn of the residuals of two models, of bounded size.

    Parameters
    ----------
    before, after
        Theirs, by joint.
    units
        Unit of the torque, by joint.
    names
        What the two are called.
    of
        The same, in a sentence.

    Returns
    -------
    ``names``, by ``before`` and ``after``, ``of``, and ``joints``: of each its ``name`` and ``views``, each with the
    titles ``x`` and ``y``, whether y is on a logarithmic axis (``log``), and of the models ``before`` and ``after`` the
    ``at`` and, as far as there are, ``mean`` and ``rms``.
    """
    joints = [joint for joint in units if joint in before and joint in after]
    points = min(max(_MOST_VALUES // max(_CURVES * len(joints), 1), _LEAST_POINTS), _MOST_POINTS)
    views = [{"name": joint, "views": _views(before[joint], after[joint], units[joint], points)} for joint in joints]
    return {"names": dict(zip(("before", "after"), names, strict=True)), "of": of, "joints": views}


def _views(before: ResidualProfile, after: ResidualProfile, tau: str, points: int) -> list[dict[str, Any]]:
    models = {"before": before, "after": after}
    q = position_units({"": tau})[""]
    binned: list[dict[str, Any]] = [
        {
            "x": _AXES.get(name, name).format(q=q, tau=tau),
            "y": f"residual [{tau}]",
            "log": False,
            **{
                model: _binned(residual, name, points) for model, residual in models.items() if name in residual.against
            },
        }
        for name in before.against
    ]
    turn = "periods per turn" if q == "rad" else "periods per 2π m"
    spectra: list[dict[str, Any]] = [
        {"x": "frequency [Hz]", "y": f"residual [{tau}/√Hz]", "log": True}
        | {model: _peaks(of.frequency, of.density, points) for model, of in models.items()},
        {"x": turn, "y": f"residual [{tau}]", "log": False}
        | {model: _peaks(of.angle, of.amplitude, points) for model, of in models.items()},
    ]
    views = [view for view in (*binned, *spectra) if view["before"]["at"]]
    return [{"after": {"at": [], "rms": []}, **view} for view in views]


def _binned(residual: ResidualProfile, name: str, points: int) -> dict[str, list[float | None]]:
    kept = _largest(residual.rms[name], points)
    columns = {"at": residual.against[name], "mean": residual.mean[name], "rms": residual.rms[name]}
    return {key: significant(values[kept].tolist()) for key, values in columns.items()}


def _peaks(at: Array, height: Array, points: int) -> dict[str, list[float | None]]:
    """A spectrum; of lines that are too many, the highest of every few."""
    kept = _largest(height, points)
    return {"at": significant(at[kept].tolist()), "rms": significant(height[kept].tolist())}


def _largest(x: Array, points: int) -> NDArray[np.int64]:
    """Indices of at most so many values: of every few that lie beside each other, the largest."""
    if len(x) <= points:
        return np.arange(len(x))
    edges = np.linspace(0, len(x), points + 1).astype(int)
    found = np.nan_to_num(x, nan=-np.inf)
    return np.array([low + int(np.argmax(found[low:high])) for low, high in itertools.pairwise(edges)])
