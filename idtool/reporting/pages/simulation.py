"""The section on a model run forwards, of report.html and validation.html."""

from __future__ import annotations

from typing import Any

from idtool.estimation.evaluation.rollouts import RolloutEvaluation
from idtool.reporting.number_text import rows_by_unit
from idtool.reporting.pages.base import Sections
from idtool.reporting.plots.simulation import horizon_figure, position_figures
from idtool.reporting.results.rollouts import Simulation
from idtool.reporting.sections.simulation import SimulationErrorsSection

SIMULATION = SimulationErrorsSection()


def with_simulation(sections: Sections, simulation: Simulation | None) -> Sections:
    """The sections, without that on the simulation where there was none."""
    return [section for section in sections if section != SIMULATION or simulation is not None]


def simulation_view(rollouts: RolloutEvaluation | None, simulation: Simulation | None, model: str) -> dict[str, Any]:
    """Template variables of a simulation.

    Parameters
    ----------
    rollouts
        The simulation.
    simulation
        Its record; None where there was none.
    model
        The model whose motion is the ``simulated`` one.
    """
    if rollouts is None or simulation is None:
        return {"simulation": None}
    return {
        "simulation": simulation,
        "positions": position_figures(rollouts, simulation, model),
        "horizon": horizon_figure(simulation),
        "position_groups": rows_by_unit(simulation.units),
    }
