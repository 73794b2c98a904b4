"""validation.html."""

from __future__ import annotations

from typing import Any

from idtool.pages.base import render
from idtool.pages.curves import curves
from idtool.pages.figures import by_unit
from idtool.pages.simulation import SIMULATION, simulation_text, simulation_view, with_simulation
from idtool.replay import Replay
from idtool.validation import Evaluation

_SECTIONS = (
    ("What was found", "validation_findings.html"),
    ("Torque error", "validation_errors.html"),
    ("Measured and predicted torque", "torques.html"),
    SIMULATION,
    ("How this was made", "origin.html"),
)


def validation_page(evaluation: Evaluation, report: dict[str, Any], command: str, replay: Replay | None = None) -> str:
    """validation.html.

    Parameters
    ----------
    evaluation
        Errors and curves of ``model`` and, where one was given, ``prior``.
    report
        The content of validation.json.
    command
        The command line that made it.
    replay
        The same models run forwards, if they were.
    """
    units = report["units"]
    return render(
        "Validation of a dynamics model",
        with_simulation(_SECTIONS, report),
        ["torques.js", "lines.js", "positions.js"],
        {**curves(evaluation, "model", units), **simulation_view(replay, report, "model")},
        report=report,
        groups=by_unit(units),
        **simulation_text(report),
        where="On the validation logs",
        command=command,
    )
