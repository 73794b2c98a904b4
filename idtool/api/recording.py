"""Results as recordings for rerun's viewer."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array
from idtool.common.outputs import write_all
from idtool.estimation.evaluation.envelope import Envelope, Trace
from idtool.estimation.evaluation.validation import Evaluation
from idtool.estimation.fit import Fit
from idtool.reporting.rerun_recording import log_recording, rerun_recording
from idtool.robot.model import Model

_MEASURED_PATHS = {"measured": "torque/measured", "residual": "torque/residual", "q": "position/measured"}


def save_recording(file: str | os.PathLike[str], model: Model, logs: Sequence[Sequence[Trace]], shown: str) -> Path:
    """Write what was measured, predicted and simulated, with the robot and its bounding ellipsoids.

    Parameters
    ----------
    file
        Where to.
    model
        The robot.
    logs
        Of each log the torque and, where the model was run forwards, the positions.
    shown
        The model that is shown, as the traces have it.

    Raises
    ------
    ConfigError
        If rerun is not installed.
    OutputError
        If the file cannot be written.
    """
    torque = {**_MEASURED_PATHS, shown: "torque/model"}
    motion = {"measured": "position/measured", shown: "position/simulated"}
    takes = [log_recording(traces[0].name, list(zip(traces, (torque, motion), strict=False))) for traces in logs]
    ellipsoids = {body.name: body.ellipsoids for body in model.bodies if body.kind == "link" and body.ellipsoids}
    write_all(Path(file).parent, {Path(file).name: rerun_recording(model.robot, model.names, ellipsoids, takes)})
    return Path(file)


def fit_traces(fit: Fit) -> list[list[Trace]]:
    """The logs of a fit: what was held out, else what it was fitted to."""
    return traces_by_log(fit.evaluation, fit.simulation.traces if fit.simulation else ())


def traces_by_log(evaluation: Evaluation, motions: Sequence[Trace]) -> list[list[Trace]]:
    """Of each log its torque and its positions, where there are some."""
    return [[trace, *(m for m in motions if m.name == trace.name)] for trace in evaluation.traces]


def motion_traces(name: str, t: Array, measured: Array, simulated: Array) -> list[list[Trace]]:
    """A log by its positions alone, shape (N, nv) each."""
    envelope = Envelope([slice(0, len(t))], t)
    envelope.add(t, {"measured": np.asarray(measured).T, "model": np.asarray(simulated).T})
    motion = envelope.trace(name)
    return [[Trace(name, motion.t), motion]]
