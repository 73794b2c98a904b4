"""A model run forwards, in `fit`, `validate` and `simulate`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from idtool.common.number_text import short_number
from idtool.common.units import units_text
from idtool.reporting.results.rollouts import Simulation
from idtool.reporting.results.simulation import SimulationReport
from idtool.reporting.sections.simulation import SimulationErrorsSection, restarts_text
from idtool.reporting.terminal.output import STYLE, Output


def show_simulation(terminal: Output, simulation: Simulation | None) -> None:
    """Position errors of a model run forwards, by joint and by time since the restart."""
    if simulation is None:
        return
    terminal.sections([SimulationErrorsSection()], simulation)
    if remark := _warning(simulation):
        terminal.say(f"{remark}\n", STYLE["warning"])


def show_simulated_log(terminal: Output, report: SimulationReport, tracks: bool) -> None:
    """The kind of simulation, its distance from the trajectory it tracks or the measured motion, and the file."""
    loop = "closed loop under the controller" if report.kind == "closed_loop" else "open loop under the logged torque"
    restarts = "never restarted" if report.window is None else f"{report.window:g} s at a time"
    terminal.say(f"{loop}, {restarts}: {short_number(report.seconds)} s simulated in {report.wall_seconds:.1f} s")
    if position := report.rmse.position:
        units = units_text(report.units)
        joints = ", ".join(f"{name} {short_number(position[name])}" for name in report.joints)
        target = "trajectory" if tracks else "measured positions"
        terminal.say(f"{short_number(position['overall'])} {units} RMS from the {target}: {joints}")
    terminal.notices(report.notices)
    if report.file is not None:
        terminal.say(f"written: {report.file}")


def _warning(simulation: Simulation) -> str | None:
    """Warning that the model is no better than the baseline; None if it is better."""
    if _is_better(simulation.position, simulation.baseline.position):
        return None
    baseline = "a robot that keeps its position"
    if simulation.kind == "closed_loop":
        baseline = "a robot that follows its command exactly"
    return f"Simulated for {restarts_text(simulation)}, the model has a larger error than {baseline}."


def _is_better(model: Mapping[str, Any], baseline: Mapping[str, Any] | None) -> bool:
    """True if a model's error is below the baseline's; a model that diverged has no error."""
    error = model["overall"]
    baseline_error = (baseline or {}).get("overall")
    return error is not None and (baseline_error is None or error < baseline_error)
