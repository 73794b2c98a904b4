"""The section on a model run forwards, of report.html and validation.html."""

from __future__ import annotations

from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.estimation.evaluation.rollouts import RolloutEvaluation
from idtool.reporting.figures import by_unit
from idtool.reporting.pages.base import Sections
from idtool.reporting.pages.charts import chart, line, numbers, panel
from idtool.reporting.pages.curves import drawn
from idtool.reporting.results.rollouts import Simulation
from idtool.reporting.sections.simulation import SimulationErrorsSection

SIMULATION = SimulationErrorsSection()

_MOST_VALUES = 40_000  # that all curves hold together: some 300 kB of text
_BEYOND = 0.5  # of the measured range, by which a curve that leaves it is shown to either side
_COLORS = {"model": 5, "prior": 1, "baseline": 0}  # as in the plots over time
_BASELINES = {"open_loop": "stays where it was", "closed_loop": "q = qcmd"}


def with_simulation(sections: Sections, simulation: Simulation | None) -> Sections:
    """The sections, without that on the simulation where there was none."""
    return [section for section in sections if section != SIMULATION or simulation is not None]


def simulation_view(rollouts: RolloutEvaluation | None, simulation: Simulation | None, model: str) -> dict[str, Any]:
    """What is drawn of a simulation, of bounded size; nothing where there was none.

    Parameters
    ----------
    rollouts
        The simulation.
    simulation
        Its record; None where there was none.
    model
        Whose motion is the ``simulated`` one.

    Returns
    -------
    ``simulation``, as `curves` has the torques, each joint with the ``range`` of positions to show, and ``charts``.
    """
    if rollouts is None or simulation is None:
        return {}
    names = {"measured": "measured", "simulated": model, **({"prior": "prior"} if simulation.prior else {})}
    view = drawn(rollouts.traces, names, simulation.units, _MOST_VALUES)
    for log in view["logs"]:
        for joint in log["joints"]:
            joint["range"] = _shown(numbers(joint["measured"]), numbers(joint.get("simulated", [])))
    return {"simulation": view, "charts": _charts(simulation)}


def simulation_text(simulation: Simulation | None) -> dict[str, Any]:
    """What the template says of a simulation beside its record."""
    if simulation is None:
        return {}
    return {"position_groups": by_unit(simulation.units)}


def _shown(measured: Array, simulated: Array) -> list[float]:
    """The range of positions to show: that of both, of what leaves the measured one not more than a part."""
    low, high = np.nanmin(measured), np.nanmax(measured)
    room = _BEYOND * (high - low)
    both = np.concatenate([measured, np.clip(simulated, low - room, high + room)])
    low, high = np.nanmin(both), np.nanmax(both)
    edge = 0.05 * (high - low) or 0.01
    return [float(f"{low - edge:.4g}"), float(f"{high + edge:.4g}")]


def _charts(simulation: Simulation) -> dict[str, Any]:
    """What `lines.js` draws: error against time since the restart."""
    horizons = simulation.horizon
    if len(horizons) < 2:
        return {}
    lines = []
    for name, key in {"model": "position", "prior": "prior", "baseline": "baseline"}.items():
        errors = [getattr(horizon, key) for horizon in horizons]
        if all(errors):
            label = _BASELINES[simulation.kind] if name == "baseline" else name
            lines.append(line(label, [error["overall"] for error in errors], _COLORS[name]))
    title = f"RMS error [{by_unit(simulation.units)[-1][0]}]"
    caption = "Position error against time since the restart, all joints"
    seconds = [horizon.seconds for horizon in horizons]
    return {"horizon": chart(caption, seconds, "time since the restart [s]", [panel(title, lines, log=True)], log=True)}
