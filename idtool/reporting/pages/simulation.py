"""The section on a model run forwards, of report.html and validation.html."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from idtool.common.arrays import Array
from idtool.estimation.evaluation.rollouts import RolloutEvaluation
from idtool.reporting.pages.base import Sections
from idtool.reporting.pages.charts import chart, line, numbers, panel
from idtool.reporting.pages.curves import drawn
from idtool.reporting.pages.figures import by_unit

SIMULATION = ("Simulation", "simulation.html")

_MOST_VALUES = 40_000  # that all curves hold together: some 300 kB of text
_BEYOND = 0.5  # of the measured range, by which a curve that leaves it is shown to either side
_COLORS = {"model": 5, "prior": 1, "baseline": 0}  # as in the plots over time
_BASELINES = {"open_loop": "stays where it was", "closed_loop": "q = qcmd"}


def with_simulation(sections: Sections, report: Mapping[str, Any]) -> Sections:
    """The sections, without that on the simulation where there was none."""
    return [section for section in sections if section != SIMULATION or report["simulation"] is not None]


def simulation_view(rollouts: RolloutEvaluation | None, report: Mapping[str, Any], model: str) -> dict[str, Any]:
    """What is drawn of a simulation, of bounded size; nothing where there was none.

    Parameters
    ----------
    replay
        The simulation.
    report
        The content of report.json or validation.json.
    model
        Whose motion is the ``simulated`` one.

    Returns
    -------
    ``simulation``, as `curves` has the torques, each joint with the ``range`` of positions to show, and ``charts``.
    """
    found = report["simulation"]
    if rollouts is None or found is None:
        return {}
    names = {"measured": "measured", "simulated": model, **({"prior": "prior"} if found["prior"] else {})}
    view = drawn(rollouts.traces, names, found["units"], _MOST_VALUES)
    for log in view["logs"]:
        for joint in log["joints"]:
            joint["range"] = _shown(numbers(joint["measured"]), numbers(joint.get("simulated", [])))
    return {"simulation": view, "charts": _charts(found)}


def simulation_text(report: Mapping[str, Any]) -> dict[str, Any]:
    """What the template says of a simulation beside the report."""
    found = report["simulation"]
    if found is None:
        return {}
    return {"position_groups": by_unit(found["units"]), "baseline": _BASELINES[found["kind"]]}


def _shown(measured: Array, simulated: Array) -> list[float]:
    """The range of positions to show: that of both, of what leaves the measured one not more than a part."""
    low, high = np.nanmin(measured), np.nanmax(measured)
    room = _BEYOND * (high - low)
    both = np.concatenate([measured, np.clip(simulated, low - room, high + room)])
    low, high = np.nanmin(both), np.nanmax(both)
    edge = 0.05 * (high - low) or 0.01
    return [float(f"{low - edge:.4g}"), float(f"{high + edge:.4g}")]


def _charts(found: Mapping[str, Any]) -> dict[str, Any]:
    """What `lines.js` draws: error against time since the restart."""
    horizons = found["horizon"]
    if len(horizons) < 2:
        return {}
    lines = []
    for name, key in {"model": "position", "prior": "prior", "baseline": "baseline"}.items():
        if all(at[key] for at in horizons):
            label = _BASELINES[found["kind"]] if name == "baseline" else name
            lines.append(line(label, [at[key]["overall"] for at in horizons], _COLORS[name]))
    title = f"RMS error [{by_unit(found['units'])[-1][0]}]"
    caption = "Position error against time since the restart, all joints"
    seconds = [at["seconds"] for at in horizons]
    return {"horizon": chart(caption, seconds, "time since the restart [s]", [panel(title, lines, log=True)], log=True)}
