"""`inspect`: the contents and faults of a log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from idtool.api.data import LogSource
from idtool.api.log import Log
from idtool.api.model import Model, Source, load_settings
from idtool.api.notebook import Displayable
from idtool.api.results import notice_lines
from idtool.common.exceptions import IdtoolError
from idtool.common.notice import Notice
from idtool.common.number_text import short_number
from idtool.data.base_sensors import sensor_options
from idtool.data.controller import with_unknown_torque
from idtool.data.inspection import inspect_log
from idtool.data.inspection.findings import in_order
from idtool.data.logs import JointLog, read_log
from idtool.data.logs.message_options import message_options
from idtool.estimation.dataset.experiment import prepare
from idtool.reporting.inspection_report import inspection_report
from idtool.reporting.results.inspection import InspectionReport
from idtool.robot.config import Config
from idtool.robot.urdf.reading import read_robot

if TYPE_CHECKING:
    from idtool.reporting.terminal.output import Output


class InspectionResult(InspectionReport, Displayable):
    """Inspection of a log: its contents and its faults. The fields are what `idtool inspect --json` prints."""

    def _show(self, output: Output) -> None:
        from idtool.reporting.terminal.inspection import show_inspection

        show_inspection(output, self)

    def __repr__(self) -> str:
        joints = ", ".join(self.joints)
        title = f"InspectionResult {self.path}: {self.samples} samples at {short_number(self.rate_hz, 4)} Hz, {joints}"
        return "\n".join([title, *notice_lines(self.notices)])


def inspect(
    log: LogSource, *, config: Source | Mapping[str, Any] | None = None, urdf: Source | None = None
) -> InspectionResult:
    """Determine the contents and the faults of a log, like `idtool inspect`.

    Parameters
    ----------
    log
        A path, or a `Log`.
    config
        Configuration, as in `Model`: how a file is read, and which sensors it must have. None: the defaults, or what
        is beside the URDF.
    urdf
        URDF with which the IMU, the contacts and the wrench sensors of the configuration are compared. None: that of
        the configuration's name beside it, if there is one.

    Raises
    ------
    IdtoolError
        If the log, the configuration or the URDF cannot be read.
    """
    settings = Model(urdf).settings if config is None and urdf is not None else load_settings(config)
    record = log.record if isinstance(log, Log) else _read(log, settings)
    if settings.wrench_sensors:
        record = with_unknown_torque(record, settings.controller)
    inspection = inspect_log(record, settings)
    findings = [*inspection.findings, *_robot_findings(record, settings, config, urdf)]
    inspection = replace(inspection, findings=in_order(findings))
    return InspectionResult.from_result(inspection_report(inspection))


def _robot_findings(
    log: JointLog, settings: Config, config: Source | Mapping[str, Any] | None, urdf: Source | None
) -> Iterator[Notice]:
    """Notices about the sensors of a robot that only its URDF shows."""
    if sensor_options(settings) is None:
        return
    if urdf is not None:
        yield from _comparison_notices(log, settings, Path(urdf))
        return
    if config is None or isinstance(config, Mapping):
        return
    beside = Path(config).with_suffix(".urdf")
    if not beside.is_file():
        return
    try:
        yield from _comparison_notices(log, settings, beside)
    except IdtoolError as error:  # the user did not ask for this comparison
        yield Notice("not_compared_with_urdf", "note", None, f"the log was not compared with {beside.name}: {error}")


def _comparison_notices(log: JointLog, settings: Config, urdf: Path) -> tuple[Notice, ...]:
    return prepare(read_robot(urdf), settings, [log], holdout=0.0).comparison_notices


def _read(path: Source, settings: Config) -> JointLog:
    """The log in a file, as a configuration says."""
    options = settings.log
    return read_log(
        path,
        topic=options.topic,
        columns=options.columns,
        scale=dict(options.scale),
        sensors=sensor_options(settings),
        messages=message_options(options),
    )
