"""`inspect`: the contents and faults of a log."""

from __future__ import annotations

from idtool.api.data import LogSource
from idtool.api.log import Log
from idtool.api.results import notice_lines
from idtool.data.inspection import inspect_log
from idtool.reporting.inspection_report import inspection_report
from idtool.reporting.results.inspection import InspectionReport


class InspectionResult(InspectionReport):
    """Inspection of a log: its contents and its faults. The fields are what `idtool inspect --json` prints."""

    def __repr__(self) -> str:
        joints = ", ".join(self.joints)
        title = f"InspectionResult {self.path}: {self.samples} samples at {self.rate_hz:.4g} Hz, {joints}"
        return "\n".join([title, *notice_lines(self.notices)])


def inspect(log: LogSource) -> InspectionResult:
    """Determine the contents and the faults of a log, like `idtool inspect`.

    Parameters
    ----------
    log
        A path, or a `Log`.

    Raises
    ------
    LogError
        If the log cannot be read.
    """
    record = (log if isinstance(log, Log) else Log(log)).record
    return InspectionResult.from_result(inspection_report(inspect_log(record)))
