"""The results of `idtool validate`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from idtool.estimation.regression import Outcome
from idtool.reporting.terminal.base import Terminal, figure, new_table, units_of
from idtool.reporting.terminal.simulation import show_simulation
from idtool.reporting.terminal.tables import Words


def show_validation(terminal: Terminal, report: dict[str, Any], folder: Path) -> None:
    """The result of a validation."""
    models = list(report["rms"])
    columns = [*models, "raw", "of torque", "bound"]
    table = new_table(f"RMS torque error, {units_of(report)}, below {report['band_hz']:g} Hz", "joint", *columns)
    for name in (*report["joints"], "overall"):
        bound = report["bound"].get(name)
        met = "" if bound is None else " ok" if report["ok"][name] else " NOT MET"
        share = report["nrms"].get(name)
        table.add_row(
            name,
            *(figure(report["rms"][model][name]) for model in models),
            figure(report["rms_raw"]["model"][name]),
            "" if share is None else f"{share:.1%}",
            "" if bound is None else f"{bound:g}{met}",
        )
    terminal.show(table)
    show_simulation(terminal, report["simulation"])
    terminal.warn(report["warnings"])
    terminal.say(f"written: {folder}/validation.json, validation.html")


def show_regression(terminal: Terminal, outcomes: Sequence[Outcome]) -> None:
    """Every case against its bounds."""
    table = new_table(
        "Regression: RMS torque error in the band, N·m or N", (Words("case"), "joint"), "prior", "fit", ("bound", "")
    )
    for o in outcomes:
        met = "ok" if o.ok else "NOT MET"
        table.add_row(o.case, o.joint, figure(o.prior), figure(o.rms), figure(o.bound), met)
    terminal.show(table)
