"""`ReducedExperiment`: model and reduced logs, in place of model and logs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from typing_extensions import override

from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError, LogError
from idtool.common.names import join_names
from idtool.common.notice import Notice, unique
from idtool.common.provenance import InputFile
from idtool.dynamics.armature import with_armature
from idtool.dynamics.effects import build_effects
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.command_delay import with_delay
from idtool.estimation.dataset.equality_constraints import equality_constraints, with_equal_bounds
from idtool.estimation.dataset.experiment import Experiment, Progress, duplicate_notice, sources_of
from idtool.estimation.dataset.reduced_logs import ReducedLog, is_reducible, reduce_logs
from idtool.estimation.dataset.reduction import Reduction
from idtool.estimation.dataset.row_settings import first_difference, row_settings
from idtool.estimation.saved_reduction import SavedReduction
from idtool.robot.config import Config
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import Robot

_LONGEST_VALUE = 80  # characters of a setting in a message
_LOG_FILES = ("log", "bag metadata")  # kinds of files


@dataclass(frozen=True)
class ReducedExperiment(Experiment):
    """Model and reduced logs.

    Attributes
    ----------
    logs
        The logs.
    band
        Cut-off of the low-pass [Hz].
    log_notices
        Notices about the logs.
    files
        Files that were read, but for the URDF and the configuration.
    """

    logs: tuple[ReducedLog, ...] = ()
    band: float = 0.0
    log_notices: tuple[Notice, ...] = ()
    files: tuple[InputFile, ...] = ()

    @property
    @override
    def notices(self) -> tuple[Notice, ...]:
        return (*self.loading_notices, *self.model.notices, *self.log_notices)

    @property
    @override
    def sources(self) -> tuple[InputFile, ...]:
        return tuple(dict.fromkeys((*sources_of(self.model.robot, self.config), *self.files)))

    @property
    @override
    def log_paths(self) -> tuple[Path, ...]:
        return tuple(dict.fromkeys(log.path for log in self.logs))

    @property
    @override
    def has_commands(self) -> bool:
        return any(log.has_commands for log in self.logs)

    @override
    def is_torque_unknown(self, joint: str) -> bool:
        return all(joint in log.unknown_torque for log in self.logs if log.train)

    @property
    @override
    def has_held_out(self) -> bool:
        return any(log.held_out for log in self.logs)

    @property
    @override
    def band_hz(self) -> float:
        return self.band

    @override
    def samples(self, held_out: bool) -> int:
        return sum(part.samples for log in self.logs for part in log.parts(held_out))

    @override
    def checked(self, data: Reduction) -> Reduction:
        pairs = zip(self.equation.joints, data, strict=True)
        still = [name for name, factor in pairs if not factor.rows and not self.is_torque_unknown(name)]
        if still:
            what = f"joint {join_names(still)} hardly moves in the part of the logs that is used for the fit"
            raise LogError(self.log_paths[0], f"{what}; add a log with a motion of the joint")
        return data


def save_reduction(
    experiment: Experiment,
    holdout: float,
    progress: Progress,
    log_count: int | None = None,
    keeps_excerpts: bool = False,
) -> SavedReduction:
    """Reduce the logs of an experiment.

    Parameters
    ----------
    experiment
        Model and data.
    holdout
        Share of every log that was held out.
    progress
        Callback for the stage and its progress, from 0 to 1.
    log_count
        Number of logs that are used together, of which these are some; None: there are no others.
    keeps_excerpts
        If true, an excerpt of each log is kept, for a diagnosis.

    Raises
    ------
    ConfigError
        If what the rows are depends on what is fitted, or on all logs together.
    LogError
        If a log is too short.
    """
    if not is_reducible(experiment):
        what = "has effects that depend on other parameters or act on the measured torque"
        raise ConfigError("effects", f"{what}; idtool reduce cannot handle them, so fit the logs themselves")
    if experiment.lacks_gains:
        what = "fit depends on all logs together; fit the logs themselves"
        raise ConfigError("controller", f"{what}, and give the numbers that idtool fit writes to model.yaml")
    given = experiment.config.controller
    experiment, delay, _ = with_delay(experiment, progress)
    not_of_logs = {*experiment.model.notices, *experiment.loading_notices}
    notices = [notice for notice in experiment.notices if notice not in not_of_logs]
    if delay is not None and given is not None:
        notices += delay.notices
    return SavedReduction(
        settings=row_settings(experiment.model, experiment.config, experiment.band_hz),
        coefficients=tuple(c.key for c in experiment.equation.coefficients),
        band_hz=experiment.band_hz,
        delay=None if delay is None else delay.value,
        holdout=holdout,
        notices=tuple(notices),
        files=experiment.sources,
        logs=reduce_logs(experiment, progress, log_count, True, draws_rows=True, keeps_excerpts=keeps_excerpts),
    )


def merged_reduction(experiment: ReducedExperiment, holdout: float) -> SavedReduction:
    """One reduction of the logs of several.

    Parameters
    ----------
    experiment
        Model and reduced logs.
    holdout
        Share of every log that was held out.
    """
    controller = experiment.config.controller
    known = controller.known_delay if controller is not None else None
    return SavedReduction(
        settings=row_settings(experiment.model, experiment.config, experiment.band_hz),
        coefficients=tuple(c.key for c in experiment.equation.coefficients),
        band_hz=experiment.band_hz,
        delay=None if known is None else known.value,
        holdout=holdout,
        notices=experiment.log_notices,
        files=experiment.sources,
        logs=experiment.logs,
    )


def prepare_reduced(
    robot: Robot,
    config: Config,
    reductions: Sequence[tuple[Path, SavedReduction]],
    validate: Sequence[tuple[Path, SavedReduction]] = (),
) -> ReducedExperiment:
    """Put a model and reduced logs together.

    Parameters
    ----------
    robot
        From the URDF.
    config
        The configuration.
    reductions
        Reduced logs to fit to, each with its file.
    validate
        Reduced logs for validation; where given, nothing is held out of the others.

    Raises
    ------
    IdtoolError
        If the configuration or the model cannot be used, or the logs were reduced with other ones.
    """
    every = (*reductions, *validate)
    first = every[0][1]
    config = _with_fitted_settings(config, first)
    model = build_model(robot, config, first.settings["joints"])
    config = with_armature(config, model)
    settings = row_settings(model, config, config.filter.cutoff_hz or first.band_hz)
    equation = LinearModel(model.names, build_effects(model, config))
    for path, reduction in every:
        _check_settings(path, reduction, settings, equation)
    logs: list[ReducedLog] = []
    for _, reduction in reductions:
        logs += [_all_for_fit(log) for log in reduction.logs] if validate else reduction.logs
    for _, reduction in validate:
        logs += map(_all_for_validation, reduction.logs)
    equalities = equality_constraints(config, model, equation)
    notices = [*_duplicate_notices(reductions), *_notices_of_logs([reduction for _, reduction in every])]
    files = [file for _, reduction in every for file in reduction.files if file.kind in _LOG_FILES]
    return ReducedExperiment(
        config,
        with_equal_bounds(model, equalities),
        equation,
        equalities,
        (),
        logs=tuple(logs),
        band=first.band_hz,
        log_notices=unique(notices),
        files=tuple(dict.fromkeys(files)),
    )


def _notices_of_logs(reductions: Sequence[SavedReduction]) -> Iterator[Notice]:
    """Notices about logs; one about a log that was reduced alone names it, if there are others."""
    for reduction in reductions:
        is_one_of_many = len(reduction.logs) == 1 and len(reductions) > 1
        for notice in reduction.notices:
            yield notice.in_log(reduction.logs[0].name) if is_one_of_many else notice


def _duplicate_notices(reductions: Sequence[tuple[Path, SavedReduction]]) -> Iterator[Notice]:
    """Notices about reductions of the same logs."""
    names_by_content: dict[tuple[str | None, ...], list[str]] = {}
    for path, reduction in reductions:
        content = tuple(file.sha256 for file in reduction.files if file.kind == "log")
        if content and None not in content:
            names_by_content.setdefault(content, []).append(path.name)
    for names in names_by_content.values():
        if len(names) > 1:
            yield duplicate_notice(names)


def _with_fitted_settings(config: Config, reduction: SavedReduction) -> Config:
    """The configuration with the band and the delay of a reduction where it leaves them open."""
    if config.filter.cutoff_hz is None:
        band = config.filter.model_copy(update={"cutoff_hz": reduction.band_hz})
        config = config.model_copy(update={"filter": band})
    controller = config.controller
    if controller is not None and controller.known_delay is None and reduction.delay is not None:
        controller = controller.model_copy(update={"delay": reduction.delay})
        config = config.model_copy(update={"controller": controller})
    return config


def _check_settings(path: Path, reduction: SavedReduction, settings: Mapping[str, Any], equation: LinearModel) -> None:
    """Refuse a reduction whose rows are not those of a model."""
    difference = first_difference(reduction.settings, settings)
    if difference is not None:
        key, old, new = difference
        was = f"was made with {key}: {_value_text(old)}, which is now {_value_text(new)}"
        raise LogError(path, f"{was}; make it again with idtool reduce")
    if reduction.coefficients != tuple(c.key for c in equation.coefficients):
        raise LogError(path, "was made with other bodies or terms of the model; make it again with idtool reduce")


def _value_text(value: Any) -> str:
    """A value of a setting, shortened."""
    text = "not set" if value is None else str(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}…"


def _all_for_fit(log: ReducedLog) -> ReducedLog:
    """A log whose held-out part is for the fit too."""
    return replace(log, train=(*log.train, *log.held_out), held_out=())


def _all_for_validation(log: ReducedLog) -> ReducedLog:
    """A log that is for validation alone."""
    return replace(log, train=(), held_out=(*log.train, *log.held_out))
