"""Results as recordings for rerun's viewer."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array
from idtool.common.outputs import write_all
from idtool.estimation.dataset.envelope import Envelope, Trace
from idtool.estimation.evaluation.torque_errors import Evaluation
from idtool.estimation.fit import Fit
from idtool.reporting.rerun_recording import log_recording, rerun_recording
from idtool.robot.model import RobotModel

_MEASURED_PATHS = {"measured": "torque/measured", "residual": "torque/residual", "q": "position/measured"}


def save_recording(
    file: str | os.PathLike[str], model: RobotModel, logs: Sequence[Sequence[Trace]], curve: str
) -> Path:
    """Write measured, predicted and simulated curves, with the robot and its bounding ellipsoids.

    Parameters
    ----------
    file
        The recording.
    model
        The robot.
    logs
        For each log, the trace of the torque and, where the model was run forwards, that of the positions.
    curve
        Name of the model's curve in the traces.

    Raises
    ------
    ConfigError
        If rerun is not installed.
    OutputError
        If the file cannot be written.
    """
    torque = {**_MEASURED_PATHS, curve: "torque/model"}
    motion = {"measured": "position/measured", curve: "position/simulated"}
    recordings = []
    for traces in logs:
        parts = list(zip(traces, (torque, motion), strict=False))
        recordings.append(log_recording(traces[0].name, parts))
    ellipsoids = {body.name: body.ellipsoids for body in model.bodies if body.kind == "link" and body.ellipsoids}
    content = rerun_recording(model.robot, model.names, ellipsoids, recordings)
    path = Path(file)
    write_all(path.parent, {path.name: content})
    return path


def fit_traces(fit: Fit) -> list[list[Trace]]:
    """Traces of a fit's logs: of the held-out data, or of the training data if none were held out."""
    motions = fit.simulation.traces if fit.simulation else ()
    return traces_by_log(fit.evaluation, motions)


def traces_by_log(evaluation: Evaluation, motions: Sequence[Trace]) -> list[list[Trace]]:
    """Traces of each log: its torque and, where the model was run forwards, its positions."""
    logs = []
    for trace in evaluation.traces:
        own_motions = [motion for motion in motions if motion.name == trace.name]
        logs.append([trace, *own_motions])
    return logs


def motion_traces(name: str, t: Array, measured: Array, simulated: Array) -> list[list[Trace]]:
    """Traces of one log with positions only, shape (N, nv) each."""
    envelope = Envelope([slice(0, len(t))], t)
    envelope.add(t, {"measured": np.asarray(measured).T, "model": np.asarray(simulated).T})
    motion = envelope.trace(name)
    return [[Trace(name, motion.t), motion]]
