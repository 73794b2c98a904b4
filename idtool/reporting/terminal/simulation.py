"""A model run forwards, in `fit` and `validate`."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

from idtool.reporting.results.rollouts import Simulation
from idtool.reporting.sections.simulation import SimulationErrorsSection, restarts_text
from idtool.reporting.terminal.base import STYLE, Terminal


def show_simulation(terminal: Terminal, simulation: Simulation | None) -> None:
    """Position errors of a model run forwards, by joint and by time since the restart."""
    if simulation is None:
        return
    terminal.sections([SimulationErrorsSection()], simulation)
    if remark := _remark(simulation):
        terminal.say(f"{remark}\n", STYLE["warning"])


def _remark(simulation: Simulation) -> str | None:
    """That the model is no better than the baseline in all, and how long it is better; None where it is."""
    if _better(simulation.position, simulation.baseline.position):
        return None
    baseline = "a robot that keeps its position"
    if simulation.kind == "closed_loop":
        baseline = "a robot that follows its command exactly"
    drift = f"Simulated for {restarts_text(simulation)}, the model is farther from the data than {baseline}"
    better = itertools.takewhile(lambda at: _better(at.position, at.baseline), simulation.horizon)
    if good := [at.seconds for at in better]:
        long = f"{1000 * good[-1]:g} ms"
        return f"{drift}; it is closer up to {long} after a restart: do not trust its rollouts for longer than that."
    return f"{drift}: do not trust its rollouts."


def _better(model: Mapping[str, Any], baseline: Mapping[str, Any] | None) -> bool:
    """Whether a model's error is below the baseline's; one that ran away has none."""
    own, other = model["overall"], (baseline or {}).get("overall")
    return own is not None and (other is None or own < other)
