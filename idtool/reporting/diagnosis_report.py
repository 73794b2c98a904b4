"""The record of a diagnosis: diagnosis.json."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict

from idtool.common.notice import Notice
from idtool.diagnosis.comparison import Comparison
from idtool.diagnosis.records import Candidate, Diagnosis, DiagnosisStep, EffectProfile, ErrorSummary, ResidualProfile
from idtool.dynamics.effects import effect_from_entry
from idtool.estimation.dataset.kinematic_checks import KINEMATIC_FAULTS
from idtool.reporting.against_report import against_report
from idtool.reporting.diagnosis_text import next_steps, summary
from idtool.reporting.diagnosis_verdict import diagnosis_reasons
from idtool.reporting.fit_report import fit_report, parameter_units
from idtool.reporting.results.base import Source, notice_fields, plain_data
from idtool.reporting.results.diagnosis import (
    CandidateReport,
    DataFault,
    DiagnosisReport,
    EffectProfileReport,
    ErrorLevel,
    Evidence,
    Location,
    PartReport,
    ResidualBins,
    ResidualMap,
    ResidualMaps,
    StepReport,
)
from idtool.reporting.verdict import worst_level
from idtool.robot.model import RobotModel

_MIN_RELATIVE_GAP = 0.05  # of the error before: a gap to the noise floor that is smaller than this is none
_MIN_RELATIVE_INCREASE = 0.02  # of the rollout's error before: how much larger it must be to be called worse


def diagnosis_report(diagnosis: Diagnosis, inertia: str, comparison: Comparison | None = None) -> DiagnosisReport:
    """The content of diagnosis.json.

    Parameters
    ----------
    diagnosis
        The result.
    inertia
        ``refit`` or ``fixed``: whether the inertia was identified anew at every step or taken from the URDF.
    comparison
        The comparison with the simulator that the diagnosis is part of; None: there is none.
    """
    floor = plain_data(diagnosis.floor) if diagnosis.is_floor_known else None
    model = fit_report(diagnosis.last, noise_floor=floor)
    faults = {fault.code for fault in diagnosis.faults}
    warnings = [notice for notice in diagnosis.last.notices if notice.code not in faults.intersection(KINEMATIC_FAULTS)]
    warnings += [*diagnosis.notices, *(comparison.notices if comparison else ())]
    report = DiagnosisReport(
        versions=model.versions,
        inputs=[*model.inputs, *_simulator_inputs(comparison)],
        urdf=model.urdf,
        logs=model.logs,
        joints=model.joints,
        units=model.units,
        inertia=inertia,
        verdict=diagnosis.verdict,
        model_verdict=model.verdict,
        verdict_reasons=model.verdict_reasons,
        searched=diagnosis.searched,
        stopped=diagnosis.stopped,
        before=_level(diagnosis.before),
        after=_level(diagnosis.after),
        noise_floor=floor or dict.fromkeys(diagnosis.floor),
        gap_closed=_gap_closed(diagnosis),
        rollout_worse=_worse_rollouts(diagnosis.before, diagnosis.after),
        steps=[_step(step, diagnosis.last.experiment.model) for step in diagnosis.steps],
        removed=diagnosis.removed,
        data_faults=[_data_fault(fault) for fault in diagnosis.faults],
        samples=model.samples,
        band_hz=model.band_hz,
        friction=model.friction,
        friction_intervals=model.friction_intervals,
        rotors=model.rotors,
        bodies=model.bodies,
        known=model.known,
        solver=model.solver,
        residual_maps=ResidualMaps(
            before={joint: _residual(profile) for joint, profile in diagnosis.maps_before.items()},
            after={joint: _residual(profile) for joint, profile in diagnosis.maps_after.items()},
        ),
        notices=notice_fields([*diagnosis.faults, *warnings])["notices"],
        warnings=notice_fields(warnings)["warnings"],
        against=against_report(comparison) if comparison else None,
        seconds=diagnosis.seconds,
        summary="",
        next=(),
    )
    reasons = diagnosis_reasons(report, model.verdict_reasons, diagnosis.faults)
    verdict = {"model_verdict": worst_level(reasons), "verdict_reasons": reasons}
    report = report.model_copy(update={"summary": summary(report), **verdict})  # of the robot's logs by themselves
    if comparison and comparison.obstacle and report.verdict in ("explained", "no_disagreement"):
        report = report.model_copy(update={"verdict": "partly_explained"})
    return report.model_copy(update={"next": tuple(next_steps(report))})


def _simulator_inputs(comparison: Comparison | None) -> list[Source]:
    """The simulator's logs; URDF and configuration are those of the robot."""
    if comparison is None:
        return []
    read_for_robot = comparison.measured.last.experiment.sources
    inputs = []
    for source in comparison.simulated.last.experiment.sources:
        if source not in read_for_robot:
            inputs.append(Source(kind=f"simulator's {source.kind}", path=source.path, sha256=source.sha256))
    return inputs


def _data_fault(fault: Notice) -> DataFault:
    return DataFault(
        fault=fault.code,
        joint=fault.subject,
        detail=f"{fault.message}; {fault.advice}" if fault.advice else fault.message,
        undone=fault.severity == "note",
    )


def gap_closed(
    before: Mapping[str, float], after: Mapping[str, float], floor: Mapping[str, float]
) -> dict[str, float | None]:
    """(before − after) / (before − floor) by name, at most 1; None where there was next to no gap.

    Below zero, the gap has grown.
    """
    shares: dict[str, float | None] = {}
    for name, error in before.items():
        gap = error - floor[name]
        if gap > _MIN_RELATIVE_GAP * error:
            shares[name] = min((error - after[name]) / gap, 1.0)
        else:
            shares[name] = None
    return shares


def _gap_closed(diagnosis: Diagnosis) -> dict[str, float | None]:
    """`gap_closed` of a diagnosis; None for all joints if there is no gap, or the noise floor is not known."""
    before, after = diagnosis.before.torque, diagnosis.after.torque
    if diagnosis.verdict == "no_disagreement" or not diagnosis.is_floor_known:
        return dict.fromkeys(before)
    return gap_closed(before, after, diagnosis.floor)


def _level(level: ErrorSummary) -> ErrorLevel:
    return ErrorLevel(
        train=plain_data(level.train), validation=plain_data(level.validation), simulation=plain_data(level.simulation)
    )


def _worse_rollouts(before: ErrorSummary, after: ErrorSummary) -> list[str]:
    """Joints, and ``overall``, whose rollouts a change has made worse although the torque of all has become better.

    An error that is not finite is that of rollouts that ran away.
    """
    if before.simulation is None or after.simulation is None or after.torque["overall"] >= before.torque["overall"]:
        return []
    return [
        name
        for name, error in after.simulation.items()
        if math.isfinite(before.simulation[name])
        and not error <= (1 + _MIN_RELATIVE_INCREASE) * before.simulation[name]
    ]


def _candidate(candidate: Candidate) -> CandidateReport:
    return CandidateReport(
        effect=candidate.effect,
        joint=candidate.joint,
        link=candidate.link,
        score=plain_data(candidate.score),
        standard_error=plain_data(candidate.standard_error),
        parameters=candidate.parameters,
        reason=candidate.reason,
    )


def _step(step: DiagnosisStep, model: RobotModel) -> StepReport:
    """One entry of ``steps``."""
    chosen, location = step.chosen, step.location
    return StepReport(
        effect=chosen.effect,
        joint=chosen.joint,
        link=chosen.link,
        parameters=plain_data(step.parameters),
        standard_error=plain_data(step.standard_error),
        units=_units(step, model),
        where=Location(joints=location.joints, windows=plain_data(location.windows), region=location.region),
        evidence=Evidence(
            score=plain_data(chosen.score),
            standard_error=plain_data(chosen.standard_error),
            significance=plain_data(step.significance),
            pair=step.pair,
            separate=step.distinguishing_experiment,
            simulation_before=plain_data(step.before.simulation),
            simulation_after=plain_data(step.after.simulation),
            rollout_worse=_worse_rollouts(step.before, step.after),
            assumed=step.is_assumed,
            sentence=step.sentence,
            doubt=step.doubt,
            parts=tuple(PartReport(**asdict(part)) for part in step.parts),
        ),
        validation_rms_before=plain_data(step.before.torque),
        validation_rms_after=plain_data(step.after.torque),
        alternatives=[_candidate(candidate) for candidate in step.alternatives],
        rejected=[_candidate(candidate) for candidate in step.rejected],
        profile=_profile(step.profile) if step.profile else None,
    )


def _profile(profile: EffectProfile) -> EffectProfileReport:
    return EffectProfileReport(
        joint=profile.joint,
        cause=profile.cause,
        cause_joint=profile.cause_joint,
        period=profile.period,
        in_direction_of_motion=profile.in_direction_of_motion,
        values=plain_data(profile.values),
        before=ResidualBins(mean=plain_data(profile.mean_before), deviation=plain_data(profile.deviation_before)),
        after=ResidualBins(mean=plain_data(profile.mean_after), deviation=plain_data(profile.deviation_after)),
        effect_torque=plain_data(profile.effect_torque),
    )


def _units(step: DiagnosisStep, model: RobotModel) -> dict[str, str | None]:
    """The units of an effect's parameters; None of one that has none."""
    if step.entry is None:
        return dict.fromkeys(step.parameters)
    return parameter_units(effect_from_entry(step.entry, model), step.parameters)


def _residual(residual: ResidualProfile) -> ResidualMap:
    return ResidualMap(**{name: plain_data(getattr(residual, name)) for name in ResidualMap.model_fields})
