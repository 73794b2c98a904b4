"""The sections of a designed trajectory: the errors to expect, the limits, the criteria."""

from __future__ import annotations

import math

from typing_extensions import override

from idtool.common.number_text import short_number
from idtool.common.units import units_text
from idtool.reporting.results.excitation import ExcitationReport, LimitUtilization
from idtool.reporting.sections.base import (
    Cell,
    Column,
    Section,
    Table,
    error_column,
    name_column,
    number_cell,
    percent_cell,
)

CLEAR_DIFFERENCE = 5.0  # standard errors, from which a diagnosis decides clearly


class ExpectedErrorsSection(Section[ExcitationReport]):
    """Standard errors to expect of the base parameters."""

    title = "Expected standard errors"

    @override
    def table(self, report: ExcitationReport) -> Table:
        is_logged = "logged" in report.criteria
        columns = [
            Column("base parameter", kind="words"),
            Column("prior"),
            error_column(),
            Column("relative", help="Standard error divided by the prior", attached=True),
            Column("unit", kind="name", attached=True),
        ]
        if is_logged:
            columns.append(Column("± se, existing logs", help="Standard error with the existing logs only"))
        rows = []
        for p in report.base_parameters:
            row = [Cell(p.name + (" *" if p.favoured else "")), number_cell(p.prior), number_cell(p.standard_error)]
            row += [percent_cell(p.relative), Cell(p.unit)]
            if is_logged:
                row.append(number_cell(p.logged_standard_error))
            rows.append(row)
        return Table("Expected standard errors", columns, rows)

    @override
    def text(self, report: ExcitationReport) -> str:
        noise = [f"{number_cell(x, 3).text} {report.units[joint]} ({joint})" for joint, x in report.noise.items()]
        favoured = " *: parameters of --favour." if any(p.favoured for p in report.base_parameters) else ""
        return (
            "The combinations of parameters that the torque depends on, and the standard errors of a fit to a log of "
            f"this trajectory. Assumed torque noise in the band: {', '.join(noise)}.{favoured}"
        )


class LimitsSection(Section[ExcitationReport]):
    """Limits of the motion, and the largest share of each that it uses."""

    title = "Limits"

    @override
    def table(self, report: ExcitationReport) -> Table:
        limits = ("lower limit", "upper limit", "velocity limit", "acceleration limit", "effort limit")
        quantities = tuple(LimitUtilization.model_fields)
        columns = [
            name_column("joint"),
            *(Column(heading, "SI", page_only=True) for heading in limits),
            *(Column(quantity) for quantity in quantities),
        ]
        rows = []
        for joint in report.joints:
            limit, use = report.limits[joint], report.use[joint]
            values = (*limit.position, limit.velocity, limit.acceleration, limit.effort)
            shares = [percent_cell(getattr(use, quantity)) for quantity in quantities]
            rows.append([Cell(joint), *map(number_cell, values), *shares])
        return Table("Largest share of each limit", columns, rows)

    @override
    def text(self, report: ExcitationReport) -> str:
        return (
            "The limits are those of the URDF, tightened by the configuration. For the position, 100 % is half the "
            "range, measured from its middle."
        )


class GroundSection(Section[ExcitationReport]):
    """Loads of the feet that stay on the ground."""

    title = "Feet on the ground"

    @override
    def table(self, report: ExcitationReport) -> Table | None:
        standing = report.standing
        if standing is None:
            return None
        columns = [
            name_column("foot"),
            Column("friction needed", help="Largest friction coefficient that the foot needs"),
            Column("min. normal force", "N", help="Smallest normal force on the foot"),
            Column("centre of pressure", help="Largest distance from the middle of the sole; 100 %: at its edge"),
        ]
        rows = []
        for name, foot in standing.feet.items():
            row = [Cell(name), number_cell(foot.friction_coefficient, 3), number_cell(foot.min_force, 3)]
            rows.append([*row, percent_cell(foot.pressure)])
        return Table("Feet on the ground", columns, rows)

    @override
    def text(self, report: ExcitationReport) -> str:
        return ground_sentence(report)


def ground_sentence(report: ExcitationReport) -> str:
    """Sentences on the tightest limit of a standing robot, and how far the base moves; empty for other robots."""
    standing = report.standing
    if standing is None:
        return ""
    largest = {name: max(abs(end) for end in interval) for name, interval in standing.base.items()}
    shift = max(largest[f"base_{axis}"] for axis in "xyz")
    turn = max(largest[f"base_{axis}"] for axis in ("roll", "pitch", "yaw"))
    use = percent_cell(standing.tightest_use).text
    return (
        f"The tightest limit is {standing.tightest} ({use}, with all margins and a friction coefficient of "
        f"{standing.friction_coefficient:g}). The base moves by up to {short_number(100 * shift, 2)} cm and turns by "
        f"up to {short_number(math.degrees(turn), 2)}° from the stance."
    )


class CriteriaSection(Section[ExcitationReport]):
    """All criteria of a random motion, of the design and of what is logged."""

    title = "Criteria"

    @override
    def table(self, report: ExcitationReport) -> Table:
        columns = [name_column("motion"), Column("D"), Column("A"), Column("E"), Column("condition")]
        rows = []
        for name, criteria in report.criteria.items():
            values = (criteria.d, criteria.a, criteria.e, criteria.condition)
            rows.append([Cell(name), *map(number_cell, values)])
        return Table("Criteria", columns, rows)

    @override
    def text(self, report: ExcitationReport) -> str:
        return (
            "D: geometric mean of the relative standard errors; A: their root mean square; E: the largest of them; "
            "condition: condition number."
        )


class DecisionSection(Section[ExcitationReport]):
    """Difference of two explanations on the design, the ordinary trajectory and what is logged."""

    title = "Two explanations"

    @override
    def table(self, report: ExcitationReport) -> Table | None:
        decision = report.decide
        if decision is None:
            return None
        columns = [
            name_column("motion"),
            name_column("joint"),
            Column("difference", units_text(report.units), help="RMS difference of the torque after a fit"),
            Column("difference / noise"),
            Column("standard errors", help="Difference on all joints"),
        ]
        separations = {"this trajectory": decision, "without --decide": decision.ordinary}
        if decision.logged is not None:
            separations["existing logs"] = decision.logged
        rows = []
        for name, separation in separations.items():
            ratio = separation.difference / separation.noise
            values = (separation.difference, ratio, separation.significance)
            rows.append([Cell(name), Cell(separation.joint), *(number_cell(value, 3) for value in values)])
        return Table("Difference of the two explanations", columns, rows)

    @override
    def text(self, report: ExcitationReport) -> str:
        return decision_sentence(report)


def decision_sentence(report: ExcitationReport) -> str:
    """Sentences on the difference of the two explanations, and what to do next; empty without explanations."""
    decision = report.decide
    if decision is None:
        return ""
    ratio = number_cell(decision.difference / decision.noise, 2).text
    difference = f"{number_cell(decision.difference, 3).text} {report.units[decision.joint]} RMS"
    significance = number_cell(decision.significance, 2).text
    start = f"The explanations {decision.a.name} and {decision.b.name} differ by {difference} on joint {decision.joint}"
    amount = f"which is {ratio} times the noise ({significance} standard errors)"
    if decision.significance < CLEAR_DIFFERENCE:
        return f"{start}, {amount}. This is too little to decide between them. Make the trajectory longer."
    logs = "all logs" if report.logs else "the new log"
    return f"{start}, {amount}. Log this trajectory and run diagnose on {logs}."
