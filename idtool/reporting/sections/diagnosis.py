"""The sections of a diagnosis: its steps, the errors before and after, and the other candidates."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from typing_extensions import override

from idtool.common.dataclass import dataclass
from idtool.common.names import is_or_are
from idtool.common.number_text import number, parameter_text, with_error
from idtool.common.units import common_unit, position_units
from idtool.reporting.diagnosis_text import UNKNOWN, effect_name, owner_name, worse_motion
from idtool.reporting.number_text import percent
from idtool.reporting.results.base import ByJointOrNone
from idtool.reporting.results.diagnosis import CandidateReport, DiagnosisReport, StepReport
from idtool.reporting.sections.base import (
    NO_VALUE,
    Cell,
    Column,
    Emphasis,
    Section,
    Table,
    name_column,
    number_cell,
    percent_cell,
)

_MIN_SCORE = 5e-4  # a share that is shown as 0
_MAX_INCREASE = 1.02  # times the torque error before
_NO_REASON = "the chosen effect explains more, is simpler, or is more likely"
_EXPLAINED = "Percentage of the mean square residual that the effect removes on data not used for fitting"


class StepsSection(Section[DiagnosisReport]):
    """The effects that were added to the model, in order."""

    title = "Effects that the model lacks, step by step; errors before → after each step"

    @override
    def table(self, report: DiagnosisReport) -> Table | None:
        steps = [(i, step) for i, step in enumerate(report.steps, 1) if step.effect != UNKNOWN]
        if not steps:
            return None
        data = "held-out torque" if report.before.validation else "torque"
        columns = [
            name_column("step"),
            Column("effect", kind="words"),
            Column("on", kind="words", attached=True),
            Column("parameters", kind="words"),
            Column(f"{data} error, {common_unit(report.units)}"),
            Column(
                f"simulation error, {common_unit(position_units(report.units))}",
                help="Position error of the simulation, of the model before and after this step",
            ),
            Column("residual explained", help=_EXPLAINED),
            Column("explained / se", help="Residual explained, divided by its standard error", attached=True),
            Column("alternative", kind="words", help="Effect that the data cannot distinguish from this one"),
        ]
        rows = []
        for i, step in steps:
            evidence = step.evidence
            rival = step.alternatives[0] if evidence.pair and step.alternatives else None
            simulation = change_text(evidence.simulation_before, evidence.simulation_after)
            worse: Emphasis | None = None
            if worse_motion(step):
                simulation += " (worse)"
                worse = "bad"
            row = [
                Cell(str(i)),
                Cell(effect_name(step.effect)),
                Cell(owner_name(step)),
                Cell.of_lines(parameter_texts(step)),
                Cell(change_text(step.validation_rms_before, step.validation_rms_after)),
                Cell(simulation, None, worse),
                Cell(score_text(evidence.score, evidence.standard_error), evidence.score),
                number_cell(evidence.significance, 2),
                Cell(f"{effect_name(rival.effect)} on {owner_name(rival)}" if rival else ""),
            ]
            rows.append(row)
        return Table(self.title, columns, rows)


class ErrorsBeforeAfterSection(Section[DiagnosisReport]):
    """Errors by joint, before, after and at the noise floor."""

    title = "Errors before and after"
    template = "diagnosis_gap.html"
    parts = (StepsSection(),)

    @override
    def table(self, report: DiagnosisReport) -> Table:
        is_held_out = report.before.validation is not None
        before = report.before.torque
        after = report.after.torque
        rollouts: tuple[ByJointOrNone, ByJointOrNone] | None = None
        if report.before.simulation and report.after.simulation:
            rollouts = report.before.simulation, report.after.simulation
        lengths = position_units(report.units)
        is_mixed = len(set(report.units.values())) > 1
        columns = [name_column("joint")]
        if is_mixed:
            columns.append(name_column("units"))
        columns += [
            Column("before"),
            Column("after", attached=True),
            Column("noise floor", attached=True),
            Column("gap closed", attached=True),
            Column("after, training data", page_only=True),
        ]
        if rollouts:
            columns += [
                Column("simulation before", help="Position error of the simulation of the original model"),
                Column(
                    "simulation after",
                    help="Position error of the simulation of the final model, with all effects",
                    attached=True,
                ),
            ]
        rows = []
        for name in (*report.joints, "overall"):
            row = [Cell(name)]
            if is_mixed:
                torque = report.units.get(name) or common_unit(report.units)
                row.append(Cell(f"{torque}, {lengths.get(name) or common_unit(lengths)}"))
            first, last = before[name], after[name]
            is_worse = first is not None and last is not None and last > _MAX_INCREASE * first
            row += [number_cell(first, 3), number_cell(last, 3, "bad" if is_worse else None)]
            row += [number_cell(report.noise_floor[name], 3), percent_cell(report.gap_closed[name])]
            row.append(number_cell(report.after.train[name], 3))
            if rollouts:
                row += [number_cell(rollouts[0][name], 3), _rollout_cell(report, rollouts[1][name], name)]
            rows.append(row)
        title = f"Original and final model: RMS torque error{' on held-out data' if is_held_out else ''}"
        title += f", {common_unit(report.units)}"
        if rollouts:
            title += f"; position error of the simulation, {common_unit(lengths)}"
        return Table(title, columns, rows, key_columns=1 + is_mixed)

    @override
    def text(self, report: DiagnosisReport) -> str:
        fixed = " with the URDF's inertia" if report.inertia == "fixed" else ""
        return (
            f"Root mean square; torque errors are in the band up to {report.band_hz:g} Hz. Before: the original model, "
            f"fitted{fixed}, without the effects found. After: the final model, with all of them; the figures of a "
            "step are those of the model with the effects up to that step. Noise floor: the error that no model can go "
            "below on these data. Gap closed: reduction of the error, relative to its initial distance from the noise "
            "floor; –: this distance was almost zero."
        )


def _rollout_cell(report: DiagnosisReport, error: float | None, name: str) -> Cell:
    """The rollouts' error in the end, marked where it is worse than before."""
    if name in report.rollout_worse:
        return Cell(f"{number(error)} (worse)", error, "bad")
    return number_cell(error, 3)


@dataclass(frozen=True)
class CandidatesSection(Section[StepReport]):
    """Effects that were tried in a step and rejected, and why; joints and links with the same reason share a row.

    Attributes
    ----------
    title
        Its heading.
    max_rows
        Largest number of rows; None: all.
    """

    title: str
    max_rows: int | None = None

    @override
    def table(self, report: StepReport) -> Table | None:
        groups = _candidate_groups(report)
        if not groups:
            return None
        columns = [
            Column("effect", kind="words"),
            Column("on", kind="words"),
            Column("residual explained", help=f"{_EXPLAINED}, at most"),
            Column("parameters", help="Number of parameters"),
            Column("reason for rejection", kind="words"),
        ]
        rows = []
        for group in groups[: self.max_rows]:
            best = group[0]
            owners = ", ".join(dict.fromkeys(owner_name(candidate) for candidate in group))
            score = Cell(score_text(best.score, best.standard_error), best.score)
            reason = Cell(best.reason or _NO_REASON)
            rows.append([Cell(effect_name(best.effect)), Cell(owners), score, Cell(str(best.parameters)), reason])
        return Table(self.title, columns, rows, key_columns=2)

    @override
    def text(self, report: StepReport) -> str:
        hidden = 0
        if self.max_rows is not None:
            hidden = sum(len(group) for group in _candidate_groups(report)[self.max_rows :])
        return f"{hidden} more {is_or_are(hidden)} listed in diagnosis.json." if hidden else ""


def _candidate_groups(step: StepReport) -> list[list[CandidateReport]]:
    """Candidates of one effect, rejected for the same reason, the best first; alternatives come before the others."""
    groups: dict[tuple[bool, str, int, str], list[CandidateReport]] = {}
    for is_rejected, candidates in ((False, step.alternatives), (True, step.rejected)):
        for candidate in sorted(candidates, key=lambda one: -(one.score or 0.0)):
            key = (is_rejected, candidate.effect, candidate.parameters, candidate.reason)
            groups.setdefault(key, []).append(candidate)
    return list(groups.values())


def parameter_texts(step: StepReport) -> list[str]:
    """An effect's parameters, each with its standard error and unit.

    Parameters
    ----------
    step
        An entry of ``steps`` of diagnosis.json.
    """
    texts = []
    for name, value in step.parameters.items():
        texts.append(parameter_text(name, value, step.standard_error.get(name), step.units.get(name)))
    return texts


def score_text(score: float | None, error: float | None) -> str:
    """A share of the disagreement in percent, with its standard error."""
    if score is None:
        return NO_VALUE
    if error is None or not math.isfinite(error):
        return "0 %" if abs(score) < _MIN_SCORE else percent(score)
    if max(abs(score), error) < _MIN_SCORE:
        return "0 %"
    text, deviation = with_error(100 * score, 100 * error)
    return f"{float(text) + 0.0:.{len(text.partition('.')[2])}f} ± {deviation} %"  # without a sign before 0


def change_text(before: Mapping[str, Any] | None, after: Mapping[str, Any] | None, name: str = "overall") -> str:
    """An error before and after."""
    if not before or not after:
        return NO_VALUE
    return f"{number(before[name])} → {number(after[name])}"
