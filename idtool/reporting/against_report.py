"""The record of a robot against its simulator: `against` of diagnosis.json."""

from __future__ import annotations

from dataclasses import asdict

from idtool.common.units import common_unit
from idtool.data.pairing import LogPair
from idtool.diagnosis.comparison import Change, Comparison, Quantity
from idtool.reporting.diagnosis_text import against_summary
from idtool.reporting.fit_report import effect_report
from idtool.reporting.results.base import plain_data
from idtool.reporting.results.diagnosis import AgainstReport, ChangeReport, ComparedParameter, LogPairReport


def against_report(comparison: Comparison) -> AgainstReport:
    """The content of `against`."""
    simulator = comparison.simulated.last
    entries = simulator.experiment.config.effects
    report = AgainstReport(
        pairs=[_pair(pair) for pair in comparison.pairs],
        changes=[_change(change) for change in comparison.changes],
        unchanged=[_change(change) for change in comparison.unchanged],
        torque_before=plain_data(comparison.before.torque),
        torque_after=plain_data(comparison.after.torque),
        position_before=plain_data(comparison.before.position),
        position_after=plain_data(comparison.after.position),
        simulator_rms=plain_data(comparison.simulated.after.torque),
        simulator_effects=[effect_report(simulator, entry) for entry in entries],
        inconclusive=comparison.obstacle.reason if comparison.obstacle else "",
        advice=comparison.obstacle.advice if comparison.obstacle else "",
        summary="",
    )
    unit = common_unit(simulator.experiment.model.units)
    measured = comparison.measured
    stopped = measured.stopped or comparison.simulated.stopped
    floor = measured.floor["overall"] if measured.is_floor_known else None
    sentences = against_summary(report, unit, floor, stopped)
    return report.model_copy(update={"summary": sentences})


def _pair(pair: LogPair) -> LogPairReport:
    return LogPairReport(
        log=str(pair.measured),
        simulation=str(pair.simulated),
        offset=pair.offset,
        seconds=pair.seconds,
        torque_rms=plain_data(pair.torque),
        position_rms=plain_data(pair.position),
    )


def _change(change: Change) -> ChangeReport:
    return ChangeReport(
        effect=change.effect,
        joint=change.joint,
        link=change.link,
        parameters={name: _parameter(quantity) for name, quantity in change.quantities.items()},
        share=plain_data(change.share),
        reason=change.reason,
    )


def _parameter(quantity: Quantity) -> ComparedParameter:
    values = asdict(quantity)
    return ComparedParameter(
        simulator=plain_data(values["simulator"]),
        simulator_standard_error=plain_data(values["simulator_error"]),
        robot=plain_data(values["robot"]),
        robot_standard_error=plain_data(values["robot_error"]),
        unit=values["unit"],
    )
