"""The result of `idtool study`."""

from __future__ import annotations

from pathlib import Path

from idtool.reporting.figures import figure
from idtool.reporting.results.study import StudyReport
from idtool.reporting.terminal.base import Terminal, new_table, units_of


def show_study(terminal: Terminal, report: StudyReport, folder: Path) -> None:
    """Constraint sets, estimators, learning curves and Remark 5 in tables."""
    unit, band = units_of(report.units), report.band_hz
    table = new_table(
        f"Constraint sets: RMS torque error, {unit}, below {band:g} Hz",
        *("set", "inequalities", "train", "held out", "unrealizable", "ms", "gap"),
    )
    for name, s in report.sets.items():
        rms = [figure(errors["overall"]) for errors in (s.rms.train, s.rms.validation)]
        table.add_row(name, s.lmi, *rms, str(s.violations), figure(1000 * s.seconds), f"{abs(s.duality_gap):.0e}")
    terminal.show(table)
    table = new_table("Estimators", "estimator", "train", "held out", "ms", "gap", "iterations")
    for name, e in report.estimators.items():
        rms = [figure(errors["overall"]) for errors in (e.rms.train, e.rms.validation)]
        table.add_row(name, *rms, figure(1000 * e.seconds), f"{abs(e.duality_gap):.0e}", str(e.iterations))
    terminal.show(table)
    learning = report.learning
    title = f"Median held-out RMS, {unit}, against training samples, {learning.draws} draws"
    table = new_table(title, "samples", *learning.curves, *(f"{name} violation" for name in learning.violation))
    for k, count in enumerate(learning.counts):
        medians = [figure(curve.median[k]) for curve in learning.curves.values()]
        table.add_row(str(count), *medians, *(figure(v[k]) for v in learning.violation.values()))
    terminal.show(table)
    settled = report.adaptation.time_to_10_percent
    table = new_table("Online: time to 10 % parameter error", "set", "s")
    for name, seconds in settled.items():
        table.add_row(name, "not reached" if seconds is None else figure(seconds))
    terminal.show(table)
    terminal.notices(report.notices)
    terminal.say(f"written: {folder}/study.json, study.html ({report.seconds:.0f} s)")
