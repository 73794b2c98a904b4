"""The result of `idtool adapt`."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.figures import figure
from idtool.reporting.results.adaptation import AdaptationReport
from idtool.reporting.terminal.base import Terminal, new_table, units_of


def show_adaptation(terminal: Terminal, report: AdaptationReport, folder: Path) -> None:
    """The error of the prediction one sample ahead, and the bodies at the end."""
    title = f"RMS error of the torque predicted one sample ahead, {units_of(report.units)}, below {report.band_hz:g} Hz"
    table = new_table(title, "joint", "rms")
    for name in (*report.joints, "overall"):
        table.add_row(name, figure(report.prediction_rms[name]))
    terminal.show(table)
    table = new_table("Bodies at the end", "body", "mass kg", "realizable")
    for name, body in report.final.bodies.items():
        table.add_row(name, figure(body.mass), "yes" if body.realizable else "NO")
    terminal.show(table)
    terminal.notices(report.notices)
    updates = f"{report.samples} updates, one for each decimated row: {report.update_hz:.4g} Hz"
    terminal.say(f"{updates}, in {report.seconds:.1f} s")
    terminal.say(f"written: {folder}/adapt.json, adapt.html")
