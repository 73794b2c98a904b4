"""The sections of an online identification."""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array
from idtool.common.units import position_units, units_text
from idtool.reporting.number_text import metres
from idtool.reporting.results.adaptation import AdaptationReport
from idtool.reporting.sections.base import (
    Cell,
    Column,
    Section,
    Table,
    name_column,
    number_cell,
    realizable_cell,
    unit_cells,
    unit_columns,
)

_SETTLING_TOLERANCE = 0.05  # of the last value


class PredictionErrorsSection(Section[AdaptationReport]):
    """Error of the torque predicted one sample ahead, by joint."""

    title = "Torque error"

    @override
    def table(self, report: AdaptationReport) -> Table:
        units = unit_columns(report.units)
        rows = []
        for name in (*report.joints, "overall"):
            rows.append([Cell(name), *unit_cells(report.units, name), number_cell(report.prediction_rms[name])])
        unit = units_text(report.units)
        title = f"RMS error of the torque predicted one sample ahead, {unit}, below {report.band_hz:g} Hz"
        return Table(title, [name_column("joint"), *units, Column("rms")], rows, key_columns=1 + len(units))

    @override
    def text(self, report: AdaptationReport) -> str:
        return "Root mean square of measured minus predicted torque. Each sample is predicted before it is used."


class FinalBodiesSection(Section[AdaptationReport]):
    """The bodies at the end of the logs."""

    title = "Masses"
    template = "adapt_masses.html"

    @override
    def table(self, report: AdaptationReport) -> Table:
        times = settling_times(report)
        columns = [
            name_column("body"),
            Column("mass", "kg"),
            Column("within 5 % of the final value after", "s", page_only=True),
            Column("centre of mass", "m", page_only=True),
            Column("realizable"),
            Column("constraint set", kind="name", page_only=True),
        ]
        rows = []
        for name, body in report.final.bodies.items():
            center = ", ".join(map(metres, body.com.tolist()))
            row = [Cell(name), number_cell(body.mass), number_cell(times.get(name)), Cell(center)]
            row += [realizable_cell(body.realizable), Cell(report.constraints.get(name, "–"))]
            rows.append(row)
        return Table("Bodies at the end", columns, rows)


class FinalFrictionSection(Section[AdaptationReport]):
    """The joints' friction at the end of the logs."""

    title = "Friction"
    template = "adapt_friction.html"

    @override
    def table(self, report: AdaptationReport) -> Table:
        units = unit_columns(report.units)
        positions = position_units(report.units)
        columns = [name_column("joint"), *units, Column("viscous"), Column("Coulomb"), Column("offset")]
        rows = []
        for joint, friction in report.final.friction.items():
            terms = (friction.viscous, friction.coulomb, friction.offset)
            rows.append([Cell(joint), *unit_cells(report.units, joint), *map(number_cell, terms)])
        viscous = " or ".join(dict.fromkeys(f"{unit}·s/{positions[joint]}" for joint, unit in report.units.items()))
        title = f"Friction at the end, viscous {viscous}, others {units_text(report.units)}"
        return Table(title, columns, rows, key_columns=1 + len(units))

    @override
    def text(self, report: AdaptationReport) -> str:
        return "Torque = viscous · v + Coulomb · sign(v) + offset. –: not part of the model."


def coefficient_history(report: AdaptationReport) -> tuple[Array, Array]:
    """Times [s], shape (T,), and coefficients, shape (T, p), NaN where there is none."""
    p = len(report.coefficients)
    return np.array(report.t, dtype=float), np.array(report.theta, dtype=float).reshape(-1, p)


def settling_times(report: AdaptationReport) -> dict[str, float | None]:
    """`settling_time` of each body's mass."""
    t, theta = coefficient_history(report)
    columns = {(c.owner, c.name): i for i, c in enumerate(report.coefficients)}
    masses = {body: theta[:, columns[body, "m"]] for body in report.bodies if (body, "m") in columns}
    return {body: settling_time(t - t[0], mass) for body, mass in masses.items()}


def settling_time(t: Array, values: Array) -> float | None:
    """Time from which values stay within a twentieth of the last one [s]; None if only at the end.

    Parameters
    ----------
    t
        Times [s], shape (T,).
    values
        Values, shape (T,).
    """
    if not len(values):
        return None
    is_settled = np.abs(values - values[-1]) <= _SETTLING_TOLERANCE * abs(values[-1])
    unsettled = np.flatnonzero(~is_settled)
    first = int(unsettled[-1]) + 1 if len(unsettled) else 0
    if first >= len(values) - 1:
        return None
    return float(t[first])
