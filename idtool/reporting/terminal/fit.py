"""The result of `idtool fit`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from idtool.estimation.problem.certificate import GAP, ROUNDING
from idtool.reporting.figures import figure
from idtool.reporting.results.fit import FitReport, RepeatabilityReport, SolverReport
from idtool.reporting.terminal.base import Terminal, new_table, units_of
from idtool.reporting.terminal.simulation import show_simulation
from idtool.reporting.terminal.tables import Words

_WORST = 8  # parameters that are listed
_SIDE_BY_SIDE = 4  # logs in a table


def show_fit(terminal: Terminal, report: FitReport, folder: Path) -> None:
    """The result of a fit: errors, bodies, friction, certificate, and where the files are."""
    rms = report.rms
    table = new_table(
        f"RMS torque error, {units_of(report.units)}, below {report.band_hz:g} Hz",
        "joint",
        "prior",
        "train",
        "held out",
    )
    for name in (*report.joints, "overall"):
        prior = rms.prior_validation[name] if rms.prior_validation else None
        held_out = rms.validation[name] if rms.validation else None
        table.add_row(name, figure(prior), figure(rms.train[name]), figure(held_out))
    terminal.show(table)
    show_simulation(terminal, report.simulation)
    _show_bodies(terminal, report)
    kinds = ("viscous", "Coulomb", "offset")
    table = new_table("Friction, with standard errors", "joint", *((kind, "± se") for kind in kinds))
    for name, friction in report.friction.items():
        error = friction.standard_error
        pairs = (
            (friction.viscous, error.viscous),
            (friction.coulomb, error.coulomb),
            (friction.offset, error.offset),
        )
        table.add_row(name, *(figure(x) for pair in pairs for x in pair))
    terminal.show(table)
    if report.controller and report.controller.text:
        terminal.say(f"controller delay: {report.controller.text}")
    _show_trust(terminal, report)
    regularization = report.regularization
    if regularization.automatic is not None:
        reason = regularization.automatic.reason
        terminal.say(f"the prior's weight is {regularization.weight:.2g}: {reason}")
    terminal.say(_optimality(report.solver))
    terminal.notices(report.notices)
    terminal.say(f"written: {folder}/identified.urdf, model.yaml, report.json, report.html")


def _optimality(solver: SolverReport) -> str:
    """How far the cost may be above the least."""
    gap = max(abs(solver.duality_gap), ROUNDING)
    if gap <= GAP:
        return f"optimum certified to a relative duality gap of {gap:.1e}"
    return f"not the optimum: {solver.name} ended at a cost that may be {gap:.1e} above the least, relative to it"


def _show_bodies(terminal: Terminal, report: FitReport) -> None:
    """Masses, and how many of a body's ten parameters rest on what."""
    analyzed = report.base_parameters is not None
    sources = ("data", "combination", "constraints", "prior") if analyzed else ("determined",)
    table = new_table("Bodies", "body", "prior kg", ("mass kg", "± se"), sources, "realizable")
    for name, body in report.bodies.items():
        if analyzed:
            count = Counter[str](source.on for source in body.rests_on or ())
            counts = [str(count[source]) for source in sources]
        else:
            counts = [f"{sum(body.identifiable)}/10"]
        error = None if np.isnan(body.standard_error[0]) else float(body.standard_error[0])
        mass = map(figure, (float(body.prior[0]), body.mass, error))
        table.add_row(name, *mass, *counts, "yes" if body.realizable else "NO")
    terminal.show(table)


def _show_trust(terminal: Terminal, report: FitReport) -> None:
    """What the numbers rest on, and whether several logs agree."""
    if base := report.base_parameters:
        terminal.say(
            f"the log determines {base.determined} of the {base.structural} combinations of the {base.of} "
            "parameters that any motion of this robot can tell; the columns above say what each body's ten rest on"
        )
    if report.repeatability:
        _show_repeatability(terminal, report.repeatability)


def _show_repeatability(terminal: Terminal, report: RepeatabilityReport) -> None:
    """The combinations that scatter most between the logs: by log, or of many logs the extremes."""
    is_short = len(report.logs) <= _SIDE_BY_SIDE
    values = report.logs if is_short else (("least", "in"), ("greatest", "in"))
    columns = (Words("parameter"), *values, ("times expected", "beyond chance"))
    table = new_table("Least repeatable between the logs", *columns)
    worst = sorted(report.parameters, key=lambda p: (p.agrees, -(p.ratio or 0)))
    for p in worst[:_WORST]:
        cells = [figure(value) for value in p.value] if is_short else _extremes(p.value, report.logs)
        table.add_row(p.name, *cells, figure(p.ratio), "" if p.agrees else "yes")
    terminal.show(table)


def _extremes(values: Sequence[float | None], logs: Sequence[str]) -> list[str]:
    """The least and the greatest value, each with its log."""
    known = [(value, name) for value, name in zip(values, logs, strict=True) if value is not None]
    if not known:
        return ["–"] * 4
    least, greatest = min(known), max(known)
    return [figure(least[0]), least[1], figure(greatest[0]), greatest[1]]
