"""The section on a model run forwards, of a fit, a validation and a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence

from typing_extensions import override

from idtool.common.dataclass import dataclass
from idtool.common.number_text import short_number
from idtool.common.units import units_text
from idtool.reporting.results.base import ByJointOrNone
from idtool.reporting.results.rollouts import Simulation
from idtool.reporting.sections.base import (
    Cell,
    Column,
    Section,
    Table,
    name_column,
    number_cell,
    unit_cells,
    unit_columns,
)

Errors = ByJointOrNone | None


@dataclass(frozen=True)
class SimulationErrorsSection(Section[Simulation]):
    """Errors of a model run forwards, by joint and by time since the restart.

    Attributes
    ----------
    template
        The file under ``templates/`` that shows it on the page.
    """

    title = "Simulation"
    template: str = "simulation.html"

    @override
    def table(self, report: Simulation) -> Table:
        names = _model_names(report)
        units = unit_columns(report.units)
        unit = next(iter(report.units.values())) if not units else ""
        velocity_unit = f"{unit}/s" if unit else "unit/s"
        columns = [
            name_column("joint"),
            *units,
            *(Column(name) for name in names),
            *(Column(f"velocity, {name}", velocity_unit, page_only=True) for name in names),
        ]
        prior = report.prior
        positions = [report.position, prior.position if prior else None, report.baseline.position]
        velocities = [report.velocity, prior.velocity if prior else None, report.baseline.velocity]
        rows = []
        for joint in report.position:
            errors = [*_error_cells(positions, joint), *_error_cells(velocities, joint)]
            rows.append([Cell(joint), *unit_cells(report.units, joint), *errors])
        for horizon in report.horizon:
            after = Cell(f"after {1000 * horizon.seconds:g} ms")
            errors = [number_cell(_overall(horizon.position))]
            if prior:
                errors.append(number_cell(_overall(horizon.prior)))
            errors.append(number_cell(_overall(horizon.baseline)))
            errors += [Cell("")] * len(names)
            rows.append([after, *unit_cells(report.units, "overall"), *errors])
        closed = report.kind == "closed_loop"
        loop = "closed loop under the controller" if closed else "open loop"
        title = f"Simulated position, RMS error, {units_text(report.units)}: {loop}, {restarts_text(report)}"
        return Table(title, columns, rows, key_columns=1 + len(units))


def baseline_name(simulation: Simulation) -> str:
    """The motion that a model is compared with, as a column's heading."""
    return "q = qcmd" if simulation.kind == "closed_loop" else "hold"


def restarts_text(simulation: Simulation) -> str:
    """Time between restarts, in words."""
    if simulation.window:
        return f"{simulation.window:g} s at a time"
    return f"{short_number(simulation.seconds)} s, never restarted"


def _model_names(simulation: Simulation) -> list[str]:
    prior = ["prior"] if simulation.prior else []
    return ["model", *prior, baseline_name(simulation)]


def _error_cells(errors: Sequence[Errors], joint: str) -> list[Cell]:
    """A joint's errors of the models that there are."""
    return [number_cell(by_joint.get(joint)) for by_joint in errors if by_joint is not None]


def _overall(errors: Errors) -> float | None:
    return errors["overall"] if errors else None
