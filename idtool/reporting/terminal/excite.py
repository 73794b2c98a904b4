"""The result of `idtool excite`."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.figures import figure
from idtool.reporting.results.excitation import ExcitationReport
from idtool.reporting.terminal.base import Terminal, new_table
from idtool.reporting.terminal.tables import Words


def show_excitation(terminal: Terminal, report: ExcitationReport) -> None:
    """The errors to expect, the limits, and where the files are."""
    logged = "logged" in report.criteria
    errors = new_table(
        "Standard errors to expect",
        Words("base parameter"),
        ("prior", "± se", "of it", Words("unit")),
        *(["so far ±"] if logged else []),
    )
    for p in report.base_parameters:
        share = "-" if p.relative is None else f"{p.relative:.2%}"
        before = [figure(p.logged_standard_error)] if logged else []
        name = p.name + (" *" if p.favoured else "")
        errors.add_row(name, figure(p.prior), figure(p.standard_error), share, p.unit, *before)
    terminal.show(errors)
    limits = new_table("Largest share of each limit", "joint", "position", "velocity", "acceleration", "effort")
    for joint, use in report.use.items():
        shares = (use.position, use.velocity, use.acceleration, use.effort)
        limits.add_row(joint, *(f"{share:.0%}" for share in shares))
    terminal.show(limits)
    criteria = new_table("Criteria", "of", "D", "A", "E", "condition")
    for name, values in report.criteria.items():
        criteria.add_row(name, *map(figure, (values.d, values.a, values.e, values.condition)))
    terminal.show(criteria)
    near = report.clearance
    if near and near.distance is not None:
        links = " and ".join(near.links)
        terminal.say(f"nearest links: {links}, {1000 * near.distance:.3g} mm after {near.t:.4g} s")
    terminal.notices(report.notices)
    if report.file is not None:
        terminal.say(f"written: {report.file} and {Path(report.file).with_suffix('.html').name}")
