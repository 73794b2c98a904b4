"""`simulate`: run a model forwards along a log, or along a trajectory under its controller."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass  # noqa: TID251  # which refuses changes of a result
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from idtool.api.data import LogSource, load_experiment
from idtool.api.log import Log
from idtool.api.model import Model, Source, as_model
from idtool.api.notebook import Displayable, shows_progress
from idtool.api.results import Progress, Recordable, ignore_progress, notice_lines, table_lines
from idtool.common.arrays import Array
from idtool.common.exceptions import ConfigError
from idtool.common.notice import Notice
from idtool.common.number_text import number, short_number
from idtool.common.outputs import OutputError
from idtool.common.threads import with_single_threaded_blas
from idtool.common.units import position_units, units_text
from idtool.data.logs import check_log_file, log_suffixes, write_log
from idtool.estimation.dataset.experiment import NOT_SIMULATED, Experiment
from idtool.estimation.evaluation.simulated_log import (
    SimulatedLog,
    as_command,
    as_logged,
    simulated_log,
    under_controller,
)
from idtool.reporting.results.base import NoticeReport, notice_fields
from idtool.reporting.results.simulation import MotionRmse, SimulationReport
from idtool.robot.config import Config
from idtool.robot.model import RobotModel

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from idtool.api.results import RecordingData
    from idtool.reporting.terminal.output import Output

LOG_NAME = "simulated.mcap"  # what the log is called in a folder
_MOST_OF_LOG = 0.95  # of its time: what is not simulated beside this is needed by filters


@dataclass(frozen=True, eq=False, repr=False)
class SimulationResult(Recordable, Displayable):
    """Result of a simulation.

    Attributes
    ----------
    log
        The motion: q, v, tau, and also qcmd and vcmd if the controller used them.
    report
        The content of `idtool simulate --json`. Its fields are also attributes of the result.
    """

    log: Log
    report: SimulationReport
    _model: RobotModel
    _measured: Array
    _source: Path
    _tracks: bool

    @property
    def rmse(self) -> MotionRmse:
        """RMS error relative to the measured motion, without the samples at which the simulation was restarted."""
        return self.report.rmse

    @property
    def kind(self) -> str:
        """``open_loop``, under the logged torque, or ``closed_loop``, under the controller."""
        return self.report.kind

    @property
    def window(self) -> float | None:
        """Time between restarts from the measured state [s]; None: never restarted."""
        return self.report.window

    @property
    def seconds(self) -> float:
        """Simulated time [s]."""
        return self.report.seconds

    @property
    def rollouts(self) -> int:
        """Number of rollouts."""
        return self.report.rollouts

    @property
    def lost(self) -> int:
        """Number of rollouts that diverged; they end at that time."""
        return self.report.lost

    @property
    def notices(self) -> tuple[NoticeReport, ...]:
        """The notices."""
        return self.report.notices

    @property
    def warnings(self) -> tuple[str, ...]:
        """The notices, a text each."""
        return self.report.warnings

    def to_json(self, file: str | os.PathLike[str] | None = None) -> dict[str, Any]:
        """The content that `idtool simulate --json` prints; a copy.

        Parameters
        ----------
        file
            Where the log was saved, ``file`` of the result.
        """
        return self.report.model_copy(update={"file": None if file is None else str(file)}).to_json()

    def save(self, place: str | os.PathLike[str]) -> tuple[Path, ...]:
        """Write the log, as `idtool simulate` does.

        Parameters
        ----------
        place
            A folder, in which ``simulated.mcap`` is written, or an MCAP or CSV file.

        Returns
        -------
        The file.

        Raises
        ------
        IdtoolError
            If the log cannot be written, or would overwrite the log that was read.
        """
        file = Path(place)
        if file.suffix.lower() not in log_suffixes():
            file = file / LOG_NAME
        check_log_file(file, [self._source])
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            what = f"cannot be written to ({error.strerror}); give another --out"
            raise OutputError(file.parent, what) from None
        write_log(file, self.log.record)
        return (file,)

    def _recording_data(self) -> RecordingData:
        from idtool.api.recording import motion_traces

        motion = motion_traces(self._source.name, self.log.t, self._measured, self.log.q)
        return self._model, motion, "model"

    def plot(self) -> Figure:
        """Measured and simulated position of every joint; with ``track``, the trajectory instead of the measurement."""
        from idtool.reporting.plots.simulation import motion_figures

        curves = {"measured": self._measured.T, "simulated": self.log.q.T}
        return motion_figures(self.log.t, curves, self.report.units).to_plotly()

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.simulation import show_simulated_log

        show_simulated_log(output, self.report, self._tracks)

    def __repr__(self) -> str:
        kinds = dict.fromkeys(self.report.units.values())
        position_unit = " or ".join(kinds)
        velocity_unit = " or ".join(f"{unit}/s" for unit in kinds)
        loop = self.kind.replace("_", " ")
        restarts = "never restarted" if self.window is None else f"{self.window:g} s at a time"
        lines = [f"SimulationResult: {short_number(self.seconds)} s {loop}, {restarts}"]
        velocity = self.rmse.velocity
        if self.rmse.position is not None:
            rows = []
            for name, position_error in self.rmse.position.items():
                velocity_error = velocity[name] if velocity else None
                rows.append([name, number(position_error), number(velocity_error)])
            head = ["RMS error", f"position [{position_unit}]", f"velocity [{velocity_unit}]"]
            lines += table_lines(head, rows)
        lines += notice_lines(self.notices)
        return "\n".join(lines)


@shows_progress
@with_single_threaded_blas
def simulate(
    model: Model | Source,
    log: LogSource,
    *,
    window: float | None = None,
    closed_loop: bool = False,
    track: bool = False,
    progress: Progress | None = None,
) -> SimulationResult:
    """Simulate a model under the torque or the controller of a log, or along a trajectory, like `idtool simulate`.

    Parameters
    ----------
    model
        The model, or its URDF.
    log
        A log or, with ``track``, a trajectory: a path, read as the configuration says, or a `Log`.
    window
        Time between restarts from the measured state [s]; 0: no restarts. None: the configuration's
        ``simulation.window`` under the logged torque, and no restarts under the controller.
    closed_loop
        Drive the joints with the configuration's controller and the logged command instead of the logged torque.
    track
        Let the controller track the log's qcmd and vcmd, or q and v without them, from their first state.
    progress
        Function that is called with the name of a stage and the fraction of it that is done; None: no reports.

    Raises
    ------
    IdtoolError
        If the log, the configuration or the model cannot be used, or the simulation diverges immediately.
        Messages name options as the command line does.

    Examples
    --------
    >>> run = idtool.simulate("sample_logs/leg.urdf", "sample_logs/leg_validate.mcap", window=0.1)
    >>> run.log.joints, run.rollouts
    (('abad', 'hip', 'knee'), 100)
    """
    start = time.monotonic()
    report_progress = progress or ignore_progress
    model = as_model(model)
    _check_options(model.settings, window, closed_loop, track)
    transform = as_logged
    if track:
        transform = as_command
    elif closed_loop:
        transform = under_controller
    experiment = load_experiment(model, (), log, progress=report_progress, transform=transform)
    used_window = _choose_window(experiment, window)
    theta = experiment.equation.prior
    simulated = simulated_log(experiment, theta, used_window, Path(LOG_NAME), report_progress)
    report = _report(experiment, simulated, time.monotonic() - start)
    return SimulationResult(
        log=Log.from_record(simulated.log),
        report=report,
        _model=experiment.model,
        _measured=simulated.measured,
        _source=experiment.runs[0].signals.log.path,
        _tracks=track,
    )


def _check_options(settings: Config, window: float | None, closed_loop: bool, track: bool) -> None:
    if closed_loop and track:
        raise ConfigError("--track", "cannot be combined with --closed-loop; use only one of them")
    if (closed_loop or track) and settings.controller is None:
        option = "--track" if track else "--closed-loop"
        raise ConfigError("controller", f"is missing in the configuration; {option} needs its kp and kd")
    if window is not None and not 0 <= window < math.inf:
        raise ConfigError("--window", f"{window:g} is not a valid time; give seconds, or 0 for no restarts")


def _choose_window(experiment: Experiment, window: float | None) -> float | None:
    """Time between restarts [s]; None: never restarted."""
    if window is not None:
        return window or None
    if experiment.runs[0].signals.controller.joints.any():
        return None
    return experiment.config.simulation.window


def _report(experiment: Experiment, simulated: SimulatedLog, wall_seconds: float) -> SimulationReport:
    """The record of the result, without the file."""
    notices = [notice for notice in experiment.notices if notice.code not in NOT_SIMULATED]
    notices += _motion_notices(experiment, simulated)
    return SimulationReport(
        file=None,
        joints=simulated.log.joints,
        units=_position_units(experiment.model),
        kind=simulated.kind,
        window=simulated.window,
        rollouts=simulated.rollouts,
        lost=simulated.diverged,
        samples=len(simulated.log),
        seconds=simulated.seconds,
        log_seconds=simulated.log_seconds,
        wall_seconds=wall_seconds,
        rmse=MotionRmse(position=simulated.position or None, velocity=simulated.velocity or None),
        urdf=str(experiment.model.robot.path),
        log=str(experiment.runs[0].signals.log.path),
        **notice_fields(notices),
    )


def _position_units(model: RobotModel) -> dict[str, str]:
    """Unit of each joint's position."""
    return position_units({name: model.units[name] for name in model.joint_names})


def _motion_notices(experiment: Experiment, simulated: SimulatedLog) -> Iterator[Notice]:
    """Notices about a motion that is not that of the log, or not of all of it."""
    if experiment.equation.contacts is not None and simulated.seconds < _MOST_OF_LOG * simulated.log_seconds:
        share = f"{short_number(simulated.seconds)} s of {short_number(simulated.log_seconds)} s"
        message = f"simulated: {share}, in which no contact force acts on the joints"
        yield Notice("simulated_without_contact", "note", None, f"{message}; the log has gaps elsewhere")
    if simulated.diverged:
        message = f"{simulated.diverged} of {simulated.rollouts} rollouts diverged; each ends where it diverged"
        yield Notice("simulation_diverged", "warning", None, message)
    if experiment.config.wrench_sensors:
        message = "the readings of wrench sensors are not simulated, and are left out of the log"
        advice = "read it with a configuration without wrench_sensors"
        yield Notice("wrench_sensors_not_simulated", "note", None, message, advice)
    if simulated.position:
        units = units_text(_position_units(experiment.model))
        error = simulated.position["overall"]
        motion = float(np.sqrt(np.nanvar(simulated.measured, axis=0).mean()))
        if error > motion:
            difference = (
                f"it differs by {short_number(error)} {units} RMS, and the joints move by "
                f"{short_number(motion)} {units} RMS"
            )
            message = f"the simulated motion does not follow the log: {difference}"
            advice = "check kp and kd of the controller"
            if simulated.kind == "open_loop":
                advice = "torque errors add up under a logged torque: use --closed-loop, --track or a short --window"
            yield Notice("simulation_ran_away", "warning", None, message, advice)
    if simulated.rollouts > simulated.stretches:
        message = f"every {simulated.window:g} s, the simulation restarts from the measured state, and the motion jumps"
        advice = "for a log without jumps, as diagnose --against needs it, use --closed-loop, --track or --window 0"
        yield Notice("simulation_restarted", "note", None, message, advice)
