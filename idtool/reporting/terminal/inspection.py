"""The result of `idtool inspect`."""

from __future__ import annotations

from idtool.reporting.figures import figure
from idtool.reporting.results.inspection import InspectionReport
from idtool.reporting.terminal.base import Terminal, new_table
from idtool.reporting.terminal.tables import Words


def show_inspection(terminal: Terminal, inspection: InspectionReport) -> None:
    """What is in a log, and the findings."""
    terminal.say(
        f"{inspection.path}: {inspection.samples} samples, {inspection.duration:.2f} s at {inspection.rate_hz:.4g} Hz, "
        f"{inspection.segments} stretches without a gap"
    )
    table = new_table(
        "Joints",
        "joint",
        Words("signals"),
        ("from", "to"),
        *("v rms", "tau rms", "band Hz", "at rest", "v lag ms"),
        Words("tau"),
    )
    for name, joint in inspection.joints.items():
        q, tau, v = joint.signals.get("q"), joint.signals.get("tau"), joint.velocity
        table.add_row(
            name,
            " ".join(joint.signals),
            figure(q.minimum if q else None),
            figure(q.maximum if q else None),
            figure(joint.speed_rms),
            figure(tau.rms if tau else None),
            figure(joint.band_hz),
            f"{joint.standstill:.0%}",
            figure(v.lag_ms if v else None),
            joint.torque.kind if joint.torque else "-",
        )
    terminal.show(table)
    terminal.notices(inspection.notices)
