"""A made-up diagnosis of the sample leg: real fits, and invented candidates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from commands import LEG, csv_text, sample_table

from idtool.common.notice import Notice
from idtool.diagnosis.records import (
    Candidate,
    Diagnosis,
    DiagnosisStep,
    EffectProfile,
    ErrorSummary,
    ResidualLocation,
    ResidualProfile,
)
from idtool.estimation.dataset.experiment import prepare
from idtool.estimation.fit import Fit, fit
from idtool.robot.config import Config, EffectEntry, read_config
from idtool.robot.urdf.reading import read_robot

STRIBECK = EffectEntry(effect="stribeck_friction", joint="hip", parameters={"stribeck": 0.0, "velocity": 0.15})
DELAY = EffectEntry(effect="time_delay", parameters={"delay": 0.005})
BEHIND = 'a <b>"&{{ 7 * 7 }}'


PROFILE = EffectProfile(
    joint="hip",
    cause="velocity",
    cause_joint="hip",
    period=None,
    in_direction_of_motion=False,
    values=np.array([-1.0, -0.1, 0.1, 1.0]),
    mean_before=np.array([0.1, -0.9, 0.9, -0.1]),
    deviation_before=np.array([0.1, 0.3, 0.3, 0.1]),
    mean_after=np.array([0.0, 0.01, -0.01, 0.0]),
    deviation_after=np.array([0.1, 0.2, 0.2, 0.1]),
    effect_torque=np.array([0.0, -1.2, 1.2, 0.0]),
)


def fits(folder: Path) -> tuple[Fit, Fit]:
    """The leg fitted to a short log without and with effects, and run forwards."""
    (folder / "log.csv").write_text(csv_text(sample_table(3000)))
    config = read_config(LEG.with_suffix(".yaml"))
    return _fit(folder, config), _fit(folder, config.model_copy(update={"effects": (STRIBECK, DELAY)}))


def _fit(folder: Path, config: Config) -> Fit:
    experiment = prepare(read_robot(LEG), config, [folder / "log.csv"])
    return fit(experiment, lambda stage, share: None, simulate=True)


def level(*values: float, simulated: float | None = 0.03) -> ErrorSummary:
    """Errors of the three joints; those held out are a tenth larger."""
    return ErrorSummary(_rms(*values), _rms(*(1.1 * x for x in values)), simulated and _rms(*(simulated,) * 3))


def _rms(*values: float) -> dict[str, float]:
    named = dict(zip(("abad", "hip", "knee"), values, strict=True))
    return {**named, "overall": float(np.sqrt(np.mean(np.square(values))))}


def candidate(effect: str, joint: str | None = "hip", score: float = 0.4, reason: str = "") -> Candidate:
    """One that was tried."""
    return Candidate(effect, joint, None, score, 0.03, 2, reason)


def step_of(**changes: Any) -> DiagnosisStep:
    """Stribeck friction on the hip, which the data cannot tell from load-dependent friction."""
    contents: dict[str, Any] = {
        "chosen": candidate("stribeck_friction", score=0.64),
        "entry": STRIBECK,
        "parameters": {"stribeck": 1.9123, "velocity": 0.15},
        "standard_error": {"stribeck": 0.2, "velocity": None},
        "location": ResidualLocation(("hip",), ((1.25, 2.5), (4.0, 4.5)), "below 0.15 rad/s"),
        "significance": 21.0,
        "pair": True,
        "distinguishing_experiment": "slow strokes of the hip with and without a load",
        "alternatives": (candidate("load_dependent_friction", score=0.6, reason="explains less"),),
        "rejected": (candidate("backlash", score=0.1, reason="within two standard errors of zero"),),
        "before": level(0.2, 1.3, 0.4),
        "after": level(0.2, 0.6, 0.4, simulated=0.012),
        "sentence": "Friction rises below 0.15 rad/s",
        "profile": PROFILE,
    }
    step = DiagnosisStep(**{**contents, **changes})
    if "chosen" not in changes or "entry" in changes:
        return step
    given = {name: x.tolist() if isinstance(x, np.ndarray) else x for name, x in step.parameters.items()}
    entry = EffectEntry(effect=step.chosen.effect, joint=step.chosen.joint, link=step.chosen.link, parameters=given)
    return replace(step, entry=entry)


def unknown_of(before: ErrorSummary) -> DiagnosisStep:
    """What is left on the knee."""
    where = ResidualLocation(("knee",), (), "near the upper end of its travel")
    alone = {
        "profile": None,
        "pair": False,
        "distinguishing_experiment": "",
        "alternatives": (),
        "rejected": (),
        "significance": 9.0,
    }
    return step_of(
        chosen=candidate("unknown", "knee", score=0.0),
        entry=None,
        parameters={},
        standard_error={},
        location=where,
        before=before,
        after=before,
        sentence="Something structured is left",
        **alone,
    )


def residual(scale: float, points: int = 30, lines: int = 1000) -> ResidualProfile:
    """A residual that grows with what it is drawn against, with one line in each spectrum."""
    names = ("position", "velocity", "torque", "time")
    at = np.linspace(-1, 1, points)
    x = np.linspace(0.5, 40, lines)
    peaks = np.full(lines, 0.01 * scale)
    peaks[lines // 3] = scale
    every: Callable[[Any], Mapping[str, Any]] = lambda values: dict.fromkeys(names, values)  # noqa: E731
    return ResidualProfile(every(at), every(scale * at), every(scale * np.abs(at)), x, peaks, x, peaks)


def diagnosis_of(first: Fit, last: Fit, *steps: DiagnosisStep, **changes: Any) -> Diagnosis:
    """A diagnosis with these steps."""
    joints = first.experiment.equation.joints
    contents: dict[str, Any] = {
        "first": first,
        "last": last,
        "faults": (),
        "steps": steps,
        "removed": (),
        "before": steps[0].before if steps else level(0.2, 0.6, 0.4),
        "after": steps[-1].after if steps else level(0.2, 0.6, 0.4),
        "floor": _rms(0.2, 0.5, 0.4),
        "is_floor_known": True,
        "verdict": "explained" if steps else "no_disagreement",
        "searched": None,
        "stopped": "",
        "maps_before": {joint: residual(1.0) for joint in joints},
        "maps_after": {joint: residual(0.2) for joint in joints},
        "notices": (),
        "seconds": 3.21,
    }
    return Diagnosis(**{**contents, **changes})


def faulty(diagnosis: Diagnosis) -> Diagnosis:
    """The same with all that can be said against it, in words that a stranger may choose."""
    left = unknown_of(diagnosis.after)
    return replace(
        diagnosis,
        faults=(Notice("velocity_lag", "problem", "hip", BEHIND, BEHIND),),
        steps=(*diagnosis.steps, left),
        removed=(BEHIND,),
        notices=(Notice("effect_doubtful", "warning", None, BEHIND),),
        verdict="partly_explained",
    )
