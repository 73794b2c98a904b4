"""The sections of a fit: errors and parameters; bodies, friction and rotors also of a diagnosis."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np
from typing_extensions import override

from idtool.common.number_text import number
from idtool.common.units import INERTIA_UNITS, friction_units, units_text
from idtool.reporting.diagnosis_text import effect_name, owner_name
from idtool.reporting.number_text import interval_text, metres
from idtool.reporting.results.fit import BodyReport, FitReport, FrictionErrors, FrictionReport
from idtool.reporting.sections.base import (
    NO_VALUE,
    Cell,
    Column,
    Section,
    Table,
    error_cells,
    error_column,
    kind_label,
    kind_units,
    name_column,
    number_cell,
    percent_cell,
    realizable_cell,
    unit_cells,
    unit_columns,
)

if TYPE_CHECKING:
    from idtool.reporting.results.diagnosis import DiagnosisReport

_SOURCES = ("data", "combination", "constraints", "prior")  # that a parameter may rest on


class TorqueErrorsSection(Section[FitReport]):
    """Torque errors of the prior and of the identified model, by joint."""

    title = "Torque error"

    @override
    def table(self, report: FitReport) -> Table:
        units = unit_columns(report.units)
        columns = [
            name_column("joint"),
            *units,
            Column("prior", help="The original URDF, on the held-out data"),
            Column("train", help="The identified model, on the data that it was fitted to"),
            Column("held out", help="The identified model, on the held-out data"),
            Column("error / torque", help="Error divided by the measured torque's standard deviation", page_only=True),
            Column("prior, as logged", page_only=True),
            Column("train, as logged", page_only=True),
            Column("held out, as logged", page_only=True),
        ]
        rows = []
        for name in (*report.joints, "overall"):
            errors = []
            for rms in (report.rms, report.rms_raw):
                for by_joint in (rms.prior_validation, rms.train, rms.validation):
                    errors.append(number_cell(by_joint[name] if by_joint else None))
            share = percent_cell(report.nrms.get(name))
            rows.append([Cell(name), *unit_cells(report.units, name), *errors[:3], share, *errors[3:]])
        title = f"RMS torque error, {units_text(report.units)}, below {report.band_hz:g} Hz"
        return Table(title, columns, rows, key_columns=1 + len(units))

    @override
    def text(self, report: FitReport) -> str:
        return (
            "Root mean square of predicted minus measured torque, both filtered by the same zero-phase low-pass. As "
            "logged: relative to the unfiltered torque, so noise above the band counts as error too. Prior: the "
            "original URDF, on the held-out data. Error / torque: the error divided by the standard deviation of the "
            "measured torque."
        )


class ErrorsByKindSection(Section[FitReport]):
    """Errors of the joints, and of the forces and moments on the base and in sensors."""

    title = "Error by kind"

    @override
    def table(self, report: FitReport) -> Table | None:
        errors = report.rms_by_kind
        if errors is None:
            return None
        columns = [
            Column("quantity", kind="words"),
            name_column("unit"),
            Column("prior", help="The original URDF, on the held-out data"),
            Column("train", help="The identified model, on the data that it was fitted to"),
            Column("held out", help="The identified model, on the held-out data"),
        ]
        units = kind_units(errors.train, report.units)
        rows = []
        for kind in errors.train:
            cells = []
            for by_kind in (errors.prior_validation, errors.train, errors.validation):
                cells.append(number_cell(by_kind[kind] if by_kind else None))
            rows.append([Cell(kind_label(kind)), Cell(units[kind]), *cells])
        return Table("RMS error by kind; for forces and moments, of the error vector's magnitude", columns, rows)


class KnownValuesSection(Section["FitReport | DiagnosisReport"]):
    """Quantities known by other means, and their identified values."""

    title = "Known values"

    @override
    def table(self, report: FitReport | DiagnosisReport) -> Table | None:
        if not report.known:
            return None
        columns = [
            Column("quantity", kind="words"),
            Column("known"),
            error_column(),
            Column("identified"),
        ]
        rows = []
        for known in report.known:
            exact = known.standard_error is None
            error = Cell("exact") if exact else number_cell(known.standard_error, 2)
            rows.append([Cell(known.what), number_cell(known.value, 4), error, number_cell(known.identified, 4)])
        return Table(self.title, columns, rows)


class WholeRobotSection(Section[FitReport]):
    """Mass and centre of mass of the whole robot, which a floating base makes visible."""

    title = "Whole robot"

    @override
    def table(self, report: FitReport) -> Table | None:
        robot = report.whole_robot
        if robot is None:
            return None
        columns = [
            Column("quantity", kind="words"),
            Column("unit", kind="name"),
            Column("prior"),
            Column("identified"),
            error_column(),
        ]
        mass = Cell("mass"), Cell("kg"), number_cell(robot.prior_mass)
        rows = [[*mass, *error_cells(robot.mass, robot.mass_standard_error)]]
        for axis, prior, value, error in zip("xyz", robot.prior_com, robot.com, robot.com_standard_error, strict=True):
            center = Cell(f"centre of mass, {axis}"), Cell("m"), number_cell(float(prior))
            rows.append([*center, *error_cells(float(value), error)])
        compliance = report.foot_compliance
        if compliance is not None:
            label = Cell("compliance of the feet"), Cell("m/N"), Cell(NO_VALUE)
            rows.append([*label, *error_cells(compliance.value, compliance.standard_error)])
        return Table(self.title, columns, rows)

    @override
    def text(self, report: FitReport) -> str:
        return "All bodies together, in the frame of the root link, all joints at position 0."


class WrenchSensorsSection(Section[FitReport]):
    """Readings of the wrench sensors without load."""

    title = "Offsets of the wrench sensors"

    @override
    def table(self, report: FitReport) -> Table | None:
        if not report.wrench_sensors:
            return None
        by_log = [own for sensor in report.wrench_sensors.values() for own in sensor.by_log.values()]
        has_logs = len(by_log) > len(report.wrench_sensors)
        has_drift = any(own.drift for own in by_log)
        columns = [name_column("sensor"), Column("component", kind="words"), Column("unit", kind="name")]
        if has_logs:
            columns.append(name_column("log"))
        columns += [Column("identified"), error_column()]
        if has_drift:
            columns += [Column("drift", help="Change along the part of the log that was fitted"), error_column()]
        rows = []
        for joint, sensor in report.wrench_sensors.items():
            components = [(f"force, {axis}", "N") for axis in "xyz"] + [(f"moment, {axis}", "N·m") for axis in "xyz"]
            for i, (component, unit) in enumerate(components):
                for log, own in sensor.by_log.items():
                    row = [Cell(joint), Cell(component), Cell(unit)]
                    if has_logs:
                        row.append(Cell(log))
                    row += error_cells(own.offset[i], own.standard_error[i])
                    if has_drift and own.drift and own.drift_standard_error:
                        row += error_cells(own.drift[i], own.drift_standard_error[i])
                    elif has_drift:
                        row += [Cell(NO_VALUE), Cell(NO_VALUE)]
                    rows.append(row)
        return Table(self.title, columns, rows)

    @override
    def text(self, report: FitReport) -> str:
        return (
            "Force and moment that a sensor reads without load, along its own axes, at the beginning of each log. Each "
            "log has an offset of its own, unless common_offset is set."
        )


class BodiesSection(Section["FitReport | DiagnosisReport"]):
    """Masses, centres of mass, and the number of a body's ten parameters by source."""

    title = "Bodies"
    parts = (KnownValuesSection(),)

    @override
    def table(self, report: FitReport | DiagnosisReport) -> Table:
        bodies = report.bodies
        analyzed = any(body.rests_on for body in bodies.values())
        remarks = {name: _remark(body) for name, body in bodies.items()}
        columns = [
            name_column("body"),
            Column("prior", "kg", help="Mass of the prior"),
            Column("mass", "kg"),
            error_column(),
            Column("95 % interval", page_only=True, attached=True),
        ]
        if analyzed:
            columns += [Column(source, attached=source != "data") for source in _SOURCES]
        else:
            columns.append(Column("determined", help="Parameters that the data determine"))
        columns += [
            Column("realizable"),
            Column("centre of mass", "m", help="In the link's frame", page_only=True),
            Column("margin", "kg", help="Tr(J Q)", page_only=True),
            Column("constraint set", kind="name", page_only=True),
        ]
        if any(remarks.values()):
            columns.append(Column("remark", kind="words", page_only=True))
        rows = []
        for name, body in bodies.items():
            row = [
                Cell(name),
                number_cell(float(body.prior[0])),
                *error_cells(body.mass, float(body.standard_error[0])),
                Cell(interval_text(body.interval[0])),
            ]
            if analyzed:
                count = Counter[str](source.on for source in body.rests_on or ())
                row += [Cell(str(count[source]), count[source]) for source in _SOURCES]
            else:
                determined = sum(body.identifiable)
                row.append(Cell(f"{determined}/{len(body.identifiable)}", determined))
            row += [
                realizable_cell(body.realizable),
                Cell(", ".join(map(metres, body.com.tolist()))),
                number_cell(body.ellipsoid_margin),
                Cell(body.constraints),
            ]
            if any(remarks.values()):
                row.append(Cell(remarks[name]))
            rows.append(row)
        return Table("Bodies", columns, rows)

    @override
    def text(self, report: FitReport | DiagnosisReport) -> str:
        counts = "Data, combination, constraints, prior: how many of the ten parameters come from each source. "
        analyzed = any(body.rests_on for body in report.bodies.values())
        return (
            "± se: one standard error, from the data without the prior; –: the data do not determine the mass, so it "
            f"comes from prior and constraints. {counts if analyzed else ''}Centre of mass: in the link's frame. "
            "Margin: Tr(J Q), which is 0 if the mass distribution just fits into its bounding ellipsoid; –: no "
            "ellipsoid. With: links that are fixed to this one and whose mass is included."
        )


def _remark(body: BodyReport) -> str:
    """The links that a body holds beside its own, and the body of which it is a copy."""
    parts = []
    if body.lumped:
        parts.append(f"with {', '.join(body.lumped)}")
    if body.copy_of:
        parts.append(f"a copy of {body.copy_of}")
    return "; ".join(parts)


class ReflectedInertiasSection(Section["FitReport | DiagnosisReport"]):
    """Rotors' inertia as the joints feel it."""

    title = "Reflected rotor inertia"

    @override
    def table(self, report: FitReport | DiagnosisReport) -> Table | None:
        columns = [
            name_column("joint"),
            name_column("rotor"),
            Column("reflected inertia"),
            error_column(),
            Column("95 % interval", attached=True),
            Column("unit", kind="name", attached=True),
        ]
        rows = []
        for rotor, joints in report.rotors.items():
            for joint, inertia in joints.items():
                unit = INERTIA_UNITS[report.units.get(joint, "N·m")]
                errors = error_cells(inertia.reflected_inertia, inertia.standard_error)
                rows.append([Cell(joint), Cell(rotor), *errors, Cell(interval_text(inertia.interval)), Cell(unit)])
        return Table(self.title, columns, rows, key_columns=2) if rows else None

    @override
    def text(self, report: FitReport | DiagnosisReport) -> str:
        return (
            "The rotor's inertia about its axis times the square of the gear ratio. –: the data determine only the sum "
            "of this value and the inertia of the bodies that turn with the rotor. If prior or constraints change the "
            "value, the interval contains both the value and the estimate from the data alone."
        )


class FrictionSection(Section["FitReport | DiagnosisReport"]):
    """Friction of each joint with standard errors."""

    title = "Friction"
    parts = (ReflectedInertiasSection(),)

    @override
    def table(self, report: FitReport | DiagnosisReport) -> Table:
        kinds = {torque: friction_units(torque) for torque in dict.fromkeys(report.units.values())}
        is_mixed = len(kinds) > 1
        columns = [name_column("joint")]
        if is_mixed:
            columns.append(name_column("units"))
        title = "Friction, with standard errors"
        if not is_mixed:
            viscous, dry = next(iter(kinds.values()))
            title = f"Friction, {viscous} and {dry}, with standard errors"
        for heading in ("viscous", "Coulomb", "offset"):
            columns += [Column(heading), error_column()]
        rows = []
        for joint, friction in report.friction.items():
            row = [Cell(joint)]
            if is_mixed:
                row.append(Cell(", ".join(kinds[report.units[joint]])))
            row += _friction_cells(friction)
            rows.append(row)
        return Table(title, columns, rows, key_columns=1 + is_mixed)

    @override
    def text(self, report: FitReport | DiagnosisReport) -> str:
        return (
            "Torque = viscous · v + Coulomb · sign(v) + offset. ± se: one standard error. – as a value: the term "
            "is not part of the model; – as a standard error: the data do not determine the value."
        )


def _friction_cells(friction: FrictionReport) -> list[Cell]:
    cells: list[Cell] = []
    for term in FrictionErrors.model_fields:
        cells += error_cells(getattr(friction, term), getattr(friction.standard_error, term))
    return cells


class EffectsSection(Section[FitReport]):
    """Parameters of the effects besides rigid bodies and friction, with standard errors."""

    title = "Effects"

    @override
    def table(self, report: FitReport) -> Table | None:
        columns = [
            name_column("effect"),
            name_column("on"),
            name_column("parameter"),
            Column("value"),
            error_column(),
            Column("unit", kind="name", attached=True),
        ]
        rows = []
        for effect in report.effects:
            for name, value in effect.parameters.items():
                cells = _parameter_cells(value, effect.standard_error[name])
                unit = effect.units[name] or ""
                rows.append(
                    [Cell(effect_name(effect.effect)), Cell(owner_name(effect)), Cell(name), *cells, Cell(unit)]
                )
        return Table(self.title, columns, rows, key_columns=3) if rows else None

    @override
    def text(self, report: FitReport) -> str:
        return "± se: one standard error; –: given in the configuration, or not determined by the data."


def _parameter_cells(value: Any, error: Any) -> tuple[Cell, Cell]:
    """A parameter and its standard error: a number, a list of numbers, or a name."""
    if isinstance(value, str) or value is None:
        return Cell(value or NO_VALUE), Cell(NO_VALUE)
    if isinstance(value, float | int):
        return error_cells(value, error)
    numbers = ", ".join(number(x) for x in np.ravel(value))
    return Cell(numbers), Cell(NO_VALUE)


class PriorWeightsSection(Section[FitReport]):
    """Fits with other weights of the prior."""

    title = "Weight of the prior"
    template = "prior.html"

    @override
    def table(self, report: FitReport) -> Table | None:
        automatic = report.regularization.automatic
        if automatic is None:
            return None
        columns = [
            name_column("fit"),
            Column("weight"),
            Column("error, fitted data"),
            Column("error, held-out blocks"),
            Column("total mass", "kg"),
            Column("distance from the prior"),
        ]
        points = {"a tenth": automatic.weaker, "chosen": automatic.chosen, "ten times": automatic.stronger}
        rows = []
        for name, point in points.items():
            errors = [number_cell(point.train_error), number_cell(point.validation_error)]
            others = [number_cell(point.total_mass), number_cell(point.distance)]
            rows.append([Cell(name), number_cell(point.weight, 2), *errors, *others])
        return Table("Errors in units of each joint's noise", columns, rows)
