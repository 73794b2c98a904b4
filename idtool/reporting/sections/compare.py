"""The sections of a comparison of two results, A and B."""

from __future__ import annotations

from collections.abc import Sequence

from typing_extensions import override

from idtool.common.dataclass import dataclass
from idtool.common.names import join_names
from idtool.common.units import units_text
from idtool.reporting.number_text import interval_text, metres
from idtool.reporting.results.comparison import (
    BodyValues,
    ComparedParameter,
    ComparedResult,
    ComparedValue,
    ComparisonReport,
    ParameterKind,
)
from idtool.reporting.results.rollouts import Simulation
from idtool.reporting.sections.base import (
    NO_VALUE,
    Cell,
    Column,
    Section,
    Table,
    error_cells,
    error_column,
    name_column,
    number_cell,
    percent_cell,
    unit_cells,
    unit_columns,
)
from idtool.reporting.sections.simulation import baseline_name, restarts_text
from idtool.reporting.verdict import LEVEL_TEXTS
from idtool.robot.inertia import PARAMETER_WORDS

_DIGITS = 3  # of a number that stands beside another one
_MAX_ROWS = 60  # of a table of base parameters
_MAX_TERMINAL_ROWS = 8  # base parameters
_MAX_TERMINAL_SETTINGS = 20


class ComparedResultsSection(Section[ComparisonReport]):
    """Files, versions and verdicts of the two results."""

    title = "The two results"

    @override
    def table(self, report: ComparisonReport) -> Table:
        columns = [name_column(""), Column("A", kind="words"), Column("B", kind="words")]
        of_a, of_b = _result_texts(report.a), _result_texts(report.b)
        rows = [[Cell(name), Cell(of_a[name]), Cell(of_b[name])] for name in of_a]
        return Table(self.title, columns, rows)


def _result_texts(result: ComparedResult) -> dict[str, str]:
    """The cells of a result's column, by their row."""
    return {
        "report": result.report,
        "verdict": LEVEL_TEXTS[result.verdict],
        "URDF": result.urdf,
        "logs": join_names(result.logs),
        "samples fitted": f"{result.samples.train:,}",
        "determined": NO_VALUE if result.determined is None else f"{result.determined} base parameters",
        "idtool": result.idtool,
    }


class ComparedErrorsSection(Section[ComparisonReport]):
    """Torque errors of both, each on its own data, by joint."""

    title = "Torque error"

    @override
    def table(self, report: ComparisonReport) -> Table:
        units = {**report.b.units, **report.a.units}
        unit_column = unit_columns(units)
        columns = [name_column("joint"), *unit_column]
        for heading, text in (
            ("{}", "RMS torque error on {}'s own data"),
            ("{}, error / torque", "Error divided by the standard deviation of the torque measured for {}"),
            ("{}, noise floor", "Error due to noise and to friction at standstill, which no model can predict, in {}"),
        ):
            columns += [Column(heading.format(name), help=text.format(name)) for name in "AB"]
        rows = []
        for joint in (*report.all_joints, "overall"):
            row = [Cell(joint), *unit_cells(units, joint)]
            row += [number_cell(result.rms.get(joint), _DIGITS) for result in (report.a, report.b)]
            row += [percent_cell(result.nrms.get(joint)) for result in (report.a, report.b)]
            for noise_floor in (report.a.noise_floor, report.b.noise_floor):
                row.append(number_cell(noise_floor.get(joint) if noise_floor else None, _DIGITS))
            rows.append(row)
        bands = " and ".join(dict.fromkeys(f"{result.band_hz:g} Hz" for result in (report.a, report.b)))
        data = " and ".join(dict.fromkeys(_data_text(result) for result in (report.a, report.b)))
        title = f"RMS torque error, {units_text(units)}, below {bands}, on {data} data"
        return Table(title, columns, rows, key_columns=1 + len(unit_column))

    @override
    def text(self, report: ComparisonReport) -> str:
        return (
            "Each model is evaluated on its own data, so the errors also depend on the motion in those data. Error / "
            "torque: the error divided by the standard deviation of the measured torque. Noise floor: the error due to "
            "noise and to friction at standstill, which no model can predict."
        )


def _data_text(result: ComparedResult) -> str:
    return "held-out" if result.held_out else "fitted"


class ComparedRolloutsSection(Section[ComparisonReport]):
    """Position errors of both models run forwards, by joint and by time since the restart."""

    title = "Simulation"

    @override
    def table(self, report: ComparisonReport) -> Table | None:
        simulations = [report.a.simulation, report.b.simulation]
        first = report.a.simulation or report.b.simulation
        if first is None:
            return None
        units = {**(simulations[1].units if simulations[1] else {}), **first.units}
        unit_column = unit_columns(units)
        baseline = baseline_name(first)
        columns = [name_column("joint"), *unit_column, Column("A"), Column("B")]
        columns += [Column(f"A, {baseline}"), Column(f"B, {baseline}")]
        rows = []
        for joint in (*report.all_joints, "overall"):
            errors = [_position_error(simulation, joint) for simulation in simulations]
            errors += [_baseline_error(simulation, joint) for simulation in simulations]
            cells = [number_cell(error, _DIGITS) for error in errors]
            rows.append([Cell(joint), *unit_cells(units, joint), *cells])
        for seconds in dict.fromkeys(h.seconds for s in simulations if s for h in s.horizon):
            cells = [number_cell(error, _DIGITS) for error in _horizon_errors(simulations, seconds)]
            rows.append([Cell(f"after {1000 * seconds:g} ms"), *unit_cells(units, "overall"), *cells])
        restarts = " and ".join(dict.fromkeys(restarts_text(s) for s in simulations if s))
        title = f"Simulated position, RMS error, {units_text(units)}: {restarts}"
        return Table(title, columns, rows, key_columns=1 + len(unit_column))

    @override
    def text(self, report: ComparisonReport) -> str:
        return "Each model along its own logs. Hold: a robot that keeps the position of the last restart."


def _position_error(simulation: Simulation | None, joint: str) -> float | None:
    return simulation.position.get(joint) if simulation else None


def _baseline_error(simulation: Simulation | None, joint: str) -> float | None:
    return simulation.baseline.position.get(joint) if simulation else None


def _horizon_errors(simulations: Sequence[Simulation | None], seconds: float) -> list[float | None]:
    """Errors of both models and of both baselines at one time after a restart."""
    models: list[float | None] = []
    baselines: list[float | None] = []
    for simulation in simulations:
        horizons = [h for h in simulation.horizon if h.seconds == seconds] if simulation else []
        models.append(horizons[0].position.get("overall") if horizons else None)
        baselines.append(horizons[0].baseline.get("overall") if horizons else None)
    return [*models, *baselines]


class ComparedBaseParametersSection(Section[ComparisonReport]):
    """The base parameters: those that differ first."""

    title = "What the data determine"

    @override
    def table(self, report: ComparisonReport) -> Table | None:
        parameters = [p for p in report.parameters if p.kind == "base" and p.a is not None and p.b is not None]
        if not parameters:
            return None
        columns = [
            Column("base parameter", kind="words"),
            Column("unit", kind="name"),
            Column("A"),
            error_column(),
            Column("B"),
            error_column(),
            Column("difference / se", help="Difference in its standard errors"),
            Column("differs", kind="words", attached=True),
        ]
        rows = []
        for p in sorted(parameters, key=_by_significance)[:_MAX_ROWS]:
            estimates = [*_estimate_cells(p.a), *_estimate_cells(p.b)]
            distance = number_cell(p.difference_in_errors, 2)
            rows.append([Cell(p.of), Cell(p.unit), *estimates, distance, _differs_cell(p)])
        count = sum(p.differs is True for p in parameters)
        compared = sum(p.differs is not None for p in parameters)
        title = f"Base parameters, estimated from the data alone: {count} of {compared} differ"
        return Table(title, columns, rows, max_terminal_rows=_MAX_TERMINAL_ROWS)

    @override
    def text(self, report: ComparisonReport) -> str:
        share = f"{100 * report.false_discoveries:g} %"
        return (
            "The torque depends on these combinations only. Values: the estimates from the data alone, without prior "
            "and constraints, ± one standard error; –: the data do not determine it. If the logs of a result scatter "
            "more than their standard errors predict, these are enlarged by that factor. Differs: Welch's test for two "
            f"independent estimates; the false discovery rate is limited to {share} (Benjamini and Hochberg). The same "
            "limit holds for the other tables. comparison.json lists all of them."
        )


def _by_significance(p: ComparedParameter) -> tuple[bool, float]:
    """Order of a table: what differs most surely first, what cannot be compared last."""
    distance = p.difference_in_errors
    return distance is None, -abs(distance or 0.0)


def _estimate_cells(value: ComparedValue | None) -> tuple[Cell, Cell]:
    if value is None or value.estimate is None:
        return Cell(NO_VALUE), Cell(NO_VALUE)
    return error_cells(value.estimate, value.standard_error)


def _differs_cell(p: ComparedParameter) -> Cell:
    """Answer whether a parameter differs, or the reason why that cannot be told."""
    if p.differs is None:
        return Cell(p.reason)
    return Cell("yes", emphasis="bad") if p.differs else Cell("no")


@dataclass(frozen=True)
class ComparedParametersSection(Section[ComparisonReport]):
    """Parameters of some kinds in both models, with their 95 % intervals.

    Attributes
    ----------
    title
        Heading and title.
    kinds
        The kinds.
    owner
        Heading of the column of owners.
    template
        The file under ``templates/`` that shows it on the page.
    """

    title: str
    kinds: tuple[ParameterKind, ...]
    owner: str = "joint"
    template: str = "section.html"

    @override
    def table(self, report: ComparisonReport) -> Table | None:
        columns = [
            name_column(self.owner),
            Column("parameter", kind="words"),
            Column("unit", kind="name"),
            Column("A"),
            Column("95 % interval", attached=True),
            Column("B"),
            Column("95 % interval", attached=True),
            Column("differs", kind="words"),
        ]
        rows = []
        for p in report.parameters:
            if p.kind in self.kinds:
                names = [Cell(p.of), Cell(_parameter_words(p.what)), Cell(p.unit)]
                rows.append([*names, *_interval_cells(p.a), *_interval_cells(p.b), _differs_cell(p)])
        return Table(self.title, columns, rows, key_columns=2) if rows else None


def _parameter_words(what: str) -> str:
    """Name of a parameter as it is written in reports."""
    return "Coulomb" if what == "coulomb" else PARAMETER_WORDS.get(what, what)


def _interval_cells(value: ComparedValue | None) -> tuple[Cell, Cell]:
    if value is None:
        return Cell(NO_VALUE), Cell(NO_VALUE)
    return number_cell(value.value, _DIGITS), Cell(interval_text(value.interval))


class ComparedShapesSection(Section[ComparisonReport]):
    """Centres of mass and inertias of the bodies, as they are in the models."""

    title = "Centres of mass and inertias"

    @override
    def table(self, report: ComparisonReport) -> Table:
        columns = [name_column("body")]
        columns += [Column(f"centre of mass {name}", "m", help="In the link's frame") for name in "AB"]
        columns += [Column(f"inertia {name}", "kg·m²", help="xx, yy, zz about the centre of mass") for name in "AB"]
        rows = []
        for name, body in report.bodies.items():
            centers = [_center_cell(body.a), _center_cell(body.b)]
            rows.append([Cell(name), *centers, _inertia_cell(body.a), _inertia_cell(body.b)])
        return Table("Centres of mass; I_xx, I_yy, I_zz about them", columns, rows)


class ComparedBodiesSection(Section[ComparisonReport]):
    """Masses of the bodies, as they are in the models."""

    title = "Bodies"
    parts = (
        ComparedShapesSection(),
        ComparedParametersSection("The ten parameters of each body", ("body",), owner="body"),
    )

    @override
    def table(self, report: ComparisonReport) -> Table:
        masses = {p.of: p for p in report.parameters if p.kind == "body" and p.what == "m"}
        columns = [name_column("body")]
        for name in "AB":
            columns += [Column(f"mass {name}", "kg"), Column("95 % interval", attached=True)]
        columns.append(Column("mass differs", kind="words"))
        rows = []
        for name, mass in masses.items():
            rows.append([Cell(name), *_interval_cells(mass.a), *_interval_cells(mass.b), _differs_cell(mass)])
        return Table("Bodies", columns, rows)

    @override
    def text(self, report: ComparisonReport) -> str:
        return (
            "Values in the models. A single body parameter is compared only if the data determine it in both results. "
            "Otherwise the difference may come from the prior or the constraints; compare the base parameters instead. "
            "The intervals contain the value in the model and the estimate from the data alone; –: the data do not "
            "determine it. Centre of mass and inertia follow from the ten parameters and have no interval of their own."
        )


def _center_cell(body: BodyValues | None) -> Cell:
    return Cell(NO_VALUE) if body is None else Cell(", ".join(map(metres, body.com.tolist())))


def _inertia_cell(body: BodyValues | None) -> Cell:
    if body is None:
        return Cell(NO_VALUE)
    return Cell(", ".join(number_cell(float(body.inertia_com[i]), _DIGITS).text for i in (0, 2, 5)))


FRICTION = ComparedParametersSection("Friction", ("friction",), template="friction.html")
OTHERS = ComparedParametersSection("Rotors and effects", ("rotor", "effect", "whole_robot", "controller"), owner="of")


class SettingsSection(Section[ComparisonReport]):
    """Settings, files and versions that differ."""

    title = "Different settings"

    @override
    def table(self, report: ComparisonReport) -> Table | None:
        if not report.settings:
            return None
        columns = [name_column("setting"), Column("A", kind="words"), Column("B", kind="words")]
        rows = []
        for setting in report.settings:
            values = [Cell(NO_VALUE if value is None else value) for value in (setting.a, setting.b)]
            rows.append([Cell(setting.name), *values])
        title = f"{self.title}: {len(rows)}"
        return Table(title, columns, rows, max_terminal_rows=_MAX_TERMINAL_SETTINGS)
