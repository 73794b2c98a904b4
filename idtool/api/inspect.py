"""`inspect`: the contents and faults of a log."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from idtool.api.data import LogSource
from idtool.api.log import Log
from idtool.api.model import Source, load_settings
from idtool.api.results import notice_lines
from idtool.data.base_sensors import sensor_options
from idtool.data.controller import with_unknown_torque
from idtool.data.inspection import inspect_log
from idtool.data.logs import JointLog, read_log
from idtool.data.logs.message_options import message_options
from idtool.reporting.inspection_report import inspection_report
from idtool.reporting.results.inspection import InspectionReport
from idtool.robot.config import Config


class InspectionResult(InspectionReport):
    """Inspection of a log: its contents and its faults. The fields are what `idtool inspect --json` prints."""

    def __repr__(self) -> str:
        joints = ", ".join(self.joints)
        title = f"InspectionResult {self.path}: {self.samples} samples at {self.rate_hz:.4g} Hz, {joints}"
        return "\n".join([title, *notice_lines(self.notices)])


def inspect(log: LogSource, *, config: Source | Mapping[str, Any] | None = None) -> InspectionResult:
    """Determine the contents and the faults of a log, like `idtool inspect`.

    Parameters
    ----------
    log
        A path, or a `Log`.
    config
        Configuration, as in `Model`: how a file is read, and which sensors it must have. None: the defaults.

    Raises
    ------
    IdtoolError
        If the log or the configuration cannot be read.
    """
    settings = load_settings(config)
    record = log.record if isinstance(log, Log) else _read(log, settings)
    if settings.wrench_sensors:
        record = with_unknown_torque(record, settings.controller)
    return InspectionResult.from_result(inspection_report(inspect_log(record, settings)))


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
