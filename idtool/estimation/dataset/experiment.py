"""`Experiment`: a robot, its logs and its configuration put together, with what is kept for validation set aside."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, LogError, ModelError
from idtool.common.names import join_names, printable, suggestion
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.common.processes import process_count
from idtool.common.provenance import InputFile
from idtool.common.threads import in_threads
from idtool.data.base_sensors import POSE, BaseSensors, needed_channels, sensor_options
from idtool.data.batches import Batches
from idtool.data.contact_channels import ContactChannels
from idtool.data.controller import with_unknown_torque, without_constant_torque
from idtool.data.logs import JointLog, read_log
from idtool.data.logs.message_options import message_options
from idtool.data.logs.sensor_channels import is_dead, with_sensors
from idtool.data.logs.stored_arrays import blocks_of, evaluate_blocks
from idtool.data.same_recording import distinct_names, is_same_recording, same_recordings
from idtool.data.signals import BATCH_SAMPLES, Batch, Signals
from idtool.data.wrench_channels import WrenchChannels
from idtool.dynamics.armature import with_armature
from idtool.dynamics.contact_model import ContactModel
from idtool.dynamics.effects import build_effects
from idtool.dynamics.effects.wrench_sensor_offset import drift_times
from idtool.dynamics.regressor import LinearModel
from idtool.dynamics.regrouping import not_regrouped, regrouped
from idtool.dynamics.row_filter import Shares
from idtool.estimation.dataset.batch_cache import BatchCache
from idtool.estimation.dataset.blocks import (
    Blocks,
    block_rows,
    cut_into_blocks,
    merge_reductions,
    most_blocks,
    rounded_count,
)
from idtool.estimation.dataset.contact_detection import is_foot, is_support, with_detected_contacts
from idtool.estimation.dataset.cutoff import with_cutoff_for_logs
from idtool.estimation.dataset.equality_constraints import EqualityConstraints, equality_constraints, with_equal_bounds
from idtool.estimation.dataset.imu_delay import with_imu_delay
from idtool.estimation.dataset.joint_limits import beyond_limits_notice, position_ranges
from idtool.estimation.dataset.kinematic_checks import kinematic_notices
from idtool.estimation.dataset.passes import LogPart, read_through
from idtool.estimation.dataset.reduction import Reduction, empty, merge, with_all_columns
from idtool.estimation.dataset.weights import initial_row_noise
from idtool.estimation.dataset.wrench_sensor_sign import sign_notices
from idtool.robot.bounding import hull_sources
from idtool.robot.config import Config
from idtool.robot.inertia import PI_SIZE
from idtool.robot.model import RobotModel, build_model, check_wrench_sensors
from idtool.robot.urdf.reading import Robot

Progress = Callable[[str, float], None]  # stage, share of it that is done
Rows = Batches[tuple[list[Array], Shares]]

NOT_SIMULATED = ("floating_base_not_simulated", "contacts_not_simulated")  # notices for evaluations of models
_BATCH_BYTES = 64 << 20  # that columns may take
_LARGEST = 1e12  # of a signal in SI: powers of what is larger are not finite
_STANDING = {"prismatic": 0.005}  # m, that a joint may move and still count as standing
_STANDING_ANGLE = 0.02  # rad, of any other joint
_TRAVEL_PERCENTILES = (0.5, 99.5)  # between which a joint moves: a spike is no motion


@dataclass(frozen=True)
class Run:
    """One log: its signals, and its parts for fitting and for validation.

    Attributes
    ----------
    signals
        The motion of the model's joints.
    train, held_out
        Ranges of samples, without a gap each.
    """

    signals: Signals
    train: tuple[slice, ...]
    held_out: tuple[slice, ...]

    def parts(self, held_out: bool) -> tuple[slice, ...]:
        """The parts for validation, or those for fitting."""
        return self.held_out if held_out else self.train

    @property
    def fitted_times(self) -> tuple[float, float]:
        """First and last time of the part for fitting, since the log's first complete sample [s]."""
        dt = self.signals.log.dt
        return self.train[0].start * dt, self.train[-1].stop * dt


@dataclass(frozen=True)
class Experiment:
    """Model and data to fit or to validate.

    Attributes
    ----------
    config
        The configuration.
    model
        The tree of bodies.
    equation
        The torque equation.
    equalities
        Equality constraints on the coefficients.
    runs
        The logs.
    cache
        Batches and columns that are kept for other models of the same logs; None: none are.
    comparison_notices
        Those of the `notices` that a comparison of the logs with the model gave, without the logs' names.
    loading_notices
        Notices about logs that were given and are not used, or only in part.
    """

    config: Config
    model: RobotModel
    equation: LinearModel
    equalities: EqualityConstraints
    runs: tuple[Run, ...]
    cache: BatchCache | None = None
    comparison_notices: tuple[Notice, ...] = ()
    loading_notices: tuple[Notice, ...] = ()

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Notices about model and logs."""
        notices = [*self.loading_notices, *self.model.notices]
        notices += [*self._moving_joints_notice(), *self._same_recording_notices()]
        controller = self.config.controller
        if self.has_commands and controller is not None and controller.known_delay is None:
            message = "the delay is not known, so 0 is used; idtool fit determines it"
            notices.append(Notice("command_delay_not_fitted", "warning", "controller.delay", message))
        if self.model.has_floating_base:
            message = "a robot with a floating base is simulated only while no leg touches the ground"
            notices.append(Notice("floating_base_not_simulated", "note", None, message))
        elif self.equation.contacts is not None:
            message = "a robot with contacts is simulated only while no contact force acts on it"
            notices.append(Notice("contacts_not_simulated", "note", None, message))
        for run in self.runs:
            for notice in (*run.signals.log.notices, *run.signals.notices):
                notices.append(notice.in_log(run.signals.log.path.name) if len(self.runs) > 1 else notice)
        return tuple(notices)

    def _same_recording_notices(self) -> Iterator[Notice]:
        """Notices about logs that hold the same recording."""
        fitted = [run.signals.log for run in self.runs if run.train]
        for group in same_recordings(fitted):
            yield duplicate_notice(distinct_names(group))
        for run in self.runs:
            log = run.signals.log
            same = [other for other in fitted if not run.train and is_same_recording(other, log)]
            if same:
                others = distinct_names([log, *same])[1:]
                as_others = f", as {join_names(others)}," if others else ""
                use = f"the log is used for validation and{as_others} for the fit"
                message = f"{use}, so its error says little about prediction"
                yield Notice("validated_on_training_log", "warning", log.path.name, message)

    def _moving_joints_notice(self) -> Iterator[Notice]:
        """Notice about joints that move though they are not in the model, on one branch with joints that are."""
        moved = []
        robot = self.model.robot
        for joint in robot.joints.values():
            if joint.kind == "fixed" or joint.mimic or joint.name in self.model.names:
                continue
            is_on_branch = any(robot.on_same_branch(joint.name, name) for name in self.model.joint_names)
            if not (is_on_branch or self.model.has_floating_base):
                continue  # the root stands still, so that nothing is felt of it
            travel = max((_travel(run.signals.log, joint.name) for run in self.runs), default=0.0)
            if travel > _STANDING.get(joint.kind, _STANDING_ANGLE):
                unit = "m" if joint.kind == "prismatic" else "rad"
                place = self.config.locked_joints.get(joint.name, 0.0)
                moved.append(
                    f"{printable(joint.name)} (moves by {short_number(travel)} {unit}, assumed position {place:g})"
                )
        if moved:
            message = (
                f"these joints are assumed to stand still, but move in the log: {', '.join(moved)}; the effect of "
                "their motion on the other joints' torque is not in the model and biases the parameters"
            )
            advice = "add them to joints, or keep them at rest while you log"
            yield Notice("moving_joints_held_still", "warning", None, message, advice)

    @property
    def sources(self) -> tuple[InputFile, ...]:
        """Files of the experiment: the URDF, the configuration and the logs, each once."""
        return sources_of(self.model.robot, self.config, [run.signals.log for run in self.runs])

    @property
    def log_paths(self) -> tuple[Path, ...]:
        """The logs."""
        return tuple(run.signals.log.path for run in self.runs)

    @property
    def has_commands(self) -> bool:
        """True if the torque of a joint in a log is that of a controller under the logged command."""
        return any(run.signals.controller.joints.any() for run in self.runs)

    @property
    def lacks_gains(self) -> bool:
        """True if gains of a controller are yet to be fitted."""
        return any(run.signals.controller.lacks_gains for run in self.runs)

    def is_torque_unknown(self, joint: str) -> bool:
        """True if no log that is fitted has the torque of a joint."""
        return all(joint in run.signals.log.unknown_torque for run in self.runs if run.train)

    @property
    def has_held_out(self) -> bool:
        """True if a log has a part for validation."""
        return any(run.held_out for run in self.runs)

    @property
    def band_hz(self) -> float:
        """The low-pass's cut-off, the lowest of the runs' [Hz]."""
        return min(run.signals.band_hz for run in self.runs)

    @property
    def has_only_joints(self) -> bool:
        """True for a robot without a floating base, wrench sensors and contacts."""
        return self.equation.contacts is None and self.model.joint_count == len(self.model.joints)

    def batches(self, run: Run, held_out: bool) -> Batches[Batch]:
        """Batches of a log's part for validation, or for fitting."""
        parts = run.parts(held_out)
        return run.signals.batches(parts) if self.cache is None else self.cache.batches(run.signals, parts)

    def samples(self, held_out: bool) -> int:
        """Number of samples at the logged rate that are used for fitting or validation."""
        return sum(
            max(part.stop - part.start - 2 * run.signals.full_rate_low_pass.edge, 0)
            for run in self.runs
            for part in run.parts(held_out)
        )

    def blocks(
        self,
        rows: Callable[[Run], Rows],
        progress: Progress,
        stage: str,
        columns: Sequence[int] | None = None,
    ) -> tuple[Blocks, ...]:
        """Rows along the training data as R-factors of consecutive blocks, log by log.

        Parameters
        ----------
        rows
            Those of a log: per joint columns and torque, shape (columns + 1, n), and which of the n samples count.
        progress
            Callback for the stage and its progress, from 0 to 1.
        stage
            What is done to the logs; their names follow.
        columns
            Number of columns of each joint, for the memory that they take; None: one for each of its coefficients.

        Raises
        ------
        LogError
            If a joint has no sample that counts.
        """
        widths = self.columns_of_coefficients if columns is None else columns
        return self.checked_blocks(self._unchecked_blocks(rows, progress, stage, widths))

    def checked_blocks(self, blocks: Sequence[Blocks]) -> tuple[Blocks, ...]:
        """The training data in blocks, checked to have samples for every joint; LogError as `blocks`."""
        total = merge_reductions([log.total for log in blocks]) if blocks else empty(self.equation.active())
        self.checked(total)
        return tuple(blocks)

    def _unchecked_blocks(
        self, rows: Callable[[Run], Rows], progress: Progress, stage: str, columns: Sequence[int]
    ) -> tuple[Blocks, ...]:
        """`blocks`, whose joints may have no sample that counts; none if the logs are too short."""
        runs = [run for run in self.runs if run.train]
        of_logs = [rows(run) for run in runs]
        row_counts = [batches.rows for batches in of_logs]
        lengths = self.block_rows(runs, row_counts, columns, rounded_count(len(self.runs)))

        def cut(part: LogPart[tuple[list[Array], Shares]]) -> list[tuple[int, Reduction]]:
            redundancy = runs[part.log].signals.low_pass.redundancy
            return list(cut_into_blocks(part.batches, lengths[part.log], redundancy, part.first_row))

        parts: list[dict[int, Reduction]] = [{} for _ in runs]
        stages = [f"{stage} {run.signals.log.path.name}" for run in runs]
        most_processes = None if self.cache is None else 1  # copies of this process would fill a cache of their own
        for log, numbered in read_through(of_logs, cut, stages, progress, most_processes):
            for number, block in numbered:
                parts[log][number] = merge(parts[log][number], block) if number in parts[log] else block
        blocks = []
        for run, of_log, length in zip(runs, parts, lengths, strict=True):
            if of_log:
                seconds = length * run.signals.row_step
                blocks.append(Blocks(run.signals.log.path.name, tuple(of_log.values()), seconds))
        return tuple(blocks)

    @property
    def columns_of_coefficients(self) -> list[int]:
        """Number of columns of each joint's equation, one for each of its coefficients."""
        return [len(active) for active in self.equation.active()]

    def block_rows(
        self, runs: Sequence[Run], rows: Sequence[int], columns: Sequence[int], logs: int | None = None
    ) -> list[int]:
        """Number of rows in a block of each of some logs; see `blocks.block_rows`.

        Parameters
        ----------
        runs
            The logs.
        rows
            Number of rows of each.
        columns
            Number of columns of each joint.
        logs
            Number of logs of which these are some; None: there are no others.
        """
        steps = [run.signals.row_step for run in runs]
        return block_rows(rows, steps, self.band_hz, most_blocks(columns), logs or rounded_count(len(runs)))

    def reduce(self, progress: Progress) -> Reduction:
        """The training data as R-factors; see `checked`."""
        return merge_reductions([log.total for log in self.reduce_in_blocks(progress)])

    def reduce_unchecked(self, progress: Progress) -> Reduction:
        """The training data as R-factors, of which some joints may have no rows."""
        blocks = self._reduce_in_unchecked_blocks(progress)
        return merge_reductions([empty(self.equation.active()), *(log.total for log in blocks)])

    def reduce_in_blocks(self, progress: Progress) -> tuple[Blocks, ...]:
        """The training data as R-factors of consecutive blocks, log by log; LogError as `checked`."""
        return self.checked_blocks(self._reduce_in_unchecked_blocks(progress))

    def _reduce_in_unchecked_blocks(self, progress: Progress) -> tuple[Blocks, ...]:
        """`reduce_in_blocks`, where joints may have no sample that counts."""
        is_diagnosis = self.cache is not None  # which has columns, filtered, of the equation as it is
        model = not_regrouped(self.equation) if is_diagnosis else regrouped(self.equation)

        def rows(run: Run) -> Rows:
            return self.batches(run, False).map(model.equation.counted_rows)

        blocks = []
        for log in self._unchecked_blocks(rows, progress, "reading", self.columns_of_coefficients):
            merged, *parts = with_all_columns([log.total, *log.parts], model)
            blocks.append(replace(log, parts=tuple(parts), merged=merged))
        return tuple(blocks)

    def checked(self, data: Reduction) -> Reduction:
        """The training data, checked to have samples for every joint.

        Raises
        ------
        LogError
            If a joint has no sample that counts.
        """
        unknown = {name for run in self.runs for name in run.signals.log.unknown_torque}
        rows = zip(self.equation.joints, data, strict=True)
        still = [name for name, factor in rows if not factor.rows and name not in unknown]
        has_unknown_forces = any(not contact.is_measured for contact in self.config.contacts)
        may_lack_rows = has_unknown_forces or self.model.has_floating_base
        if may_lack_rows and len(still) < len(data):
            return data  # contact forces may leave nothing of a row
        if len(still) == len(data) and not self.samples(held_out=False):
            lengths = [(part.stop - part.start) * run.signals.log.dt for run in self.runs for part in run.train]
            longest = max(lengths, default=0.0)
            what = f"no part without gaps is long enough for the filter; the longest lasts {short_number(longest)} s"
            raise LogError(self.runs[0].signals.log.path, f"{what}: idtool inspect shows where samples are missing")
        if has_unknown_forces:
            what = "whenever the joints move, unknown contact forces can explain all torques"
            advice = "measure these forces, give the contact a flag, or log a motion without contact"
            raise LogError(self.runs[0].signals.log.path, f"{what}; {advice}")
        if still:
            what = "hardly moves in the part of the logs that is used for the fit"
            if effects := dict.fromkeys(entry.effect for entry in self.config.effects):
                what += f", or only where one of the effects ({join_names(effects)}) is not defined"
            what += "; log a motion of the joint, or lock the joint by leaving it out of joints"
            raise LogError(self.runs[0].signals.log.path, f"joint {join_names(still)} {what}")
        return data


def is_about(error: LogError, log: Path) -> bool:
    """True if an error is about a log."""
    return error.where == LogError(log, error.what).where


def left_out_notice(error: LogError) -> Notice:
    """Notice about a log that is left out, since it cannot be used."""
    return Notice("log_left_out", "warning", Path(error.where).name, "the log is left out", str(error))


def duplicate_notice(names: Sequence[str]) -> Notice:
    """Notice about logs that hold the same recording."""
    if len(set(names)) > 1:
        message = f"the same recording is in {join_names(names)}"
    else:
        message = f"{names[0]} is given more than once"
    advice = "give it once: standard errors are too small, and that these logs agree confirms nothing"
    return Notice("duplicate_log", "warning", None, message, advice)


def _travel(log: JointLog, joint: str) -> float:
    """Travel of a joint in a log [rad or m]; 0 if the log does not have it."""
    if not log.has("q", joint):
        return 0.0
    q = log.signals["q"][:, log.joints.index(joint)]
    low, high = np.nanpercentile(q, _TRAVEL_PERCENTILES)
    log.release_memory()
    return float(high - low)


def sources_of(robot: Robot, config: Config, logs: Iterable[JointLog] = ()) -> tuple[InputFile, ...]:
    """Files of a robot, a configuration and logs, each once; a log of arrays has no hash."""
    read = [robot.source]
    if config.source:
        read.append(config.source)
    read += hull_sources(robot, config)
    for log in logs:
        read += log.sources or [InputFile("log", str(log.path), None)]
    return tuple(dict.fromkeys(read))


def tracked(batches: Iterable[Batch], parts: Sequence[slice], progress: Progress, stage: str) -> Iterable[Batch]:
    """The batches, unchanged; each reports the progress."""
    whole = sum(part.stop - part.start for part in parts) or 1
    done = 0
    for batch in batches:
        yield batch
        done += len(batch.motion.t) - batch.before - batch.after
        progress(stage, min(done / whole, 1.0))


def prepare(
    robot: Robot,
    config: Config,
    logs: Sequence[Path | JointLog],
    validate: Sequence[Path | JointLog] = (),
    holdout: float = 0.3,
    transform: Callable[[JointLog], JointLog] = lambda log: log,
) -> Experiment:
    """Read the logs and put model and data together.

    Parameters
    ----------
    robot
        From the URDF.
    config
        The configuration.
    logs
        Logs to fit to: files, which are read as the configuration says, or logs that were read.
    validate
        Whole logs for validation; where given, nothing is held out of the others.
    holdout
        Share at the end of every log that is kept for validation.
    transform
        Applied to every log that is read.

    Raises
    ------
    IdtoolError
        If a log, the configuration or the model cannot be used.
    """
    check_holdout(holdout)
    if not logs and not validate:
        raise LogError("logs", "no log given; name at least one log file")
    check_wrench_sensors(robot, config)
    fitted = [transform(_read(log, config, robot)) for log in logs]
    validated = [transform(_read(log, config, robot)) for log in validate]
    every = (*fitted, *validated)
    _check_joints(every, config)
    common = [name for name in every[0].joints if all(name in log.joints for log in every)]
    model = build_model(robot, config, common)
    config = with_armature(config, model)
    for log in every:
        _check_signals(log, model.joint_names)
        _check_sensors(log, config)
    if config.base.uses_pose:  # of which there are noisy derivatives beyond
        config, _ = with_cutoff_for_logs(config, every)
    _check_detected_contacts(model, config)
    comparison_notices: list[Notice] = []
    beyond_limits = [beyond_limits_notice(robot, position_ranges(log, model.joint_names)) for log in every]
    are_positions_right = not any(beyond_limits)
    if model.has_floating_base:
        every, notices = _with_contacts(every, model, config, are_positions_right)
        comparison_notices += notices
        fitted, validated = list(every[: len(fitted)]), list(every[len(fitted) :])
        config, notices = with_imu_delay(config, model, every)
        comparison_notices += notices
        model = replace(model, notices=(*model.notices, *notices))
    names = recording_names(every)
    if config.wrench_sensors:
        seconds = [(1 - (0.0 if validate else holdout)) * (log.t[-1] - log.t[0]) for log in fitted]
        times = map(drift_times, seconds)
        model = replace(model, offset_logs=dict(zip(names, times, strict=False)))
    equation = LinearModel(
        model.names, build_effects(model, config), contacts=_contacts(model, config, fitted or every)
    )
    equalities = equality_constraints(config, model, equation)
    config, notices = with_cutoff_for_logs(config, every)
    model = replace(model, notices=(*model.notices, *notices))
    shares = [0.0 if validate else holdout] * len(fitted) + [1.0] * len(validated)

    def signals_of_named(log_and_name: tuple[JointLog, str]) -> Signals:
        log, name = log_and_name
        return signals_of(log, model, config, name)

    # Each log has threads of its own if it is not prepared in one: they are more where logs are few.
    values = sum(log.signals["q"].size for log in every) if len(every) >= process_count() else 0
    signals_by_log = in_threads(signals_of_named, list(zip(every, names, strict=True)), values)
    runs = []
    for signals, share, limits in zip(signals_by_log, shares, beyond_limits, strict=True):
        notices = [limits] if limits is not None else _signal_notices(signals, model, config)
        comparison_notices += notices
        signals.notices += notices
        runs.append(_split(signals, share))
    return Experiment(
        config,
        with_equal_bounds(model, equalities),
        equation,
        equalities,
        tuple(runs),
        comparison_notices=tuple(comparison_notices),
    )


def check_holdout(holdout: float) -> None:
    """Refuse a share of a log that leaves nothing of it for the fit, or is none; ConfigError."""
    if not 0 <= holdout < 1:
        raise ConfigError("--holdout", f"{holdout:g} is not a fraction; give a number from 0 to below 1")


def _with_contacts(
    logs: Sequence[JointLog], model: RobotModel, config: Config, are_positions_right: bool
) -> tuple[tuple[JointLog, ...], list[Notice]]:
    """Logs with a flag for every contact, and the notices about the flags.

    By wrong positions, legs seem to carry no load: there are then no notices.
    """
    with_flags = []
    flag_notices: list[Notice] = []
    for log in logs:
        detected = with_detected_contacts(log, model, config)
        if are_positions_right:
            flag_notices += detected.notices[len(log.notices) :]
        else:
            detected = replace(detected, notices=log.notices)
        with_flags.append(detected)
    return tuple(with_flags), flag_notices


def _signal_notices(signals: Signals, model: RobotModel, config: Config) -> list[Notice]:
    """Notices from a comparison of a log's signals with the robot's kinematics, and of its wrench sensors with it."""
    return [*kinematic_notices(signals, model, config), *sign_notices(signals, model, config)]


def recording_names(logs: Sequence[JointLog]) -> list[str]:
    """Names of logs, different from each other: the names of their files, with a number where these are the same."""
    names: list[str] = []
    for log in logs:
        same = [other for other in logs[: len(names)] if other.path.name == log.path.name]
        names.append(f"{log.path.name} ({len(same) + 1})" if same else log.path.name)
    return names


def signals_of(log: JointLog, model: RobotModel, config: Config, recording: str = "") -> Signals:
    """A log as the motion of a model.

    Parameters
    ----------
    log
        The log.
    model, config
        The robot.
    recording
        From `recording_names`; empty: its file name.

    Raises
    ------
    LogError
        If it lacks a signal of a joint or of a sensor.
    """
    base_sensors = BaseSensors.of_log(log, model, config)
    wrench_channels = WrenchChannels.of_log(log, model, config)
    contact_channels = ContactChannels.of_log(log, config, base_sensors)
    signals = Signals(
        log,
        model.joint_names,
        config,
        base_sensors,
        wrench_channels,
        contact_channels,
        recording,
        batch_samples=_batch_samples(model),
    )
    if base_sensors is not None:
        from idtool.data.inspection.imu_findings import imu_findings

        signals.notices += imu_findings(log)
    return signals


def _batch_samples(model: RobotModel) -> int:
    """Number of samples in a batch, so that the columns of all bodies along it fit in memory."""
    columns = PI_SIZE * int(model.support().sum())
    return min(BATCH_SAMPLES, _BATCH_BYTES // (8 * columns))


def _check_detected_contacts(model: RobotModel, config: Config) -> None:
    """Refuse to detect a contact that neither the torque of its leg nor the other contacts tell."""
    supports = [contact for contact in config.contacts if model.has_floating_base and is_support(contact, model)]
    always_closed = [contact.name for contact in config.contacts if contact.flag is None and not contact.is_measured]
    for i, contact in enumerate(config.contacts):
        key = f"contacts.{i}.flag: auto"
        if contact in supports and always_closed:
            what = f"needs a flag or a measured force of {join_names(always_closed)}, to tell when nothing else holds"
            raise ConfigError(key, f"{what} the robot; give one, or leave out flag: auto")
        if contact in supports or not contact.has_automatic_flag:
            continue
        if not (model.has_floating_base and is_foot(contact, model)):
            places = "the base, or points on links that at least three joints move"
            where = places if model.has_floating_base else "a floating base"
            what = f"is for {where}; name the channel of a flag, or leave it out"
            raise ConfigError(key, what)


def _contacts(model: RobotModel, config: Config, logs: Sequence[JointLog]) -> ContactModel | None:
    """The contacts of a robot; noise of rows that is not configured is guessed from its torque."""
    if not (model.has_floating_base or config.contacts):
        return None
    squares = [_mean_square_torques(log, model.joint_names) for log in logs]
    noise = initial_row_noise(model, np.sqrt(np.mean(squares, axis=0)))
    for name, value in config.base.noise.items():
        if name not in model.names:
            raise ConfigError(f"base.noise: {name}", f"is not a row of the equation; {suggestion(name, model.names)}")
        noise[model.names.index(name)] = value
    return ContactModel(model, config.contacts, noise)


def _mean_square_torques(log: JointLog, joints: Sequence[str]) -> Array:
    """Mean square of the logged torque in the log's segments, shape (joints,); of 1 N·m where none was logged."""
    columns = [log.joints.index(name) for name in joints]
    if "tau" not in log.signals:
        return np.ones(len(joints))
    total = np.zeros(len(joints))
    count = 0
    for segment in log.segments:
        logged = log.signals["tau"][segment]
        count += len(logged)
        for rows in blocks_of([logged], len(logged)):
            tau = logged[rows][:, columns]
            total += np.square(np.where(np.isfinite(tau), tau, 1.0)).sum(axis=0)
    return total / count


def _read(log: Path | JointLog, config: Config, robot: Robot) -> JointLog:
    if not isinstance(log, JointLog):
        options = config.log
        sensors = sensor_options(config)
        log = read_log(
            log,
            topic=options.topic,
            columns=options.columns,
            scale=dict(options.scale),
            sensors=sensors,
            messages=message_options(options, robot.joints),
        )
    if sensor_options(config) is not None:
        log = with_sensors(log, needed_channels(config))
    if config.wrench_sensors:
        log = with_unknown_torque(log, config.controller)
    return without_constant_torque(log, config.controller)


def _check_joints(logs: Sequence[JointLog], config: Config) -> None:
    """Refuse a log that lacks a joint of the configuration which another log has."""
    for name in config.joints or ():
        without = [log for log in logs if name not in log.joints]
        if without and len(without) < len(logs):
            what = f"has no joint {name}, which the configuration lists under joints and other logs have"
            raise LogError(without[0].path, f"{what}; leave out the log, or the joint")


def _check_signals(log: JointLog, joints: Sequence[str]) -> None:
    """Refuse a log in which a joint of the model has no position, or that has a value that no sensor gives."""
    for name in joints:
        if not log.has("q", name):
            raise LogError(log.path, f"joint {name} has no position; log it, or leave it out of joints")
    for signal, peaks in _finite_peaks(log.signals).items():
        for name in joints:
            peak = peaks[log.joints.index(name)]
            if peak > _LARGEST:
                raise LogError(
                    log.path, f"{signal} of joint {name} reaches {short_number(peak, 1)}; remove invalid readings"
                )
    for name, channel in log.channels.items():
        (peak,) = _finite_peaks({name: channel.x[:, None]})[name]
        if peak > _LARGEST:
            raise LogError(
                log.path, f"channel {printable(name)} reaches {short_number(peak, 1)}; remove invalid readings"
            )


def _finite_peaks(signals: Mapping[str, Array]) -> dict[str, Array]:
    """Greatest finite absolute value of each column of each signal, shapes (N, k) to (k,); 0 where none is finite."""

    def peaks_of(rows: slice) -> dict[str, Array]:
        peaks = {}
        for name, x in signals.items():
            sizes = np.abs(x[rows].T.copy(order="C"))
            sizes[~np.isfinite(sizes)] = 0.0
            peaks[name] = sizes.max(axis=1)
        return peaks

    count = max((len(x) for x in signals.values()), default=0)
    in_blocks = evaluate_blocks(peaks_of, signals.values(), count)
    peaks = {}
    for name, x in signals.items():
        of_blocks = [block[name] for block in in_blocks]
        peaks[name] = np.max(of_blocks, axis=0, initial=0.0) if of_blocks else np.zeros(x.shape[1])
    return peaks


def _check_sensors(log: JointLog, config: Config) -> None:
    """Refuse a log in which a wrench sensor or the IMU is dead."""
    for sensor in config.wrench_sensors:
        if is_dead(log, sensor.logged_channels):
            what = f"the wrench sensor at {sensor.joint} has a constant reading; log it, or remove it"
            raise LogError(log.path, what)
    if config.base.kind != "floating":
        return
    if config.base.pose is not None and is_dead(log, POSE):
        what = "the pose of the base has a constant reading; log it, or remove base.pose"
        raise LogError(log.path, what)
    from idtool.data.inspection.imu_findings import dead_imu_sensors

    if not config.base.uses_pose and (dead := dead_imu_sensors(log)):
        what = f"the {dead} of the IMU has a constant reading"
        raise LogError(log.path, f"{what}; log what it measures, or set base.kind: fixed if the base stands still")


def _split(signals: Signals, share: float) -> Run:
    """A log whose last ``share`` of samples is for validation, the first for fitting."""
    samples = sum(part.stop - part.start for part in signals.ranges)
    train, held_out = split_ranges(signals.ranges, round((1 - share) * samples))
    return Run(signals, train, held_out)


def split_ranges(ranges: Sequence[slice], count: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Ranges of samples, split into the first ``count`` samples and the rest."""
    remaining = count
    first, second = [], []
    for part in ranges:
        split = min(part.start + max(remaining, 0), part.stop)
        remaining -= part.stop - part.start
        if split > part.start:
            first.append(slice(part.start, split))
        if part.stop > split:
            second.append(slice(split, part.stop))
    return tuple(first), tuple(second)


def coefficients_of(robot: Robot, config: Config, experiment: Experiment) -> Array:
    """Another URDF's coefficients in the order of an experiment's, shape (p,).

    Parameters
    ----------
    robot
        From the other URDF.
    config
        Its configuration; its choice of joints gives way to the experiment's.
    experiment
        Whose torque equation the coefficients are for; what the other model lacks is zero.

    Raises
    ------
    ModelError
        If it is not a URDF of the same robot.
    """
    joints = experiment.model.joint_names
    own = experiment.config
    sensors = {"base": own.base, "contacts": own.contacts, "wrench_sensors": own.wrench_sensors}
    config = config.model_copy(update={"joints": joints, **sensors})
    model = replace(build_model(robot, config, joints), offset_logs=experiment.model.offset_logs)
    coefficients = LinearModel(model.names, build_effects(model, with_armature(config, model))).coefficients
    values = {c.key: c.prior for c in coefficients}
    if {body.name for body in model.bodies} != {body.name for body in experiment.model.bodies}:
        raise ModelError(robot.path, "does not have the same bodies as the model; compare URDFs of one robot")
    return np.array([values.get(c.key, 0.0) for c in experiment.equation.coefficients])
